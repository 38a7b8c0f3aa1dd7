"""A physics scene while somebody acts in it: what is wanted of each hand, what is seen, what comes of it."""

from dataclasses import dataclass, field

import mujoco
import numpy as np

from demoplan.engines.mujoco.demonstration import Demonstration, DemonstrationParams, HandArrays, Phase
from demoplan.engines.mujoco.hands import SIDES, Hand, HandParams, add_hand
from demoplan.engines.mujoco.motion import Tremor
from demoplan.engines.mujoco.participants import Participant
from demoplan.engines.mujoco.scene import (
    CubeIndex,
    Layout,
    SceneParams,
    build_scene,
    is_resting_on,
    touching,
)
from demoplan.engines.mujoco.tasks import Task
from demoplan.geometry import Array, multiply, rotate


@dataclass
class Intent:
    """What the participant wants of one hand now."""

    position_xyz_m: Array
    orientation_wxyz: Array
    closure: float = 0.0
    phase: Phase = Phase.REST
    step: int = -1


@dataclass
class _Track:
    """What one hand did, one element per tick."""

    position_xyz_m: list[Array] = field(default_factory=list)
    orientation_wxyz: list[Array] = field(default_factory=list)
    grip: list[float] = field(default_factory=list)
    intended_xyz_m: list[Array] = field(default_factory=list)
    phase: list[int] = field(default_factory=list)
    step: list[int] = field(default_factory=list)
    is_held: list[bool] = field(default_factory=list)


def yaw_quaternion(yaw_rad: float) -> Array:
    """A turn about the vertical, ``(4,)``."""
    return np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])


def _tilt(roll_rad: float, pitch_rad: float) -> Array:
    roll = np.array([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0.0, 0.0])
    pitch = np.array([np.cos(pitch_rad / 2), 0.0, np.sin(pitch_rad / 2), 0.0])
    return multiply(roll, pitch)


def yaw_of(orientation_wxyz: Array) -> float:
    """How a body is turned about the vertical [rad]."""
    w, x, y, z = orientation_wxyz
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


class Workspace:
    """Cubes on a table and the hands that act, advanced tick by tick; every tick is written down."""

    def __init__(
        self,
        participant: Participant,
        task: Task,
        layout: Layout,
        rng: np.random.Generator,
        *,
        scene: SceneParams,
        hand: HandParams,
        params: DemonstrationParams,
    ) -> None:
        """Build the scene; both hands rest, and only those that the task needs have a body."""
        self.task, self.layout = task, layout
        self.scene, self.hand_params, self.params = scene, hand, params
        acting = sorted({step.hand for step in task.steps})
        spec = build_scene(layout, scene)
        x, y, z = participant.rest_xyz_m
        rest = {side: np.array([x, y if side == "Right_hand" else -y, z]) for side in SIDES}
        for side in acting:
            add_hand(spec, side, rest[side], hand)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._index = CubeIndex.of(self._model, layout.names)
        self.hands = {side: Hand(self._model, self._data, side, hand) for side in acting}
        self._tremor = {
            side: Tremor(rng, participant.tremor_rms_m, participant.drift_rms_m) for side in SIDES
        }
        tilt = {side: _tilt(*rng.normal(0.0, 0.12, 2)) for side in SIDES}
        self.intent = {
            side: Intent(rest[side].copy(), multiply(yaw_quaternion(rng.normal(0.0, 0.15)), tilt[side]))
            for side in SIDES
        }
        self.rest = rest
        self.rest_orientation = {side: self.intent[side].orientation_wxyz for side in SIDES}
        self._tracks = {side: _Track() for side in SIDES}
        self._cube_positions: list[Array] = []
        self._cube_orientations: list[Array] = []
        self._ids = [self._index.bodies[name] for name in layout.names]

    def cube(self, name: str) -> Array:
        """Where a cube is, ``(3,)``."""
        return np.array(self._data.xpos[self._index.bodies[name]])

    def cube_yaw(self, name: str) -> float:
        """How a cube is turned about the vertical [rad]."""
        axes = self._data.xmat[self._index.bodies[name]].reshape(3, 3)
        # A cube that has rolled over stands on another face: its most level edge tells how it is turned.
        edge = axes[:, np.argmin(np.abs(axes[2]))]
        return float(np.arctan2(edge[1], edge[0]))

    def holds(self, side: str, cube: str) -> bool:
        """Whether a cube is where the fingers close."""
        gap = np.linalg.norm(self.cube(cube) - self.hands[side].grasp_point_xyz_m)
        return bool(gap <= self.params.lost_distance_m)

    def has_come_down(self, cube: str) -> bool:
        """Whether a carried cube has come down on anything but the hand."""
        geoms = self._index.geoms
        return any(touching(self._data, geoms[cube], geom) for name, geom in geoms.items() if name != cube)

    def is_reachable(self, cube: str) -> bool:
        """Whether a cube is still on the table, and upright enough to be taken."""
        position = self.cube(cube)
        depth, width, _ = self.scene.table_size_xyz_m
        return bool(abs(position[0]) < depth / 2 and abs(position[1]) < width / 2 and position[2] > 0.0)

    def settle(self) -> None:
        """Let everything come to rest before anybody looks."""
        for side, hand in self.hands.items():
            hand.command(self.intent[side].position_xyz_m, self.intent[side].orientation_wxyz, 0.0)
        mujoco.mj_step(self._model, self._data, nstep=round(self.scene.settle_s / self.scene.timestep_s))

    def tick(self) -> None:
        """Command every hand, let physics run for one control step, and write down what is then so."""
        n = len(self._cube_positions)
        now_s = n * self.params.control_step_s
        shifted = {side: self.intent[side].position_xyz_m + self._tremor[side].at(now_s) for side in SIDES}
        for side, hand in self.hands.items():
            intent = self.intent[side]
            hand.command(shifted[side], intent.orientation_wxyz, intent.closure)
        if n:
            steps = round(self.params.control_step_s / self.scene.timestep_s)
            mujoco.mj_step(self._model, self._data, nstep=steps)
        self._cube_positions.append(self._data.xpos[self._ids])
        self._cube_orientations.append(self._data.xquat[self._ids])
        for side, track in self._tracks.items():
            intent = self.intent[side]
            acting = self.hands.get(side)
            track.position_xyz_m.append(shifted[side] if acting is None else acting.position_xyz_m)
            track.orientation_wxyz.append(
                intent.orientation_wxyz if acting is None else acting.orientation_wxyz
            )
            track.grip.append(intent.closure)
            track.intended_xyz_m.append(intent.position_xyz_m)
            track.phase.append(int(intent.phase))
            track.step.append(intent.step)
            track.is_held.append(
                acting is not None
                and intent.step >= 0
                and intent.closure > 0.5
                and self.holds(side, self.task.steps[intent.step].cube)
            )

    def finish(self, n_misses: int) -> Demonstration:
        """All that was written down, and whether the goal is reached now."""
        resting = all(
            is_resting_on(self._data, self._index, cube, support, self.scene)
            for cube, support in self.task.goal
        )
        n = len(self._cube_positions)
        step_s = self.params.control_step_s
        return Demonstration(
            task=self.task,
            cubes=self.layout.names,
            time_s=np.arange(n, dtype=np.float64) * step_s,
            cube_position_xyz_m=np.array(self._cube_positions),
            cube_orientation_wxyz=np.array(self._cube_orientations),
            hands={side: self._arrays(track) for side, track in self._tracks.items()},
            is_goal_reached=resting,
            n_misses=n_misses,
            physics={
                "engine": f"mujoco {mujoco.__version__}",
                "friction_cone": self.scene.friction_cone,
                "impedance_ratio": str(self.scene.impedance_ratio),
                "timestep_s": str(self.scene.timestep_s),
                "cube_edge_m": str(self.scene.cube_edge_m),
                "cube_mass_kg": str(self.scene.cube_mass_kg),
                "cube_friction": str(self.scene.cube_friction),
            },
        )

    def _arrays(self, track: _Track) -> HandArrays:
        intended = np.array(track.intended_xyz_m)
        velocity = np.gradient(intended, self.params.control_step_s, axis=0)
        orientation = np.array(track.orientation_wxyz)
        to_grasp = np.array([0.0, 0.0, -self.hand_params.grasp_point_m])
        return HandArrays(
            position_xyz_m=np.array(track.position_xyz_m) + rotate(orientation, to_grasp),
            orientation_wxyz=orientation,
            trigger=np.array(track.grip),
            speed_m_per_s=np.linalg.norm(velocity, axis=1),
            phase=np.array(track.phase, dtype=np.int64),
            step=np.array(track.step, dtype=np.int64),
            is_held=np.array(track.is_held, dtype=bool),
        )
