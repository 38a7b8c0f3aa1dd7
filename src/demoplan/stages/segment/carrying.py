"""Which object travels along with which hand: holding, as motion alone shows it.

Facts say what is in hand by thresholds that suit a vocabulary and a rig; this needs neither grip nor shapes
nor where on the hand a marker sits, and so gives a trained segmenter a footing that does not move when a
vocabulary is tuned.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry import Array, hysteresis
from demoplan.stages.segment import windows

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class CarryParams:
    """When an object counts as carried."""

    moving_enter_m_per_s: float = 0.06
    """An object faster than this moves [m/s]: above the noise of a resting body's fitted speed."""
    moving_leave_m_per_s: float = 0.04
    """A moving object slower than this has stopped [m/s]."""
    reach_m: float = 0.3
    """Markers of a hand and of what it holds are never farther apart [m]: a hand and a long tool."""
    slip_m_per_s: float = 0.1
    """The distance of hand and object changes by less than this [m/s] …"""
    slip_ratio: float = 0.3
    """… plus this part of the object's speed, since an object that turns in hand moves its marker."""
    pause_s: float = 0.6
    """A shorter rest between two motions with the same hand does not end carrying [s]."""
    raised_m: float = 0.03
    """Nor does any rest while the object stays this far above its lowest place of the episode [m]."""
    min_duration_s: float = 0.25
    """A shorter motion along with a hand is a touch [s]."""


def carried(
    distance_m: Array, object_speed: Array, object_height_m: Array, tick_s: float, params: CarryParams
) -> Mask:
    """Whether each object travels with each hand.

    Args:
        distance_m: Distance of each hand and object ``(h, o, t)``.
        object_speed: ``(o, t)`` [m/s].
        object_height_m: Height above the object's own lowest place ``(o, t)``.
        tick_s: Period of the clock.
        params: Thresholds.

    Returns:
        ``(h, o, t)``; at most one hand carries an object at a time.
    """
    if not distance_m.size:
        return np.zeros(distance_m.shape, dtype=np.bool_)
    is_moving = hysteresis(
        object_speed > params.moving_enter_m_per_s, object_speed >= params.moving_leave_m_per_s
    )
    slip = np.abs(windows.difference(distance_m, 0.3, tick_s))
    is_nearest = distance_m.argmin(axis=0)[None] == np.arange(len(distance_m))[:, None, None]
    is_with = (
        is_moving
        & is_nearest
        & (distance_m < params.reach_m)
        & (slip < params.slip_m_per_s + params.slip_ratio * object_speed)
    )
    is_with = _without_gaps(is_with, windows.n_ticks(params.pause_s, tick_s))
    is_with = ~_without_gaps(~is_with, windows.n_ticks(params.min_duration_s, tick_s))
    is_pausing = _raised_pauses(is_with, object_height_m > params.raised_m)
    # While both hands are close to what one of them holds still, the one that moved it last has it.
    return np.asarray(is_with | (is_pausing & ~is_with.any(axis=0)))


def _without_gaps(mask: Mask, longest: int) -> Mask:
    """The mask with false runs between true ones filled, where they are no longer than ``longest`` ticks."""
    before, after = windows.last_true(mask), windows.next_true(mask)
    return np.asarray(mask | ((before >= 0) & (after < mask.shape[-1]) & (after - before <= longest)))


def _raised_pauses(is_with: Mask, is_raised: Mask) -> Mask:
    """Ticks between two motions with one hand, throughout which the object was held up ``(h, o, t)``."""
    length = is_with.shape[-1]
    before, after = windows.last_true(is_with), windows.next_true(is_with)
    is_gap = ~is_with & (before >= 0) & (after < length)
    n_low = np.broadcast_to(np.cumsum(~is_raised, axis=-1), is_with.shape)
    low_until = np.take_along_axis(n_low, np.minimum(after, length - 1), axis=-1)
    low_before = np.take_along_axis(n_low, np.maximum(before, 0), axis=-1)
    return np.asarray(is_gap & (low_until == low_before))
