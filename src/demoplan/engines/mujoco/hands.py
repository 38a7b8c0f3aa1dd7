"""A virtual hand: two padded fingers on a palm that follows a commanded pose.

The commanded pose moves a mocap body; a soft weld pulls the palm after it, so that the hand yields when it
pushes against something, as a force-limited avatar hand does. The fingers close with limited force; cubes
are held by friction alone, slip when they are held badly, and fall when they are let go.

Frame of the hand: origin in the palm, fingers point along -z, they open along y.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from demoplan.engines.mujoco.robots.fingers import FingerParams, add_pads
from demoplan.geometry import Array

SIDES = ("Left_hand", "Right_hand")

_PALM_HALF_SIZE_M = (0.030, 0.045, 0.010)


@dataclass(frozen=True, kw_only=True)
class HandParams:
    """Geometry and strength of a virtual hand."""

    grasp_point_m: float = 0.06
    """How far below the palm's origin the fingers close [m]."""
    finger_reach_m: float = 0.016
    """How far the fingertips reach below the grasp point [m]."""
    pad_width_m: float = 0.022
    pad_thickness_m: float = 0.010
    widest_opening_m: float = 0.100
    """Distance between the pads when the hand is fully open [m]."""
    pad_friction: float = 1.3
    grip_force_n: float = 14.0
    """Limit of each finger's force [N]."""
    palm_mass_kg: float = 0.35
    finger_mass_kg: float = 0.04


def add_hand(
    spec: mujoco.MjSpec, name: str, position_xyz_m: Array, params: HandParams = HandParams()
) -> None:
    """Attach the hand ``name`` to a scene: bodies ``name`` and ``name:target``, fingers and their actuators.

    Args:
        spec: The scene.
        name: Name of the hand.
        position_xyz_m: Where its palm starts, ``(3,)``, in the world.
        params: Geometry and strength.
    """
    spec.worldbody.add_body(name=f"{name}:target", pos=position_xyz_m, mocap=True)
    palm = spec.worldbody.add_body(name=name, pos=position_xyz_m, gravcomp=1.0)
    palm.add_freejoint(name=name)
    palm.add_geom(
        name=f"{name}:palm",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=list(_PALM_HALF_SIZE_M),
        mass=params.palm_mass_kg,
        rgba=[0.85, 0.70, 0.60, 1.0],
    )
    for joint, pad in add_pads(spec, palm, name, _fingers(params)):
        pad.solref = [0.006, 1.0]
        pad.rgba = [0.80, 0.62, 0.52, 1.0]
        actuator = spec.add_actuator(name=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
        actuator.set_to_position(kp=900.0, kv=18.0)
        actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        actuator.forcerange = [-params.grip_force_n, params.grip_force_n]
    weld = spec.add_equality(
        name=name,
        type=mujoco.mjtEq.mjEQ_WELD,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=f"{name}:target",
        name2=name,
        solref=[0.012, 1.0],
    )
    # anchor (3), pose of the second body in the first (3 + 4, w first), and the weight of torques
    weld.data[:11] = [0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0.5]


def _fingers(params: HandParams) -> FingerParams:
    return FingerParams(
        grasp_point_m=params.grasp_point_m,
        finger_reach_m=params.finger_reach_m,
        palm_half_height_m=_PALM_HALF_SIZE_M[2],
        pad_width_m=params.pad_width_m,
        pad_thickness_m=params.pad_thickness_m,
        widest_opening_m=params.widest_opening_m,
        pad_friction=params.pad_friction,
        finger_mass_kg=params.finger_mass_kg,
    )


class Hand:
    """A hand of a compiled model: commanded by pose and closure, read by palm pose."""

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, name: str, params: HandParams = HandParams()
    ) -> None:
        """Find the hand ``name`` in a model."""
        self._data = data
        self._params = params
        self._mocap = int(model.body(f"{name}:target").mocapid[0])
        self._palm = model.body(name).id
        self._actuators = [model.actuator(f"{name}:{finger}").id for finger in ("left", "right")]

    def command(self, position_xyz_m: Array, orientation_wxyz: Array, closure: float) -> None:
        """Pull the palm to a pose, and the fingers to ``closure``: 0 open, 1 closed."""
        self._data.mocap_pos[self._mocap] = position_xyz_m
        self._data.mocap_quat[self._mocap] = orientation_wxyz
        self._data.ctrl[self._actuators] = (1.0 - closure) * self._params.widest_opening_m / 2

    @property
    def position_xyz_m(self) -> Array:
        """Palm in the world, ``(3,)``."""
        return np.array(self._data.xpos[self._palm])

    @property
    def orientation_wxyz(self) -> Array:
        """Palm in the world, ``(4,)``."""
        return np.array(self._data.xquat[self._palm])

    @property
    def grasp_point_xyz_m(self) -> Array:
        """Where the fingers close, in the world, ``(3,)``."""
        down = -self._data.xmat[self._palm].reshape(3, 3)[:, 2]
        return np.array(self._data.xpos[self._palm] + self._params.grasp_point_m * down)
