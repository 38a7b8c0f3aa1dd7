"""Samples, sorted into streams: the usable readings of one source about one body, in order of time."""

from dataclasses import dataclass, fields, replace
from typing import Any, Self, TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.geometry import Array, Bools, are_known, normalised
from demoplan.stages.align.clocks import Stamps, steady


@dataclass(frozen=True, kw_only=True)
class AlignParams:
    """What can be chosen about alignment."""

    tick_rate_hz: float = 100.0
    """Rate of the episode clock [Hz]."""
    staleness_ns: int = 100_000_000
    """A reading farther from a tick than this says nothing about it; gaps up to twice as long are
    interpolated [ns]. Six frames of 60 Hz motion capture; a hand at 1 m/s moves 10 cm."""
    clock_jump_ns: int = 500_000_000
    """Smallest step of a clock, against the recorder's, that counts as a jump [ns]."""
    longest_pause_ns: int = 3_600_000_000_000
    """A longer pause of the recorder's clock is a jump of that clock [ns]."""
    longest_episode_ns: int = 86_400_000_000_000
    """Longer episodes are refused: clocks of different topics differ [ns]."""


@dataclass(frozen=True, eq=False)
class Stream:
    """The usable readings of one source about one body, in order of time."""

    topic: str
    kind: str
    entity: str
    reference: str
    is_static: bool
    stamp_ns: Stamps
    stretches: Stamps
    position_xyz_m: Array
    orientation_wxyz: Array
    grip: Array


Key: TypeAlias = tuple[str, str, str, str, bool]
"""Topic, kind, entity, reference, and whether it is static: what makes a stream."""


def readings_by_stream(rows: pl.DataFrame) -> dict[Key, "Readings"]:
    """Samples, sorted into streams; rows of each keep their order."""
    keys = ["topic", "kind", "entity", "reference", "is_static"]
    code = np.zeros(len(rows), np.int64)
    for key in keys:
        # Most columns say one thing throughout, and part nothing.
        if not (rows[key] == rows[key][0]).all():
            codes = _codes(rows[key])
            code = np.unique(code, return_inverse=True)[1] if code.max() > 2**31 else code
            code = code * (int(codes.max()) + 1) + codes
    readings = Readings.of(rows)
    if code.max(initial=0) < 2**15:
        # Small numbers are sorted by their digits, which takes a fraction of the time.
        code = code.astype(np.int16)
    by_stream = np.argsort(code, kind="stable")
    bounds = np.flatnonzero(np.append(True, np.diff(code[by_stream]) != 0))
    found: dict[Key, Readings] = {}
    for start, end in zip(bounds, np.append(bounds[1:], len(by_stream)), strict=True):
        topic, kind, entity, reference, is_static = (rows[key][int(by_stream[start])] for key in keys)
        stream = str(topic), str(kind), str(entity), str(reference), bool(is_static)
        found[stream] = readings.take(_evenly(by_stream[start:end]))
    return found


def _evenly(rows: NDArray[np.intp]) -> slice | NDArray[np.intp]:
    """Rows as a slice where they are evenly spaced, as those of one body often are: nothing is copied."""
    if len(rows) == 0:
        return rows
    first, last = int(rows[0]), int(rows[-1])
    step = int(rows[1]) - first if len(rows) > 1 else 1
    is_even = step > 0 and last - first == step * (len(rows) - 1) and bool(np.all(np.diff(rows) == step))
    return slice(first, last + 1, step) if is_even else rows


def _codes(column: pl.Series) -> Stamps:
    """Equal numbers for equal values ``(n,)``."""
    if column.dtype == pl.String:
        column = column.cast(pl.Categorical)
    return np.asarray(column.to_physical().to_numpy(), np.int64)


@dataclass(frozen=True, eq=False)
class Readings:
    """Columns of samples, as arrays."""

    message_index: Stamps
    stamp_ns: Stamps
    log_ns: Stamps
    position_xyz_m: Array
    orientation_wxyz: Array
    has_orientation: Bools
    grip: Array
    is_tracked: Bools

    @classmethod
    def of(cls, rows: pl.DataFrame) -> Self:
        """All rows."""
        return cls(
            rows["message_index"].to_numpy(),
            rows["stamp_ns"].to_numpy(),
            rows["log_ns"].to_numpy(),
            _numbers(rows["position_xyz_m"], 3),
            _numbers(rows["orientation_wxyz"], 4),
            rows["orientation_wxyz"].is_not_null().to_numpy(),
            rows["grip"].cast(pl.Float64).to_numpy().astype(np.float64),
            rows["is_tracked"].to_numpy(),
        )

    def take(self, rows: slice | NDArray[np.intp]) -> "Readings":
        """Some rows, in the order given."""
        return Readings(*(getattr(self, column.name)[rows] for column in fields(self)))

    def copied(self) -> "Readings":
        """The same in memory of their own, so that what they were taken from can go.

        A column without a single number takes no room.
        """
        columns = (getattr(self, column.name) for column in fields(self))
        return Readings(
            *(
                np.broadcast_to(np.nan, values.shape)
                if values.dtype.kind == "f" and np.isnan(values).all()
                else values.copy()
                for values in columns
            )
        )

    @classmethod
    def joined(cls, parts: list["Readings"]) -> "Readings":
        """Readings one after the other."""
        columns = ([getattr(part, column.name) for part in parts] for column in fields(cls))
        return cls(*(_joined(values) for values in columns))


def stream_of(key: Key, readings: Readings, world: str, params: AlignParams) -> Stream:
    """Readings in order of time on a steady clock, without those that cannot be used."""
    topic, kind, entity, reference, is_static = key
    index = readings.message_index
    if np.any(np.diff(index) <= 0):
        # Into file order; and by value, if one body stands twice in one message: rows may come in any order.
        values = (readings.grip, *readings.orientation_wxyz.T[::-1], *readings.position_xyz_m.T[::-1])
        readings = readings.take(np.lexsort((*values, readings.stamp_ns, index)))
    stamps, stretches = steady(
        readings.stamp_ns, readings.log_ns, params.clock_jump_ns, params.longest_pause_ns
    )
    orientation = readings.orientation_wxyz
    if kind == "grip":
        is_usable = np.isfinite(readings.grip)
    else:
        orientation = normalised(orientation)
        is_usable = are_known(readings.position_xyz_m) & (are_known(orientation) | ~readings.has_orientation)
    is_usable &= readings.is_tracked
    kept: slice | NDArray[np.intp] = slice(None) if is_usable.all() else np.flatnonzero(is_usable)
    steps = np.diff(stamps[kept])
    if np.any(steps < 0):
        kept = np.arange(len(stamps))[kept]
        kept = kept[np.argsort(stamps[kept], kind="stable")]
        steps = np.diff(stamps[kept])
    if is_static:
        kept = np.arange(len(stamps))[kept][-1:]
    elif not np.all(steps > 0):
        kept = np.arange(len(stamps))[kept]
        kept = kept[np.append(True, steps > 0)]
    return Stream(
        topic=topic,
        kind=kind,
        entity=frame_name(entity, world) if kind == "transform" else entity,
        reference=frame_name(reference, world),
        is_static=is_static,
        stamp_ns=stamps[kept],
        stretches=stretches[kept],
        position_xyz_m=readings.position_xyz_m[kept],
        orientation_wxyz=orientation[kept],
        grip=readings.grip[kept],
    )


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Arrays one after the other; if none of them takes room, neither does the result."""
    if any(any(part.strides) for part in parts):
        return np.concatenate(parts)
    return np.broadcast_to(parts[0].flat[0], (sum(len(part) for part in parts), *parts[0].shape[1:]))


def slender(stream: Stream) -> Stream:
    """The same stream, in which what its kind never tells takes no room."""
    n = len(stream.stamp_ns)
    if stream.kind != "grip":
        return replace(stream, grip=np.broadcast_to(np.nan, n))
    return replace(
        stream,
        position_xyz_m=np.broadcast_to(np.nan, (n, 3)),
        orientation_wxyz=np.broadcast_to(np.nan, (n, 4)),
    )


def _numbers(column: pl.Series, width: int) -> Array:
    """An array column as ``(n, width)``; nulls become NaN."""
    if column.null_count() == len(column):
        return np.full((len(column), width), np.nan)
    return np.asarray(column.to_numpy(), np.float64).reshape(-1, width)


def frame_name(name: str, world: str) -> str:
    """A frame's name; ROS 1 wrote some with a leading slash, and an empty one means the world."""
    return name.lstrip("/") or world.lstrip("/")
