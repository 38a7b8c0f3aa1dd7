"""Where a robot that can drive stands, so that its arms reach as much as they can of what lies on a table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from demoplan.geometry import Array


@dataclass(frozen=True, kw_only=True)
class StandingParams:
    """Where it may stand before the table, and what its arms reach; seen from the middle of its base."""

    usual_xy_m: tuple[float, float]
    """Where it stands if nothing speaks against it, before a table of 0.8 m depth."""
    shoulders_xy_m: tuple[tuple[float, float], ...]
    """Vertical axis of each arm's first joint."""
    reach_m: tuple[float, float]
    """Least and greatest distance from it at which a hand can be upright."""
    edge_gap_m: float = 0.055
    """From the table's near edge to the middle of the base, at least."""
    farthest_m: float = 0.30
    """How much farther back it may stand."""
    aside_m: float = 0.30
    """How far to either side."""
    step_m: float = 0.015
    enough_m: float = 0.05
    """Room inside the reach beyond which more does not count."""


def standing_xy_m(
    points_xy_m: Sequence[Sequence[float]], table_depth_m: float, params: StandingParams
) -> Array:
    """Where to stand ``(2,)``: most things in reach of an arm, then farthest inside it, then as usual.

    Args:
        points_xy_m: What is to be reached, ``(n, 2)``.
        table_depth_m: Extent of the table away from the robot.
        params: Choices.
    """
    nearest = -table_depth_m / 2 - params.edge_gap_m
    usual = np.array([min(params.usual_xy_m[0] + 0.4 - table_depth_m / 2, nearest), params.usual_xy_m[1]])
    points = np.asarray(points_xy_m, dtype=float).reshape(-1, 2)
    if not len(points):
        return usual
    back = np.arange(0.0, params.farthest_m + 1e-9, params.step_m)
    side = np.arange(-params.aside_m, params.aside_m + 1e-9, params.step_m)
    spots = np.stack(np.meshgrid(nearest - back, side, indexing="ij"), axis=-1).reshape(-1, 2)
    shoulders = spots[:, None] + np.array(params.shoulders_xy_m)
    away = np.linalg.norm(points[None, None] - shoulders[:, :, None], axis=-1)
    low, high = params.reach_m
    # Inside the reach of the arm that does best, ``(spots, points)``.
    inside = np.minimum(away - low, high - away).max(axis=1)
    n_reached = (inside >= 0.0).sum(axis=1)
    room = np.minimum(inside, params.enough_m).sum(axis=1)
    order = np.lexsort((np.linalg.norm(spots - usual, axis=1), -np.round(room, 6), -n_reached))
    return np.asarray(spots[order[0]])
