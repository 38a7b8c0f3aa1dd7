"""How a thing can be grasped from above: which way to turn, how high to close, how far to open."""

from dataclasses import dataclass

import numpy as np

from demoplan.engines.mujoco.robots.paths import shortest_turn
from demoplan.geometry import Array, matrices

FINGER_ROOM_M = 0.014
"""Room between each pad and the thing when the hand comes down [m]."""
LEAST_ROOM_M = 0.004
STEEPEST_TILT_RAD = 0.45
"""A thing that leans more than this cannot be grasped from above."""


@dataclass(frozen=True)
class Stance:
    """A thing as it stands: which of its extents is up, and how the others are turned."""

    kind: str
    position_xyz_m: Array
    height_m: float
    """Vertical extent."""
    sides: tuple[tuple[float, float], ...]
    """(extent [m], direction [rad]) of each horizontal axis; one entry for an upright cylinder or a ball."""
    is_round: bool
    """Whether it looks the same from every side."""
    tilt_rad: float

    @property
    def top_m(self) -> float:
        """Height of its top."""
        return float(self.position_xyz_m[2]) + self.height_m / 2

    @property
    def radius_m(self) -> float:
        """Radius of an upright cylinder that holds it."""
        extents = [extent for extent, _ in self.sides]
        return extents[0] / 2 if self.is_round else float(np.hypot(extents[0], extents[1])) / 2


def stance_of(kind: str, size_xyz_m: Array, position_xyz_m: Array, orientation_wxyz: Array) -> Stance:
    """How a thing of full extents ``(3,)`` stands."""
    axes = matrices(orientation_wxyz)
    up = int(np.argmax(np.abs(axes[2])))
    tilt = float(np.arccos(np.clip(abs(axes[2, up]), 0.0, 1.0)))
    if kind == "sphere":
        return Stance(kind, position_xyz_m, float(size_xyz_m[0]), ((float(size_xyz_m[0]), 0.0),), True, 0.0)
    extents = np.array([size_xyz_m[0], size_xyz_m[0], size_xyz_m[2]]) if kind == "cylinder" else size_xyz_m
    sides = tuple(
        (float(extents[axis]), float(np.arctan2(axes[1, axis], axes[0, axis])))
        for axis in range(3)
        if axis != up
    )
    is_round = kind == "cylinder" and up == 2
    return Stance(kind, position_xyz_m, float(extents[up]), sides[:1] if is_round else sides, is_round, tilt)


@dataclass(frozen=True)
class Grasp:
    """Where the grasp's middle is to come, how turned, and how far the hand is open for it."""

    position_xyz_m: Array
    yaw_rad: float
    opening_m: float
    width_m: float


def grasps_of(
    stance: Stance, *, near_yaw_rad: float, widest_m: float, finger_reach_m: float, palm_gap_m: float
) -> tuple[Grasp, ...]:
    """All grasps from above that fit a hand, those that turn it least first.

    The hand closes along its y axis, which is at right angles to its yaw.
    """
    bottom = stance.position_xyz_m[2] - stance.height_m / 2
    # Not so deep that fingertips reach what it stands on or the palm its top; else about its middle.
    height = max(stance.position_xyz_m[2], stance.top_m - palm_gap_m + 0.008, bottom + finger_reach_m + 0.004)
    position = np.array([stance.position_xyz_m[0], stance.position_xyz_m[1], height])
    if stance.is_round:
        turns = [
            (stance.sides[0][0], near_yaw_rad + turn)
            for turn in (0.0, np.pi / 4, -np.pi / 4, np.pi / 2, -3 * np.pi / 8)
        ]
    else:
        turns = [
            (extent, direction - np.pi / 2 + half)
            for extent, direction in stance.sides
            for half in (0.0, np.pi)
            # A lying cylinder rolls out of a hand that closes on its ends.
            if not (stance.kind == "cylinder" and len(stance.sides) == 2 and extent == max(stance.sides)[0])
        ]
    fitting = [
        (abs(shortest_turn(near_yaw_rad, yaw)), width, yaw)
        for width, yaw in turns
        if width + 2 * LEAST_ROOM_M <= widest_m
    ]
    return tuple(
        Grasp(
            position,
            near_yaw_rad + shortest_turn(near_yaw_rad, yaw),
            min(widest_m, max(width + 2 * FINGER_ROOM_M, 0.75 * widest_m)),
            width,
        )
        for _, width, yaw in sorted(fitting)
    )


def yaws_on(stance: Stance, support: Stance | None) -> tuple[float, ...]:
    """By how much to turn a thing so that it lies square on a support, the smallest turn first [rad]."""
    if support is None or stance.is_round or support.is_round:
        return (0.0, np.pi / 2, -np.pi / 2)
    to = support.sides[0][1]
    own = stance.sides[0][1]
    turns = [shortest_turn(own, to + quarter * np.pi / 2) for quarter in range(4)]
    return tuple(sorted(turns, key=abs))
