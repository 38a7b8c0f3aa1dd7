"""Whether an arm can go along a way without touching anything: tried out in the model before it is done.

Anything is objects, table and obstacles, the robot's own body, its other arm, and links of the arm itself
that do not follow each other. The model is arranged as sensors say, not as it truly is.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

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
        self._hand_geoms: dict[str, NDArray[np.bool_]] = {}
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
        clearance_m: float = 0.0,
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
            clearance_m: Free room that is asked for about arm and load; with it, no depth is forgiven.
        """
        if clearance_m > 0.0:
            mine = sorted(arm.geoms) + ([] if held is None else [self._objects[held.object][1]])
            with self._widened(mine, clearance_m):
                return self.first_touch(
                    arm, configurations, opening_m, held, others, hidden, depth_m=-clearance_m
                )
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
            # Links that follow each other are no pair in the model: any other two of an arm must not meet.
            bad |= (sides == 1).all(axis=1)
            bad |= (
                (sides.min(axis=1) == 1)
                & (sides.max(axis=1) == 2)
                & ~self._is_hand_of(arm)[pairs].any(axis=1)
            )
            bad &= data.contact.dist[: data.ncon] < -depth_m
            if bad.any():
                first, second = pairs[np.argmax(bad)]
                if side[first] == 0:
                    first, second = second, first
                is_hand = side[second] == 0 and any(int(second) in each.geoms for each in self._arms.values())
                return Touch(at, self.names[first], self.names[second], is_hand)
        return None

    def _is_hand_of(self, arm: Arm) -> NDArray[np.bool_]:
        """Which geoms may touch what the arm holds ``(ngeom,)``."""
        if arm.hand not in self._hand_geoms:
            mask = np.zeros(self._model.ngeom, dtype=bool)
            mask[list(arm.hand_geoms)] = True
            self._hand_geoms[arm.hand] = mask
        return self._hand_geoms[arm.hand]

    @contextmanager
    def _widened(self, geoms: Sequence[int], clearance_m: float) -> Iterator[None]:
        """Let contacts of some geoms be found at a distance already."""
        model = self._model
        bodies = sorted({int(model.geom_bodyid[geom]) for geom in geoms})
        kept = model.geom_margin[geoms].copy(), model.body_margin[bodies].copy()
        model.geom_margin[geoms], model.body_margin[bodies] = clearance_m, clearance_m
        try:
            yield
        finally:
            model.geom_margin[geoms], model.body_margin[bodies] = kept

    def poses(self, arm: Arm, configurations: Array) -> tuple[Array, Array]:
        """Where the grasp is in each configuration ``(n, 3)``, and how far it leans ``(n,)`` [rad]."""
        positions, leans = np.empty((len(configurations), 3)), np.empty(len(configurations))
        for at, configuration in enumerate(configurations):
            self._data.qpos[arm.joint_addresses] = configuration
            mujoco.mj_kinematics(self._model, self._data)
            positions[at], (_, x, y, _) = arm.pose(self._data)
            leans[at] = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
        return positions, leans
