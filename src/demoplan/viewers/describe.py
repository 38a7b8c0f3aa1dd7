"""What an episode is, in Markdown, from names that are not trusted."""

import re
from collections.abc import Sequence
from typing import Any, TypeAlias

from demoplan.viewers.episode_view import Entity, Threshold

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>()#+!|~])")


def markdown_text(text: str) -> str:
    r"""Text that Markdown shows as it is, on one line.

    >>> markdown_text("a|b\n*c*")
    'a\\|b \\*c\\*'
    """
    return _SPECIAL.sub(r"\\\1", " ".join(str(text).split()))


def activity_text(activity: str, acted_on: str | None, in_hand: str | None) -> str:
    """An activity with its objects, as a lane shows it.

    >>> activity_text("Put", "cube_blue", "cube_red"), activity_text("Reach", "cube_red", None)
    ('Put cube_red → cube_blue', 'Reach cube_red')
    >>> activity_text("Take", "cube_red", "cube_red"), activity_text("Idle", None, None)
    ('Take cube_red', 'Idle')
    """
    things = [thing for thing in (in_hand, acted_on) if thing is not None]
    return " ".join([activity, " → ".join(dict.fromkeys(things))]).strip()


def document_of(
    episode_id: str,
    episode: dict[str, Any] | None,
    entities: Sequence[Entity],
    thresholds: Sequence[Threshold],
    *,
    start_ns: int,
    end_ns: int,
    goal: str | None = None,
) -> str:
    """Task, participant, outcome and entities of an episode, as Markdown.

    Args:
        episode_id: The demonstration.
        episode: Its row of the Episodes table, if known.
        entities: Instances that the view shows.
        thresholds: Numbers that its charts show.
        start_ns: First tick.
        end_ns: First tick after it.
        goal: What was to be reached, as goal text.
    """
    rows = [("duration", f"{(end_ns - start_ns) * 1e-9:.2f} s")]
    title = episode_id
    if episode is not None:
        title = episode["task"] or episode_id
        reached = {True: "reached", False: "not reached", None: "not stated"}[episode["is_goal_reached"]]
        rows = [
            ("episode", episode_id),
            ("participant", episode["participant"]),
            ("goal", f"{goal}: {reached}" if goal else reached),
            ("dataset", episode["dataset"]),
            ("log", episode["file"]),
            ("status", episode["status"] + (f": {episode['reason']}" if episode["reason"] else "")),
            *rows,
        ]
    lines = _table(title, rows)
    by_type: dict[str, list[str]] = {}
    for entity in entities:
        by_type.setdefault(entity.type_name, []).append(entity.name)
    lines += [
        f"| {markdown_text(t)} | {markdown_text(', '.join(names))} |" for t, names in sorted(by_type.items())
    ]
    lines += [f"| {markdown_text(t.name)} | {t.value:g} |" for t in thresholds]
    return "\n".join(lines) + "\n"


def document_of_run(run: dict[str, Any], *, duration_s: float, goal: str | None = None) -> str:
    """Goal, outcome and circumstances of an execution, as Markdown.

    Args:
        run: Its row of the Runs table.
        duration_s: Simulated time that the view shows [s].
        goal: Text of the goal; the run states its name.
    """
    fault = "none"
    if run["fault"] is not None:
        happened = "injected" if run["is_fault_injected"] else "never came to happen"
        fault = f"{run['fault']} ({run['fault_class']}; {happened})"
    rows = [
        ("goal", "reached by physics" if run["is_goal_reached"] else "not reached by physics"),
        ("outcome", str(run["outcome"]) + (f": {run['reason']}" if run["reason"] else "")),
        ("plans, steps", f"{run['n_plans']}, {run['n_steps']}"),
        ("discrepancies", f"{run['n_discrepancies']} acted upon, {run['n_passed']} passed by themselves"),
        ("diagnosed", run["diagnosed"] or "nothing"),
        ("fault", fault),
        ("robot, monitor", f"{run['robot']}, {run['monitor']}"),
        ("domain", f"{run['domain_name']} {run['domain_id']}"),
        ("seed", str(run["seed"])),
        ("duration", f"{duration_s:.2f} s"),
        ("run", run["run_id"]),
    ]
    return "\n".join(_table(goal or run["goal"], rows)) + "\n"


def _table(title: str, rows: Sequence[tuple[str, str]]) -> list[str]:
    lines = [f"### {markdown_text(title)}", "", "| | |", "| --- | --- |"]
    return lines + [f"| {name} | {markdown_text(value)} |" for name, value in rows]


Properties: TypeAlias = tuple[tuple[str, str | int | float | bool], ...]


def properties_of(
    episode_id: str, episode: dict[str, Any] | None, *, duration_s: float, goal: str | None
) -> Properties:
    """What a demonstration's recording is found by; what is not known is left out."""
    row = episode or {}
    found = {
        "kind": "demonstration",
        "id": episode_id,
        "success": row.get("is_goal_reached"),
        "goal": goal,
        "dataset": row.get("dataset"),
        "participant": row.get("participant"),
        "task": row.get("task"),
        "status": row.get("status"),
        "duration_s": duration_s,
    }
    return tuple((name, value) for name, value in found.items() if value is not None)


def properties_of_run(run: dict[str, Any], *, duration_s: float, goal: str | None = None) -> Properties:
    """What an execution's recording is found by; ``success`` is whether physics reached the goal."""
    found = {
        "kind": "execution",
        "id": run["run_id"],
        "success": run["is_goal_reached"],
        "goal": goal or run["goal"],
        "task": run["goal"],
        "robot": run["robot"],
        "domain": run["domain_name"],
        "domain_id": run["domain_id"],
        "outcome": run["outcome"],
        "monitor": run["monitor"],
        "seed": run["seed"],
        "fault": run["fault"],
        "diagnosed": run["diagnosed"],
        "n_plans": run["n_plans"],
        "n_discrepancies": run["n_discrepancies"],
        "duration_s": duration_s,
    }
    return tuple((name, value) for name, value in found.items() if value is not None)
