"""A parallel gripper: two padded fingers that a mechanism keeps symmetric, closed with limited force.

What it holds it holds by friction: there is no weld between a hand and a thing.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from demoplan.geometry import Array


@dataclass(frozen=True, kw_only=True)
class FingerParams:
    """Geometry and strength of a parallel gripper."""

    grasp_point_m: float = 0.06
    """How far below the palm's origin the fingers close [m]."""
    finger_reach_m: float = 0.014
    """How far fingertips reach below the grasp point [m]."""
    palm_half_height_m: float = 0.010
    pad_width_m: float = 0.022
    pad_thickness_m: float = 0.010
    widest_opening_m: float = 0.090
    """Distance between the pads when fully open [m]."""
    pad_friction: float = 1.2
    """Rubber on wood."""
    grip_force_n: float = 25.0
    """Limit of the mechanism's force [N]."""
    finger_mass_kg: float = 0.04


def add_pads(
    spec: mujoco.MjSpec, palm: mujoco.MjsBody, name: str, params: FingerParams
) -> list[tuple[mujoco.MjsJoint, mujoco.MjsGeom]]:
    """Two padded fingers on a palm, which point along its -z and open along its y; nothing drives them yet.

    Bodies, joints and geoms are named ``<name>:left`` and ``<name>:right``. Fingers and palm never collide.

    Returns:
        Joint and pad of each finger.
    """
    tip = params.grasp_point_m + params.finger_reach_m
    half_length = (tip - params.palm_half_height_m) / 2
    pairs = []
    for finger, sign in (("left", 1.0), ("right", -1.0)):
        body = palm.add_body(name=f"{name}:{finger}", gravcomp=1.0)
        joint = body.add_joint(
            name=f"{name}:{finger}",
            type=mujoco.mjtJoint.mjJNT_SLIDE,
            axis=[0.0, sign, 0.0],
            range=[0.0, params.widest_opening_m / 2],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
        )
        pad = body.add_geom(
            name=f"{name}:{finger}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[params.pad_width_m / 2, params.pad_thickness_m / 2, half_length],
            pos=[0.0, sign * params.pad_thickness_m / 2, -(tip - half_length)],
            mass=params.finger_mass_kg,
            condim=4,
            friction=[params.pad_friction, 0.02, 0.0005],
        )
        pairs.append((joint, pad))
    for first, second in ((palm.name, f"{name}:left"), (palm.name, f"{name}:right")):
        spec.add_exclude(bodyname1=first, bodyname2=second)
    spec.add_exclude(bodyname1=f"{name}:left", bodyname2=f"{name}:right")
    return pairs


def add_fingers(spec: mujoco.MjSpec, palm: mujoco.MjsBody, name: str, params: FingerParams) -> None:
    """Two fingers that a mechanism moves as one; its actuator is ``<name>:grip``."""
    for joint, pad in add_pads(spec, palm, name, params):
        joint.damping, joint.armature = [2.0, 0.0, 0.0], 0.05
        # The pads' friction counts, not the larger of theirs and the object's: else nothing could slip.
        pad.priority = 1
        pad.rgba = [0.16, 0.17, 0.19, 1.0]
    # The mechanism: one finger mirrors the other, so that what is held does not drift sideways.
    spec.add_equality(
        name=f"{name}:mirror",
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1=f"{name}:left",
        name2=f"{name}:right",
        data=[0.0, 1.0, *[0.0] * 10],
    )
    actuator = spec.add_actuator(
        name=f"{name}:grip", trntype=mujoco.mjtTrn.mjTRN_JOINT, target=f"{name}:left"
    )
    actuator.set_to_position(kp=1500.0, kv=30.0)
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.forcerange = [-params.grip_force_n, params.grip_force_n]


class Fingers:
    """The fingers of a compiled model."""

    def __init__(
        self, model: mujoco.MjModel, name: str, params: FingerParams, palm: int, palm_from_grasp: Array
    ) -> None:
        """Find them.

        Args:
            model: The scene.
            name: Name of the hand.
            params: Geometry and strength.
            palm: Body of the palm.
            palm_from_grasp: Middle of the grasp in the palm's frame, ``(3,)``.
        """
        self.params = params
        self._palm = palm
        self._offset = palm_from_grasp
        self._joint = int(model.joint(f"{name}:left").qposadr[0])
        self._actuator = model.actuator(f"{name}:grip").id
        self.geoms = frozenset(model.geom(f"{name}:{finger}").id for finger in ("left", "right"))

    def command(self, data: mujoco.MjData, closure: float) -> None:
        """Drive to a closure: 0 open, 1 closed."""
        data.ctrl[self._actuator] = (1.0 - closure) * self.params.widest_opening_m / 2

    def opening_m(self, data: mujoco.MjData) -> float:
        """How far the pads are apart, as the joint tells [m]."""
        return 2.0 * float(data.qpos[self._joint])

    def position_xyz_m(self, data: mujoco.MjData) -> Array:
        """Middle of the grasp in the world ``(3,)``."""
        turn = data.xmat[self._palm].reshape(3, 3)
        return np.asarray(data.xpos[self._palm] + turn @ self._offset)

    def set_friction(self, model: mujoco.MjModel, friction: float | None) -> None:
        """Change the pads' sliding friction; None restores it."""
        for geom in self.geoms:
            model.geom_friction[geom, 0] = self.params.pad_friction if friction is None else friction
