"""A participant carries out a task in a physics scene; what really happened is written down tick by tick.

The participant is a script that yields one command per control tick and looks at the scene as a person
would: it sees where cubes are, whether the cube comes along, and whether it has come down on something.
What becomes of the cubes is left to physics.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from enum import IntEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.hands import SIDES, Hand, HandParams, add_hand
from demoplan.engines.mujoco.motion import (
    ArcParams,
    Hesitation,
    MovementClock,
    Path,
    Submovement,
    Tremor,
    arc,
    minimum_jerk,
)
from demoplan.engines.mujoco.participants import Participant
from demoplan.engines.mujoco.scene import (
    TABLE,
    CubeIndex,
    Layout,
    SceneParams,
    build_scene,
    free_spot,
    is_resting_on,
    touching,
)
from demoplan.engines.mujoco.tasks import Step, Task
from demoplan.geometry import Array, multiply, rotate, slerp


class Phase(IntEnum):
    """What a participant is about to do with one hand; the commands of a phase begin with the phase."""

    REST = 0
    APPROACH = 1
    GRASP = 2
    CARRY = 3
    LET_GO = 4
    RETREAT = 5


@dataclass(frozen=True, kw_only=True)
class DemonstrationParams:
    """How a demonstration is run."""

    control_step_s: float = 0.004
    """Time between two commands, a multiple of the physics step [s]."""
    most_attempts: int = 4
    """How often a participant tries one step before giving up."""
    longest_s: float = 120.0
    """A demonstration that takes longer is ended [s]."""
    lost_distance_m: float = 0.035
    """A cube that far from the grasp point is not in the hand [m]."""
    touch_depth_m: float = 0.0015
    """How far below contact the hand aims when it sets a cube down [m]."""


@dataclass
class HandTrack:
    """What one hand did, one element per tick."""

    position_xyz_m: list[Array] = field(default_factory=list)
    orientation_wxyz: list[Array] = field(default_factory=list)
    grip: list[float] = field(default_factory=list)
    intended_xyz_m: list[Array] = field(default_factory=list)
    phase: list[int] = field(default_factory=list)
    step: list[int] = field(default_factory=list)
    is_held: list[bool] = field(default_factory=list)


@dataclass(frozen=True)
class Demonstration:
    """What really happened, on the control clock."""

    task: Task
    cubes: tuple[str, ...]
    time_s: Array
    """``(n,)``, from 0, evenly spaced."""
    cube_position_xyz_m: Array
    """``(n, k, 3)``"""
    cube_orientation_wxyz: Array
    """``(n, k, 4)``"""
    hands: dict[str, "HandArrays"]
    is_goal_reached: bool
    n_misses: int
    """Grasps that closed on nothing, or lost the cube."""
    physics: dict[str, str]
    """Contact options and sizes, for the record."""


@dataclass(frozen=True)
class HandArrays:
    """One hand, one row per tick."""

    position_xyz_m: Array
    """Middle of the grasp, ``(n, 3)``: the point that OpenXR calls the grip pose's origin."""
    orientation_wxyz: Array
    """``(n, 4)``"""
    trigger: Array
    """What the person's finger does: 0 let go, 1 pulled; ``(n,)``."""
    speed_m_per_s: Array
    """Speed of the intended movement, without tremor; ``(n,)``."""
    phase: NDArray[np.int64]
    step: NDArray[np.int64]
    """Index of the task's step, −1 where there is none."""
    is_held: NDArray[np.bool_]
    """The step's cube is in the hand, as physics has it."""


@dataclass
class _Intent:
    """What the participant wants of one hand now."""

    position_xyz_m: Array
    orientation_wxyz: Array
    closure: float = 0.0
    phase: Phase = Phase.REST
    step: int = -1


Script = Generator[None, None, None]


def _yaw_quaternion(yaw_rad: float) -> Array:
    return np.array([np.cos(yaw_rad / 2), 0.0, 0.0, np.sin(yaw_rad / 2)])


def _tilt(roll_rad: float, pitch_rad: float) -> Array:
    roll = np.array([np.cos(roll_rad / 2), np.sin(roll_rad / 2), 0.0, 0.0])
    pitch = np.array([np.cos(pitch_rad / 2), 0.0, np.sin(pitch_rad / 2), 0.0])
    return multiply(roll, pitch)


def _yaw_of(orientation_wxyz: Array) -> float:
    w, x, y, z = orientation_wxyz
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _nearest_quarter(yaw_rad: float, to_rad: float) -> float:
    """The angle that is a multiple of 90° from ``yaw_rad`` and nearest to ``to_rad``."""
    quarter = np.pi / 2
    return float(yaw_rad + quarter * np.round((to_rad - yaw_rad) / quarter))


class _Session:
    """One participant in one scene: the state that a demonstration changes while it runs."""

    def __init__(
        self,
        participant: Participant,
        task: Task,
        layout: Layout,
        rng: np.random.Generator,
        scene: SceneParams,
        hand: HandParams,
        params: DemonstrationParams,
    ) -> None:
        self.who, self.task, self.layout, self.rng = participant, task, layout, rng
        self.scene, self.hand_params, self.params = scene, hand, params
        acting = sorted({step.hand for step in task.steps})
        spec = build_scene(layout, scene)
        rest = {side: self._rest_of(side) for side in SIDES}
        for side in acting:
            add_hand(spec, side, rest[side], hand)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.index = CubeIndex.of(self.model, layout.names)
        self.hands = {side: Hand(self.model, self.data, side, hand) for side in acting}
        self.tremor = {side: Tremor(rng, participant.tremor_rms_m, participant.drift_rms_m) for side in SIDES}
        self.tilt = {side: _tilt(*rng.normal(0.0, 0.12, 2)) for side in SIDES}
        self.intent = {
            side: _Intent(
                rest[side].copy(), multiply(_yaw_quaternion(rng.normal(0.0, 0.15)), self.tilt[side])
            )
            for side in SIDES
        }
        self.rest = rest
        self.rest_orientation = {side: self.intent[side].orientation_wxyz for side in SIDES}
        self.tracks = {side: HandTrack() for side in SIDES}
        self.cube_positions: list[Array] = []
        self.cube_orientations: list[Array] = []
        self.n_misses = 0
        self.ids = [self.index.bodies[name] for name in layout.names]

    def _rest_of(self, side: str) -> Array:
        x, y, z = self.who.rest_xyz_m
        return np.array([x, y if side == "Right_hand" else -y, z])

    # --- what the participant sees -------------------------------------------------------------

    def cube(self, name: str) -> Array:
        """Where a cube is, ``(3,)``."""
        return np.array(self.data.xpos[self.index.bodies[name]])

    def cube_yaw(self, name: str) -> float:
        """How a cube is turned about the vertical [rad]."""
        axes = self.data.xmat[self.index.bodies[name]].reshape(3, 3)
        # A cube that has rolled over stands on another face: its most level edge tells how it is turned.
        edge = axes[:, np.argmin(np.abs(axes[2]))]
        return float(np.arctan2(edge[1], edge[0]))

    def holds(self, side: str, cube: str) -> bool:
        """Whether a cube is where the fingers close."""
        gap = np.linalg.norm(self.cube(cube) - self.hands[side].grasp_point_xyz_m)
        return bool(gap <= self.params.lost_distance_m)

    def is_on_support(self, cube: str, step: Step) -> bool:
        """Whether a carried cube has come down on anything but the hand."""
        geoms = self.index.geoms
        return any(touching(self.data, geoms[cube], geom) for name, geom in geoms.items() if name != cube)

    # --- physics ---------------------------------------------------------------------------------

    def settle(self) -> None:
        """Let everything come to rest before anybody looks."""
        for side, hand in self.hands.items():
            hand.command(self.intent[side].position_xyz_m, self.intent[side].orientation_wxyz, 0.0)
        mujoco.mj_step(self.model, self.data, nstep=round(self.scene.settle_s / self.scene.timestep_s))

    def tick(self) -> None:
        """Command every hand, let physics run for one control step, and write down what is then so."""
        n = len(self.cube_positions)
        now_s = n * self.params.control_step_s
        shifted = {side: self.intent[side].position_xyz_m + self.tremor[side].at(now_s) for side in SIDES}
        for side, hand in self.hands.items():
            intent = self.intent[side]
            hand.command(shifted[side], intent.orientation_wxyz, intent.closure)
        if n:
            steps = round(self.params.control_step_s / self.scene.timestep_s)
            mujoco.mj_step(self.model, self.data, nstep=steps)
        self.cube_positions.append(self.data.xpos[self.ids])
        self.cube_orientations.append(self.data.xquat[self.ids])
        for side, track in self.tracks.items():
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

    # --- what the participant does ---------------------------------------------------------------

    def chance(self, probability: float) -> bool:
        """A coin that falls on this side with a probability."""
        return bool(self.rng.random() < probability)

    def wait(self, duration_s: float) -> Script:
        """Leave everything as it is."""
        for _ in range(max(1, round(duration_s / self.params.control_step_s))):
            yield

    def squeeze(self, side: str, closure: float, duration_s: float) -> Script:
        """Move the trigger."""
        intent = self.intent[side]
        start = intent.closure
        n = max(2, round(duration_s / self.params.control_step_s))
        for k in range(1, n + 1):
            intent.closure = start + (closure - start) * float(minimum_jerk(np.array(k / n)))
            yield

    def follow(
        self,
        side: str,
        path: Path,
        orientation_wxyz: Array,
        *,
        may_hesitate: bool = True,
        watch: str | None = None,
        until_contact: str | None = None,
        step: Step | None = None,
        open_to: float | None = None,
    ) -> Generator[None, None, bool]:
        """Move the hand along a path; whether it got to the end as it meant to.

        Args:
            side: The hand.
            path: Where to.
            orientation_wxyz: How to be turned in the end.
            may_hesitate: Whether this person may hesitate on this way.
            watch: A cube that should come along: when it does not, the hand stops after a reaction time.
            until_contact: A held cube: when it comes down on something, the hand stops.
            step: The step, where ``until_contact`` is given.
            open_to: Closure that the hand goes to on the way.
        """
        intent = self.intent[side]
        start_orientation, start_closure = intent.orientation_wxyz, intent.closure
        hesitations: list[Hesitation] = []
        if may_hesitate and path.duration_s > 0.5 and self.chance(self.who.hesitation_probability):
            hesitations.append(
                Hesitation(
                    float(self.rng.uniform(0.3, 0.75) * path.duration_s),
                    float(self.rng.uniform(0.25, 0.75)),
                    float(self.rng.uniform(0.7, 1.0)),
                )
            )
        clock = MovementClock(hesitations)
        step_s = self.params.control_step_s
        reaction_s, missing_s = float(self.rng.uniform(0.18, 0.35)), 0.0
        is_fine = True
        while clock.time_s < path.duration_s and not clock.is_stopped:
            clock.advance(step_s)
            done = minimum_jerk(np.array([clock.time_s / path.duration_s]))
            intent.position_xyz_m = path.at(clock.time_s)
            intent.orientation_wxyz = slerp(start_orientation[None], orientation_wxyz[None], done)[0]
            if open_to is not None:
                early = minimum_jerk(np.array(clock.time_s / (0.5 * path.duration_s)))
                intent.closure = start_closure + (open_to - start_closure) * float(early)
            yield
            if watch is not None:
                missing_s = 0.0 if self.holds(side, watch) else missing_s + step_s
                if missing_s >= reaction_s:
                    is_fine = False
                    clock.brake(0.20)
            if until_contact is not None and step is not None and self.is_on_support(until_contact, step):
                clock.brake(0.05)
        return is_fine

    def duration_of(self, start: Array, end: Array, clearance_m: float) -> float:
        """How long this person takes from one place to another [s]."""
        across = float(np.linalg.norm(end[:2] - start[:2]))
        top = max(start[2], end[2]) + clearance_m
        length = across + 0.7 * float((top - start[2]) + (top - end[2]))
        varied = float(np.exp(self.rng.normal(0.0, 0.08)))
        return varied * (self.who.movement_base_s + length / self.who.speed_m_per_s)

    def arc_to(
        self, side: str, end: Array, *, lift_m: float, onset: float, settle: float, held: str | None = None
    ) -> Path:
        """An arc from where the hand is, at this person's speed and curvature.

        Args:
            side: The hand.
            end: Where the palm is to come.
            lift_m: How far the hand goes up from where it is before it may go across [m].
            onset: Share of the time after which it goes across.
            settle: Share of the time, at the end, in which it only goes down.
            held: The cube in the hand.
        """
        start = self.intent[side].position_xyz_m
        usual = self.who.clearance_m * float(self.rng.uniform(0.85, 1.2))
        highest = max(float(start[2]), float(end[2]))
        if lift_m == 0.0 and start[2] > end[2] and np.linalg.norm(end[:2] - start[:2]) < 0.08:
            # Already above it: straight down, as after a grasp that missed.
            return self.straight(side, end, self.duration_of(start, end, 0.0))
        clearance = max(start[2] + lift_m, end[2] + usual, highest) - highest
        sign = 1.0 if side == "Right_hand" else -1.0
        curvature = sign * self.who.curvature * float(self.rng.uniform(0.6, 1.4))
        duration_s = self.duration_of(start, end, clearance)
        for _ in range(6):
            path = arc(
                start,
                end,
                ArcParams(
                    duration_s=duration_s,
                    clearance_m=clearance,
                    curvature=curvature,
                    onset_share=onset,
                    settle_share=settle,
                ),
            )
            if not self.would_hit(path, held):
                break
            clearance += 0.03
            duration_s += 0.03 / self.who.speed_m_per_s
        return path

    def would_hit(self, path: Path, held: str | None) -> bool:
        """Whether fingers or cargo would touch a cube while they go across, between both ends of a path."""
        way = np.array([path.at(time_s) for time_s in np.linspace(0.0, path.duration_s, 32)])
        across = way[:, :2]
        is_between = (np.linalg.norm(across - across[0], axis=1) > 0.02) & (
            np.linalg.norm(across - across[-1], axis=1) > 0.02
        )
        spots = np.array([self.cube(name) for name in self.layout.names if name != held]).reshape(-1, 3)
        aside = np.linalg.norm(across[:, None] - spots[None, :, :2], axis=2)
        lowest = way[:, 2] - self.hand_params.grasp_point_m - self.scene.cube_edge_m / 2 - 0.005
        is_low = lowest[:, None] < spots[None, :, 2] + self.scene.cube_edge_m / 2
        return bool((is_low & (aside < 0.10) & is_between[:, None]).any())

    def straight(self, side: str, end: Array, duration_s: float) -> Path:
        """A straight way from where the hand is."""
        start = self.intent[side].position_xyz_m
        dx, dy, dz = (float(value) for value in end - start)
        return Path(start, (Submovement((dx, dy, dz), 0.0, duration_s),))

    def palm_above(self, point: Array) -> Array:
        """Where the palm is when the fingers close at a point."""
        palm: Array = point + np.array([0.0, 0.0, self.hand_params.grasp_point_m])
        return palm

    def reach(self, side: str, cube: str) -> Generator[None, None, None]:
        """Go to a cube with an open hand; now and then the aim is off."""
        intent = self.intent[side]
        intent.phase = Phase.APPROACH
        yaw = _nearest_quarter(self.cube_yaw(cube), _yaw_of(intent.orientation_wxyz))
        aim = np.append(self.rng.normal(0.0, self.who.aim_sd_m, 2), 0.0)
        aim[2] = self.who.grasp_height_m + self.rng.normal(0.0, 0.0015)
        if self.chance(self.who.miss_probability):
            if self.chance(0.5):
                aim[2] += self.rng.uniform(0.040, 0.052)
            else:
                forward = self.rng.choice([-1.0, 1.0]) * self.rng.uniform(0.041, 0.050)
                aim[:2] += forward * np.array([np.cos(yaw), np.sin(yaw)])
        goal = self.palm_above(self.cube(cube) + aim)
        orientation = _yaw_quaternion(yaw + self.rng.normal(0.0, self.who.yaw_sd_rad))
        path = self.arc_to(side, goal, lift_m=0.0, onset=0.05, settle=0.22)
        yield from self.follow(side, path, orientation, open_to=0.0)
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.5, 1.6)))

    def grasp(self, side: str) -> Script:
        """Close the fingers; now and then loosen and close them again."""
        intent = self.intent[side]
        intent.phase = Phase.GRASP
        yield from self.squeeze(side, 1.0, self.who.grip_s * float(self.rng.uniform(0.85, 1.25)))
        if self.chance(self.who.regrasp_probability):
            yield from self.wait(float(self.rng.uniform(0.05, 0.15)))
            yield from self.squeeze(side, float(self.rng.uniform(0.2, 0.6)), self.who.grip_s)
            shift = np.append(self.rng.normal(0.0, 0.002, 2), 0.0)
            end = intent.position_xyz_m + shift
            path = self.straight(side, end, 0.2)
            yield from self.follow(side, path, intent.orientation_wxyz, may_hesitate=False)
            yield from self.squeeze(side, 1.0, self.who.grip_s)
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.6, 1.8)))

    def spot_for(self, step: Step) -> tuple[Array, float]:
        """Where the middle of the cube is to come, ``(3,)``, and how the cube is to be turned [rad]."""
        edge = self.scene.cube_edge_m
        if step.onto != TABLE:
            return self.cube(step.onto) + np.array([0.0, 0.0, edge]), self.cube_yaw(step.onto)
        others = np.array([self.cube(name)[:2] for name in self.layout.names if name != step.cube])
        spot = free_spot(others.reshape(-1, 2), self.cube(step.cube)[:2], self.rng)
        return np.append(spot, edge / 2), self.cube_yaw(step.cube)

    def carry(self, side: str, step: Step) -> Generator[None, None, bool]:
        """Bring the cube to its place; whether it came along."""
        intent = self.intent[side]
        intent.phase = Phase.CARRY
        spot, cube_yaw = self.spot_for(step)
        error = np.append(self.rng.normal(0.0, self.who.place_sd_m, 2), 0.0)
        if self.chance(self.who.careless_probability):
            angle, size = self.rng.uniform(0.0, 2 * np.pi), self.rng.uniform(0.007, 0.012)
            error[:2] += size * np.array([np.cos(angle), np.sin(angle)])
        target = spot + error
        in_hand = self.cube(step.cube) - intent.position_xyz_m
        turned = self.cube_yaw(step.cube) - _yaw_of(intent.orientation_wxyz)
        hand_yaw = _nearest_quarter(cube_yaw - turned, _yaw_of(intent.orientation_wxyz))
        orientation = _yaw_quaternion(hand_yaw + self.rng.normal(0.0, self.who.yaw_sd_rad))
        hover_m = float(self.rng.uniform(0.018, 0.040))
        hover = target - in_hand + np.array([0.0, 0.0, hover_m])
        path = self.arc_to(side, hover, lift_m=self.who.clearance_m, onset=0.22, settle=0.16, held=step.cube)
        if not (yield from self.follow(side, path, orientation, watch=step.cube)):
            return False
        # The last bit is done by eye: what counts is where the cube is, not where the hand is.
        in_hand = self.cube(step.cube) - intent.position_xyz_m
        release_m = -self.params.touch_depth_m
        if self.chance(self.who.careless_probability):
            release_m = float(self.rng.uniform(0.006, 0.016))
        low = target - in_hand + np.array([0.0, 0.0, release_m])
        drop = float(np.linalg.norm(low - intent.position_xyz_m))
        duration = 0.8 * self.who.movement_base_s + 1.6 * drop / self.who.speed_m_per_s
        path = self.straight(side, low, duration)
        is_fine = yield from self.follow(
            side, path, orientation, may_hesitate=False, watch=step.cube, until_contact=step.cube, step=step
        )
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.5, 1.6)))
        return is_fine

    def let_go(self, side: str) -> Script:
        """Open the hand, then begin to move away."""
        self.intent[side].phase = Phase.LET_GO
        yield from self.squeeze(side, 0.0, self.who.grip_s * float(self.rng.uniform(0.85, 1.2)))
        yield from self.wait(self.who.dwell_s * float(self.rng.uniform(0.2, 0.8)))

    def retreat(self, side: str, *, height_m: float) -> Script:
        """Move straight up, a little back, away from what was let go."""
        intent = self.intent[side]
        intent.phase = Phase.RETREAT
        end = intent.position_xyz_m + np.array([-0.2 * height_m, 0.0, height_m])
        duration = 0.8 * self.who.movement_base_s + 1.2 * height_m / self.who.speed_m_per_s
        path = self.straight(side, end, duration)
        yield from self.follow(side, path, intent.orientation_wxyz, may_hesitate=False)

    def go_home(self, side: str) -> Script:
        """Go back to where the hand rests, up first."""
        self.intent[side].phase = Phase.RETREAT
        path = self.arc_to(side, self.rest[side], lift_m=self.who.clearance_m + 0.03, onset=0.36, settle=0.0)
        yield from self.follow(side, path, self.rest_orientation[side], may_hesitate=False)
        self.intent[side].phase = Phase.REST
        self.intent[side].step = -1

    def do(self, number: int) -> Generator[None, None, bool]:
        """One step of the task; whether it is done."""
        step = self.task.steps[number]
        side = step.hand
        intent = self.intent[side]
        for _ in range(self.params.most_attempts):
            intent.step = number
            yield from self.reach(side, step.cube)
            yield from self.grasp(side)
            is_placed = yield from self.carry(side, step)
            yield from self.let_go(side)
            if is_placed:
                return True
            self.n_misses += 1
            yield from self.retreat(side, height_m=float(self.rng.uniform(0.05, 0.09)))
            if not self.is_reachable(step.cube):
                return False
        return False

    def is_reachable(self, cube: str) -> bool:
        """Whether a cube is still on the table, and upright enough to be taken."""
        position = self.cube(cube)
        depth, width, _ = self.scene.table_size_xyz_m
        return bool(abs(position[0]) < depth / 2 and abs(position[1]) < width / 2 and position[2] > 0.0)

    def act(self) -> Script:
        """The whole demonstration."""
        yield from self.wait(float(self.rng.uniform(0.6, 1.3)))
        for number, step in enumerate(self.task.steps):
            is_done = yield from self.do(number)
            upcoming = self.task.steps[number + 1 :]
            if not is_done or not upcoming or upcoming[0].hand != step.hand:
                yield from self.go_home(step.hand)
                if not is_done:
                    break
                if upcoming:
                    yield from self.wait(self.who.pause_s * float(self.rng.uniform(0.6, 1.4)))
                continue
            yield from self.retreat(step.hand, height_m=self.who.clearance_m * 1.2)
            if self.chance(self.who.pause_probability):
                self.intent[step.hand].phase = Phase.REST
                yield from self.wait(self.who.pause_s * float(self.rng.uniform(0.6, 1.5)))
        yield from self.wait(float(self.rng.uniform(0.8, 1.5)))

    def run(self) -> Demonstration:
        """Let the participant act until the end."""
        self.settle()
        most = round(self.params.longest_s / self.params.control_step_s)
        script = self.act()
        for _ in range(most):
            if next(script, self) is self:
                break
            self.tick()
        resting = all(
            is_resting_on(self.data, self.index, cube, support, self.scene)
            for cube, support in self.task.goal
        )
        n = len(self.cube_positions)
        step_s = self.params.control_step_s
        return Demonstration(
            task=self.task,
            cubes=self.layout.names,
            time_s=np.arange(n, dtype=np.float64) * step_s,
            cube_position_xyz_m=np.array(self.cube_positions),
            cube_orientation_wxyz=np.array(self.cube_orientations),
            hands={side: self._arrays(track) for side, track in self.tracks.items()},
            is_goal_reached=resting,
            n_misses=self.n_misses,
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

    def _arrays(self, track: HandTrack) -> HandArrays:
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


def demonstrate(
    participant: Participant,
    task: Task,
    layout: Layout,
    rng: np.random.Generator,
    *,
    scene: SceneParams = SceneParams(),
    hand: HandParams = HandParams(),
    params: DemonstrationParams = DemonstrationParams(),
) -> Demonstration:
    """Let a participant carry out a task, and write down what really happened.

    Args:
        participant: Who acts.
        task: What is to be done.
        layout: Where the cubes start.
        rng: Source of every random choice; the same source gives the same demonstration.
        scene: Physics.
        hand: The virtual hands.
        params: How it is run.

    Returns:
        Poses of cubes and hands, triggers and intentions at every control tick. The goal counts as reached if
        in the end every moved cube rests, upright and still, where it was to be.
    """
    return _Session(participant, task, layout, rng, scene, hand, params).run()
