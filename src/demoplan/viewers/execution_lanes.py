"""The steps of an execution to lanes and lines: which plan, what each hand was told, and what went wrong."""

from collections.abc import Sequence
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


def plan_lanes_of(steps: pl.DataFrame) -> tuple[Lane, ...]:
    """Which plan was followed when, and from where to where something was wrong."""
    rows = dispatched(steps)
    if rows.is_empty():
        return ()
    end_ns = int(max(rows["end_ns"]))
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
    """From the end of each step that went wrong to the next dispatch, or to the next trouble."""
    starts = sorted(set(rows["start_ns"]))
    found: list[tuple[int, int, str]] = []
    for step in rows.filter(pl.col("failure").is_not_null()).sort("end_ns").iter_rows(named=True):
        begin = int(step["end_ns"])
        until = next((start for start in starts if start >= begin), max(end_ns, begin + 1))
        until = max(int(until), begin + 1)
        if found and found[-1][1] > begin:
            found[-1] = (found[-1][0], begin, found[-1][2])
        if found and found[-1][0] >= begin:
            found.pop()
        found.append((begin, until, f"{step['failure']}: {step['cause']}"))
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
    parts = [
        f"{word}: {', '.join(step[column])}"
        for column, word in (
            ("unmet", "not given at the start"),
            ("missing", "expected and not sensed"),
            ("extra", "sensed and not expected"),
        )
        if step[column]
    ]
    if step["state"] not in _BAD_STATES and not parts and step["failure"] is None:
        return []
    is_bad = step["state"] in _BAD_STATES or step["failure"] is not None
    text = f"{step['operator']} {step['state']}" + (f"; {'; '.join(parts)}" if parts else "")
    return [
        Note(
            tick_ns=step["end_ns"],
            text=text,
            colour=FAILED if is_bad else colours.UNKNOWN,
            level="ERROR" if is_bad else "WARN",
        )
    ]


def diagnoses_of(steps: pl.DataFrame) -> tuple[Note, ...]:
    """The class and the cause of each failure, in words."""
    rows = dispatched(steps).filter(pl.col("failure").is_not_null()).sort("end_ns")
    return tuple(
        Note(
            tick_ns=step["end_ns"],
            text=f"{step['operator']}({', '.join(step['arguments'])}): {step['failure']}: {step['cause']}",
            colour=FAILED,
            level="ERROR",
        )
        for step in rows.iter_rows(named=True)
    )


def names_of_plans(steps: pl.DataFrame) -> Sequence[str]:
    """The plans that were begun, in order."""
    return [_plan_name(int(k)) for k in sorted(set(dispatched(steps)["plan_index"]))]
