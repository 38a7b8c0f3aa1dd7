"""From readings to states that switch: hysteresis, runs, and runs too short to mean anything.

All functions work along the last axis, without a loop over ticks.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Bools: TypeAlias = NDArray[np.bool_]
Ints: TypeAlias = NDArray[np.int64]
Codes: TypeAlias = NDArray[np.int8]


def hysteresis(enters: Bools, stays: Bools) -> Bools:
    """A state that is set wherever ``enters`` and lasts as long as ``stays``.

    Args:
        enters: ``(..., n)``; sets the state.
        stays: ``(..., n)``; where false (and not ``enters``), the state is reset. It begins reset.

    >>> import numpy as np
    >>> level = np.array([0, 2, 1, 1, 0, 1, 1])
    >>> hysteresis(level >= 2, level >= 1).astype(int)
    array([0, 1, 1, 1, 0, 0, 0])
    """
    # What never enters never holds; of many atoms, that is most.
    if enters.ndim == 2:
        is_entered = enters.any(axis=-1)
        if not is_entered.all():
            found = np.zeros(enters.shape, np.bool_)
            if is_entered.any():
                found[is_entered] = hysteresis(enters[is_entered], stays[is_entered])
            return found
    # Events are numbered by their ticks, from 1, with what they do in the lowest bit: the latest one decides.
    n = enters.shape[-1]
    numbers = 2 * np.arange(1, n + 1, dtype=np.int32 if n < 2**30 - 1 else np.int64)
    latest = np.maximum.accumulate((numbers + enters) * (enters | ~stays), axis=-1)
    return np.asarray((latest & 1).astype(np.bool_))


def run_lengths(codes: Codes) -> tuple[Ints, Ints, Ints, Codes]:
    """Longest runs of equal values in each row of ``(m, n)``.

    Returns:
        Row, first column, column after the last, and value of each run; in order of row, then column. Every
        row is tiled by its runs.
    """
    n_rows, n_columns = codes.shape
    if n_rows == 0 or n_columns == 0:
        nothing = np.zeros(0, np.int64)
        return nothing, nothing, nothing, np.zeros(0, np.int8)
    begins = np.empty(codes.shape, np.bool_)
    begins[:, 0] = True
    np.not_equal(codes[:, 1:], codes[:, :-1], out=begins[:, 1:])
    flat = np.flatnonzero(begins)
    rows, starts = np.divmod(flat, n_columns)
    ends = np.append(flat[1:], n_rows * n_columns) - rows * n_columns
    return rows, starts, ends, codes.reshape(-1)[flat]


def without_short_runs(codes: Codes, code: int, between: int, n_least: int) -> Codes:
    """The same rows, in which runs of ``code`` shorter than ``n_least`` ticks become ``between``.

    Only runs with ``between`` on both sides are changed: at the ends of a row, and next to a third value,
    nothing says that the run is short.
    """
    if n_least <= 1:
        return codes
    rows, starts, ends, values = run_lengths(codes)
    is_short = (values == code) & (ends - starts < n_least)
    is_short[1:] &= (rows[1:] == rows[:-1]) & (values[:-1] == between)
    is_short[:-1] &= (rows[:-1] == rows[1:]) & (values[1:] == between)
    is_short[:1] = is_short[-1:] = False
    if not is_short.any():
        return codes
    values = np.where(is_short, np.int8(between), values)
    return np.asarray(np.repeat(values, ends - starts)).reshape(codes.shape)
