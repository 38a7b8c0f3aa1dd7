"""One stream of readings, brought on to a grid of ticks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry import Array, slerp
from demoplan.stages.align.clocks import Stamps


@dataclass(frozen=True, eq=False)
class Track:
    """A pose at every tick; NaN where nothing was seen near enough."""

    position_xyz_m: Array
    """``(n, 3)``"""
    orientation_wxyz: Array
    """``(n, 4)``; NaN too where a source tells no orientation."""
    age_ns: Array
    """``(n,)`` distance in time to the nearest reading; infinite where there is no pose."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The readings about each tick of a grid."""

    before: NDArray[np.intp]
    after: NDArray[np.intp]
    fraction: Array
    """How far the tick lies on the way from ``before`` to ``after``; 0 or 1 where only one counts."""
    age_ns: Array
    """Distance in time to the nearer one that counts; infinite where that is too far."""


def neighbours(stamp_ns: Stamps, stretches: Stamps, tick_ns: Stamps, staleness_ns: int) -> Neighbours:
    """The two readings between which each tick lies, and whether they may be used.

    A tick between two readings of one stretch that are at most twice ``staleness_ns`` apart is
    interpolated. In a longer gap, and at the ends, the nearer reading holds for ``staleness_ns``, and
    beyond that nothing is known.

    Args:
        stamp_ns: Strictly increasing ``(m,)``, m ≥ 1.
        stretches: Stretch of the clock that each reading belongs to ``(m,)``.
        tick_ns: Ticks ``(n,)``.
        staleness_ns: How far a reading may be from a tick.
    """
    n = len(stamp_ns)
    after = np.searchsorted(stamp_ns, tick_ns, side="left")
    before = after - 1
    has_before, has_after = before >= 0, after < n
    before, after = np.maximum(before, 0), np.minimum(after, n - 1)
    to_before = np.where(has_before, tick_ns - stamp_ns[before], np.inf)
    to_after = np.where(has_after, stamp_ns[after] - tick_ns, np.inf)
    gap = to_before + to_after
    age = np.minimum(to_before, to_after)
    may_mix = (gap <= 2 * staleness_ns) & (stretches[before] == stretches[after])
    with np.errstate(invalid="ignore"):
        between = to_before / gap
    nearer = (to_after < to_before).astype(np.float64)
    fraction = np.where(may_mix, between, nearer)
    return Neighbours(before, after, fraction, np.where(age <= staleness_ns, age, np.inf))


def positions_at(near: Neighbours, values: Array) -> Array:
    """Readings ``(m, k)`` on the straight line between neighbours ``(n, k)``; NaN where none is near."""
    # Taking whole rows is quicker than indexing with them.
    low, high = values.take(near.before, axis=0), values.take(near.after, axis=0)
    mixed = low + (high - low) * near.fraction[:, None]
    return _where_near(near, mixed)


def orientations_at(near: Neighbours, values_wxyz: Array) -> Array:
    """Orientations ``(m, 4)`` on the shorter arc between neighbours ``(n, 4)``; NaN where none is near."""
    low, high = values_wxyz.take(near.before, axis=0), values_wxyz.take(near.after, axis=0)
    mixed = slerp(low, high, near.fraction)
    return _where_near(near, mixed)


def _where_near(near: Neighbours, values: Array) -> Array:
    is_near = np.isfinite(near.age_ns)
    return values if is_near.all() else np.where(is_near[:, None], values, np.nan)


def youngest(tracks: list[Track]) -> Track:
    """At each tick the pose that is nearest in time; of equals, the first track's."""
    result = tracks[0]
    for other in tracks[1:]:
        is_younger = other.age_ns < result.age_ns
        result = Track(
            np.where(is_younger[:, None], other.position_xyz_m, result.position_xyz_m),
            np.where(is_younger[:, None], other.orientation_wxyz, result.orientation_wxyz),
            np.minimum(result.age_ns, other.age_ns),
        )
    return result
