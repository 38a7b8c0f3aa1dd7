"""One episode as arrays: what hands and objects did, tick by tick.

Tables are for contracts, arrays for arithmetic: a `Tracks` value holds an episode's frames as blocks of
shape ``(entity, tick, …)`` on one uniform clock, and the intervals of its facts as masks on the same ticks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.geometry import Array, are_known, hysteresis, normalised, speeds
from demoplan.language.types import TypeHierarchy
from demoplan.tables import Facts, Frames
from demoplan.tables.episodewise import by_episode

Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """Hands and movable objects of one episode; positions in metres, orientations w, x, y, z.

    Gaps in a track are bridged linearly (a nearest pose at its ends), since features need a number at every
    tick.
    """

    episode_id: str
    tick_ns: NDArray[np.int64]
    """Ticks ``(t,)``."""
    hands: tuple[str, ...]
    objects: tuple[str, ...]
    """Objects that were seen at least once, without fixed surfaces."""
    surfaces: tuple[str, ...]
    """Bodies that others rest on: tables, shelves."""
    hand_position_m: Array
    """``(h, t, 3)``."""
    object_position_m: Array
    """``(o, t, 3)``."""
    object_orientation: Array
    """``(o, t, 4)``; the identity where orientation is not known."""
    grip: Array
    """Opening of each hand ``(h, t)``: 0 closed, 1 open; NaN where there is no grip signal."""
    is_moving: Mask
    """Whether each hand moves ``(h, t)``."""
    in_hand: Mask
    """Whether hand h holds object o ``(h, o, t)``, as facts say."""
    acted_on: Mask
    """Whether hand h acts on object or surface o ``(h, o + s, t)``, as facts say."""

    @cached_property
    def tick_s(self) -> float:
        """Period of the clock [s]."""
        return _period_s(self.tick_ns)


@dataclass(frozen=True, kw_only=True)
class TrackParams:
    """What counts as motion where no fact says so. Source of 0.04: the published rules (lineage)."""

    velocity_window_s: float = 0.1
    """Speeds are fitted over this time [s]."""
    moving_enter_m_per_s: float = 0.04
    """A hand faster than this moves."""
    moving_leave_m_per_s: float = 0.03
    """A moving hand slower than this has stopped: without the gap, noise would flip it at every tick."""


def roles_of(entities: Mapping[str, str], types: TypeHierarchy) -> dict[str, str]:
    """What each entity is to a hand: ``hand``, ``surface`` or ``object``.

    Args:
        entities: Instance → type.
        types: Hierarchy in which ``Hand`` and ``Surface`` name the types that are not manipulated.

    Raises:
        UnknownNameError: If a type is not in the hierarchy.
    """
    return {
        name: "hand" if "Hand" in ancestors else "surface" if "Surface" in ancestors else "object"
        for name, ancestors in ((name, types.ancestors(entities[name])) for name in sorted(entities))
    }


def tracks_of(
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts],
    roles: Mapping[str, str],
    params: TrackParams = TrackParams(),
) -> tuple[Tracks, ...]:
    """Every episode of a table as arrays, sorted by episode.

    Args:
        frames: Poses and grips, every entity at every tick of its episode.
        facts: Atoms of the same episodes; ``inHand``, ``actedOn`` and ``handMove`` are read.
        roles: Entity → ``hand``, ``surface`` or ``object``; entities that are not named are left out.
        params: Thresholds of motion, used where no fact ``handMove`` speaks of an episode.

    Raises:
        DataError: If an entity lacks ticks that another one of its episode has.
    """
    read = facts.filter(pl.col("predicate").is_in(["inHand", "actedOn", "handMove"]))
    facts_of = {key[0]: group for key, group in read.group_by("episode_id")}
    nothing = facts.clear()
    found = []
    for episode_id, group in by_episode(frames):
        # Frames come in this order; sorting them again would copy them.
        ordered = group if _is_ordered(group) else group.sort("entity", "tick_ns")
        found.append(_tracks(episode_id, ordered, facts_of.get(episode_id, nothing), roles, params))
    return tuple(found)


def _is_ordered(frames: pl.DataFrame) -> bool:
    """Whether rows go by entity, then tick: where ticks do not rise, the entity must."""
    falls = np.flatnonzero(np.diff(frames.get_column("tick_ns").to_numpy()) <= 0)
    entity = frames.get_column("entity")
    return bool((entity.gather(falls + 1) > entity.gather(falls)).all())


def _tracks(
    episode_id: str,
    frames: pl.DataFrame,
    facts: pl.DataFrame,
    roles: Mapping[str, str],
    params: TrackParams,
) -> Tracks:
    names = frames.get_column("entity").unique(maintain_order=True).to_list()
    if frames.height % len(names):
        raise DataError(
            f"episode {episode_id!r}: {frames.height} rows for {len(names)} entities; "
            "frames need every entity at every tick"
        )
    n_ticks = frames.height // len(names)
    tick_ns = frames.get_column("tick_ns").to_numpy().reshape(len(names), n_ticks)
    if (tick_ns != tick_ns[0]).any():
        raise DataError(
            f"episode {episode_id!r}: entities differ in ticks; frames need one clock per episode"
        )
    position = _block(frames, "position_xyz_m", 3).reshape(len(names), n_ticks, 3)
    orientation = _block(frames, "orientation_wxyz", 4).reshape(len(names), n_ticks, 4)
    grip = frames.get_column("grip").to_numpy().reshape(len(names), n_ticks)

    row = {name: index for index, name in enumerate(names)}
    is_seen = are_known(position)
    hands = tuple(name for name in names if roles.get(name) == "hand")
    objects = tuple(name for name in names if roles.get(name) == "object" and is_seen[row[name]].any())
    surfaces = tuple(name for name in names if roles.get(name) == "surface")
    hand_rows = [row[name] for name in hands]
    object_rows = [row[name] for name in objects]
    clock_ns = tick_ns[0]
    hand_position_m = _bridged(position[hand_rows])
    if facts.filter(pl.col("predicate") == "handMove").height:
        is_moving = interval_masks(facts, "handMove", hands, None, clock_ns)[:, 0]
    else:
        is_moving = moving(hand_position_m, _period_s(clock_ns), params)
    return Tracks(
        episode_id=episode_id,
        tick_ns=clock_ns,
        hands=hands,
        objects=objects,
        surfaces=surfaces,
        hand_position_m=hand_position_m,
        object_position_m=_bridged(position[object_rows]),
        object_orientation=_held_over(normalised(orientation[object_rows])),
        grip=grip[hand_rows].astype(float),
        is_moving=is_moving,
        in_hand=interval_masks(facts, "inHand", hands, objects, clock_ns),
        acted_on=interval_masks(facts, "actedOn", hands, objects + surfaces, clock_ns),
    )


def moving(hand_position_m: Array, tick_s: float, params: TrackParams) -> Mask:
    """Whether each hand moves ``(h, t)``: speed with hysteresis."""
    if not len(hand_position_m):
        return np.zeros(hand_position_m.shape[:2], dtype=np.bool_)
    speed = speeds(hand_position_m, tick_s, params.velocity_window_s)
    return hysteresis(speed > params.moving_enter_m_per_s, speed >= params.moving_leave_m_per_s)


def _period_s(tick_ns: NDArray[np.int64]) -> float:
    """Period of a clock [s]; a single tick stands for 10 ms."""
    return float(np.median(np.diff(tick_ns))) / 1e9 if len(tick_ns) > 1 else 0.01


def _block(frames: pl.DataFrame, column: str, width: int) -> Array:
    """A column of fixed-width arrays as ``(n, width)``, NaN for null."""
    values = frames.get_column(column)
    if values.null_count():
        values = values.fill_null([None] * width)
    return values.reshape((-1,)).to_numpy().astype(float, copy=False).reshape(-1, width)


def _bridged(position_m: Array) -> Array:
    """Tracks ``(n, t, 3)`` with gaps filled along straight lines; a track never seen stays at the origin."""
    filled = position_m
    is_seen = are_known(position_m)
    ticks = np.arange(position_m.shape[1])
    for body in np.flatnonzero(~is_seen.all(axis=1)):
        if filled is position_m:
            filled = position_m.copy()
        seen = is_seen[body]
        for axis in range(3):
            known = position_m[body, seen, axis]
            filled[body, :, axis] = np.interp(ticks, ticks[seen], known) if len(known) else 0.0
    return filled


def _held_over(orientation: Array) -> Array:
    """Orientations ``(n, t, 4)`` with gaps filled by the last seen one (the first seen one before it)."""
    is_seen = are_known(orientation)
    if is_seen.all():
        return orientation
    ticks = np.arange(orientation.shape[1])
    filled = orientation.copy()
    for body in np.flatnonzero(~is_seen.all(axis=1)):
        seen = is_seen[body]
        if not seen.any():
            filled[body] = (1.0, 0.0, 0.0, 0.0)
            continue
        last = np.maximum.accumulate(np.where(seen, ticks, -1))
        filled[body] = orientation[body, np.where(last < 0, np.argmax(seen), last)]
    return filled


def interval_masks(
    facts: pl.DataFrame,
    predicate: str,
    hands: Sequence[str],
    objects: Sequence[str] | None,
    tick_ns: NDArray[np.int64],
) -> Mask:
    """On which ticks a predicate of hands, or of hands and objects, held: ``(hand, object, tick)``.

    Intervals are half-open. Rows about other names, and rows whose value is ``unknown``, are left out.
    With ``objects=None`` the predicate has one argument and the middle axis one row.
    """
    edges = np.zeros((len(hands), 1 if objects is None else len(objects), len(tick_ns) + 1), dtype=np.int32)
    rows = facts.filter((pl.col("predicate") == predicate) & (pl.col("value") == "true"))
    hand_index = {name: index for index, name in enumerate(hands)}
    object_index = {name: index for index, name in enumerate(objects or ())}
    first = np.searchsorted(tick_ns, rows.get_column("start_ns").to_numpy())
    last = np.searchsorted(tick_ns, rows.get_column("end_ns").to_numpy())
    for names, start, end in zip(rows.get_column("arguments").to_list(), first, last, strict=True):
        hand = hand_index.get(names[0])
        thing = 0 if objects is None else object_index.get(names[1])
        if hand is not None and thing is not None:
            edges[hand, thing, start] += 1
            edges[hand, thing, end] -= 1
    return np.cumsum(edges[..., :-1], axis=2) > 0
