"""Ways of a hand over and around what stands on a table, and how fast it goes along them.

A way goes up, across and down, with rounded corners. It passes over everything near it; where that is too
high for the arm, it goes around.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from demoplan.engines.mujoco.motion import minimum_jerk
from demoplan.geometry import Array

SHORTEST_S = 0.2
"""No movement is shorter [s]."""

TURN_M_PER_RAD = 0.12
"""A turn of one radian takes as long as this way."""


@dataclass(frozen=True)
class Upright:
    """What stands in the way: an upright cylinder that holds it."""

    name: str
    x_m: float
    y_m: float
    radius_m: float
    top_m: float


@dataclass(frozen=True)
class Way:
    """A dense path of the grasp: ``position_xyz_m`` ``(n, 3)``, ``yaw_rad`` ``(n,)``."""

    position_xyz_m: Array
    yaw_rad: Array

    @property
    def lengths_m(self) -> Array:
        """Length of the way up to each point ``(n,)``, turns included."""
        steps = np.linalg.norm(np.diff(self.position_xyz_m, axis=0), axis=1)
        turns = TURN_M_PER_RAD * np.abs(np.diff(self.yaw_rad))
        return np.concatenate([[0.0], np.cumsum(np.maximum(steps, turns))])


def shortest_turn(from_rad: float, to_rad: float) -> float:
    """The signed turn that leads from one angle to another on the shorter side [rad].

    >>> round(shortest_turn(3.0, -3.0), 3)
    0.283
    """
    return float((to_rad - from_rad + np.pi) % (2.0 * np.pi) - np.pi)


def way_through(points_xyz_m: Array, yaw_rad: Array, *, radius_m: float = 0.04, step_m: float = 0.015) -> Way:
    """A dense way through corners ``(m, 3)``, which are rounded.

    Args:
        points_xyz_m: Start, corners, end.
        yaw_rad: Turn at each of them ``(m,)``; the end's is reached exactly.
        radius_m: How long before a corner the way leaves its line [m].
        step_m: Longest distance between neighbours [m].
    """
    points = np.asarray(points_xyz_m, dtype=float)
    yaws = np.asarray(yaw_rad, dtype=float)
    sides = np.linalg.norm(np.diff(points, axis=0), axis=1)
    turns = TURN_M_PER_RAD * np.abs(np.diff(yaws))
    kept = np.concatenate([[True], np.maximum(sides, turns) > 1e-6])
    kept[-1] = True
    points, yaws = points[kept], yaws[kept]
    sides = np.linalg.norm(np.diff(points, axis=0), axis=1)
    nodes: list[Array] = [np.append(points[0], yaws[0])]
    full = np.column_stack([points, yaws])
    for corner in range(1, len(full) - 1):
        before, here, after = full[corner - 1 : corner + 2]
        reach = min(radius_m, 0.5 * sides[corner - 1], 0.5 * sides[corner])
        enter = here + (before - here) * (reach / max(sides[corner - 1], 1e-9))
        leave = here + (after - here) * (reach / max(sides[corner], 1e-9))
        t = np.linspace(0.0, 1.0, 6)[:, None]
        nodes.extend((1 - t) ** 2 * enter + 2 * t * (1 - t) * here + t**2 * leave)
    nodes.append(full[-1])
    chain = np.array(nodes)
    spans = np.maximum(
        np.linalg.norm(np.diff(chain[:, :3], axis=0), axis=1),
        TURN_M_PER_RAD * np.abs(np.diff(chain[:, 3])),
    )
    at = np.concatenate([[0.0], np.cumsum(spans)])
    n = max(2, int(np.ceil(at[-1] / step_m)) + 1)
    wanted = np.linspace(0.0, at[-1], n)
    dense = np.column_stack([np.interp(wanted, at, chain[:, column]) for column in range(4)])
    return Way(dense[:, :3], dense[:, 3])


def progress(length_m: float, speed_m_per_s: float, step_s: float, slowing: float = 1.0) -> Array:
    """Length of the way that is done after each control step ``(n,)``, by minimum jerk; the last is all.

    ``slowing`` stretches the time that the peak speed alone would ask for.
    """
    # The peak speed of a minimum-jerk movement is 15/8 of its mean.
    duration = slowing * max(1.875 * length_m / speed_m_per_s, SHORTEST_S)
    n = max(1, int(np.ceil(duration / step_s)))
    done: Array = length_m * minimum_jerk(np.arange(1, n + 1) / n)
    return done


def height_over(
    from_xy_m: Array, to_xy_m: Array, things: Sequence[Upright], radius_m: float
) -> tuple[float, str | None]:
    """Top of the highest thing that a hand of some radius would pass over on a straight way, and its name."""
    top, name = 0.0, None
    leg = to_xy_m - from_xy_m
    square = float(leg @ leg)
    for thing in things:
        middle = np.array([thing.x_m, thing.y_m])
        share = np.clip((middle - from_xy_m) @ leg / square, 0.0, 1.0) if square > 1e-12 else 0.0
        gap = float(np.linalg.norm(from_xy_m + share * leg - middle))
        if gap < thing.radius_m + radius_m and thing.top_m > top:
            top, name = thing.top_m, thing.name
    return top, name


def ways_over(
    start_xyz_m: Array,
    goal_xyz_m: Array,
    things: Sequence[Upright],
    *,
    radius_m: float,
    below_m: float,
    clearance_m: float,
    approach_m: float,
    highest_m: float,
) -> Iterator[Array]:
    """Corners ``(m, 3)`` of ways from start to goal, the best one first.

    Args:
        start_xyz_m: Where the grasp is.
        goal_xyz_m: Where it is to come, from above.
        things: What stands about.
        radius_m: Radius of the hand, or of what it carries.
        below_m: How far the hand, or what it carries, reaches below the grasp.
        clearance_m: Free height over things.
        approach_m: Height above the goal from which it goes straight down.
        highest_m: Height of the grasp above which no way leads.
    """
    across = goal_xyz_m[:2] - start_xyz_m[:2]
    length = float(np.linalg.norm(across))
    aside = np.array([-across[1], across[0]]) / max(length, 1e-9)
    middle = (start_xyz_m[:2] + goal_xyz_m[:2]) / 2
    for sideways_m, extra_m in (
        (0.0, 0.0),
        (0.12, 0.0),
        (-0.12, 0.0),
        (0.0, 0.06),
        (0.22, 0.0),
        (-0.22, 0.0),
    ):
        vias = [start_xyz_m[:2], goal_xyz_m[:2]]
        if sideways_m:
            if length < 0.08:
                continue
            vias.insert(1, middle + sideways_m * aside)
        corners = [start_xyz_m]
        for leg, (one, other) in enumerate(pairwise(vias)):
            top, _ = height_over(one, other, things, radius_m)
            level = top + clearance_m + below_m + extra_m if top > 0.0 else extra_m
            begin = max(level, start_xyz_m[2]) if leg == 0 else level
            end = max(level, goal_xyz_m[2] + approach_m) if leg == len(vias) - 2 else level
            corners.append(np.array([one[0], one[1], max(begin, below_m + 0.02)]))
            corners.append(np.array([other[0], other[1], max(end, below_m + 0.02)]))
        corners.append(goal_xyz_m)
        if max(corner[2] for corner in corners[1:-1]) <= highest_m:
            yield np.array(corners)
