"""Whether a hand can go along a way without touching anything: tried out in the model before it is done.

The model is arranged as sensors say, not as it truly is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from demoplan.engines.mujoco.robots.robot import Arm
from demoplan.geometry import Array

FAR_AWAY = np.array([0.0, 0.0, -5.0])


@dataclass(frozen=True)
class Held:
    """What is in a hand: an object, and how it lies in the frame of the grasp."""

    object: str
    position_xyz_m: Array
    orientation_wxyz: Array


@dataclass(frozen=True)
class Touch:
    """The first contact on a way: at which of its points, and between what."""

    at: int
    part: str
    other: str
    is_hand: bool
    """Whether the other is a hand, which may move away again."""


class Checker:
    """A copy of the scene in which ways are tried out."""

    def __init__(
        self, model: mujoco.MjModel, objects: Mapping[str, tuple[int, int]], arms: Mapping[str, Arm]
    ) -> None:
        """Make the copy.

        Args:
            model: The scene.
            objects: Address in ``qpos`` and geom of each object.
            arms: Every arm in the scene.
        """
        self._model = model
        self._data = mujoco.MjData(model)
        self._objects = dict(objects)
        self._arms = dict(arms)
        self.names = [
            model.geom(geom).name or model.body(model.geom_bodyid[geom]).name for geom in range(model.ngeom)
        ]
        self._side = np.zeros(model.ngeom, dtype=np.int64)
        self._fingers = {
            name: [int(model.joint(f"{name}:{finger}").qposadr[0]) for finger in ("left", "right")]
            for name in arms
        }

    def arrange(self, data: mujoco.MjData, believed: Mapping[str, tuple[Array, Array] | None]) -> None:
        """Put hands and obstacles where they are, and objects where they are believed to be, or away."""
        scratch = self._data
        scratch.qpos[:] = data.qpos
        scratch.mocap_pos[:] = data.mocap_pos
        scratch.mocap_quat[:] = data.mocap_quat
        for name, (address, _) in self._objects.items():
            pose = believed.get(name)
            if pose is None:
                scratch.qpos[address : address + 3] = FAR_AWAY
                continue
            scratch.qpos[address : address + 3] = pose[0]
            scratch.qpos[address + 3 : address + 7] = pose[1]

    def first_touch(
        self,
        arm: Arm,
        configurations: Array,
        opening_m: float,
        held: Held | None = None,
        others: Sequence[tuple[Arm, Array]] = (),
        hidden: Sequence[int] = (),
        depth_m: float = 0.0015,
    ) -> Touch | None:
        """The first unwanted contact of an arm, or of what it holds, along its configurations ``(n, d)``.

        Args:
            arm: Which arm.
            configurations: Where it goes.
            opening_m: How far its fingers are open.
            held: What it carries.
            others: Arms that move meanwhile, with their configurations ``(n, d)``.
            hidden: Geoms that the robot does not know of.
            depth_m: Contacts that are not deeper than this are within the uncertainty of sensing.
        """
        model, data, side = self._model, self._data, self._side
        side[:] = 0
        side[list(arm.geoms)] = 1
        if held is not None:
            geom = self._objects[held.object][1]
            side[geom] = 2
        if hidden:
            side[list(hidden)] = 3
        data.qpos[self._fingers[arm.hand]] = opening_m / 2
        middle, turned, matrix = np.zeros(3), np.zeros(4), np.zeros(9)
        for at, configuration in enumerate(configurations):
            data.qpos[arm.joint_addresses] = configuration
            for other, theirs in others:
                data.qpos[other.joint_addresses] = theirs[at]
            mujoco.mj_kinematics(model, data)
            if held is not None:
                position, orientation = arm.pose(data)
                mujoco.mju_mulPose(
                    middle, turned, position, orientation, held.position_xyz_m, held.orientation_wxyz
                )
                mujoco.mju_quat2Mat(matrix, turned)
                data.geom_xpos[geom] = middle
                data.geom_xmat[geom] = matrix
            mujoco.mj_collision(model, data)
            if not data.ncon:
                continue
            pairs = data.contact.geom[: data.ncon]
            sides = side[pairs]
            # Between mover (1, 2) and anything else (0); what is held may touch its own hand.
            bad = (sides.min(axis=1) == 0) & np.isin(sides.max(axis=1), (1, 2))
            bad &= data.contact.dist[: data.ncon] < -depth_m
            if bad.any():
                first, second = pairs[np.argmax(bad)]
                if side[first] == 0:
                    first, second = second, first
                is_hand = any(int(second) in each.geoms for each in self._arms.values())
                return Touch(at, self.names[first], self.names[second], is_hand)
        return None
