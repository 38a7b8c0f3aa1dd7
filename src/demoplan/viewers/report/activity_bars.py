"""Activities along time as inline SVG: what was inferred, what is true beneath it, and where they differ.

Lengths along time are percentages and heights are pixels, so that a bar fills any page width while its text
keeps its size; each stretch is a nested ``svg``, which clips its own text.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import polars as pl
from markupsafe import Markup

from demoplan.viewers.colours import activity_colour, hex_colour
from demoplan.viewers.describe import activity_text
from demoplan.viewers.report.markup import ink_on, text

_ROW = 18
_GAP = 3
_DIFFERENCE = 4
_AXIS = 18


@dataclass(frozen=True, kw_only=True)
class HandBars:
    """One hand's bars, drawn."""

    hand: str
    svg: Markup
    agreement: float | None
    """Share of the time in which both say the same; null without truth."""


@dataclass(frozen=True, kw_only=True)
class EpisodeBars:
    """One episode's bars, hand by hand, over a shared time axis."""

    episode_id: str
    duration_s: float
    hands: tuple[HandBars, ...]
    axis: Markup


def episode_bars(activities: pl.DataFrame | None, truth: pl.DataFrame | None) -> tuple[EpisodeBars, ...]:
    """Bars for every episode that has activities or truth, sorted by episode and hand."""
    tables = [table for table in (activities, truth) if table is not None and not table.is_empty()]
    if not tables:
        return ()
    everything = pl.concat([table.select("episode_id", "hand", "start_ns", "end_ns") for table in tables])
    spans = (
        everything.group_by("episode_id")
        .agg(pl.col("start_ns").min(), pl.col("end_ns").max())
        .sort("episode_id")
    )
    inferred, true = _rows_by_hand(activities), _rows_by_hand(truth)
    result = []
    for episode_id, start, end in spans.iter_rows():
        hands = sorted({hand for episode, hand in (*inferred, *true) if episode == episode_id})
        result.append(
            EpisodeBars(
                episode_id=episode_id,
                duration_s=(end - start) * 1e-9,
                hands=tuple(
                    _hand_bars(
                        hand,
                        inferred.get((episode_id, hand), []),
                        true.get((episode_id, hand), []),
                        start,
                        end,
                    )
                    for hand in hands
                ),
                axis=_axis((end - start) * 1e-9),
            )
        )
    return tuple(result)


def activity_names(*tables: pl.DataFrame | None) -> tuple[str, ...]:
    """Every activity that occurs, sorted: the legend."""
    return tuple(
        sorted({name for table in tables if table is not None for name in table["activity"].unique()})
    )


_Row: TypeAlias = tuple[int, int, str, str | None, str | None]
"""Start and end [ns], activity, what it acts on, what is in the hand."""


def _rows_by_hand(table: pl.DataFrame | None) -> dict[tuple[str, str], list[_Row]]:
    rows: dict[tuple[str, str], list[_Row]] = {}
    if table is not None:
        columns = ("episode_id", "hand", "start_ns", "end_ns", "activity", "acted_on", "in_hand")
        for episode, hand, *rest in table.sort("episode_id", "hand", "start_ns").select(columns).iter_rows():
            rows.setdefault((episode, hand), []).append((rest[0], rest[1], rest[2], rest[3], rest[4]))
    return rows


def _hand_bars(
    hand: str, inferred: Sequence[_Row], true: Sequence[_Row], start_ns: int, end_ns: int
) -> HandBars:
    parts = []
    y = 0
    if inferred:
        parts += [_stretch(row, "inferred", y, start_ns, end_ns) for row in inferred]
        y += _ROW
    agreement = None
    if inferred and true:
        differences, agreement = _differences(inferred, true)
        parts += [
            Markup('<rect class="differs" x="{}" y="{}" width="{}" height="{}"/>').format(
                _percent(a - start_ns, end_ns - start_ns),
                y + 1,
                _percent(b - a, end_ns - start_ns),
                _DIFFERENCE - 1,
            )
            for a, b in differences
        ]
        y += _DIFFERENCE + 1
    if true:
        parts += [_stretch(row, "true", y, start_ns, end_ns) for row in true]
        y += _ROW
    label = text(f"Activities of {hand}")
    svg = Markup('<svg class="bars" height="{}" role="img" aria-label="{}">{}</svg>').format(
        y + _GAP, label, Markup("").join(parts)
    )
    return HandBars(hand=hand, svg=svg, agreement=agreement)


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.3f}%"


def _stretch(row: _Row, kind: str, y: int, start_ns: int, end_ns: int) -> Markup:
    start, end, activity, acted_on, in_hand = row
    colour = activity_colour(activity)
    what = activity_text(activity, acted_on, in_hand)
    share = (end - start) / (end_ns - start_ns)
    # A stretch too short for a letter gets none; its title still says what it is.
    label = Markup("")
    if share > 0.018:
        label = Markup('<text x="3" y="{}" fill="{}">{}</text>').format(_ROW - 5, ink_on(colour), text(what))
    return Markup(
        '<svg x="{}" y="{}" width="{}" height="{}"><title>{}: {}, {:.2f} s to {:.2f} s</title>'
        '<rect width="100%" height="100%" fill="{}" class="stretch"/>{}</svg>'
    ).format(
        _percent(start - start_ns, end_ns - start_ns),
        y,
        _percent(end - start, end_ns - start_ns),
        _ROW,
        kind,
        text(what),
        (start - start_ns) * 1e-9,
        (end - start_ns) * 1e-9,
        hex_colour(colour),
        label,
    )


def _differences(inferred: Sequence[_Row], true: Sequence[_Row]) -> tuple[list[tuple[int, int]], float]:
    """Spans in which the names differ, merged, and the share of the common time in which they agree."""
    spans: list[tuple[int, int]] = []
    common = same = 0
    i = j = 0
    while i < len(inferred) and j < len(true):
        low, high = max(inferred[i][0], true[j][0]), min(inferred[i][1], true[j][1])
        if low < high:
            common += high - low
            if inferred[i][2] == true[j][2]:
                same += high - low
            elif spans and spans[-1][1] == low:
                spans[-1] = (spans[-1][0], high)
            else:
                spans.append((low, high))
        if inferred[i][1] <= true[j][1]:
            i += 1
        else:
            j += 1
    return spans, same / common if common else 0.0


def _axis(duration_s: float) -> Markup:
    """Round seconds, six or so of them."""
    rough = max(duration_s, 1e-3) / 6
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= rough)
    marks = []
    for k in range(int(duration_s / step + 1e-9) + 1):
        seconds = k * step
        share = seconds / duration_s
        anchor = "start" if k == 0 else "end" if share > 0.97 else "middle"
        marks.append(
            Markup(
                '<line x1="{0}" x2="{0}" y1="0" y2="4" class="tick"/>'
                '<text x="{0}" y="15" text-anchor="{1}">{2:g} s</text>'
            ).format(_percent(seconds, duration_s), anchor, round(seconds, 6))
        )
    return Markup('<svg class="axis" height="{}" aria-hidden="true">{}</svg>').format(
        _AXIS, Markup("").join(marks)
    )
