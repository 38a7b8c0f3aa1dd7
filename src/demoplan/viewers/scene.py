"""Frames and facts to what a 3D scene shows: bodies with their paths, trails of hands, contacts."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan import geometry
from demoplan.errors import DataError
from demoplan.geometry import Array
from demoplan.viewers import colours
from demoplan.viewers.episode_view import Body, Entity, Segments, Ticks
from demoplan.viewers.sources import EpisodeViewParams


def columns_of(series: pl.Series, width: int) -> Array:
    """An array column as ``(n, width)``; NaN where it is null."""
    return np.column_stack([series.arr.get(k).to_numpy() for k in range(width)]).astype(np.float64)


def body_of(entity: Entity, track: pl.DataFrame | None, start_ns: int) -> Body:
    """An entity's path through an episode.

    Args:
        entity: What it is.
        track: Its frames, in order; null for what no log tracks.
        start_ns: First tick of the episode, from which a fixed body stands.

    Raises:
        DataError: If it has neither frames nor a fixed pose.
    """
    if track is None:
        if entity.fixed_position_xyz_m is None:
            raise DataError(f"entity {entity.name!r} has neither frames nor a fixed pose")
        ticks = np.array([start_ns], dtype=np.int64)
        positions = np.array([entity.fixed_position_xyz_m], dtype=np.float64)
        orientations = np.array([entity.fixed_orientation_wxyz], dtype=np.float64)
        grips = None
        is_seen: NDArray[np.bool_] = np.array([True])
        all_ticks = ticks
    else:
        all_ticks = track["tick_ns"].to_numpy()
        positions = columns_of(track["position_xyz_m"], 3)
        orientations = columns_of(track["orientation_wxyz"], 4)
        is_seen = np.asarray(np.isfinite(positions).all(axis=1))
        # A point or a sphere needs no orientation; what has none is drawn upright.
        orientations = np.where(np.isfinite(orientations), orientations, np.array([1.0, 0.0, 0.0, 0.0]))
        grips = (
            None if track["grip"].null_count() == len(track) else track["grip"].to_numpy().astype(np.float64)
        )
    before = np.concatenate(([False], is_seen[:-1]))
    changes = np.flatnonzero(is_seen != before)
    if _stands_still(positions[is_seen], orientations[is_seen]):
        # What never moves needs a pose only where it appears.
        keep = changes[is_seen[changes]]
    else:
        keep = np.flatnonzero(is_seen)
    return Body(
        entity=entity,
        colour=colours.SURFACE if entity.is_surface else colours.entity_colour(entity.name),
        label=entity.name,
        ticks_ns=all_ticks[keep],
        positions_xyz_m=positions[keep],
        orientations_wxyz=orientations[keep],
        grips=None if grips is None else grips[keep],
        change_ticks_ns=all_ticks[changes],
        is_visible=is_seen[changes],
    )


def _stands_still(positions: Array, orientations: Array) -> bool:
    return bool(
        len(positions) > 0 and (positions == positions[0]).all() and (orientations == orientations[0]).all()
    )


def where_things_happen(bodies: Sequence[Body]) -> tuple[tuple[float, float, float], float]:
    """Middle and half diagonal of the box around what moves; if nothing moves, around everything."""
    moving = [b.positions_xyz_m for b in bodies if not b.entity.is_surface and len(b.ticks_ns) > 1]
    points = moving or [b.positions_xyz_m for b in bodies if len(b.ticks_ns)]
    if not points:
        return (0.0, 0.0, 0.0), 0.5
    # Single lost readings must not decide where the camera stands.
    low, high = np.quantile(np.concatenate(points), (0.01, 0.99), axis=0)
    middle = (low + high) / 2
    return (float(middle[0]), float(middle[1]), float(middle[2])), float(
        max(0.15, float(np.linalg.norm(high - low)) / 2)
    )


def trail_of(body: Body, tick_ns: int, params: EpisodeViewParams) -> Segments:
    """Lines between successive sightings of a hand; none across a gap, which is longer than two ticks."""
    kept = _every(body.ticks_ns, params.trail_step_ns)
    ticks = body.ticks_ns[kept]
    points = body.positions_xyz_m[kept]
    is_near = np.diff(ticks) <= max(params.trail_step_ns, tick_ns) * 2
    lines = np.stack((points[:-1], points[1:]), axis=1)[is_near]
    return Segments(
        name=body.entity.name,
        colour=body.colour,
        ticks_ns=ticks[1:][is_near],
        counts=np.ones(len(lines), dtype=np.int64),
        lines_xyz_m=lines.reshape(-1, 2, 3),
    )


def _every(ticks_ns: Ticks, step_ns: int) -> NDArray[np.int64]:
    """Indices of the first tick in each step."""
    if len(ticks_ns) == 0:
        return np.zeros(0, dtype=np.int64)
    return np.unique((ticks_ns - ticks_ns[0]) // step_ns, return_index=True)[1]


def contacts_of(facts: pl.DataFrame | None, bodies: Sequence[Body], params: EpisodeViewParams) -> Segments:
    """A line per touching pair, redrawn as they move, and gone when they part."""
    named = {body.entity.name: body for body in bodies}
    ticks_parts: list[Ticks] = []
    lines_parts: list[Array] = []
    ends: list[int] = []
    if facts is not None:
        touching = facts.filter(
            (pl.col("predicate") == params.contact_predicate)
            & (pl.col("value") == "true")
            & (pl.col("arguments").list.len() == 2)
        )
        every = np.unique(np.concatenate([body.ticks_ns for body in bodies]))
        grid = every[_every(every, params.contact_step_ns)]
        drawn: set[tuple[str, str, int]] = set()
        for (one, other), start, end in zip(
            touching["arguments"].to_list(), touching["start_ns"], touching["end_ns"], strict=True
        ):
            first, second = sorted((one, other))
            if one not in named or other not in named or (first, second, start) in drawn:
                continue
            drawn.add((first, second, start))
            ticks = grid[(grid >= start) & (grid < end)]
            ticks = ticks if len(ticks) and ticks[0] == start else np.concatenate(([start], ticks))
            lines = _between(named[one], named[other], ticks, params.surface_extent_m)
            is_seen = np.isfinite(lines).all(axis=(1, 2))
            ticks_parts.append(ticks[is_seen])
            lines_parts.append(lines[is_seen])
            ends.append(end)
    if not ticks_parts:
        return Segments(
            name="contacts",
            colour=(255, 255, 255),
            ticks_ns=np.zeros(0, np.int64),
            counts=np.zeros(0, np.int64),
            lines_xyz_m=np.zeros((0, 2, 3)),
        )
    # Every change redraws all lines of its instant, so all pairs share one set of ticks.
    starts = np.concatenate(ticks_parts)
    lines = np.concatenate(lines_parts)
    ticks, which = np.unique(np.concatenate((starts, np.array(ends, dtype=np.int64))), return_inverse=True)
    which = which[: len(starts)]
    order = np.argsort(which, kind="stable")
    return Segments(
        name="contacts",
        colour=(250, 250, 250),
        ticks_ns=ticks,
        counts=np.bincount(which, minlength=len(ticks)),
        lines_xyz_m=lines[order],
    )


def _pose_at(body: Body, ticks_ns: Ticks) -> tuple[Array, Array]:
    """Poses of the latest sighting at or before each tick; NaN where the body is out of sight."""
    if len(body.ticks_ns) == 0:
        return np.full((len(ticks_ns), 3), np.nan), np.full((len(ticks_ns), 4), np.nan)
    index = np.clip(np.searchsorted(body.ticks_ns, ticks_ns, side="right") - 1, 0, None)
    state = np.searchsorted(body.change_ticks_ns, ticks_ns, side="right") - 1
    is_seen = (state >= 0) & body.is_visible[np.clip(state, 0, None)]
    positions = np.where(is_seen[:, None], body.positions_xyz_m[index], np.nan)
    return positions, body.orientations_wxyz[index]


def _between(one: Body, other: Body, ticks_ns: Ticks, surface_extent_m: float) -> Array:
    """Lines ``(n, 2, 3)`` from middle to middle, or to the nearest point of a wide body."""
    middles = []
    poses = []
    for body in (one, other):
        position, orientation = _pose_at(body, ticks_ns)
        poses.append((position, orientation))
        offset = np.broadcast_to(np.array(body.entity.shape.centre_xyz_m), position.shape)
        middles.append(position + geometry.rotate(orientation, offset))
    ends = list(middles)
    for k, body in enumerate((one, other)):
        size = np.array(body.entity.shape.size_xyz_m)
        if size.max() > surface_extent_m:
            away = middles[1 - k] - middles[k]
            _, orientation = poses[k]
            inside = np.clip(geometry.rotate(geometry.conjugate(orientation), away), -size / 2, size / 2)
            ends[k] = middles[k] + geometry.rotate(orientation, inside)
    return np.stack(ends, axis=1)
