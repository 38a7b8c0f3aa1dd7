"""Activities to subtasks: a text for each frame, and the table that numbers the texts."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

NOTHING = "unlabelled"
"""Text of frames that no activity covers."""


class SubtaskTable:
    """Texts, numbered in the order in which they are first met."""

    def __init__(self) -> None:
        """Begin without any text."""
        self._numbers: dict[str, int] = {}

    def number(self, text: str) -> int:
        """The text's number; a new one if it is new."""
        return self._numbers.setdefault(text, len(self._numbers))

    @property
    def texts(self) -> tuple[str, ...]:
        """All texts; each stands at its number."""
        return tuple(self._numbers)


def subtask_text(activity: str, acted_on: str | None, in_hand: str | None) -> str:
    """An activity and the things that it is about, as words.

    >>> subtask_text("Put", "cube_blue", "cube_red"), subtask_text("Reach", "cube_red", None)
    ('Put cube_red to cube_blue', 'Reach cube_red')
    >>> subtask_text("Take", "cube_red", "cube_red"), subtask_text("Idle", None, None)
    ('Take cube_red', 'Idle')
    """
    things = dict.fromkeys(thing for thing in (in_hand, acted_on) if thing is not None)
    return " ".join([activity, " to ".join(things)]).strip()


def hand_texts(
    activities: pl.DataFrame, hand: str, ticks_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[str]]:
    """What a hand does at each tick: ``(n,)`` indices into a list of texts."""
    rows = activities.filter(pl.col("hand") == hand).sort("start_ns")
    texts = [subtask_text(*row) for row in rows.select("activity", "acted_on", "in_hand").iter_rows()]
    if not texts:
        return np.zeros(len(ticks_ns), dtype=np.int64), [NOTHING]
    starts, ends = rows["start_ns"].to_numpy(), rows["end_ns"].to_numpy()
    which = np.searchsorted(starts, ticks_ns, side="right") - 1
    is_covered = (which >= 0) & (ticks_ns < ends[np.clip(which, 0, None)])
    return np.where(is_covered, which, len(texts)), [*texts, NOTHING]


def joint_texts(
    hands: Sequence[str], texts_by_hand: Sequence[tuple[NDArray[np.int64], list[str]]]
) -> tuple[NDArray[np.int64], list[str]]:
    """What all hands do at each tick; with one hand its own text, with more each after its name.

    Returns:
        ``(n,)`` indices into a list of texts.
    """
    if len(hands) == 1:
        return texts_by_hand[0]
    columns = np.stack([indices for indices, _ in texts_by_hand], axis=1)
    rows, which = np.unique(columns, axis=0, return_inverse=True)
    texts = [
        "; ".join(f"{hand}: {texts_by_hand[k][1][int(row[k])]}" for k, hand in enumerate(hands))
        for row in rows
    ]
    return which.reshape(-1), texts


def changes(numbers: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices at which a stretch of equal numbers begins.

    >>> changes(np.array([3, 3, 1, 1, 3])).tolist()
    [0, 2, 4]
    """
    return np.flatnonzero(np.concatenate(([True], numbers[1:] != numbers[:-1]))[: len(numbers)])
