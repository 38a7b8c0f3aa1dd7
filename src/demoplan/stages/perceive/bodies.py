"""What is known of every body of one episode at every tick, in the form that definitions ask for it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError, UnknownNameError
from demoplan.geometry import Array, Bools, Solid, are_known, nearest_points, surface_distances, velocities
from demoplan.language.vocabulary import Shape, Vocabulary
from demoplan.manifests.mapping import Entity

_POINT = Shape("point", (0.0, 0.0, 0.0))


@dataclass(frozen=True, eq=False)
class Bodies:
    """Bodies of one episode, by number; ``e`` bodies, ``n`` ticks. NaN where nothing was seen."""

    names: tuple[str, ...]
    """In order."""
    types: tuple[str, ...]
    is_fixed: tuple[bool, ...]
    """Whether nothing moves it, as a table: the mapping fixes its pose, or a static transform does."""
    shapes: tuple[Shape, ...]
    tick_ns: NDArray[np.int64]
    """``(n,)``"""
    tick_s: float
    """Seconds between ticks."""
    position_xyz_m: Array
    """Tracked origins ``(e, n, 3)``."""
    orientation_wxyz: Array
    """``(e, n, 4)``"""
    grip: Array
    """Openings of hands ``(e, n)``."""
    velocity_window_s: float
    """Window of every velocity."""
    whole: "Bodies | None" = None
    """Where these are some ticks of an episode: all of it, which velocities are fitted to."""
    during_ticks: slice = field(default_factory=lambda: slice(None))
    """Which ticks of it these are."""
    _velocities: dict[int, Array] = field(default_factory=dict, repr=False)
    _distances: dict[tuple[int, int], tuple[float, Array]] = field(default_factory=dict, repr=False)

    @cached_property
    def is_seen(self) -> Bools:
        """Whether the pose is known ``(e, n)``."""
        return are_known(self.position_xyz_m)

    @cached_property
    def solids(self) -> tuple[Solid, ...]:
        """Every body's extent, placed at every tick."""
        return tuple(
            _solid(shape, position, orientation)
            for shape, position, orientation in zip(
                self.shapes, self.position_xyz_m, self.orientation_wxyz, strict=True
            )
        )

    def during(self, ticks: slice) -> "Bodies":
        """The same bodies at some ticks."""
        return replace(
            self,
            tick_ns=self.tick_ns[ticks],
            position_xyz_m=self.position_xyz_m[:, ticks],
            orientation_wxyz=self.orientation_wxyz[:, ticks],
            grip=self.grip[:, ticks],
            whole=self,
            during_ticks=ticks,
            _velocities={},
            _distances={},
        )

    def measure(self, pairs: Iterable[tuple[int, int]], windows: Iterable[slice]) -> None:
        """Find the distances of pairs at all ticks ahead of time, without placing bodies at all of them."""
        wanted = list(pairs)
        n = len(self.tick_ns)
        found = {(min(pair), max(pair)): np.empty(n) for pair in wanted}
        for window in windows:
            some = self.during(window)
            for (one, other), distance in found.items():
                distance[window] = some.distance(one, other)
        self._distances.update({pair: (np.inf, distance) for pair, distance in found.items()})

    def forget(self) -> None:
        """Let go of distances that were found."""
        self._distances.clear()

    def velocity(self, bodies: Sequence[int]) -> Array:
        """Velocities of tracked origins [m/s] ``(k, n, 3)``; NaN where the pose is not known."""
        self._fit_velocities(bodies)
        return np.stack([self._velocities[body] for body in bodies])

    def _fit_velocities(self, bodies: Sequence[int]) -> None:
        missing = [body for body in bodies if body not in self._velocities]
        if missing and self.whole is not None:
            self.whole._fit_velocities(missing)
            self._velocities.update(
                (body, self.whole._velocities[body][self.during_ticks]) for body in missing
            )
        elif missing:
            found = velocities(self.position_xyz_m[missing], self.tick_s, self.velocity_window_s)
            found[~self.is_seen[missing]] = np.nan
            self._velocities.update(zip(missing, found, strict=True))

    def speed(self, bodies: Sequence[int]) -> Array:
        """Speeds of tracked origins [m/s] ``(k, n)``; NaN where the pose is not known."""
        return np.asarray(np.linalg.norm(self.velocity(bodies), axis=-1))

    def closing_speed(self, one: int, other: int, ticks: NDArray[np.intp]) -> Array:
        """Speed [m/s] ``(k,)`` at which a body itself moves towards the nearest point of another, at k ticks.

        Whether the other moves does not count; 0 while the middle of the one is within the other.
        """
        is_every = len(ticks) == len(self.tick_ns)
        middle = self.solids[one].position_xyz_m
        middle = middle if is_every else middle.T[:, ticks].T
        way = (
            nearest_points(self.solids[other] if is_every else self.solids[other].take(ticks), middle)
            - middle
        )
        length = np.sqrt(way[:, 0] ** 2 + way[:, 1] ** 2 + way[:, 2] ** 2)
        self._fit_velocities([one])
        velocity = self._velocities[one]
        along = np.einsum("ni,ni->n", velocity if is_every else velocity[ticks], way)
        return np.where(
            length > 1e-9, along / np.maximum(length, 1e-9), np.where(np.isnan(length), np.nan, 0.0)
        )

    def distance(self, one: int, other: int, exact_below_m: float = np.inf) -> Array:
        """Surface distances [m] ``(n,)`` of two bodies; see :func:`demoplan.geometry.surface_distances`."""
        pair = (min(one, other), max(one, other))
        known_below_m, known = self._distances.get(pair, (-np.inf, None))
        if known is None or known_below_m < exact_below_m:
            known = surface_distances(self.solids[pair[0]], self.solids[pair[1]], exact_below_m)
            self._distances[pair] = (exact_below_m, known)
        return known


def bodies_of(
    frames: Iterable[pl.DataFrame],
    entities: Mapping[str, Entity],
    vocabulary: Vocabulary,
    velocity_window_s: float,
) -> Bodies:
    """The bodies of one episode.

    Args:
        frames: The episode's frames, in one or more parts.
        entities: Type and shape of each body.
        vocabulary: Types, and their shapes.
        velocity_window_s: Window of every velocity.

    Raises:
        DataError: If an entity of the frames has no type, or lacks ticks that others have.
        UnknownNameError: If a type is not in the vocabulary.
    """
    columns = _Columns()
    for part in frames:
        columns.take(part)
    names = tuple(sorted(columns.names))
    for name in names:
        if name not in entities:
            raise UnknownNameError("entity", name, entities, "the mapping: an object without a type")
        vocabulary.types.require(entities[name].type)
    ticks = _joined(columns.ticks)
    n = len(ticks) // max(len(names), 1)
    if len(ticks) != n * len(names) or not np.array_equal(np.tile(ticks[:n], len(names)), ticks):
        raise DataError(
            f"frames of episode {columns.episode_id!r} are not a full grid in order of entity and tick: "
            f"{len(ticks)} rows for {len(names)} entities; frames come from align"
        )
    positions = _joined(columns.positions).reshape(len(names), n, 3)
    orientations = _joined(columns.orientations).reshape(len(names), n, 4)
    ages = _joined(columns.ages).reshape(len(names), n)
    return Bodies(
        names=names,
        types=tuple(entities[name].type for name in names),
        is_fixed=tuple(
            entities[name].fixed is not None or _is_static(positions[row], orientations[row], ages[row])
            for row, name in enumerate(names)
        ),
        shapes=tuple(shape_of(entities[name], vocabulary) for name in names),
        tick_ns=ticks[:n].copy() if columns.n_parts > 1 else ticks[:n],
        tick_s=float(ticks[1] - ticks[0]) / 1e9 if n > 1 else 0.01,
        position_xyz_m=positions,
        orientation_wxyz=orientations,
        grip=_joined(columns.grips).reshape(len(names), n),
        velocity_window_s=velocity_window_s,
    )


class _Columns:
    """Columns of frames as arrays, part after part."""

    def __init__(self) -> None:
        self.episode_id = ""
        self.n_parts = 0
        self.names: set[str] = set()
        self.ticks: list[NDArray[np.int64]] = []
        self.positions: list[Array] = []
        self.orientations: list[Array] = []
        self.grips: list[Array] = []
        self.ages: list[NDArray[Any]] = []

    def take(self, part: pl.DataFrame) -> None:
        """Take up some more rows."""
        self.n_parts += 1
        self.episode_id = part["episode_id"][0]
        self.names |= set(part["entity"].unique())
        self.ticks.append(part["tick_ns"].to_numpy())
        self.positions.append(_matrix(part["position_xyz_m"], 3))
        self.orientations.append(_matrix(part["orientation_wxyz"], 4))
        self.grips.append(part["grip"].cast(pl.Float64).to_numpy().astype(np.float64))
        self.ages.append(part["pose_age_ns"].to_numpy())


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Arrays one after the other, each let go of; one alone is not copied."""
    found = parts[0] if len(parts) == 1 else np.concatenate(parts)
    parts.clear()
    return found


def shape_of(entity: Entity, vocabulary: Vocabulary) -> Shape:
    """An entity's extent: its own, else that of its type or of the nearest ancestor; else a point."""
    if entity.shape is not None:
        return Shape(entity.shape.kind, entity.shape.size_xyz_m, entity.shape.centre_xyz_m)
    shapes = dict(vocabulary.shapes)
    for name in vocabulary.types.ancestors(entity.type):
        if name in shapes:
            return shapes[name]
    return _POINT


def _is_static(positions: Array, orientations: Array, ages_ns: NDArray[np.int64]) -> bool:
    """Whether a pose is latched: never stale, and the same to the last digit at every tick."""
    return bool(
        np.all(ages_ns == 0)
        and np.all(positions == positions[0])
        and np.all((orientations == orientations[0]) | np.isnan(orientations))
    )


def _solid(shape: Shape, positions: Array, orientations: Array) -> Solid:
    return Solid.placed(
        shape.kind, np.array(shape.size_xyz_m), np.array(shape.centre_xyz_m), positions, orientations
    )


def _matrix(column: pl.Series, width: int) -> Array:
    if column.null_count() == len(column):
        return np.full((len(column), width), np.nan)
    return np.asarray(column.to_numpy(), np.float64).reshape(-1, width)
