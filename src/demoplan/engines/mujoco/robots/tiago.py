"""TIAGo with one or two arms, each with a parallel gripper, behind a table.

Arms are driven by position actuators with gravity compensation, within the joints' own limits of speed; the
base stands, the torso is raised by a fixed height.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.robots.fingers import FingerParams, Fingers, add_fingers
from demoplan.engines.mujoco.robots.inverse import Inverse
from demoplan.engines.mujoco.robots.robot import Arm, Unreachable, lead_steps
from demoplan.engines.mujoco.robots.tiago_description import load_tiago, set_contacts
from demoplan.errors import SimulationError
from demoplan.geometry import Array

DUAL_BASE_XY_M = (-0.45, 0.0)
"""With two arms, whose shoulders are farther back, it stands nearer."""

_N_JOINTS = 7
_PREFIX = "tiago/"
JOINT_SPEEDS_RAD_PER_S = (2.7, 3.66, 4.58, 4.58, 1.95, 1.76, 1.76)
"""Limits of the arm's joints, as its description has them."""


@dataclass(frozen=True, kw_only=True)
class TiagoParams:
    """Where TIAGo stands, and how it is driven."""

    base_xy_m: tuple[float, float] = (-0.555, 0.0)
    """Middle of its base, seen from the table's middle; it looks along x [m]."""
    table_height_m: float = 0.70
    """Height of the table's top above the floor [m]."""
    torso_lift_m: float = 0.35
    rest_xyz_m: tuple[float, float, float] = (-0.12, -0.30, 0.24)
    """Rest of the right hand's grasp; the left hand's is its mirror image [m]."""
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

    def __init__(self, hands: tuple[str, ...] = ("Right_hand",), params: TiagoParams = TiagoParams()) -> None:
        """A robot with these hands: ``("Right_hand",)``, or both."""
        self.hands = hands
        self.params = params
        self.name = "tiago" if len(hands) == 1 else "tiago_dual"
        self._urdf = "tiago_no_hand.urdf" if len(hands) == 1 else "tiago_dual.urdf"
        self._sides = (
            {hands[0]: "arm_"}
            if len(hands) == 1
            else {hand: f"arm_{hand.split('_')[0].lower()}_" for hand in hands}
        )

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
        x, y = p.base_xy_m
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
        x, y, z = self.params.rest_xyz_m
        return np.array([x, -y if hand.startswith("Left") else y, z])

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, step_s: float) -> dict[str, Arm]:
        """The arms in the compiled scene, at rest and open."""
        arms: dict[str, Arm] = {}
        for hand, prefix in self._sides.items():
            arm = TiagoArm(
                model, hand, prefix, self.rest_of(hand), self._inverse(hand, prefix), self.params, step_s
            )
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
        self.pads = self._fingers.geoms
        bodies = {model.body(f"{_PREFIX}{prefix}{link}_link").id for link in range(2, _N_JOINTS + 1)} | {
            self._palm
        }
        own = (geom for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in bodies)
        self.geoms = self.pads | {geom for geom in own if model.geom_contype[geom]}
        middle, turn = inverse.pose(inverse.posture)
        self.rest_yaw_rad = turn
        self._home = (middle, inverse.posture)
        n = 20
        way = np.linspace(middle, rest_xyz_m, n)
        try:
            self._commanded = inverse.along(inverse.posture, way, np.full(n, turn))[-1]
        except Unreachable as error:
            raise SimulationError(f"{hand} cannot come to its rest: {error}") from None

    def configurations(self, start: Array, position_xyz_m: Array, yaw_rad: Array) -> Array:
        """Configurations ``(n, 7)`` along a dense path of the grasp.

        Raises:
            Unreachable: If a point has none near the one before.
        """
        return self._inverse.along(start, position_xyz_m, yaw_rad)

    def reachable(self, position_xyz_m: Array) -> str | None:
        """Why the grasp cannot come there from above, however turned; None if it can."""
        middle, posture = self._home
        why = ""
        for turn in (0.0, np.pi / 4, -np.pi / 4, np.pi / 2, -np.pi / 2):
            yaws = self.rest_yaw_rad + np.linspace(0.0, turn, 20)
            try:
                self._inverse.along(posture, np.linspace(middle, position_xyz_m, 20), yaws)
            except Unreachable as error:
                why = why or str(error)
            else:
                return None
        return why

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
