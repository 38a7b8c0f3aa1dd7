"""Activities, facts, evidence and signals to lanes, charts and notes along the time axis."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from demoplan.geometry import speeds
from demoplan.viewers import colours
from demoplan.viewers.describe import activity_text
from demoplan.viewers.episode_view import Body, Chart, Curve, Lane, Note, Threshold
from demoplan.viewers.scene import columns_of
from demoplan.viewers.sources import EpisodeViewParams


def lane_of(
    path: tuple[str, ...],
    spans: Iterable[tuple[int, int, str]],
    colour_by_state: dict[str, colours.Rgb],
    label_by_state: dict[str, str] | None = None,
) -> Lane:
    """A lane from spans in order; a gap between spans has no state."""
    ticks: list[int] = []
    states: list[str | None] = []
    last_end: int | None = None
    for start, end, state in spans:
        if last_end is not None and start > last_end:
            ticks.append(last_end)
            states.append(None)
        ticks.append(start)
        states.append(state)
        last_end = end
    if last_end is not None:
        ticks.append(last_end)
        states.append(None)
    used = {state for state in states if state is not None}
    return Lane(
        path=path,
        ticks_ns=np.array(ticks, dtype=np.int64),
        states=tuple(states),
        colours=tuple(sorted((state, colour_by_state[state]) for state in used)),
        labels=()
        if label_by_state is None
        else tuple(sorted((state, label_by_state[state]) for state in used)),
    )


def hand_lanes_of(
    activities: pl.DataFrame | None, truth: pl.DataFrame | None, evidence: pl.DataFrame | None
) -> tuple[Lane, ...]:
    """Per hand: what was inferred, what is true, and the operators that matched."""
    lanes = []
    hands: set[str] = set()
    for table in (activities, truth, evidence):
        if table is not None:
            hands |= set(table["hand"].unique())
    for hand in sorted(hands):
        # The viewer sorts lanes by name: what is true comes to stand below what was inferred.
        for title, table in (("activity", activities), ("activity_true", truth)):
            if table is None:
                continue
            rows = table.filter(pl.col("hand") == hand).sort("start_ns")
            shown = [
                (start, end, activity_text(name, thing, held), name)
                for start, end, name, thing, held in rows.select(
                    "start_ns", "end_ns", "activity", "acted_on", "in_hand"
                ).iter_rows()
            ]
            if shown:
                by_state = {state: colours.activity_colour(name) for *_, state, name in shown}
                lanes.append(lane_of((hand, title), ((s, e, state) for s, e, state, _ in shown), by_state))
        if evidence is not None:
            rows = evidence.filter(pl.col("hand") == hand).sort("start_ns", "operator")
            # One activity may support an operator and its quarantined sibling: the first by name is shown.
            rows = rows.unique("start_ns", keep="first", maintain_order=True)
            if not rows.is_empty():
                spans = list(zip(rows["start_ns"], rows["end_ns"], rows["operator"], strict=True))
                by_state = {name: colours.operator_colour(name) for name in rows["operator"].unique()}
                lanes.append(lane_of((hand, "operator"), spans, by_state))
    return tuple(lanes)


def fact_lanes_of(facts: pl.DataFrame | None) -> tuple[Lane, ...]:
    """A lane per atom that ever held or could not be observed, grouped by predicate."""
    if facts is None:
        return ()
    lanes = []
    rows = facts.sort("predicate", "arguments", "start_ns")
    for (predicate, arguments), part in rows.group_by("predicate", "arguments", maintain_order=True):
        by_state = {"true": colours.colour_of(str(predicate)), "unknown": colours.UNKNOWN}
        spans = zip(part["start_ns"], part["end_ns"], part["value"].cast(pl.String), strict=True)
        path = (str(predicate), *map(str, arguments))
        # The lane is named after its atom: a stretch of colour says enough, one without sight says so.
        lanes.append(lane_of(path, spans, by_state, {"true": " ", "unknown": "not observed"}))
    return tuple(lanes)


def relation_lanes_of(facts: pl.DataFrame | None) -> tuple[Lane, ...]:
    """Per binary predicate and first argument, what the second one is: what lies on what, who holds what.

    Only of predicates that relate a thing to at most one other at a time, as ``onTop`` does, since one lane
    can show no more; if there are none, of all binary ones, with all their second arguments.
    """
    if facts is None:
        return ()
    pairs = facts.filter(pl.col("arguments").list.len() == 2).sort("predicate", "arguments", "start_ns")
    spans: dict[tuple[str, str], list[_Span]] = {}
    crowded: set[str] = set()
    keys = pl.col("arguments").list.first().alias("first")
    for (predicate, first), part in pairs.group_by("predicate", keys, maintain_order=True):
        found = list(_together(part))
        spans[str(predicate), str(first)] = found
        if any(len(span.true) > 1 for span in found):
            crowded.add(str(predicate))
    shown = {key: found for key, found in spans.items() if key[0] not in crowded} or spans
    lanes = []
    for (predicate, first), found in shown.items():
        colour_by_state = {span.text: span.colour(predicate) for span in found}
        lanes.append(
            lane_of((predicate, first), ((s.start_ns, s.end_ns, s.text) for s in found), colour_by_state)
        )
    return tuple(lanes)


@dataclass(frozen=True)
class _Span:
    """For how long some things were related, and some might have been."""

    start_ns: int
    end_ns: int
    true: tuple[str, ...]
    unknown: tuple[str, ...]

    @property
    def text(self) -> str:
        """The things' names."""
        unseen = f"not observed: {', '.join(self.unknown)}" if self.unknown else ""
        return "; ".join(filter(None, (", ".join(self.true), unseen)))

    def colour(self, predicate: str) -> colours.Rgb:
        """That of the one thing, if it is one."""
        if not self.true:
            return colours.UNKNOWN
        return colours.entity_colour(self.true[0]) if len(self.true) == 1 else colours.colour_of(predicate)


def _together(facts: pl.DataFrame) -> Iterable[_Span]:
    """Stretches in which the set of second arguments is the same, in order; none where it is empty."""
    seconds = [str(arguments[1]) for arguments in facts["arguments"].to_list()]
    rows = list(zip(facts["start_ns"], facts["end_ns"], facts["value"].cast(pl.String), seconds, strict=True))
    begins = [(start, 1, value, second) for start, _, value, second in rows]
    ends = [(end, 0, value, second) for _, end, value, second in rows]
    active: dict[str, set[str]] = {"true": set(), "unknown": set()}
    since = 0
    # What ends at an instant goes before what begins there.
    for tick, is_begin, value, second in sorted(begins + ends):
        if tick > since and (active["true"] or active["unknown"]):
            yield _Span(since, tick, tuple(sorted(active["true"])), tuple(sorted(active["unknown"])))
        since = tick
        (active[value].add if is_begin else active[value].discard)(second)


def charts_of(
    hands: Sequence[Body],
    tracks: dict[str, pl.DataFrame],
    thresholds: Sequence[Threshold],
    params: EpisodeViewParams,
) -> tuple[Chart, ...]:
    """Speed of every hand; grip of those that have one."""
    speed, grip = [], []
    for body in hands:
        track = tracks[body.entity.name]
        ticks = track["tick_ns"].to_numpy()
        positions = columns_of(track["position_xyz_m"], 3)
        tick_s = float(ticks[1] - ticks[0]) * 1e-9 if len(ticks) > 1 else 1.0
        # The fit reaches into a gap from either side; what was not seen has no speed.
        is_seen = np.isfinite(positions).all(axis=1)
        values = np.where(is_seen, speeds(positions, tick_s, params.speed_window_s), np.nan)
        name, colour = body.entity.name, body.colour
        speed.append(Curve(name=name, unit="m/s", colour=colour, ticks_ns=ticks, values=values))
        if body.grips is not None:
            openings = track["grip"].to_numpy().astype(np.float64)
            grip.append(Curve(name=name, unit="1", colour=colour, ticks_ns=ticks, values=openings))
    charts = (("speed", "Hand speed [m/s]", speed), ("grip", "Grip [0 closed, 1 open]", grip))
    return tuple(
        Chart(
            name=name,
            title=title,
            curves=tuple(curves),
            thresholds=tuple(threshold for threshold in thresholds if threshold.quantity == name),
        )
        for name, title, curves in charts
        if curves
    )


def notes_of(evidence: pl.DataFrame | None) -> tuple[Note, ...]:
    """One line per matched operator: its binding, and what this demonstration did not show."""
    if evidence is None:
        return ()
    return tuple(
        Note(
            tick_ns=row["start_ns"],
            text=f"{row['operator']}({', '.join(row['binding'])})"
            + (f"  but not {', '.join(row['contradicts'])}" if row["contradicts"] else ""),
            colour=colours.operator_colour(row["operator"]),
        )
        for row in evidence.sort("start_ns", "hand", "operator").iter_rows(named=True)
    )
