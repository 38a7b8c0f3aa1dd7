"""TIAGo with one or two arms, each with a parallel gripper, behind a table.

Arms are driven by position actuators with gravity compensation, within the joints' own limits of speed; the
base stands, the torso is raised by a fixed height.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.robots.connecting import Space
from demoplan.engines.mujoco.robots.fingers import FingerParams, Fingers, add_fingers
from demoplan.engines.mujoco.robots.inverse import Inverse
from demoplan.engines.mujoco.robots.robot import Arm, Unreachable, lead_steps
from demoplan.engines.mujoco.robots.standing import StandingParams, standing_xy_m
from demoplan.engines.mujoco.robots.tiago_description import load_tiago, set_contacts
from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.errors import SimulationError
from demoplan.geometry import Array

_N_JOINTS = 7
_SPACING_RAD = 0.06
"""How densely paths through joints are checked."""
_TURNS_RAD = tuple(np.radians([0.0, 45.0, -45.0, 90.0, -90.0, 180.0]))
""""However turned", as far as it is tried."""
_PREFIX = "tiago/"
REACH_M = (0.34, 0.70)
"""From the shoulder's vertical axis to where the hand can be upright 0.3 m above the table, roughly."""
HIGHEST_GRASP_M = 0.42
_SHOULDERS_XY_M = {"arm_": (0.093, 0.014), "arm_right_": (-0.036, -0.190), "arm_left_": (-0.036, 0.190)}
"""The vertical axis of each arm's first joint, from the middle of the base."""
JOINT_SPEEDS_RAD_PER_S = (2.7, 3.66, 4.58, 4.58, 1.95, 1.76, 1.76)
"""Limits of the arm's joints, as its description has them."""


@dataclass(frozen=True, kw_only=True)
class TiagoParams:
    """Where TIAGo stands, and how it is driven."""

    base_xy_m: tuple[float, float] | None = None
    """Middle of its base, seen from the table's middle; it looks along x [m]. None: where it reaches most."""
    table_height_m: float = 0.70
    """Height of the table's top above the floor [m]."""
    torso_lift_m: float = 0.35
    rest_from_base_xyz_m: tuple[float, float, float] = (0.435, -0.30, 0.24)
    """Rest of the right hand's grasp, from the base, over the table's top; the left's is mirrored [m]."""
    dual_rest_from_base_xyz_m: tuple[float, float, float] = (0.33, -0.30, 0.24)
    """The same with two arms, whose shoulders are farther back [m]."""
    palm_offset_m: float = 0.045
    """From the end of the arm to the gripper's palm [m]."""
    fingers: FingerParams = FingerParams(palm_half_height_m=0.012)
    stiffness_nm_per_rad: tuple[float, ...] = (900.0, 900.0, 700.0, 700.0, 250.0, 250.0, 250.0)
    damping_ratio: float = 1.0
    armature_kg_m2: float = 0.12
    """Rotor inertia as seen at the joint."""


class TiagoRobot:
    """TIAGo, with a right hand only or with both."""

    timestep_s = 0.002

    def __init__(
        self, scene: SceneSpec, hands: tuple[str, ...] = ("Right_hand",), params: TiagoParams = TiagoParams()
    ) -> None:
        """A robot with these hands, ``("Right_hand",)`` or both, that drives up to a scene."""
        self.hands = hands
        self.params = params
        self.name = "tiago" if len(hands) == 1 else "tiago_dual"
        self._urdf = "tiago_no_hand.urdf" if len(hands) == 1 else "tiago_dual.urdf"
        self._sides = (
            {hands[0]: "arm_"}
            if len(hands) == 1
            else {hand: f"arm_{hand.split('_')[0].lower()}_" for hand in hands}
        )

        self.base_xy_m = self._drive_up(scene) if params.base_xy_m is None else np.array(params.base_xy_m)

    def _drive_up(self, scene: SceneSpec) -> Array:
        """Where to stand, before anything begins: it drives up to what lies on the table."""
        standing = StandingParams(
            usual_xy_m=(-0.555, 0.0) if len(self.hands) == 1 else (-0.455, 0.0),
            shoulders_xy_m=tuple(_SHOULDERS_XY_M[prefix] for prefix in self._sides.values()),
            reach_m=REACH_M,
        )
        points = [each.position_xyz_m[:2] for each in scene.objects]
        return standing_xy_m(points, scene.table_size_xyz_m[0], standing)

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Attach TIAGo to a scene."""
        self._attach(spec)
        for hand, prefix in self._sides.items():
            for name, stiffness in zip(_joints(prefix), self.params.stiffness_nm_per_rad, strict=True):
                spec.joint(name).armature = self.params.armature_kg_m2
                actuator = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
                actuator.set_to_position(kp=stiffness, dampratio=self.params.damping_ratio)
            add_fingers(spec, spec.body(hand), hand, self.params.fingers)
        for number, (hand, prefix) in enumerate(self._sides.items()):
            palm = spec.body(hand)
            bodies = [spec.body(f"{_PREFIX}{prefix}{link}_link") for link in range(1, _N_JOINTS + 1)]
            for body in (*bodies, palm, *palm.bodies):
                set_contacts(body, number, len(self._sides))

    def _attach(self, spec: mujoco.MjSpec) -> None:
        """TIAGo's links, with a palm at the end of each arm."""
        p = self.params
        x, y = self.base_xy_m
        frame = spec.worldbody.add_frame(pos=[x, y, -p.table_height_m])
        spec.attach(load_tiago(self._urdf, p.torso_lift_m), prefix=_PREFIX, frame=frame)
        for hand, prefix in self._sides.items():
            # The gripper points along the tool's x axis, and its own -z.
            half = np.sqrt(0.5)
            palm = spec.body(f"{_PREFIX}{prefix}tool_link").add_body(
                name=hand, pos=[p.palm_offset_m, 0.0, 0.0], quat=[half, 0.0, -half, 0.0], gravcomp=1.0
            )
            palm.add_geom(
                name=f"{hand}:palm",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[0.030, 0.055, p.fingers.palm_half_height_m],
                mass=0.35,
                rgba=[0.30, 0.31, 0.34, 1.0],
            )
            palm.add_geom(
                name=f"{hand}:wrist",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[0.030, p.palm_offset_m / 2, 0.0],
                pos=[0.0, 0.0, p.palm_offset_m / 2],
                mass=0.1,
                rgba=[0.30, 0.31, 0.34, 1.0],
            )
            palm.add_site(name=f"{hand}:grasp", pos=[0.0, 0.0, -p.fingers.grasp_point_m])

    def rest_of(self, hand: str) -> Array:
        """Where a hand's grasp rests, ``(3,)``."""
        p = self.params
        x, y, z = p.rest_from_base_xyz_m if len(self.hands) == 1 else p.dual_rest_from_base_xyz_m
        base_x, base_y = self.base_xy_m
        return np.array([base_x + x, base_y + (-y if hand.startswith("Left") else y), z])

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, step_s: float) -> dict[str, Arm]:
        """The arms in the compiled scene, at rest and open."""
        arms: dict[str, Arm] = {}
        for hand, prefix in self._sides.items():
            shoulder = self.base_xy_m + np.array(_SHOULDERS_XY_M[prefix])
            inverse = self._inverse(hand, prefix)
            arm = TiagoArm(model, hand, prefix, self.rest_of(hand), shoulder, inverse, self.params, step_s)
            data.qpos[arm.joint_addresses] = arm.commanded()
            for finger in ("left", "right"):
                data.qpos[model.joint(f"{hand}:{finger}").qposadr[0]] = arm.widest_opening_m / 2
            arm.command(data, arm.commanded(), 0.0)
            arms[hand] = arm
        return arms

    def _inverse(self, hand: str, prefix: str) -> Inverse:
        """Kinematics of one arm alone: every other joint is taken out."""
        spec = mujoco.MjSpec()
        self._attach(spec)
        for joint in list(spec.joints):
            if joint.name not in _joints(prefix):
                spec.delete(joint)
        for body in spec.bodies:
            for geom in list(body.geoms):
                geom.contype = geom.conaffinity = 0
        return Inverse(spec.compile(), f"{hand}:grasp", np.array(_POSTURES[prefix]))


def _joints(prefix: str) -> list[str]:
    return [f"{_PREFIX}{prefix}{joint}_joint" for joint in range(1, _N_JOINTS + 1)]


_POSTURES: dict[str, tuple[float, ...]] = {
    "arm_": (1.03, 0.71, -0.80, 1.94, 0.66, -0.75, 0.81),
    "arm_right_": (1.06, -0.20, 1.70, 1.73, 0.18, -1.40, -0.37),
    "arm_left_": (1.06, -0.20, 1.70, 1.73, 0.18, -1.40, -0.37),
}
"""Postures, the grasp above the table, from which most of it can be reached; found by search."""


class TiagoArm:
    """One arm of TIAGo; its configuration is its joint angles ``(7,)``."""

    def __init__(
        self,
        model: mujoco.MjModel,
        hand: str,
        prefix: str,
        rest_xyz_m: Array,
        shoulder_xy_m: Array,
        inverse: Inverse,
        params: TiagoParams,
        step_s: float,
    ) -> None:
        """Find the arm in a model.

        Raises:
            SimulationError: If it cannot come to its rest.
        """
        fingers = params.fingers
        self.hand = hand
        self.rest_xyz_m = rest_xyz_m
        self.widest_opening_m = fingers.widest_opening_m
        self.finger_reach_m = fingers.finger_reach_m
        self.palm_gap_m = fingers.grasp_point_m - fingers.palm_half_height_m
        self.hand_radius_m = 0.068
        self.highest_m = 0.60
        self._inverse = inverse
        names = _joints(prefix)
        self.joint_addresses: NDArray[np.intp] = np.array(
            [model.joint(name).qposadr[0] for name in names], dtype=np.intp
        )
        self.speed_limits = np.array(JOINT_SPEEDS_RAD_PER_S)
        self._actuators = np.array([model.actuator(name).id for name in names])
        self._lead = lead_steps(model, self._actuators, step_s)
        self._palm = model.body(hand).id
        down = np.array([0.0, 0.0, -fingers.grasp_point_m])
        self._fingers = Fingers(model, hand, fingers, self._palm, down)
        self.hand_geoms = self._fingers.geoms | {
            model.geom(f"{hand}:{part}").id for part in ("palm", "wrist")
        }
        bodies = {model.body(f"{_PREFIX}{prefix}{link}_link").id for link in range(2, _N_JOINTS + 1)} | {
            self._palm
        }
        own = (geom for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in bodies)
        self.geoms = self.hand_geoms | {geom for geom in own if model.geom_contype[geom]}
        middle, turn = inverse.pose(inverse.posture)
        self.rest_yaw_rad = turn
        self._home = inverse.posture
        self._shoulder_xy_m = shoulder_xy_m
        n = 20
        way = np.linspace(middle, rest_xyz_m, n)
        try:
            self.rest_configuration = inverse.along(inverse.posture, way, np.full(n, turn))[-1]
        except Unreachable as error:
            raise SimulationError(f"{hand} cannot come to its rest: {error}") from None
        self.space = Space(*inverse.limits, np.full(_N_JOINTS, _SPACING_RAD))
        self._commanded = self.rest_configuration
        self._known_reach: dict[tuple[float, ...], str | None] = {}

    def configurations(self, start: Array, position_xyz_m: Array, yaw_rad: Array) -> Array:
        """Configurations ``(n, 7)`` along a dense path of the grasp.

        Raises:
            Unreachable: If a point has none near the one before.
        """
        return self._inverse.along(start, position_xyz_m, yaw_rad)

    def postures(self, position_xyz_m: Array, yaw_rad: float, rng: np.random.Generator) -> Iterator[Array]:
        """Configurations ``(7,)`` for a pose, the one nearest to where the arm is first."""
        yield from self._inverse.postures(position_xyz_m, yaw_rad, rng, self._commanded)

    def room_m(self, position_xy_m: Array) -> float:
        """How far inside its reach a place on the table is, roughly [m]."""
        away = float(np.linalg.norm(np.asarray(position_xy_m) - self._shoulder_xy_m))
        return min(away - REACH_M[0], REACH_M[1] - away)

    def reachable(self, position_xyz_m: Array) -> str | None:
        """Why the upright grasp cannot come to a position, however turned; None if it can."""
        position = np.round(np.asarray(position_xyz_m, dtype=float), 3)
        key = tuple(position.tolist())
        if key not in self._known_reach:
            # A seed of its own for each place, so that the answer does not depend on what was asked before.
            rng = np.random.default_rng(np.abs(1000 * position).astype(np.uint32))
            found = (
                posture
                for turn in _TURNS_RAD
                for posture in self._inverse.postures(position, self.rest_yaw_rad + turn, rng, self._home)
            )
            self._known_reach[key] = None if next(found, None) is not None else self._far(position)
        return self._known_reach[key]

    def _far(self, position_xyz_m: Array) -> str:
        x, y, z = position_xyz_m
        away = float(np.linalg.norm(position_xyz_m[:2] - self._shoulder_xy_m))
        if REACH_M[0] <= away <= REACH_M[1] and z <= HIGHEST_GRASP_M:
            return (
                f"the arm cannot hold its hand upright at ({x:.2f}, {y:.2f}, {z:.2f}) m: it is near enough, "
                "but its joints do not turn so far to that side"
            )
        return (
            f"the arm cannot hold its hand upright at ({x:.2f}, {y:.2f}, {z:.2f}) m, {away:.2f} m from its "
            f"shoulder: it can between about {REACH_M[0]:.2f} and {REACH_M[1]:.2f} m, up to "
            f"{HIGHEST_GRASP_M:.2f} m above the table"
        )

    def command(self, data: mujoco.MjData, configuration: Array, closure: float) -> None:
        """Drive towards a configuration ``(7,)``, and the fingers to a closure: 0 open, 1 closed."""
        data.ctrl[self._actuators] = configuration + self._lead * (configuration - self._commanded)
        self._commanded = configuration
        self._fingers.command(data, closure)

    def commanded(self) -> Array:
        """The configuration that was commanded last."""
        return np.asarray(self._commanded)

    def opening_m(self, data: mujoco.MjData) -> float:
        """How far the pads are apart, as the joints tell [m]."""
        return self._fingers.opening_m(data)

    def pose(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Middle of the grasp: position ``(3,)`` and orientation ``(4,)``."""
        return self._fingers.position_xyz_m(data), np.array(data.xquat[self._palm])

    def set_pads_friction(self, model: mujoco.MjModel, friction: float | None) -> None:
        """Change the sliding friction of its pads; None restores it."""
        self._fingers.set_friction(model, friction)
