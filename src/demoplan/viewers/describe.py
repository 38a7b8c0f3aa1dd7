"""What an episode is, in Markdown, from names that are not trusted."""

import re
from collections.abc import Sequence
from typing import Any

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
) -> str:
    """Task, participant, outcome and entities of an episode, as Markdown.

    Args:
        episode_id: The demonstration.
        episode: Its row of the Episodes table, if known.
        entities: Instances that the view shows.
        thresholds: Numbers that its charts show.
        start_ns: First tick.
        end_ns: First tick after it.
    """
    rows = [("duration", f"{(end_ns - start_ns) * 1e-9:.2f} s")]
    title = episode_id
    if episode is not None:
        title = episode["task"] or episode_id
        reached = {True: "reached", False: "not reached", None: "not stated"}[episode["is_goal_reached"]]
        rows = [
            ("episode", episode_id),
            ("participant", episode["participant"]),
            ("goal", reached),
            ("dataset", episode["dataset"]),
            ("log", episode["file"]),
            ("status", episode["status"] + (f": {episode['reason']}" if episode["reason"] else "")),
            *rows,
        ]
    lines = [f"## {markdown_text(title)}", "", "| | |", "| --- | --- |"]
    lines += [f"| {name} | {markdown_text(value)} |" for name, value in rows]
    by_type: dict[str, list[str]] = {}
    for entity in entities:
        by_type.setdefault(entity.type_name, []).append(entity.name)
    lines += [
        f"| {markdown_text(t)} | {markdown_text(', '.join(names))} |" for t, names in sorted(by_type.items())
    ]
    lines += [f"| {markdown_text(t.name)} | {t.value:g} |" for t in thresholds]
    return "\n".join(lines) + "\n"
