"""The stage itself: streams out of samples, tracks out of streams, frames out of tracks."""

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
import polars as pl
from dataframely import DataFrame
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.geometry import Array, Bools, are_known, continuous, normalised
from demoplan.manifests.mapping import Mapping, TransformsTopic
from demoplan.stages.align.chains import chained, resting, world_tracks
from demoplan.stages.align.clocks import Stamps, steady, tick_grid
from demoplan.stages.align.resampling import (
    Track,
    neighbours,
    orientations_at,
    positions_at,
    youngest,
)
from demoplan.tables import Frames, Samples
from demoplan.tables.episodewise import by_episode
from demoplan.tables.validating import validated


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
class _Stream:
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


def align(
    samples: DataFrame[Samples], mapping: Mapping, params: AlignParams = AlignParams()
) -> DataFrame[Frames]:
    """Bring every episode on to one clock and into the mapping's world.

    The clock ticks at whole multiples of the period from the earliest usable stamp of any topic, to the
    latest. Positions are interpolated on straight lines, orientations on the shorter arc, grip linearly;
    nothing is interpolated across a gap longer than twice the staleness limit or across a jump of a clock
    (see :func:`demoplan.stages.align.clocks.steady` for what becomes of jumps). Readings that the source
    calls invalid, that are not finite, or whose quaternion is zero, are dropped; other quaternions are
    normalised, and signs chosen so that neighbours in time lie on one hemisphere. Transforms are chained to
    the world, static ones hold throughout, a chain is as old as its oldest link. The order of rows does not
    matter.

    Args:
        samples: What the logs said, of any number of episodes.
        mapping: Entities, world, and which transform frames stand for which entity.
        params: Rate and limits.

    Returns:
        Every entity of the mapping at every tick, in order of episode, entity, tick. An entity that no
        sample speaks of has null poses throughout, unless the mapping fixes its pose, which then holds with
        age 0. Where no orientation is told, it is null beside a position.

    Raises:
        DataError: If an episode has no usable sample, its clocks do not fit together, transforms form a
            circle, or a frame has no chain to the world.
    """
    parts = [_episode(name, rows, mapping, params) for name, rows in by_episode(samples)]
    frames = pl.concat(parts) if parts else Frames.create_empty()
    return validated(frames, Frames)


def _episode(episode_id: str, rows: pl.DataFrame, mapping: Mapping, params: AlignParams) -> pl.DataFrame:
    streams = _streams(rows, mapping.world, params)
    moving = {f"{s.topic} ({s.entity})": s for s in streams if not s.is_static and len(s.stamp_ns)}
    if not moving:
        raise DataError(
            f"episode {episode_id!r}: no usable sample on any mapped topic, of {len(rows)} rows "
            f"({int((~rows['is_tracked']).sum())} not tracked); nothing to align"
        )
    spans: dict[str, tuple[int, int]] = {}
    for name, stream in moving.items():
        low, high = spans.get(name, (stream.stamp_ns[0], stream.stamp_ns[-1]))
        spans[name] = (int(min(low, stream.stamp_ns[0])), int(max(high, stream.stamp_ns[-1])))
    ticks = tick_grid(spans, params.tick_rate_hz, params.longest_episode_ns, episode_id)
    tracks = _tracks(streams, mapping, ticks, params.staleness_ns, episode_id)
    grips = {
        name: youngest(found).position_xyz_m[:, 0]
        for name in mapping.entities
        if (
            found := [
                _grip_track(stream, ticks, params.staleness_ns)
                for stream in streams
                if stream.kind == "grip" and stream.entity == name and len(stream.stamp_ns)
            ]
        )
    }
    return _frames(episode_id, mapping, ticks, tracks, grips)


def _streams(rows: pl.DataFrame, world: str, params: AlignParams) -> list[_Stream]:
    """Samples, sorted into streams; in the order of their names, so that the order of rows is forgotten."""
    keys = ["topic", "kind", "entity", "reference", "is_static"]
    code = np.zeros(len(rows), np.int64)
    for key in keys:
        # Most columns say one thing throughout, and part nothing.
        if not (rows[key] == rows[key][0]).all():
            codes = _codes(rows[key])
            code = np.unique(code, return_inverse=True)[1] if code.max() > 2**31 else code
            code = code * (int(codes.max()) + 1) + codes
    readings = _Readings.of(rows)
    if code.max(initial=0) < 2**15:
        # Small numbers are sorted by their digits, which takes a fraction of the time.
        code = code.astype(np.int16)
    by_stream = np.argsort(code, kind="stable")
    bounds = np.flatnonzero(np.append(True, np.diff(code[by_stream]) != 0))
    found: dict[tuple[str | bool, ...], slice | NDArray[np.intp]] = {}
    for start, end in zip(bounds, np.append(bounds[1:], len(by_stream)), strict=True):
        first = int(by_stream[start])
        found[tuple(rows[key][first] for key in keys)] = _evenly(by_stream[start:end])
    return [_stream(key, readings.take(found[key]), world, params) for key in sorted(found)]


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
class _Readings:
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

    def take(self, rows: slice | NDArray[np.intp]) -> "_Readings":
        """Some rows, in the order given."""
        return _Readings(*(getattr(self, column.name)[rows] for column in fields(self)))


def _stream(key: tuple[object, ...], readings: _Readings, world: str, params: AlignParams) -> _Stream:
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
    return _Stream(
        topic=str(topic),
        kind=str(kind),
        entity=_frame(str(entity), world) if kind == "transform" else str(entity),
        reference=_frame(str(reference), world),
        is_static=bool(is_static),
        stamp_ns=stamps[kept],
        stretches=stretches[kept],
        position_xyz_m=readings.position_xyz_m[kept],
        orientation_wxyz=orientation[kept],
        grip=readings.grip[kept],
    )


def _numbers(column: pl.Series, width: int) -> Array:
    """An array column as ``(n, width)``; nulls become NaN."""
    if column.null_count() == len(column):
        return np.full((len(column), width), np.nan)
    return np.asarray(column.to_numpy(), np.float64).reshape(-1, width)


def _frame(name: str, world: str) -> str:
    """A frame's name; ROS 1 wrote some with a leading slash, and an empty one means the world."""
    return name.lstrip("/") or world.lstrip("/")


def _tracks(
    streams: list[_Stream], mapping: Mapping, ticks: Stamps, staleness_ns: int, episode_id: str
) -> dict[str, Track]:
    """World pose of every entity that some stream speaks of."""
    world = _frame(mapping.world, mapping.world)
    entity_of = {name: name for name in mapping.entities}
    for topic in mapping.topics.values():
        if isinstance(topic, TransformsTopic):
            entity_of |= {_frame(frame, world): entity for frame, entity in topic.entities.items()}
    by_edge: dict[tuple[str, str], list[Track]] = {}
    for stream in streams:
        if stream.kind == "transform":
            edge = (stream.entity, stream.reference)
            by_edge.setdefault(edge, []).append(_track(stream, ticks, staleness_ns))
    transforms = {edge: youngest(found) for edge, found in by_edge.items()}
    poses = [s for s in streams if s.kind == "pose" and s.entity in mapping.entities]
    needed = {s.reference for s in poses} | {child for child, _ in transforms if child in entity_of}
    chains = world_tracks(transforms, world, len(ticks), needed, episode_id)
    found: dict[str, list[Track]] = {}
    for stream in poses:
        track = _track(stream, ticks, staleness_ns)
        if stream.reference != world:
            track = chained(chains[stream.reference], track)
        found.setdefault(stream.entity, []).append(track)
    for frame in sorted({child for child, _ in transforms if child in entity_of}):
        found.setdefault(entity_of[frame], []).append(chains[frame])
    return {entity: youngest(tracks) for entity, tracks in found.items() if entity in mapping.entities}


def _track(stream: _Stream, ticks: Stamps, staleness_ns: int) -> Track:
    n = len(ticks)
    if len(stream.stamp_ns) == 0:
        return Track(np.full((n, 3), np.nan), np.full((n, 4), np.nan), np.full(n, np.inf))
    if stream.is_static:
        return resting(n, stream.position_xyz_m[0], stream.orientation_wxyz[0])
    near = neighbours(stream.stamp_ns, stream.stretches, ticks, staleness_ns)
    return Track(
        positions_at(near, stream.position_xyz_m),
        orientations_at(near, stream.orientation_wxyz),
        near.age_ns,
    )


def _grip_track(stream: _Stream, ticks: Stamps, staleness_ns: int) -> Track:
    """A grip reading in the place of a position's x, so that the same rules choose between sources."""
    near = neighbours(stream.stamp_ns, stream.stretches, ticks, staleness_ns)
    nothing = np.full((len(ticks), 4), np.nan)
    return Track(positions_at(near, stream.grip[:, None]), nothing, near.age_ns)


def _frames(
    episode_id: str,
    mapping: Mapping,
    ticks: Stamps,
    tracks: dict[str, Track],
    grips: dict[str, Array],
) -> pl.DataFrame:
    """The table's columns, entity after entity."""
    n = len(ticks)
    names = sorted(mapping.entities)
    unseen = Track(np.full((n, 3), np.nan), np.full((n, 4), np.nan), np.full(n, np.inf))
    rows: list[Track] = []
    for name in names:
        fixed = mapping.entities[name].fixed
        if name in tracks:
            track = tracks[name]
        elif fixed is not None:
            unit = normalised(np.array([fixed.orientation_wxyz], np.float64))[0]
            if not np.isfinite(unit).all():
                raise DataError(
                    f"entity {name!r}: its fixed orientation is zero; give a unit quaternion w, x, y, z"
                )
            track = resting(n, fixed.position_xyz_m, unit)
        else:
            track = unseen
        rows.append(Track(track.position_xyz_m, continuous(track.orientation_wxyz), track.age_ns))
    position = np.concatenate([track.position_xyz_m for track in rows])
    orientation = np.concatenate([track.orientation_wxyz for track in rows])
    age = np.concatenate([track.age_ns for track in rows])
    grip = np.concatenate(
        [np.clip(grips[name], 0.0, 1.0) if name in grips else unseen.age_ns for name in names]
    )
    is_seen = np.isfinite(age)
    return pl.DataFrame(
        {
            "episode_id": pl.Series([episode_id]).new_from_index(0, len(age)),
            "entity": pl.Series(names, dtype=pl.String).gather(np.repeat(np.arange(len(names)), n)),
            "tick_ns": np.tile(ticks, len(names)),
            "position_xyz_m": position,
            "orientation_wxyz": orientation,
            "grip": grip,
            "pose_age_ns": np.where(is_seen, age, -1.0).astype(np.int64),
            "is_seen": is_seen,
            "is_turned": are_known(orientation),
        }
    ).select(
        "episode_id",
        "entity",
        "tick_ns",
        pl.when("is_seen").then("position_xyz_m"),
        pl.when(pl.col("is_seen") & pl.col("is_turned")).then("orientation_wxyz"),
        pl.when(pl.col("grip").is_finite()).then("grip"),
        pl.when("is_seen").then("pose_age_ns"),
    )
