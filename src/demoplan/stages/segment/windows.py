"""Arithmetic over time, for whole episodes at once: differences, windows, time to an event.

The last axis is time. Windows are given in seconds and become whole ticks here, so that logs of different
rates give the same features. Every function costs linear time, whatever the window.
"""

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry import Array

Mask = NDArray[np.bool_]


def n_ticks(seconds: float, tick_s: float) -> int:
    """Whole ticks nearest to a duration, at least one."""
    return max(1, round(seconds / tick_s))


def difference(values: Array, window_s: float, tick_s: float, axis: int = -1) -> Array:
    """Central differences over a window, per second; narrower towards the ends of the episode."""
    length = values.shape[axis]
    half = n_ticks(window_s / 2.0, tick_s)
    ticks = np.arange(length)
    later = np.minimum(ticks + half, length - 1)
    earlier = np.maximum(ticks - half, 0)
    span_s = np.maximum(later - earlier, 1) * tick_s
    shape = [1] * values.ndim
    shape[axis] = length
    change = np.take(values, later, axis) - np.take(values, earlier, axis)
    return np.asarray(change / span_s.reshape(shape))


def running_total(values: Array) -> Array:
    """Sum of all values before each tick, and at last of all ``(..., t + 1)``: means are asked of it."""
    total = np.zeros((*values.shape[:-1], values.shape[-1] + 1))
    np.cumsum(values, axis=-1, out=total[..., 1:])
    return total


def past_mean(total: Array, window_s: float, tick_s: float) -> Array:
    """Mean over the last ``window_s`` up to and with each tick; shorter at the beginning."""
    return _mean(total, n_ticks(window_s, tick_s) - 1, 0)


def future_mean(total: Array, window_s: float, tick_s: float) -> Array:
    """Mean over the coming ``window_s`` from each tick on; shorter at the end."""
    return _mean(total, 0, n_ticks(window_s, tick_s) - 1)


def centred_mean(total: Array, window_s: float, tick_s: float) -> Array:
    """Mean over a window about each tick; shorter at both ends."""
    half = n_ticks(window_s / 2.0, tick_s)
    return _mean(total, half, half)


def _mean(total: Array, before: int, after: int) -> Array:
    """Mean from ``before`` ticks ago to ``after`` ticks ahead, of a running total; shorter at the ends."""
    length = total.shape[-1] - 1
    before, after = min(before, length - 1), min(after, length - 1)
    # A window that sticks out takes what is there.
    summed = np.empty((*total.shape[:-1], length))
    summed[..., : length - after] = total[..., after + 1 :]
    summed[..., length - after :] = total[..., -1:]
    summed[..., before:] -= total[..., : length - before]
    n = np.full(length, before + after + 1)
    n[:before] -= np.arange(before, 0, -1)
    n[length - after :] -= np.arange(1, after + 1)
    return np.asarray(np.divide(summed, n, out=summed))


def last_true(mask: Mask) -> NDArray[np.int64]:
    """Index of the latest true tick up to each tick; −1 before the first."""
    found: NDArray[np.int64] = np.maximum.accumulate(np.where(mask, np.arange(mask.shape[-1]), -1), axis=-1)
    return found


def next_true(mask: Mask) -> NDArray[np.int64]:
    """Index of the earliest true tick from each tick on; the number of ticks after the last."""
    length = mask.shape[-1]
    backwards = np.where(mask, np.arange(length), length)[..., ::-1]
    found: NDArray[np.int64] = np.minimum.accumulate(backwards, axis=-1)[..., ::-1]
    return found


def seconds_since(mask: Mask, horizon_s: float, tick_s: float) -> Array:
    """Time since the mask was last true, 0 while it is; at most ``horizon_s``, also if it never was."""
    latest = last_true(mask)
    elapsed = (np.arange(mask.shape[-1]) - latest) * tick_s
    return np.where(latest < 0, horizon_s, np.minimum(elapsed, horizon_s))


def seconds_until(mask: Mask, horizon_s: float, tick_s: float) -> Array:
    """Time until the mask is next true, 0 while it is; at most ``horizon_s``, also if it never is again."""
    coming = next_true(mask)
    ahead = (coming - np.arange(mask.shape[-1])) * tick_s
    return np.where(coming >= mask.shape[-1], horizon_s, np.minimum(ahead, horizon_s))
