"""What is known of every body of one episode at every tick, in the form that definitions ask for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

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
    solids: tuple[Solid, ...]
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
    _velocities: dict[int, Array] = field(default_factory=dict, repr=False)
    _distances: dict[tuple[int, int], tuple[float, Array]] = field(default_factory=dict, repr=False)

    @cached_property
    def is_seen(self) -> Bools:
        """Whether the pose is known ``(e, n)``."""
        return are_known(self.position_xyz_m)

    def velocity(self, bodies: Sequence[int]) -> Array:
        """Velocities of tracked origins [m/s] ``(k, n, 3)``; NaN where the pose is not known."""
        self._fit_velocities(bodies)
        return np.stack([self._velocities[body] for body in bodies])

    def _fit_velocities(self, bodies: Sequence[int]) -> None:
        missing = [body for body in bodies if body not in self._velocities]
        if missing:
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
    frames: pl.DataFrame,
    entities: Mapping[str, Entity],
    vocabulary: Vocabulary,
    velocity_window_s: float,
) -> Bodies:
    """The bodies of one episode's frames.

    Raises:
        DataError: If an entity of the frames has no type, or lacks ticks that others have.
        UnknownNameError: If a type is not in the vocabulary.
    """
    names = tuple(frames["entity"].unique().sort().to_list())
    for name in names:
        if name not in entities:
            raise UnknownNameError("entity", name, entities, "the mapping: an object without a type")
        vocabulary.types.require(entities[name].type)
    n = len(frames) // max(len(names), 1)
    ticks = frames["tick_ns"].to_numpy()
    if len(frames) != n * len(names) or not np.array_equal(np.tile(ticks[:n], len(names)), ticks):
        raise DataError(
            f"frames of episode {frames['episode_id'][0]!r} are not a full grid in order of entity and tick: "
            f"{len(frames)} rows for {len(names)} entities; frames come from align"
        )
    positions = _matrix(frames["position_xyz_m"], len(names), n, 3)
    orientations = _matrix(frames["orientation_wxyz"], len(names), n, 4)
    grips = frames["grip"].cast(pl.Float64).to_numpy().astype(np.float64).reshape(len(names), n)
    ages = frames["pose_age_ns"].to_numpy().reshape(len(names), n)
    return Bodies(
        names=names,
        types=tuple(entities[name].type for name in names),
        is_fixed=tuple(
            entities[name].fixed is not None or _is_static(positions[row], orientations[row], ages[row])
            for row, name in enumerate(names)
        ),
        solids=tuple(
            _solid(shape_of(entities[name], vocabulary), positions[row], orientations[row])
            for row, name in enumerate(names)
        ),
        tick_ns=ticks[:n],
        tick_s=float(ticks[1] - ticks[0]) / 1e9 if n > 1 else 0.01,
        position_xyz_m=positions,
        orientation_wxyz=orientations,
        grip=grips,
        velocity_window_s=velocity_window_s,
    )


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


def _matrix(column: pl.Series, n_bodies: int, n_ticks: int, width: int) -> Array:
    if column.null_count() == len(column):
        return np.full((n_bodies, n_ticks, width), np.nan)
    return np.asarray(column.to_numpy(), np.float64).reshape(n_bodies, n_ticks, width)
