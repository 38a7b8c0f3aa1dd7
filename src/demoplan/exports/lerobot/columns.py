"""One episode to the columns of a data file."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from demoplan.exports.lerobot import layout
from demoplan.exports.lerobot.content import DatasetFacts, EpisodeContent
from demoplan.exports.lerobot.subtasks import NOTHING, SubtaskTable, changes, hand_texts, joint_texts
from demoplan.exports.lerobot.vectors import EpisodeVectors, action_of, vectors_of


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where an episode stands in its dataset."""

    episode_index: int
    first_index: int
    """Frames of all episodes before it."""
    task_index: int


def columns_of(
    episode: EpisodeContent,
    facts: DatasetFacts,
    place: Place,
    features: dict[str, dict[str, Any]],
    subtasks: SubtaskTable,
    fps: int,
) -> dict[str, NDArray[Any]]:
    """Every declared feature of an episode but the language column: ``(n,)`` or ``(n, d)`` each.

    Args:
        episode: What is exported.
        facts: Names and order of hands and objects.
        place: Where the episode stands.
        features: What is declared; columns come in this order.
        subtasks: Texts met so far; new ones are added.
        fps: Frames per second [Hz].
    """
    vectors = vectors_of(episode.frames(), facts, fps)
    n = len(vectors.ticks_ns)
    is_last = np.arange(n) == n - 1
    columns: dict[str, NDArray[Any]] = {
        layout.STATE: vectors.state,
        layout.ENVIRONMENT: vectors.environment,
        layout.SEEN: vectors.is_seen,
        layout.ACTION: action_of(vectors.state),
        layout.DONE: is_last,
        layout.SUCCESS: is_last & bool(episode.is_goal_reached),
        "timestamp": (np.arange(n) / fps).astype(np.float32),
        "frame_index": np.arange(n, dtype=np.int64),
        "episode_index": np.full(n, place.episode_index, dtype=np.int64),
        "index": np.arange(place.first_index, place.first_index + n, dtype=np.int64),
        "task_index": np.full(n, place.task_index, dtype=np.int64),
    }
    if layout.SUBTASK in features:
        columns |= _subtask_columns(episode, facts, vectors, subtasks)
    return {name: columns[name] for name in features if name != layout.LANGUAGE}


def _subtask_columns(
    episode: EpisodeContent, facts: DatasetFacts, vectors: EpisodeVectors, subtasks: SubtaskTable
) -> dict[str, NDArray[Any]]:
    """Numbers of the subtask of all hands together, and of each; new texts are numbered as they occur."""
    ticks = vectors.ticks_ns
    if episode.activities is None:
        by_hand = [(np.zeros(len(ticks), dtype=np.int64), [NOTHING]) for _ in facts.hands]
    else:
        activities = episode.activities()
        by_hand = [hand_texts(activities, hand, ticks) for hand in facts.hands]

    def numbered(indices: NDArray[np.int64], texts: list[str]) -> NDArray[np.int64]:
        _, firsts = np.unique(indices, return_index=True)
        numbers = np.zeros(len(texts), dtype=np.int64)
        for k in indices[np.sort(firsts)]:
            numbers[k] = subtasks.number(texts[int(k)])
        return numbers[indices]

    return {
        layout.SUBTASK: numbered(*joint_texts(facts.hands, by_hand)),
        **{
            layout.hand_subtask(hand): numbered(*each)
            for hand, each in zip(facts.hands, by_hand, strict=True)
        },
    }


def arrow_of(columns: dict[str, NDArray[Any]], schema: pa.Schema, subtasks: SubtaskTable) -> pa.Table:
    """The columns as a data file holds them, with the language column if the schema has one."""
    arrays = []
    for field in schema:
        if field.name == layout.LANGUAGE:
            arrays.append(_language(columns, subtasks))
        elif pa.types.is_fixed_size_list(field.type):
            flat = pa.array(columns[field.name].reshape(-1), field.type.value_type)
            arrays.append(pa.FixedSizeListArray.from_arrays(flat, type=field.type))
        else:
            arrays.append(pa.array(columns[field.name].reshape(-1), field.type))
    return pa.Table.from_arrays(arrays, schema=schema)


def _language(columns: dict[str, NDArray[Any]], subtasks: SubtaskTable) -> pa.Array:
    """Every change of the subtask, with its time; the same list stands at every frame of the episode."""
    numbers, times = columns[layout.SUBTASK], columns["timestamp"]
    rows = [
        {
            "role": "assistant",
            "content": subtasks.texts[int(numbers[k])],
            "style": "subtask",
            "timestamp": float(times[k]),
            "camera": None,
            "tool_calls": None,
        }
        for k in changes(numbers)
    ]
    once = pa.array([rows], _storage_of(layout.language_type()))
    repeated = once.take(pa.array(np.zeros(len(numbers), dtype=np.int64)))
    return repeated.cast(layout.language_type())


def _storage_of(declared: pa.DataType) -> pa.DataType:
    """The same type with text in place of JSON, which Arrow cannot build from values."""
    row = declared.value_type
    plain = [field.with_type(pa.list_(pa.string())) if field.name == "tool_calls" else field for field in row]
    return pa.list_(pa.struct(plain))
