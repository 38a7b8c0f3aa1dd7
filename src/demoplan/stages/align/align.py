"""The stage itself: streams out of samples, tracks out of streams, frames out of tracks."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from dataframely import DataFrame

from demoplan.errors import DataError
from demoplan.geometry import Array, are_known, continuous, normalised
from demoplan.manifests.mapping import Mapping, TransformsTopic
from demoplan.stages.align.chains import chained, resting, world_tracks
from demoplan.stages.align.clocks import Stamps, tick_grid
from demoplan.stages.align.resampling import (
    Track,
    neighbours,
    orientations_at,
    positions_at,
    youngest,
)
from demoplan.stages.align.streams import AlignParams, Stream, frame_name, readings_by_stream, stream_of
from demoplan.tables import Frames, Samples
from demoplan.tables.episodewise import by_episode
from demoplan.tables.validating import validated


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
    streams = [
        stream_of(key, readings, mapping.world, params)
        for key, readings in sorted(readings_by_stream(rows).items(), key=lambda item: item[0])
    ]
    ticks = ticks_of(episode_id, streams, len(rows), int((~rows["is_tracked"]).sum()), params)
    tracks = tracks_of(streams, mapping, ticks, params.staleness_ns, episode_id)
    grips = grips_of(streams, mapping, ticks, params.staleness_ns)
    return table_of(episode_id, mapping, sorted(mapping.entities), ticks, smooth(tracks), grips)


def ticks_of(
    episode_id: str, streams: Sequence[Stream], n_rows: int, n_untracked: int, params: AlignParams
) -> Stamps:
    """The episode's clock."""
    moving = {f"{s.topic} ({s.entity})": s for s in streams if not s.is_static and len(s.stamp_ns)}
    if not moving:
        raise DataError(
            f"episode {episode_id!r}: no usable sample on any mapped topic, of {n_rows} rows "
            f"({n_untracked} not tracked); nothing to align"
        )
    spans: dict[str, tuple[int, int]] = {}
    for name, stream in moving.items():
        low, high = spans.get(name, (stream.stamp_ns[0], stream.stamp_ns[-1]))
        spans[name] = (int(min(low, stream.stamp_ns[0])), int(max(high, stream.stamp_ns[-1])))
    return tick_grid(spans, params.tick_rate_hz, params.longest_episode_ns, episode_id)


def tracks_of(
    streams: list[Stream], mapping: Mapping, ticks: Stamps, staleness_ns: int, episode_id: str
) -> dict[str, Track]:
    """World pose of every entity that some stream speaks of."""
    world = frame_name(mapping.world, mapping.world)
    entities = entity_of(mapping)
    by_edge: dict[tuple[str, str], list[Track]] = {}
    for stream in streams:
        if stream.kind == "transform":
            edge = (stream.entity, stream.reference)
            by_edge.setdefault(edge, []).append(_track(stream, ticks, staleness_ns))
    transforms = {edge: youngest(found) for edge, found in by_edge.items()}
    poses = [s for s in streams if s.kind == "pose" and s.entity in mapping.entities]
    needed = {s.reference for s in poses} | {child for child, _ in transforms if child in entities}
    chains = world_tracks(transforms, world, len(ticks), needed, episode_id)
    found: dict[str, list[Track]] = {}
    for stream in poses:
        track = _track(stream, ticks, staleness_ns)
        if stream.reference != world:
            track = chained(chains[stream.reference], track)
        found.setdefault(stream.entity, []).append(track)
    for frame in sorted({child for child, _ in transforms if child in entities}):
        found.setdefault(entities[frame], []).append(chains[frame])
    return {entity: youngest(tracks) for entity, tracks in found.items() if entity in mapping.entities}


def entity_of(mapping: Mapping) -> dict[str, str]:
    """Frame → the entity that it stands for."""
    world = frame_name(mapping.world, mapping.world)
    found = {name: name for name in mapping.entities}
    for topic in mapping.topics.values():
        if isinstance(topic, TransformsTopic):
            found |= {frame_name(frame, world): entity for frame, entity in topic.entities.items()}
    return found


def _track(stream: Stream, ticks: Stamps, staleness_ns: int) -> Track:
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


def grips_of(
    streams: Sequence[Stream], mapping: Mapping, ticks: Stamps, staleness_ns: int
) -> dict[str, Array]:
    """Grip ``(n,)`` of every entity that some stream speaks of."""
    found: dict[str, list[Track]] = {}
    for stream in streams:
        if stream.kind == "grip" and stream.entity in mapping.entities and len(stream.stamp_ns):
            found.setdefault(stream.entity, []).append(_grip_track(stream, ticks, staleness_ns))
    return {entity: youngest(tracks).position_xyz_m[:, 0] for entity, tracks in found.items()}


def smooth(tracks: dict[str, Track]) -> dict[str, Track]:
    """Tracks whose orientations do not jump from sign to sign."""
    return {
        name: Track(track.position_xyz_m, continuous(track.orientation_wxyz), track.age_ns)
        for name, track in tracks.items()
    }


def _grip_track(stream: Stream, ticks: Stamps, staleness_ns: int) -> Track:
    """A grip reading in the place of a position's x, so that the same rules choose between sources."""
    near = neighbours(stream.stamp_ns, stream.stretches, ticks, staleness_ns)
    nothing = np.broadcast_to(np.nan, (len(ticks), 4))
    return Track(positions_at(near, stream.grip[:, None]), nothing, near.age_ns)


def table_of(
    episode_id: str,
    mapping: Mapping,
    names: Sequence[str],
    ticks: Stamps,
    tracks: dict[str, Track],
    grips: dict[str, Array],
) -> pl.DataFrame:
    """The table's columns, entity after entity."""
    n = len(ticks)
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
        rows.append(track)
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
