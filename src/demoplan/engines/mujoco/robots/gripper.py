"""The light robot: one or two grippers on slides, for fast batch work.

A gripper floats on three slides and a turntable, each driven with limited force: it yields when it pushes
against something, and grasps by friction alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.robots.connecting import Space
from demoplan.engines.mujoco.robots.fingers import FingerParams, Fingers, add_fingers
from demoplan.engines.mujoco.robots.robot import Arm, Unreachable, lead_steps
from demoplan.geometry import Array

_JOINTS = ("x", "y", "z", "yaw")
_SPACING = (0.012, 0.012, 0.012, 0.10)
"""How densely paths through them are checked [m, rad]."""


@dataclass(frozen=True, kw_only=True)
class GripperParams:
    """Geometry and strength of the light robot."""

    fingers: FingerParams = FingerParams()
    rest_xyz_m: tuple[float, float, float] = (-0.26, -0.26, 0.22)
    """Rest of the right hand's grasp; the left hand's is its mirror image [m]."""
    lowest_xyz_m: tuple[float, float, float] = (-0.45, -0.55, 0.0)
    highest_xyz_m: tuple[float, float, float] = (0.45, 0.55, 0.75)
    """Corners of the space that the grasp can reach [m]."""
    palm_mass_kg: float = 0.6
    stiffness_n_per_m: float = 5000.0
    force_limit_n: float = 90.0
    turning_stiffness_nm_per_rad: float = 30.0
    torque_limit_nm: float = 6.0


class GripperRobot:
    """One or two floating grippers."""

    timestep_s = 0.005

    def __init__(
        self, hands: tuple[str, ...] = ("Right_hand",), params: GripperParams = GripperParams()
    ) -> None:
        """A robot with these hands: ``Right_hand``, ``Left_hand`` or both."""
        self.name = "gripper" if len(hands) == 1 else "gripper_dual"
        self.hands = hands
        self.params = params

    def rest_of(self, hand: str) -> Array:
        """Where a hand's grasp rests, ``(3,)``."""
        x, y, z = self.params.rest_xyz_m
        return np.array([x, -y if hand.startswith("Left") else y, z])

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Attach the grippers to a scene."""
        for hand in self.hands:
            self._add_hand(spec, hand)

    def _add_hand(self, spec: mujoco.MjSpec, hand: str) -> None:
        p = self.params
        palm = spec.worldbody.add_body(name=hand, pos=[0.0, 0.0, p.fingers.grasp_point_m], gravcomp=1.0)
        for axis, name in enumerate(_JOINTS):
            is_turn = name == "yaw"
            palm.add_joint(
                name=f"{hand}:{name}",
                type=mujoco.mjtJoint.mjJNT_HINGE if is_turn else mujoco.mjtJoint.mjJNT_SLIDE,
                axis=[float(axis == 0), float(axis == 1), float(axis >= 2)],
                armature=0.01 if is_turn else 0.0,
            )
        palm.add_geom(
            name=f"{hand}:palm",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[0.028, 0.050, p.fingers.palm_half_height_m],
            mass=p.palm_mass_kg,
            friction=[0.5, 0.005, 0.0001],
            rgba=[0.55, 0.57, 0.60, 1.0],
        )
        add_fingers(spec, palm, hand, p.fingers)
        mass = p.palm_mass_kg + 2 * p.fingers.finger_mass_kg
        inertia = 0.013
        for name in _JOINTS:
            is_turn = name == "yaw"
            stiffness = p.turning_stiffness_nm_per_rad if is_turn else p.stiffness_n_per_m
            limit = p.torque_limit_nm if is_turn else p.force_limit_n
            actuator = spec.add_actuator(
                name=f"{hand}:{name}", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"{hand}:{name}"
            )
            # Critically damped for the hand alone.
            damping = 2.0 * np.sqrt(stiffness * (inertia if is_turn else mass))
            actuator.set_to_position(kp=stiffness, kv=float(damping))
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-limit, limit]

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData, step_s: float) -> dict[str, Arm]:
        """The grippers in the compiled scene, at rest and open."""
        arms: dict[str, Arm] = {}
        for hand in self.hands:
            arm = GripperArm(model, hand, self.rest_of(hand), self.params, step_s)
            data.qpos[arm.joint_addresses] = arm.commanded()
            for finger in ("left", "right"):
                data.qpos[model.joint(f"{hand}:{finger}").qposadr[0]] = arm.widest_opening_m / 2
            arm.command(data, arm.commanded(), 0.0)
            arms[hand] = arm
        return arms


class GripperArm:
    """One floating gripper; its configuration is the grasp's position and turn, ``(4,)``."""

    def __init__(
        self, model: mujoco.MjModel, hand: str, rest_xyz_m: Array, params: GripperParams, step_s: float
    ) -> None:
        """Find the gripper of a hand in a model."""
        self.hand = hand
        self.rest_xyz_m = rest_xyz_m
        self.rest_yaw_rad = 0.0
        self.widest_opening_m = params.fingers.widest_opening_m
        self.finger_reach_m = params.fingers.finger_reach_m
        self.palm_gap_m = params.fingers.grasp_point_m - params.fingers.palm_half_height_m
        self.hand_radius_m = 0.062
        self.highest_m = params.highest_xyz_m[2]
        self._low, self._high = np.array(params.lowest_xyz_m), np.array(params.highest_xyz_m)
        self.joint_addresses: NDArray[np.intp] = np.array(
            [model.joint(f"{hand}:{name}").qposadr[0] for name in _JOINTS], dtype=np.intp
        )
        self.speed_limits = np.full(4, np.inf)
        self._actuators = np.array([model.actuator(f"{hand}:{name}").id for name in _JOINTS])
        self._lead = lead_steps(model, self._actuators, step_s)
        self._palm = model.body(hand).id
        down = np.array([0.0, 0.0, -params.fingers.grasp_point_m])
        self._fingers = Fingers(model, hand, params.fingers, self._palm, down)
        self.geoms = self.hand_geoms = self._fingers.geoms | {model.geom(f"{hand}:palm").id}
        self.rest_configuration = np.append(rest_xyz_m, self.rest_yaw_rad)
        self.space = Space(
            np.append(self._low, -2 * np.pi), np.append(self._high, 2 * np.pi), np.array(_SPACING)
        )
        self._commanded = self.rest_configuration

    def configurations(self, start: Array, position_xyz_m: Array, yaw_rad: Array) -> Array:
        """Configurations ``(n, 4)``: the poses themselves, as far as they lie in its space.

        Raises:
            Unreachable: If a point lies outside.
        """
        outside = ((position_xyz_m < self._low) | (position_xyz_m > self._high)).any(axis=1)
        if outside.any():
            raise Unreachable(self._outside(position_xyz_m[np.argmax(outside)]))
        return np.column_stack([position_xyz_m, yaw_rad])

    def _outside(self, position_xyz_m: Array) -> str:
        x, y, z = position_xyz_m
        spans = ", ".join(f"{low:.2f} to {high:.2f}" for low, high in zip(self._low, self._high, strict=True))
        return f"({x:.2f}, {y:.2f}, {z:.2f}) m is outside its slides, which span {spans} m"

    def postures(self, position_xyz_m: Array, yaw_rad: float, rng: np.random.Generator) -> Iterator[Array]:
        """The pose itself, if it lies in its space."""
        del rng
        if self.reachable(position_xyz_m) is None:
            yield np.append(position_xyz_m, yaw_rad)

    def room_m(self, position_xy_m: Array) -> float:
        """How far inside its space a place on the table is [m]."""
        position = np.asarray(position_xy_m, dtype=float)
        return float(min((position - self._low[:2]).min(), (self._high[:2] - position).min()))

    def reachable(self, position_xyz_m: Array) -> str | None:
        """Why the grasp cannot come there from above; None if it can."""
        position = np.asarray(position_xyz_m, dtype=float)
        is_inside = bool(((position >= self._low) & (position <= self._high)).all())
        return None if is_inside else self._outside(position)

    def command(self, data: mujoco.MjData, configuration: Array, closure: float) -> None:
        """Drive towards a configuration ``(4,)``, and the fingers to a closure: 0 open, 1 closed."""
        data.ctrl[self._actuators] = configuration + self._lead * (configuration - self._commanded)
        self._commanded = configuration
        self._fingers.command(data, closure)

    def commanded(self) -> Array:
        """The configuration that was commanded last."""
        return self._commanded

    def opening_m(self, data: mujoco.MjData) -> float:
        """How far the pads are apart, as the joints tell [m]."""
        return self._fingers.opening_m(data)

    def pose(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Middle of the grasp: position ``(3,)`` and orientation ``(4,)``."""
        return self._fingers.position_xyz_m(data), np.array(data.xquat[self._palm])

    def set_pads_friction(self, model: mujoco.MjModel, friction: float | None) -> None:
        """Change the sliding friction of its pads; None restores it."""
        self._fingers.set_friction(model, friction)
