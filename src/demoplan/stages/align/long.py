"""One long episode, aligned without ever holding all of its samples or of its frames."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from dataframely import DataFrame

from demoplan.errors import DataError
from demoplan.geometry import Array
from demoplan.manifests.mapping import Mapping
from demoplan.stages.align.align import entity_of, grips_of, smooth, table_of, ticks_of, tracks_of
from demoplan.stages.align.clocks import Stamps
from demoplan.stages.align.resampling import Track
from demoplan.stages.align.streams import (
    AlignParams,
    Key,
    Readings,
    Stream,
    frame_name,
    readings_by_stream,
    slender,
    stream_of,
)
from demoplan.tables import Frames, Samples
from demoplan.tables.validating import validated

TICKS_AT_ONCE = 1 << 16
"""Ticks for which poses are found, and rows made, together."""


def align_parts(
    parts: Iterable[DataFrame[Samples]],
    mapping: Mapping,
    params: AlignParams = AlignParams(),
    *,
    ticks_at_once: int = TICKS_AT_ONCE,
) -> Iterator[DataFrame[Frames]]:
    """Bring one episode on to one clock: what :func:`demoplan.stages.align.align` gives, part by part.

    Of the samples only the numbers are kept, stream by stream. Frames are made for one entity after the
    other, some ticks at a time; where transforms chain frames to one another, for all entities together.

    Args:
        parts: The samples of one episode, some rows at a time.
        mapping: As for ``align``.
        params: Rate and limits.
        ticks_at_once: Ticks to work on together; it changes no number.

    Yields:
        The rows of ``align``, in its order.

    Raises:
        DataError: As ``align`` does, or if the parts are of several episodes.
    """
    pieces: dict[Key, list[Readings]] = {}
    episodes: set[str] = set()
    n_rows = n_tracked = 0
    for part in parts:
        if not len(part):
            continue
        episodes |= set(part["episode_id"].unique())
        n_rows, n_tracked = n_rows + len(part), n_tracked + int(part["is_tracked"].sum())
        for key, readings in readings_by_stream(part).items():
            pieces.setdefault(key, []).append(readings.copied())
    if not n_rows:
        return
    if len(episodes) > 1:
        raise DataError(f"parts of several episodes cannot be aligned as one: {', '.join(sorted(episodes))}")
    (episode_id,) = episodes
    streams = [
        slender(stream_of(key, Readings.joined(pieces.pop(key)), mapping.world, params))
        for key in sorted(pieces)
    ]
    ticks = ticks_of(episode_id, streams, n_rows, n_rows - n_tracked, params)
    windows = [slice(start, start + ticks_at_once) for start in range(0, len(ticks), ticks_at_once)]
    for names in _apart(streams, mapping):
        own = _streams_about(streams, names, mapping)
        tracks, grips = _over_windows(own, mapping, ticks, windows, params, episode_id)
        for name in names:
            for window in windows:
                rows = table_of(
                    episode_id,
                    mapping,
                    [name],
                    ticks[window],
                    {name: _during(tracks[name], window)} if name in tracks else {},
                    {name: grips[name][window]} if name in grips else {},
                )
                yield validated(rows, Frames)


def _over_windows(
    streams: list[Stream],
    mapping: Mapping,
    ticks: Stamps,
    windows: Sequence[slice],
    params: AlignParams,
    episode_id: str,
) -> tuple[dict[str, Track], dict[str, Array]]:
    """Tracks and grips at all ticks, found window by window: which readings are near a tick is its own."""
    tracks: dict[str, Track] = {}
    grips: dict[str, Array] = {}
    n = len(ticks)
    for window in windows:
        now = ticks[window]
        for name, track in tracks_of(streams, mapping, now, params.staleness_ns, episode_id).items():
            whole = tracks.setdefault(name, Track(np.empty((n, 3)), np.empty((n, 4)), np.empty(n)))
            whole.position_xyz_m[window] = track.position_xyz_m
            whole.orientation_wxyz[window] = track.orientation_wxyz
            whole.age_ns[window] = track.age_ns
        for name, grip in grips_of(streams, mapping, now, params.staleness_ns).items():
            grips.setdefault(name, np.empty(n))[window] = grip
    return smooth(tracks), grips


def _during(track: Track, window: slice) -> Track:
    return Track(track.position_xyz_m[window], track.orientation_wxyz[window], track.age_ns[window])


def _apart(streams: Sequence[Stream], mapping: Mapping) -> list[list[str]]:
    """Entities that can be aligned without one another: each alone if transforms are told in the world."""
    names = sorted(mapping.entities)
    world = frame_name(mapping.world, mapping.world)
    transforms = [stream for stream in streams if stream.kind == "transform"]
    is_flat = all(stream.reference == world != stream.entity for stream in transforms)
    # A pose in a frame that nothing tells of is refused, with all that is told: so all are looked at.
    known = {world, *(stream.entity for stream in transforms)}
    is_known = all(stream.reference in known for stream in streams if stream.kind == "pose")
    return [[name] for name in names] if is_flat and is_known else [names]


def _streams_about(streams: list[Stream], names: Sequence[str], mapping: Mapping) -> list[Stream]:
    """Streams that speak of these entities, or of the frames in which their poses are told; or all."""
    if len(names) == len(mapping.entities):
        return streams
    entities = entity_of(mapping)
    frames = {s.reference for s in streams if s.kind == "pose" and s.entity in names}
    return [
        stream
        for stream in streams
        if (
            stream.entity in frames or entities.get(stream.entity) in names
            if stream.kind == "transform"
            else stream.entity in names
        )
    ]
