"""The steps of an execution to lanes and lines: which plan, what each hand was told, and what went wrong."""

from typing import Any

import polars as pl

from demoplan.viewers import colours
from demoplan.viewers.describe import activity_text
from demoplan.viewers.episode_view import Lane, Note
from demoplan.viewers.lanes import lane_of

FAILED: colours.Rgb = (220, 62, 62)
"""Steps that failed, and the time lost to them."""

_PLANS: tuple[colours.Rgb, ...] = ((119, 170, 221), (238, 200, 80), (238, 136, 102), (204, 102, 119))
"""Plans in order: the warmer, the later."""

_BAD_STATES = ("failed", "timeout", "cancelled")


def dispatched(steps: pl.DataFrame) -> pl.DataFrame:
    """The steps that were begun, in order of time, with at least an instant's length."""
    begun = steps.filter(pl.col("start_ns").is_not_null())
    ended = pl.col("end_ns").fill_null(pl.col("start_ns") + 1)
    return begun.with_columns(
        end_ns=pl.when(ended > pl.col("start_ns")).then(ended).otherwise(pl.col("start_ns") + 1)
    ).sort("start_ns", "plan_index", "step_index")


def step_text(step: dict[str, Any]) -> str:
    """A step as its lane shows it: what the hand does to what, and how it ended if not well."""
    things = [thing for thing in step["arguments"] if thing != step["hand"]]
    moved = things[0] if things else None
    target = things[-1] if len(things) > 1 else None
    text = activity_text(step["activity"], target or moved, moved if target else None)
    if step["operator"].startswith("recover"):
        text = f"recover: {text}"
    return text if step["state"] not in _BAD_STATES else f"{step['state'].upper()} {text}"


def plan_lanes_of(steps: pl.DataFrame, end_ns: int) -> tuple[Lane, ...]:
    """Which plan was followed when, and from where to where something was wrong; both until ``end_ns``."""
    rows = dispatched(steps)
    if rows.is_empty():
        return ()
    end_ns = max(end_ns, int(max(rows["end_ns"])))
    begins = rows.group_by("plan_index", maintain_order=True).agg(pl.col("start_ns").min()).sort("start_ns")
    edges = [*begins["start_ns"], end_ns]
    names = [_plan_name(int(k)) for k in begins["plan_index"]]
    colour = {_plan_name(int(k)): _PLANS[min(int(k), len(_PLANS) - 1)] for k in begins["plan_index"]}
    spans = [(a, b, name) for a, b, name in zip(edges, edges[1:], names, strict=False) if b > a]
    lanes = [lane_of(("execution", "plan"), spans, colour)]
    trouble = list(_trouble(rows, end_ns))
    if trouble:
        by_state = dict.fromkeys((text for *_, text in trouble), FAILED)
        lanes.append(lane_of(("execution", "trouble"), trouble, by_state))
    return tuple(lanes)


def _plan_name(index: int) -> str:
    return "plan 1" if index == 0 else f"plan {index + 1} (replanned)"


def _trouble(rows: pl.DataFrame, end_ns: int) -> list[tuple[int, int, str]]:
    """From the end of each step that went wrong until the next plan, the next trouble, or the end."""
    begins = rows.group_by("plan_index").agg(pl.col("start_ns").min()).sort("plan_index")
    first_of = dict(zip(begins["plan_index"], begins["start_ns"], strict=True))
    bad = rows.filter(pl.col("failure").is_not_null()).sort("end_ns", "plan_index", "step_index")
    found: list[tuple[int, int, str]] = []
    for step in bad.iter_rows(named=True):
        begin = int(step["end_ns"])
        later = [start for index, start in first_of.items() if index > step["plan_index"] and start > begin]
        until = min(later, default=max(end_ns, begin + 1))
        if found and found[-1][1] > begin:
            cut = (found[-1][0], begin, found[-1][2])
            found = [*found[:-1], cut] if cut[0] < cut[1] else found[:-1]
        found.append((begin, int(until), f"{step['failure']}: {step['cause']}"))
    return found


def step_lanes_of(steps: pl.DataFrame) -> tuple[Lane, ...]:
    """Per hand, what it was told to do; what did not end well is red and says how it ended."""
    lanes = []
    rows = dispatched(steps)
    for (hand,), part in rows.filter(pl.col("hand").is_not_null()).group_by("hand", maintain_order=True):
        spans: list[tuple[int, int, str]] = []
        by_state: dict[str, colours.Rgb] = {}
        for step in part.iter_rows(named=True):
            text = step_text(step)
            is_bad = step["state"] in _BAD_STATES
            by_state[text] = FAILED if is_bad else colours.activity_colour(step["activity"])
            if spans and spans[-1][1] > step["start_ns"]:
                spans[-1] = (spans[-1][0], step["start_ns"], spans[-1][2])
            if spans and spans[-1][0] == spans[-1][1]:
                spans.pop()
            spans.append((step["start_ns"], step["end_ns"], text))
        used = {text: colour for text, colour in by_state.items() if any(text == s[2] for s in spans)}
        lanes.append(lane_of((str(hand), "step"), spans, used))
    return tuple(sorted(lanes, key=lambda lane: lane.path))


def events_of(steps: pl.DataFrame, run: dict[str, Any] | None) -> tuple[Note, ...]:
    """What happened, line by line: plans, steps with what was sensed against what was expected, the end."""
    rows = dispatched(steps)
    notes: list[Note] = []
    last_plan = None
    for step in rows.iter_rows(named=True):
        if step["plan_index"] != last_plan:
            planned = steps.filter(pl.col("plan_index") == step["plan_index"]).height
            is_replan = last_plan is not None
            notes.append(
                Note(
                    tick_ns=step["start_ns"],
                    text=f"{_plan_name(step['plan_index'])}: {planned} steps",
                    colour=_PLANS[min(step["plan_index"], len(_PLANS) - 1)],
                    level="WARN" if is_replan else "INFO",
                )
            )
            last_plan = step["plan_index"]
        notes.append(
            Note(
                tick_ns=step["start_ns"],
                text=f"{step['operator']}({', '.join(step['arguments'])})",
                colour=colours.activity_colour(step["activity"]),
            )
        )
        notes += _ending(step)
    if run is not None and not rows.is_empty():
        reached = "reached" if run["is_goal_reached"] else "not reached"
        notes.append(
            Note(
                tick_ns=int(max(rows["end_ns"])),
                text=f"{run['outcome']}; by physics the goal is {reached}",
                colour=(102, 187, 153) if run["is_goal_reached"] else FAILED,
                level="INFO" if run["is_goal_reached"] else "ERROR",
            )
        )
    return tuple(sorted(notes, key=lambda note: note.tick_ns))


def _ending(step: dict[str, Any]) -> list[Note]:
    """How a step ended, if not as expected."""
    is_bad = step["state"] in _BAD_STATES or step["failure"] is not None
    senses = _senses(step)
    if not is_bad and not senses:
        return []
    why = f"{step['failure']}: {step['cause']}" if step["failure"] is not None else senses
    text = f"{step['operator']} {step['state']}" + (f"; {why}" if why else "")
    colour = FAILED if is_bad else colours.UNKNOWN
    return [Note(tick_ns=step["end_ns"], text=text, colour=colour, level="ERROR" if is_bad else "WARN")]


def _senses(step: dict[str, Any]) -> str:
    """What was sensed of a step against what was expected; empty if they agree."""
    parts = [
        f"{word}: {', '.join(step[column])}"
        for column, word in (
            ("unmet", "not given at its start"),
            ("missing", "expected and not sensed"),
            ("extra", "sensed and not expected"),
        )
        if step[column]
    ]
    return "; ".join(parts)


def diagnoses_of(steps: pl.DataFrame) -> tuple[Note, ...]:
    """Per failure its class and cause in words, and beneath it what was sensed against what was expected."""
    notes = []
    for step in (
        dispatched(steps).filter(pl.col("failure").is_not_null()).sort("end_ns").iter_rows(named=True)
    ):
        said = f"{step['operator']}({', '.join(step['arguments'])}): {step['failure']}: {step['cause']}"
        measured = [
            f"{word} {step[column]:.3g} {unit}".strip()
            for column, word, unit in (
                ("tracking_error_m", "hand off its course by at most", "m"),
                ("peak_force_n", "contact force at most", "N"),
                ("n_collisions", "unwanted contacts:", ""),
            )
            if step[column] is not None
        ]
        for text in (said, _senses(step), "; ".join(measured)):
            if text:
                level = "ERROR" if text is said else "INFO"
                colour = FAILED if text is said else colours.UNKNOWN
                notes.append(Note(tick_ns=step["end_ns"], text=text, colour=colour, level=level))
    return tuple(notes)
