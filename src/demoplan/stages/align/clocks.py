"""Clocks: jumps are found and undone, and one uniform grid of ticks is laid over all streams."""

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from demoplan.errors import DataError

Stamps: TypeAlias = NDArray[np.int64]


def steady(stamp_ns: Stamps, log_ns: Stamps, jump_ns: int, pause_ns: int) -> tuple[Stamps, Stamps]:
    """Stamps of one stream without the jumps of its clock, and on which stretch of the clock each lies.

    The recorder's clock is the reference. A source's clock may be off by any constant; a jump shows as a
    lasting change of that constant. So the stream is cut wherever its stamp steps back or ahead by more
    than ``jump_ns``; of each piece the offset to the recorder's clock is taken where the latency was least
    (its largest stamp − log); and a piece whose offset differs from the first one's by more than
    ``jump_ns`` is moved by the difference. What follows:

    - a clock that was set back or ahead (or restarted) during the recording is put right, and no data lost;
    - a pause in which both clocks ran on stays a pause, and messages that were merely delayed stay;
    - a few messages that came late, out of order, keep their stamps and are sorted in by the caller.

    If the recorder's own clock ran back, or ahead by more than ``pause_ns``, it goes on one typical step
    after where it was: nothing better is known.

    Args:
        stamp_ns: Chosen stamps ``(n,)`` in file order.
        log_ns: When the recorder received them ``(n,)``.
        jump_ns: Smallest step that may be a jump, and smallest change of offset that is one.
        pause_ns: Longest pause in a recording that is believed.

    Returns:
        Stamps ``(n,)``, still in file order; and the stretch ``(n,)`` each belongs to. Between stretches
        nothing may be interpolated: how far apart they are is known to within the latency only.
    """
    stretches = np.zeros(len(stamp_ns), np.int64)
    if len(stamp_ns) < 2:
        return stamp_ns, stretches
    steps = np.diff(stamp_ns)
    is_cut = np.abs(steps) > jump_ns
    log_steps = np.diff(log_ns)
    is_log_jump = (log_steps < -jump_ns) | (log_steps > pause_ns)
    if not (is_cut.any() or is_log_jump.any()):
        return stamp_ns, stretches
    if is_log_jump.any():
        steady_steps = log_steps[(log_steps > 0) & ~is_log_jump]
        typical = int(np.median(steady_steps)) if len(steady_steps) else 0
        log_ns = log_ns[0] + np.append(0, np.cumsum(np.where(is_log_jump, typical, log_steps)))
    firsts = np.append(0, np.flatnonzero(is_cut | is_log_jump) + 1)
    ends = np.append(firsts[1:], len(stamp_ns))
    offsets = np.maximum.reduceat(stamp_ns - log_ns, firsts)
    clocks: list[int] = [int(offsets[0])]
    of_piece: list[int] = []
    for offset in offsets:
        known = next((k for k, clock in enumerate(clocks) if abs(clock - offset) <= jump_ns), None)
        if known is None:
            known = len(clocks)
            clocks.append(int(offset))
        of_piece.append(known)
    pieces = [slice(first, end) for first, end in zip(firsts, ends, strict=True)]
    result = stamp_ns.copy()
    for piece, clock in enumerate(of_piece):
        is_amid = of_piece[piece - 1 : piece + 2 : 2] == [0, 0]
        if clock == 0 or (is_amid and _are_stragglers(pieces, piece, stamp_ns, log_ns, jump_ns)):
            continue
        result[pieces[piece]] += clocks[0] - clocks[clock]
        stretches[pieces[piece]] = clock
    return result, stretches


def _are_stragglers(pieces: list[slice], piece: int, stamp_ns: Stamps, log_ns: Stamps, jump_ns: int) -> bool:
    """Whether a piece is a few late messages: received in one go, and stamped within what lies about it."""
    rows, after = pieces[piece], pieces[piece + 1]
    is_brief = log_ns[rows][-1] - log_ns[rows][0] <= jump_ns
    return bool(
        is_brief and stamp_ns[0] <= stamp_ns[rows].min() and stamp_ns[rows].max() <= stamp_ns[after][0]
    )


def tick_grid(
    spans: Mapping[str, tuple[int, int]], rate_hz: float, longest_ns: int, episode_id: str
) -> Stamps:
    """Ticks at whole multiples of the period from the first stamp, up to the last.

    Args:
        spans: First and last stamp of each stream [ns], by its name.
        rate_hz: Ticks per second; the period is rounded to whole nanoseconds.
        longest_ns: Longest episode that is believed.
        episode_id: For messages.

    Raises:
        DataError: If the streams lie farther apart than that, as when one is stamped by an uptime clock
            and another by the time of day.
    """
    first = min(low for low, _ in spans.values())
    last = max(high for _, high in spans.values())
    if last - first > longest_ns:
        early = min(spans, key=lambda name: spans[name])
        late = max(spans, key=lambda name: (spans[name][1], name))
        raise DataError(
            f"episode {episode_id!r} would last {(last - first) / 3.6e12:.1f} h, the limit is "
            f"{longest_ns / 3.6e12:.1f} h: {early} begins at {spans[early][0] / 1e9:.3f} s, {late} ends at "
            f"{spans[late][1] / 1e9:.3f} s; do their clocks differ? choose 'clock: log' in the mapping"
        )
    period = round(1e9 / rate_hz)
    return np.arange(first, last + 1, period, dtype=np.int64)
