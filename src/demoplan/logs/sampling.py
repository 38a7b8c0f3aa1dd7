"""Columns of one mapped topic to rows of ``Samples``."""

from collections import Counter
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import polars as pl
from dataframely import DataFrame
from numpy.typing import NDArray

from demoplan.logs.columns import XYZ, XYZW, Columns, Field, Wanted
from demoplan.logs.layouts import Interner
from demoplan.logs.messages import Block, Times
from demoplan.manifests.mapping import (
    BodiesTopic,
    GripTopic,
    Mapping,
    PoseTopic,
    TransformsTopic,
)
from demoplan.tables import Samples
from demoplan.tables.validating import validated

MappedTopic: TypeAlias = TransformsTopic | PoseTopic | BodiesTopic | GripTopic

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
STAMP_PATHS = ("header.stamp", "stamp", "timestamp")
_FRAMES = ("header.frame_id", "frame_id")


def wanted_of(topic: MappedTopic) -> Wanted:
    """Fields that a mapped topic needs, with the names that ROS and Foxglove use for stamps and frames."""
    stamp = Field("stamp", STAMP_PATHS, "stamp", is_required=False)
    frame = Field("frame", _FRAMES, "text", is_required=False)
    if isinstance(topic, GripTopic):
        return Wanted((stamp, Field("grip", (topic.field,), "numbers")))
    if isinstance(topic, TransformsTopic):
        return Wanted(
            (
                Field("stamp", STAMP_PATHS, "stamp", is_element=True, is_required=False),
                Field("frame", ("header.frame_id", "parent_frame_id"), "text", is_element=True),
                Field("name", ("child_frame_id",), "text", is_element=True),
                Field("position", ("transform.translation", "translation"), "numbers", XYZ, is_element=True),
                Field("orientation", ("transform.rotation", "rotation"), "numbers", XYZW, is_element=True),
            ),
            topic.path,
        )
    is_element = isinstance(topic, BodiesTopic)
    fields = [stamp, frame, Field("position", (topic.position,), "numbers", XYZ, is_element)]
    if topic.orientation is not None:
        fields.append(Field("orientation", (topic.orientation,), "numbers", XYZW, is_element))
    if topic.valid is not None:
        fields.append(Field("valid", (topic.valid,), "numbers", (), is_element))
    if isinstance(topic, BodiesTopic):
        fields.append(Field("name", (topic.name,), "text", is_element=True))
        return Wanted(tuple(fields), topic.path)
    return Wanted(tuple(fields))


@dataclass(eq=False)
class TopicSampler:
    """Turns columns of one mapped topic into samples, and counts what became of its messages."""

    label: str
    """The mapping's key: topic, or topic#anything where one topic feeds several groups."""
    topic: MappedTopic
    mapping: Mapping
    episode_id: str
    interner: Interner = field(default_factory=Interner)
    n_rows: int = 0
    n_rejected: int = 0
    notes: Counter[str] = field(default_factory=Counter)
    """Remarks, with the number of messages or rows each is about."""
    last_index: int = -1
    """Index of the last message that was added."""
    _pieces: list[dict[str, NDArray[np.generic] | None]] = field(default_factory=list)
    n_pending: int = 0
    """Rows that wait for ``take``."""

    def add(self, block: Block, columns: Columns) -> None:
        """Keep the rows of a block until ``take``."""
        self.last_index = max(self.last_index, int(block.indexes[-1]))
        kept = self._kept(columns)
        message = columns.message if kept is None else columns.message[kept]
        self._count(block, columns, message)
        if not len(message):
            return
        self._pieces.append(
            {
                "index": block.indexes[message],
                "log": block.log_ns[message],
                "publish": None if block.publish_ns is None else block.publish_ns[message],
                **{
                    key: value if kept is None else value[kept]
                    for part in (columns.numbers, columns.texts, columns.stamps)
                    for key, value in part.items()
                },
            }
        )
        self.n_pending += len(message)

    def _kept(self, columns: Columns) -> NDArray[np.bool_] | None:
        """Rows of bodies that the mapping names; null for all."""
        if not isinstance(self.topic, BodiesTopic) or not len(columns.message):
            return None
        is_mapped = np.array([text in self.topic.entities for text in self.interner.texts], bool)
        kept = is_mapped[columns.texts["name"]]
        if kept.all():
            return None
        names = self.interner.texts
        for code, count in zip(*np.unique(columns.texts["name"][~kept], return_counts=True), strict=True):
            self.notes[f"rows of body {names[int(code)]!r} left out, which the mapping does not name"] += int(
                count
            )
        return kept

    def _count(self, block: Block, columns: Columns, message: Times) -> None:
        n_messages = len(block.starts)
        n_refused = sum(count for count, _ in columns.refused)
        n_listed = _n_distinct(columns.message)
        n_used = _n_distinct(message)
        for count, why in columns.refused:
            self.notes[f"messages did not decode: {why}"] += count
        if n_empty := n_messages - n_refused - n_listed:
            self.notes["messages hold an empty list"] += n_empty
        if n_others := n_listed - n_used:
            self.notes["messages hold none of the mapped bodies"] += n_others
        self.n_rejected += n_messages - n_used
        self.n_rows += len(message)

    def take(self) -> DataFrame[Samples]:
        """Every row kept so far, which is then forgotten."""
        pieces, self._pieces, self.n_pending = self._pieces, [], 0
        is_w_first = isinstance(self.topic, PoseTopic | BodiesTopic) and self.topic.order == "wxyz"
        data = {
            key: _joined([piece.get(key) for piece in pieces], key == "orientation" and not is_w_first)
            for key in pieces[0]
        }
        index: Times = data["index"]  # type: ignore[assignment]
        if (np.diff(index) < 0).any():
            # Several channels of one topic come one after the other: back into file order.
            order = np.argsort(index, kind="stable")
            data = {key: None if value is None else value[order] for key, value in data.items()}
        n_rows = len(data["index"])  # type: ignore[arg-type]
        log: Times = data["log"]  # type: ignore[assignment]
        publish: Times | None = data["publish"]  # type: ignore[assignment]
        header, stamp = self._stamps(log, publish, data.get("stamp"), n_rows)  # type: ignore[arg-type]
        position, orientation, grip, is_tracked = self._values(data, n_rows)
        entity, reference = self._names(data, n_rows)
        kind = (
            "grip" if grip is not None else "transform" if isinstance(self.topic, TransformsTopic) else "pose"
        )
        frame = pl.DataFrame(
            {
                "episode_id": _constant(self.episode_id, n_rows, pl.String()),
                "topic": _constant(self.label, n_rows, pl.String()),
                "entity": entity,
                "kind": _constant(kind, n_rows, Samples.columns()["kind"].dtype),
                "reference": reference,
                "is_static": _constant(getattr(self.topic, "static", False), n_rows, pl.Boolean()),
                "message_index": pl.Series(data["index"]),
                "stamp_ns": pl.Series(stamp),
                "log_ns": pl.Series(log),
                "publish_ns": _maybe(publish, n_rows, pl.Int64()),
                "header_ns": header,
                "position_xyz_m": _maybe(position, n_rows, pl.Array(pl.Float64, 3)),
                "orientation_wxyz": _maybe(orientation, n_rows, pl.Array(pl.Float64, 4)),
                "grip": _maybe(grip, n_rows, pl.Float64()),
                "is_tracked": pl.Series(is_tracked),
            }
        )
        return validated(frame, Samples)

    def _stamps(
        self, log: Times, publish: Times | None, header: Times | None, n_rows: int
    ) -> tuple[pl.Series, Times]:
        """Header stamps as a column, and the stamps on the clock that the mapping chose."""
        has_header = np.zeros(n_rows, bool) if header is None else header != 0
        column = pl.Series("header_ns", header if header is not None else [None] * n_rows, pl.Int64)
        if not has_header.all():
            column = pl.select(pl.when(pl.Series(has_header)).then(column)).to_series()
        clock = self.topic.clock or self.mapping.clock
        received = log if publish is None else publish
        if clock == "log":
            return column, log
        if clock == "publish":
            if publish is None:
                self.notes["rows are stamped by the log's clock, since the log has no publish times"] += (
                    n_rows
                )
            return column, received
        if header is None:
            self.notes["rows are stamped by the log's clock, since their messages have no header stamp"] += (
                n_rows
            )
            return column, received
        if n_zero := int((~has_header).sum()):
            self.notes["rows are stamped by the log's clock, since their header stamp is zero"] += n_zero
            return column, np.where(has_header, header, received)
        return column, header

    def _values(
        self, data: dict[str, NDArray[np.generic] | None], n_rows: int
    ) -> tuple[
        NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.float64] | None, NDArray[np.bool_]
    ]:
        """Position in metres, orientation w first, grip, and which rows are readings at all."""
        topic = self.topic
        if isinstance(topic, GripTopic):
            recorded = np.asarray(data["grip"], np.float64)[:, 0]
            span = topic.open_at - topic.closed_at
            with np.errstate(over="ignore", invalid="ignore"):
                grip = np.clip((recorded - topic.closed_at) / span, 0.0, 1.0)
            return None, None, grip, np.isfinite(recorded)
        position = np.asarray(data["position"], np.float64)
        is_tracked = _is_finite(position)
        if isinstance(topic, PoseTopic | BodiesTopic):
            if topic.unit != "m":
                position = position * _METRES[topic.unit]
            if (valid := data.get("valid")) is not None:
                is_tracked &= np.asarray(valid, np.float64)[:, 0] > 0
        orientation = data.get("orientation")
        if orientation is None:
            return position, None, None, is_tracked
        turned = np.asarray(orientation, np.float64)
        is_tracked &= _is_finite(turned)
        # A quaternion without length is no rotation: what trackers write when they have lost a body.
        suspects = np.flatnonzero(turned[:, 0] == 0)
        is_tracked[suspects] &= turned[suspects].any(axis=1)
        return position, turned, None, is_tracked

    def _names(self, data: dict[str, NDArray[np.generic] | None], n_rows: int) -> tuple[pl.Series, pl.Series]:
        """Entity (of a transform: child frame) and reference frame of each row."""
        topic, texts = self.topic, self.interner.texts
        names = data.get("name")
        if isinstance(topic, PoseTopic | GripTopic):
            entity = _constant(topic.entity, n_rows, pl.String())
        elif isinstance(topic, BodiesTopic):
            entity = _looked_up([topic.entities.get(text, text) for text in texts], names)
        else:
            entity = _looked_up([frame_name(text) for text in texts], names)
        fixed = getattr(topic, "frame", None)
        frames = data.get("frame")
        if fixed is not None or frames is None:
            return entity, _constant(fixed or self.mapping.world, n_rows, pl.String())
        return entity, _looked_up([frame_name(text) or self.mapping.world for text in texts], frames)

    def note(self) -> str | None:
        """What was remarkable, as one line."""
        return "; ".join(f"{count} {what}" for what, count in sorted(self.notes.items())) or None


def frame_name(name: str) -> str:
    """A frame's name without the leading slash that ROS 1 allowed: ``/world`` and ``world`` are one frame."""
    return name.lstrip("/")


def _n_distinct(ascending: Times) -> int:
    return 0 if not len(ascending) else 1 + int(np.count_nonzero(np.diff(ascending)))


def _joined(parts: list[NDArray[np.generic] | None], is_w_last: bool) -> NDArray[np.generic] | None:
    """Arrays as one; quaternions that end in w are turned to begin with it, in the same pass."""
    arrays = [part for part in parts if part is not None]
    if len(arrays) != len(parts):
        return None
    if not is_w_last:
        return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
    turned = np.empty((sum(len(array) for array in arrays), 4))
    at = 0
    for array in arrays:
        turned[at : at + len(array), 1:] = array[:, :3]
        turned[at : at + len(array), 0] = array[:, 3]
        at += len(array)
    return turned


def _is_finite(values: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which rows hold numbers only. A sum that is finite settles it for all rows at once."""
    with np.errstate(over="ignore", invalid="ignore"):
        is_all = np.isfinite(values.sum())
    if is_all:
        return np.ones(len(values), bool)
    finite: NDArray[np.bool_] = np.logical_and.reduce(np.isfinite(values), axis=1)
    return finite


def _looked_up(names: list[str], codes: NDArray[np.generic] | None) -> pl.Series:
    return pl.Series(names, dtype=pl.String).gather(pl.Series(codes))


def _constant(value: object, n_rows: int, dtype: pl.DataType) -> pl.Series:
    return pl.Series([value], dtype=dtype).new_from_index(0, n_rows)


def _maybe(values: NDArray[np.generic] | None, n_rows: int, dtype: pl.DataType) -> pl.Series:
    """A column, or one without any value."""
    if values is None:
        return _constant(None, n_rows, dtype)
    column = pl.Series(np.ascontiguousarray(values), dtype=dtype)
    if not np.issubdtype(values.dtype, np.floating):
        return column
    if _is_finite(values.astype(np.float64, copy=False).reshape(len(values), -1)).all():
        return column
    # The table holds numbers or nothing: what is not finite becomes null, and its row is not tracked.
    if values.ndim == 1:
        return column.set(~column.is_finite(), None)
    finite = pl.element().is_finite()
    return column.arr.eval(pl.when(finite).then(pl.element())).cast(dtype)
