"""The dataset card: what is in it, where it comes from, and what one must know before using it.

Source: Hugging Face, *Dataset cards*: a YAML header with licence, tags and files, then Markdown.
"""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from demoplan.exports.lerobot import layout
from demoplan.exports.lerobot.content import DatasetFacts, EpisodeContent, LeRobotParams

_SPECIAL = re.compile(r"([\\`*_{}\[\]<>#|~])")
_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_SHOWN_SUBTASKS = 40


@dataclass(frozen=True, kw_only=True)
class CardContent:
    """What a card tells."""

    facts: DatasetFacts
    params: LeRobotParams
    episodes: tuple[EpisodeContent, ...]
    """In order of their index."""
    features: dict[str, dict[str, Any]]
    splits: dict[str, str]
    n_frames: int
    subtask_s: dict[str, float]
    """Text → seconds in all, in order of its number."""


def card_of(content: CardContent) -> str:
    """The card, as Markdown with a YAML header."""
    facts = content.facts
    parts = [
        _header(content),
        f"# {_text(facts.name)}\n",
        _text(facts.description) or "No description was given.",
        _licence(facts),
        _overview(content),
        _splits(content),
        _features(content),
        _subtasks(content),
        _reading(content),
        _origin(content),
    ]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _text(text: str) -> str:
    r"""Text that Markdown shows as it is, on one line.

    >>> _text("a|b\n*c*")
    'a\\|b \\*c\\*'
    """
    return _SPECIAL.sub(r"\\\1", " ".join(str(text).split()))


def _table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    return "\n".join([*lines, *(f"| {' | '.join(map(str, row))} |" for row in rows)])


def _header(content: CardContent) -> str:
    size = next((name for most, name in _SIZES if content.n_frames < most), "n>1M")
    # JSON's strings are YAML's too, whatever is in them.
    lines = [
        "---",
        f"license: {content.facts.licence or 'unknown'}",
        f"pretty_name: {json.dumps(content.facts.name)}",
        "task_categories:\n- robotics",
        "tags:\n- LeRobot\n- demoplan\n- manipulation\n- human-demonstrations",
        f"size_categories:\n- {size}",
        "configs:\n- config_name: default\n  data_files: data/*/*.parquet",
        "---",
    ]
    return "\n".join(lines)


def _licence(facts: DatasetFacts) -> str:
    if facts.licence is not None:
        return f"Licence: {facts.licence}."
    said = f"Its manifest says: “{_text(facts.licence_words)}”." if facts.licence_words else ""
    return (
        "> **Licence: unknown. Do not pass this dataset on.** The recordings state no licence that would "
        f"allow it. {said} This export is for use where the recordings themselves may be used."
    )


def _overview(content: CardContent) -> str:
    seconds = content.n_frames / content.params.fps
    stated = [episode.is_goal_reached for episode in content.episodes]
    reached = sum(value is True for value in stated)
    missed = sum(value is False for value in stated)
    truncated = [e.episode_id for e in content.episodes if e.status != "complete"]
    rows = [
        ("episodes", len(content.episodes)),
        ("frames", f"{content.n_frames} at {content.params.fps} per second ({seconds:.1f} s)"),
        ("participants", len({e.participant for e in content.episodes})),
        ("goal reached", f"{reached}; not reached: {missed}; not stated: {stated.count(None)}"),
        ("hands", _text(", ".join(content.facts.hands))),
        ("objects", _text(", ".join(content.facts.objects)) or "none"),
        ("source", _text(content.facts.source) or "not stated"),
    ]
    if truncated:
        rows.append(("read from damaged logs", _text(", ".join(truncated))))
    return "## What is in it\n\n" + _table(["", ""], rows)


def _splits(content: CardContent) -> str:
    rows = []
    for split, span in content.splits.items():
        members = [e for e in content.episodes if e.split == split]
        people = sorted({e.participant for e in members})
        rows.append((split, span, len(members), _text(", ".join(people))))
    seen = [{e.participant for e in content.episodes if e.split == split} for split in content.splits]
    is_apart = sum(len(people) for people in seen) == len(set().union(*seen))
    word = (
        "Nobody is in two splits: what is learned from one is tried on other people."
        if is_apart
        else "Some people are in more than one split: figures on one do not speak for new people."
    )
    body = _table(["split", "episodes", "number", "participants"], rows)
    return f"## Splits\n\n{body}\n\n{word if len(content.splits) > 1 else ''}"


def _features(content: CardContent) -> str:
    facts, fps = content.facts, content.params.fps
    deviation_ms = 0.0 if facts.tick_rate_hz % fps == 0 else 500.0 / facts.tick_rate_hz
    meanings = {
        layout.STATE: (
            f"per hand: position [m] in the frame `{_text(facts.world)}`, unit quaternion w, x, y, z (hand "
            "to that frame, without jumps of sign)"
            + (", opening `grip` (0 closed, 1 open; no width is recorded)" if facts.gripping else "")
        ),
        layout.ENVIRONMENT: "per object: position [m] and unit quaternion, as for hands",
        layout.SEEN: (
            "whether each pose or opening was observed at that frame; where it was not, the last one is held "
            "(before the first: the first; never seen: zeros and no rotation)"
        ),
        layout.ACTION: (
            "the hands' state one frame later; the last frame's is its own. Demonstrations hold no commands"
        ),
        layout.DONE: "true at an episode's last frame",
        layout.SUCCESS: "true at the last frame of an episode that reached its goal",
        layout.SUBTASK: "row of `meta/subtasks.parquet`: what the hands do",
        layout.LANGUAGE: "the same texts as rows of style `subtask`, each from its time on (lerobot ≥ 0.6)",
        "timestamp": "seconds from the episode's first frame",
    }
    meanings |= {layout.hand_subtask(h): f"the same table: what {_text(h)} does" for h in facts.hands}
    rows = [
        (f"`{name}`", feature["dtype"], "×".join(map(str, feature["shape"])), meanings.get(name, "index"))
        for name, feature in content.features.items()
    ]
    names = [
        f"- `{name}`: {', '.join(f'`{each}`' for each in feature['names'])}"
        for name, feature in content.features.items()
        if feature["names"] and name != layout.ACTION
    ]
    clock = (
        f"Frames are every tick, or every few ticks, of a clock of {facts.tick_rate_hz:g} Hz."
        if not deviation_ms
        else f"Frames are the nearest ticks of a clock of {facts.tick_rate_hz:g} Hz: at most "
        f"{deviation_ms:.1f} ms from their timestamps."
    )
    body = _table(["feature", "type", "shape", "meaning"], rows)
    return f"## Features\n\n{body}\n\n{clock}\n\nComponents, in order:\n\n" + "\n".join(names)


def _subtasks(content: CardContent) -> str:
    if layout.SUBTASK not in content.features:
        return "## Subtasks\n\nNone: the episodes hold no activities."
    longest = sorted(content.subtask_s.items(), key=lambda item: (-item[1], item[0]))
    rows = [(_text(text), f"{seconds:.1f}") for text, seconds in longest[:_SHOWN_SUBTASKS]]
    more = len(longest) - len(rows)
    tail = f"\n\nand {more} more." if more > 0 else ""
    return (
        f"## Subtasks\n\nActivities, {content.facts.activities_from}.\n\n"
        + _table(["subtask", "seconds"], rows)
        + tail
    )


def _reading(content: CardContent) -> str:
    return f"""## Reading it

```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("local/{content.facts.name}", root="THIS_FOLDER")
reached = dataset.meta.filter_episodes(lambda episode: episode["success"] is True)
```

`meta/episodes` also holds, per episode: `episode_id`, `participant`, `split`, `manifest_splits`, `success`
(null: not stated), `goal`, `status`, `log_sha256`."""


def _origin(content: CardContent) -> str:
    facts = content.facts
    return (
        "## Where it comes from\n\n"
        f"Written by demoplan {facts.version} from logs that were read, put on one clock and segmented. "
        f"Manifest: SHA-256 `{facts.manifest_sha256}`. Each log's SHA-256 is in `meta/episodes`."
    )
