"""True labels, in the forms that people write them, as activities.

Only scoring and training may read what comes out of here.
"""

import re
from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

import numpy as np
import polars as pl
from dataframely import DataFrame
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from demoplan.errors import DataError, UnknownNameError
from demoplan.manifests.mapping import Clock, Strict
from demoplan.tables import Activities, Samples
from demoplan.tables.validating import validated

BIMANUAL_ACTIONS = {
    0: "Idle",
    1: "Approach",
    2: "Retreat",
    3: "Lift",
    4: "Place",
    5: "Hold",
    6: "Pour",
    7: "Cut",
    8: "Hammer",
    9: "Saw",
    10: "Stir",
    11: "Screw",
    12: "Drink",
    13: "Wipe",
}
"""Actions by number.

Source: C. R. G. Dreher, M. Wächter, T. Asfour, "Learning object-action relations from bimanual human
demonstration using graph networks", RA-L 5 (2020), doi:10.1109/LRA.2019.2949221, and the numbering of its
data set.
"""

_HOLDING = frozenset({"Lift", "Place", "Hold"})
"""Actions whose object is in the hand."""
_EMPTY = frozenset({"Idle", "Approach", "Retreat"})
"""Actions of an empty hand."""


class LabelledInterval(Strict):
    """One activity of one hand; nanoseconds may be strings, as JSON cannot hold them otherwise."""

    start_ns: int
    end_ns: int
    activity: str
    acted_on: str | None = None
    in_hand: str | None = None


class LabelledActivities(Strict):
    """The form ``activities``. Beside it a file may tell more of its episode."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    format: Literal["activities"] = "activities"
    clock: Clock = "header"
    """Clock that the times are read from."""
    episode_id: str | None = None
    hands: dict[str, tuple[LabelledInterval, ...]]


_Parsed = TypeVar("_Parsed")
_Action: TypeAlias = tuple[int, int | None, str | None]
_Track: TypeAlias = Annotated[list[int | _Action], Field(min_length=3)]
_BIMANUAL = TypeAdapter(dict[str, _Track])

Row: TypeAlias = tuple[str, int, int, str, str | None, str | None]
"""Hand, start, end [ns], activity, acted on, in hand."""


def activities_of_labels(
    document: Any, label_format: str, episode_id: str, samples: DataFrame[Samples]
) -> DataFrame[Activities]:
    """The activities that a label file states, on the clock of the episode's samples.

    Args:
        document: The file's content, parsed from JSON.
        label_format: ``activities`` or ``bimanual-frames``.
        episode_id: The demonstration.
        samples: What was read of its log: it tells when the frames of ``bimanual-frames`` were, and how the
            clock of ``activities`` relates to the one that the mapping chose.

    Raises:
        DataError: If the content does not have the form, or an interval is empty or overlaps the next one.
        UnknownNameError: If the format, an action or an instance is not known.
    """
    readers: dict[str, Callable[[Any, str, DataFrame[Samples]], Iterable[Row]]] = {
        "activities": _rows_of_activities,
        "bimanual-frames": _rows_of_bimanual_frames,
    }
    if label_format not in readers:
        raise UnknownNameError("label format", label_format, readers)
    rows = sorted(readers[label_format](document, episode_id, samples))
    for (hand, _, end_ns, *_), (next_hand, start_ns, *_) in pairwise(rows):
        if hand == next_hand and start_ns < end_ns:
            raise DataError(f"labels of {episode_id!r}: activities of {hand} overlap at {start_ns} ns")
    for hand, start_ns, end_ns, activity, *_ in rows:
        if start_ns >= end_ns:
            raise DataError(f"labels of {episode_id!r}: {activity} of {hand} is empty at {start_ns} ns")
    columns = ["hand", "start_ns", "end_ns", "activity", "acted_on", "in_hand"]
    schema = {name: pl.Int64 if name.endswith("_ns") else pl.String for name in columns}
    table = pl.DataFrame(rows, schema=schema, orient="row")
    return validated(table.select(pl.lit(episode_id).alias("episode_id"), pl.all()), Activities)


def _rows_of_activities(document: Any, episode_id: str, samples: DataFrame[Samples]) -> Iterable[Row]:
    labels = _parsed(TypeAdapter(LabelledActivities), document, episode_id)
    if labels.episode_id not in (None, episode_id):
        raise DataError(f"labels of {episode_id!r} say that they are of episode {labels.episode_id!r}")
    to_stamps = _translation(samples, labels.clock)
    for hand, intervals in labels.hands.items():
        edges = np.array([(row.start_ns, row.end_ns) for row in intervals], np.int64).reshape(-1, 2)
        for row, (start_ns, end_ns) in zip(intervals, to_stamps(edges).tolist(), strict=True):
            yield hand, start_ns, end_ns, row.activity, row.acted_on, row.in_hand


def _translation(
    samples: DataFrame[Samples], clock: Clock
) -> Callable[[NDArray[np.int64]], NDArray[np.int64]]:
    """From a clock of the log to the clock that the mapping chose, between readings on straight lines."""
    pairs = (
        samples.lazy().select(f"{clock}_ns", "stamp_ns").drop_nulls().unique().sort(f"{clock}_ns").collect()
    )
    given, chosen = pairs[f"{clock}_ns"].to_numpy(), pairs["stamp_ns"].to_numpy()
    if len(given) == 0 or np.array_equal(given, chosen):
        return lambda times: times
    offsets = (chosen - given).astype(np.float64)
    return lambda times: times + np.round(np.interp(times, given, offsets)).astype(np.int64)


def _rows_of_bimanual_frames(document: Any, episode_id: str, samples: DataFrame[Samples]) -> Iterable[Row]:
    """Per hand ``[start, [action, object class, instance], end, [action, …], end, …]``, in frames.

    Frame k is the k-th message that names a body. Where a boundary lies before the one that came before it,
    as happens in files written by hand, the later entry wins, and what it leaves nothing of is left out.
    Instances are numbered differently from take to take: if ``whisk_4`` is not an entity, the entity whose
    name is ``whisk`` but for case and number is meant.
    """
    labels = _parsed(_BIMANUAL, document, episode_id)
    messages = (
        samples.lazy()
        .filter(pl.col("kind") == "pose")
        .group_by("message_index")
        .agg(pl.col("stamp_ns").min())
        .sort("message_index")
        .collect()
    )
    stamps = messages["stamp_ns"].to_numpy()
    if len(stamps) < 2:
        raise DataError(f"labels of {episode_id!r} count frames, but the log has {len(stamps)}")
    entities = samples["entity"].unique().sort().to_list()
    for key, track in labels.items():
        hand = _entity(key, entities, episode_id)
        bounds, actions = track[0::2], track[1::2]
        if len(bounds) != len(actions) + 1 or not all(isinstance(bound, int) for bound in bounds):
            raise DataError(
                f"labels of {episode_id!r}, {key}: expected [frame, action, frame, …, action, frame]"
            )
        edges = [int(bound) for bound in bounds if isinstance(bound, int)]
        if min(edges) < 0 or max(edges) > len(stamps):
            raise DataError(
                f"labels of {episode_id!r}, {key}: frames {min(edges)} to {max(edges)}, "
                f"but the log has {len(stamps)} frames with bodies"
            )
        painted = _painted(edges, [action for action in actions if not isinstance(action, int)])
        yield from _described(painted, hand, stamps, entities, episode_id)


def _painted(edges: list[int], actions: list[_Action]) -> list[tuple[int, int, _Action]]:
    """First frame, frame after the last, and action, where later entries cover earlier ones."""
    intervals: list[tuple[int, int, _Action]] = []
    for (start, end), action in zip(pairwise(edges), actions, strict=True):
        if start >= end:
            continue
        intervals = [(low, min(high, start), kept) for low, high, kept in intervals if low < start]
        intervals.append((start, end, action))
    return intervals


def _described(
    painted: list[tuple[int, int, _Action]],
    hand: str,
    stamps: NDArray[np.int64],
    entities: list[str],
    episode_id: str,
) -> Iterable[Row]:
    """Rows with what is acted on and held: what was lifted stays held until the hand is empty again."""
    after_last = stamps[-1] + round(float(np.median(np.diff(stamps))))
    times = np.append(stamps, after_last).tolist()
    held: str | None = None
    for start, end, (number, _object_class, instance) in painted:
        if number not in BIMANUAL_ACTIONS:
            raise UnknownNameError(
                "action", str(number), map(str, BIMANUAL_ACTIONS), f"labels of {episode_id!r}"
            )
        activity = BIMANUAL_ACTIONS[number]
        target = None if instance is None else _entity(instance, entities, episode_id)
        if activity in _HOLDING:
            held, target = target, None
        elif activity in _EMPTY:
            held = None
        yield hand, times[start], times[end], activity, target, held


def _entity(name: str, entities: list[str], episode_id: str) -> str:
    """The entity that a label means: of that name, or of that name but for case and number."""
    if name in entities:
        return name
    bare = re.sub(r"_\d+$", "", name).casefold()
    found = [entity for entity in entities if re.sub(r"_\d+$", "", entity).casefold() == bare]
    if len(found) != 1:
        raise UnknownNameError("instance", name, entities, f"labels of {episode_id!r}")
    return found[0]


def _parsed(adapter: TypeAdapter[_Parsed], document: Any, episode_id: str) -> _Parsed:
    try:
        return adapter.validate_python(document)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise DataError(f"labels of {episode_id!r}: {where}: {first['msg']}") from None
