"""Velocities of tracked points, robust to noise and to missing readings."""

import numpy as np
from scipy.ndimage import correlate1d

from demoplan.geometry.rotations import Array, are_known
from demoplan.geometry.switching import Bools


def velocities(positions_xyz_m: Array, tick_s: float, window_s: float) -> Array:
    """Velocities [m/s] of points on a uniform clock, by a local straight-line fit.

    Each velocity is the slope of the least-squares line through the readings within half a window on
    either side. For a window without gaps that is the Savitzky-Golay derivative of order 1 (and 2, which
    has the same slope in the middle); missing readings are simply left out of the fit, and at the ends the
    window is one-sided. The estimate has no lag; a change of speed spreads over one window.

    Source: A. Savitzky, M. J. E. Golay, "Smoothing and differentiation of data by simplified least squares
    procedures", Analytical Chemistry 36 (1964), doi:10.1021/ac60214a047.

    Args:
        positions_xyz_m: ``(..., n, 3)``, one row per tick; NaN where nothing was seen.
        tick_s: Seconds between ticks.
        window_s: Length of the fit. At least three ticks are used, whatever it says.

    Returns:
        ``(..., n, 3)``; NaN where fewer than two readings lie within the window.
    """
    half = max(1, round(window_s / tick_s / 2))
    offsets: Array = np.arange(-half, half + 1, dtype=np.float64)
    squares: Array = np.asarray(offsets**2, dtype=np.float64)
    ones: Array = np.ones(len(offsets))
    is_seen: Bools = are_known(positions_xyz_m)[..., None]
    # Far from the origin the sums would cancel: fit about the middle of what was seen.
    filled: Array = np.where(is_seen, positions_xyz_m, 0.0)
    n_seen: Array = is_seen.sum(axis=-2, keepdims=True).astype(np.float64)
    middle: Array = filled.sum(axis=-2, keepdims=True) / np.maximum(n_seen, 1.0)
    filled = np.where(is_seen, positions_xyz_m - middle, 0.0)
    # Where nothing is missing, one mask serves all points.
    mask = is_seen.reshape(-1, *is_seen.shape[-2:])[0] if is_seen.all() else is_seen
    seen: Array = mask.astype(np.float64)

    def windowed(values: Array, weights: Array) -> Array:
        return np.asarray(correlate1d(values, weights, axis=-2, mode="constant", cval=0.0))

    length = filled.shape[-2]
    if is_seen.all() and length > 4 * half:
        # Within, windows are whole and their ticks sum to nothing: one sum is left of the fit.
        slopes = windowed(filled, offsets / (float(squares.sum()) * tick_s))
        for end, kept in ((slice(0, 3 * half), slice(0, half)), (slice(-3 * half, None), slice(-half, None))):
            slopes[..., kept, :] = velocities(filled[..., end, :], tick_s, window_s)[..., kept, :]
        return slopes
    n = windowed(seen, ones)
    sum_t = windowed(seen, offsets)
    sum_tt = windowed(seen, squares)
    sum_x = windowed(filled, ones)
    sum_tx = windowed(filled, offsets)
    spread = n * sum_tt - sum_t * sum_t
    is_fit = spread > 0.5
    slopes = (n * sum_tx - sum_t * sum_x) / np.where(is_fit, spread, 1.0)
    return np.where(is_fit, slopes / tick_s, np.nan)


def speeds(positions_xyz_m: Array, tick_s: float, window_s: float) -> Array:
    """Speeds [m/s] ``(..., n)``: lengths of :func:`velocities`.

    >>> import numpy as np
    >>> bool(np.allclose(speeds(np.linspace([0, 0, 0], [0, 0, 0.9], 10), 0.1, 0.3), 1.0))
    True
    """
    return np.asarray(np.linalg.norm(velocities(positions_xyz_m, tick_s, window_s), axis=-1))
