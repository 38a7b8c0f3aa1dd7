"""Chains of transforms, from every frame to the world."""

from collections.abc import Iterable, Mapping

import numpy as np

from demoplan.errors import DataError
from demoplan.geometry import compose, inverted
from demoplan.stages.align.resampling import Track, youngest

Edge = tuple[str, str]
"""Child frame, parent frame."""


def chained(outer: Track, inner: Track) -> Track:
    """Pose ``a_from_c`` of ``a_from_b`` (outer) and ``b_from_c`` (inner); as old as the older."""
    position, orientation = compose(
        outer.position_xyz_m, outer.orientation_wxyz, inner.position_xyz_m, inner.orientation_wxyz
    )
    return Track(position, orientation, np.maximum(outer.age_ns, inner.age_ns))


def resting(n_ticks: int, position: Iterable[float], orientation: Iterable[float]) -> Track:
    """One pose at every tick, never stale."""
    return Track(
        np.tile(np.asarray(list(position), np.float64), (n_ticks, 1)),
        np.tile(np.asarray(list(orientation), np.float64), (n_ticks, 1)),
        np.zeros(n_ticks),
    )


def world_tracks(
    transforms: Mapping[Edge, Track], world: str, n_ticks: int, needed: Iterable[str], episode_id: str
) -> dict[str, Track]:
    """Pose of every frame that hangs together with the world, at every tick.

    Frames below the world follow their parents; where a frame had several parents (it was handed over),
    the one seen last counts at each tick. Frames above the world are reached against the direction of
    their transforms.

    Args:
        transforms: ``parent_from_child`` of each (child, parent).
        world: Frame in which everything is expressed.
        n_ticks: Ticks of the episode.
        needed: Frames that must be reached.
        episode_id: For messages.

    Raises:
        DataError: If transforms form a circle, or a needed frame does not hang together with the world.
    """
    order = _parents_first(transforms, episode_id)
    tracks = {world: resting(n_ticks, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))}
    n_known = 0
    while n_known < len(tracks):
        n_known = len(tracks)
        for frame in reversed(order):
            below = [edge for edge in transforms if edge[1] == frame and edge[0] in tracks]
            if frame not in tracks and below:
                tracks[frame] = youngest(
                    [chained(tracks[edge[0]], _inverse(transforms[edge])) for edge in below]
                )
        for frame in order:
            above = [edge for edge in transforms if edge[0] == frame and edge[1] in tracks]
            if frame not in tracks and above:
                # What is told in the world already needs no chain.
                tracks[frame] = youngest(
                    [
                        transforms[edge] if edge[1] == world else chained(tracks[edge[1]], transforms[edge])
                        for edge in above
                    ]
                )
    lost = sorted(set(needed) - set(tracks))
    if lost:
        raise DataError(
            f"episode {episode_id!r}: no chain of transforms leads from world {world!r} to "
            f"{', '.join(map(repr, lost))}; frames that hang together with it: {', '.join(sorted(tracks))}; "
            f"transforms seen: {', '.join(f'{p} → {c}' for c, p in sorted(transforms)) or 'none'}"
        )
    return tracks


def _inverse(track: Track) -> Track:
    position, orientation = inverted(track.position_xyz_m, track.orientation_wxyz)
    return Track(position, orientation, track.age_ns)


def _parents_first(transforms: Mapping[Edge, Track], episode_id: str) -> list[str]:
    """Every frame, parents before children, names in order."""
    parents: dict[str, set[str]] = {}
    for child, parent in transforms:
        parents.setdefault(child, set()).add(parent)
        parents.setdefault(parent, set())
    order: list[str] = []
    waiting = sorted(parents)
    while waiting:
        done = set(order)
        ready = [frame for frame in waiting if parents[frame] <= done]
        if not ready:
            raise DataError(
                f"episode {episode_id!r}: transforms form a circle through {', '.join(map(repr, waiting))}; "
                "each frame must have its parent nearer to the root"
            )
        order += ready
        waiting = [frame for frame in waiting if frame not in set(ready)]
    return order
