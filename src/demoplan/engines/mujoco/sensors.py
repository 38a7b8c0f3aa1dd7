"""Simulated tracking of hands and objects: noise, lost readings, times of not seeing, latency."""

from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.engines.mujoco.session import SensorParams
from demoplan.geometry import Array, multiply, normalised

EPISODE = "run"
"""Episode that the frames of a session belong to."""

_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Belief:
    """Where sensors say that an entity is."""

    position_xyz_m: Array
    orientation_wxyz: Array
    age_ns: int


class Sensors:
    """Readings of all entities, tick by tick, as they were and as they were seen."""

    def __init__(
        self,
        entities: tuple[str, ...],
        hands: tuple[str, ...],
        fixed: tuple[str, ...],
        params: SensorParams,
        rng: np.random.Generator,
    ) -> None:
        """Nothing is seen yet.

        Args:
            entities: Hands, then objects, then what is fixed, in the order in which poses will be given.
            hands: Those of them that have a grip.
            fixed: Those that never move: they are known exactly, and always.
            params: How well they are seen.
            rng: Source of noise.
        """
        self.entities = entities
        self._hands = [entities.index(name) for name in hands]
        self._moving = np.array([name not in fixed for name in entities])
        self._is_object = np.array([name not in fixed and name not in hands for name in entities])
        self._params = params
        self._rng = rng
        k = len(entities)
        self._blind_until_ns = np.zeros(k, dtype=np.int64)
        self._biased_until_ns = np.zeros(k, dtype=np.int64)
        self._bias_xyz_m = np.zeros((k, 3))
        self._removed = np.zeros(k, dtype=bool)
        self._ticks: list[int] = []
        self._true: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        self._seen: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        self._presence: list[NDArray[np.bool_]] = []
        self._latency_ns = round(params.latency_s * 1e9)
        self._staleness_ns = round(params.staleness_s * 1e9)
        self._loss_probability = params.dropouts_per_minute / 60.0 / params.rate_hz

    def bias(self, entity: str, offset_xyz_m: Array, until_ns: int) -> None:
        """See one entity beside where it is, until then."""
        row = self.entities.index(entity)
        self._bias_xyz_m[row] = offset_xyz_m
        self._biased_until_ns[row] = until_ns

    def blind(self, entity: str, until_ns: int) -> None:
        """Do not see one entity until then."""
        row = self.entities.index(entity)
        self._blind_until_ns[row] = max(until_ns, self._blind_until_ns[row])

    def remove(self, entity: str) -> None:
        """Never see one entity again, unless it comes back."""
        self._removed[self.entities.index(entity)] = True

    def bring_back(self, entity: str) -> None:
        """See a removed entity again."""
        self._removed[self.entities.index(entity)] = False

    def observe(self, tick_ns: int, position_xyz_m: Array, orientation_wxyz: Array, grip: Array) -> None:
        """Take one reading of everything.

        Args:
            tick_ns: Now; later than the tick before.
            position_xyz_m: True positions ``(k, 3)``.
            orientation_wxyz: True orientations ``(k, 4)``.
            grip: True openings of the hands ``(h,)``.
        """
        p, k = self._params, len(self.entities)
        noise = self._rng.standard_normal((k, 6))
        chance = self._rng.random((k, 2))
        struck = self._is_object & (chance[:, 0] < self._loss_probability)
        if struck.any():
            low, high = p.dropout_s
            for row in np.flatnonzero(struck):
                self.blind(self.entities[row], tick_ns + round(1e9 * (low + (high - low) * chance[row, 1])))
        lost = (chance[:, 1] < p.drop_probability) | (tick_ns < self._blind_until_ns) | self._removed
        lost &= self._moving
        seen = position_xyz_m + np.where(self._moving[:, None], p.position_noise_m * noise[:, :3], 0.0)
        biased = tick_ns < self._biased_until_ns
        if biased.any():
            seen = seen + np.where(biased[:, None], self._bias_xyz_m, 0.0)
        small = np.concatenate([np.ones((k, 1)), 0.5 * p.orientation_noise_rad * noise[:, 3:]], axis=1)
        turned = np.where(
            self._moving[:, None], multiply(orientation_wxyz, normalised(small)), orientation_wxyz
        )
        seen[lost] = np.nan
        turned[lost] = np.nan
        read = np.clip(grip + p.grip_noise * self._rng.standard_normal(len(grip)), 0.0, 1.0)
        self._ticks.append(tick_ns)
        for log, values in zip(self._true, (position_xyz_m, orientation_wxyz, grip), strict=True):
            log.append(values)
        for log, values in zip(self._seen, (seen, turned, read), strict=True):
            log.append(values)
        self._presence.append(~self._removed)

    def believed(self, entity: str, now_ns: int, n_readings: int = 12) -> Belief | None:
        """Where an entity seems to be: the mean of the latest readings that agree with the last of them.

        None where it was not seen lately, which counts with latency.
        """
        row = self.entities.index(entity)
        end = self._n_readable(now_ns)
        first = max(0, end - n_readings)
        positions = np.array([each[row] for each in self._seen[0][first:end]]).reshape(-1, 3)
        known = np.flatnonzero(np.isfinite(positions[:, 0]))
        if not known.size:
            return None
        last = known[-1]
        age = now_ns - self._ticks[first + int(last)]
        if age > self._staleness_ns + self._latency_ns + round(1e9 / self._params.rate_hz):
            return None
        # What moved meanwhile is no reading of where it is now.
        near = 8.0 * self._params.position_noise_m + 0.001
        agrees = known[np.linalg.norm(positions[known] - positions[last], axis=1) <= near]
        turns = np.array([self._seen[1][first + int(each)][row] for each in agrees])
        turns *= np.sign(turns @ turns[-1])[:, None]
        return Belief(positions[agrees].mean(axis=0), normalised(turns.mean(axis=0)), age)

    def frames(self, since_ns: int, now_ns: int) -> pl.DataFrame:
        """Readings after ``since_ns`` that can be read now, as rows of ``Frames``.

        A lost reading is the last one before it, within the staleness limit, as ``align`` has it.
        """
        end = self._n_readable(now_ns)
        begin = int(np.searchsorted(self._ticks[:end], since_ns, side="right"))
        before = max(0, begin - round(self._params.staleness_s * self._params.rate_hz) - 1)
        if begin >= end:
            return _table((), np.zeros(0, np.int64), *_nothing())
        ticks = np.array(self._ticks[before:end], dtype=np.int64)
        position, orientation, grip = (np.array(log[before:end]) for log in self._seen)
        known = np.isfinite(position[..., 0])
        index = np.where(known, np.arange(len(ticks))[:, None], -1)
        source = np.maximum.accumulate(index, axis=0)
        age = ticks[:, None] - ticks[np.maximum(source, 0)]
        is_stale = (source < 0) | (age > self._staleness_ns)
        rows = np.maximum(source, 0)
        position = np.take_along_axis(position, rows[..., None], axis=0)
        orientation = np.take_along_axis(orientation, rows[..., None], axis=0)
        position[is_stale] = np.nan
        orientation[is_stale] = np.nan
        skip = begin - before
        return _table(
            self.entities,
            ticks[skip:],
            position[skip:],
            orientation[skip:],
            np.where(is_stale, -1, age)[skip:],
            self._grips(grip[skip:]),
        )

    def true_frames(self, since_ns: int) -> pl.DataFrame:
        """The same, as it truly was and without latency; what was removed has no pose."""
        begin = int(np.searchsorted(self._ticks, since_ns, side="right"))
        if begin >= len(self._ticks):
            return _table((), np.zeros(0, np.int64), *_nothing())
        position, orientation, grip = (np.array(log[begin:]) for log in self._true)
        is_gone = ~np.array(self._presence[begin:])
        position[is_gone] = np.nan
        orientation[is_gone] = np.nan
        ticks = np.array(self._ticks[begin:], dtype=np.int64)
        ages = np.where(is_gone, -1, 0)
        return _table(self.entities, ticks, position, orientation, ages, self._grips(grip))

    def _grips(self, grip: Array) -> Array:
        """Grips ``(n, k)`` of all entities; not a number where there is none."""
        full = np.full((len(grip), len(self.entities)), np.nan)
        full[:, self._hands] = grip
        return full

    def _n_readable(self, now_ns: int) -> int:
        return int(np.searchsorted(self._ticks, now_ns - self._latency_ns, side="right"))


def _nothing() -> tuple[Array, Array, NDArray[np.int64], Array]:
    return np.zeros((0, 0, 3)), np.zeros((0, 0, 4)), np.zeros((0, 0), np.int64), np.zeros((0, 0))


def _table(
    entities: tuple[str, ...],
    ticks: NDArray[np.int64],
    position: Array,
    orientation: Array,
    age: NDArray[np.int64],
    grip: Array,
) -> pl.DataFrame:
    """Rows of ``Frames`` from arrays ``(n, k, …)``, sorted by entity, then tick."""
    n, k = len(ticks), len(entities)
    order = np.argsort(np.array(entities, dtype=object), kind="stable") if k else np.zeros(0, np.intp)
    flat_position = np.ascontiguousarray(np.swapaxes(position, 0, 1)[order]).reshape(-1, 3)
    flat_orientation = np.ascontiguousarray(np.swapaxes(orientation, 0, 1)[order]).reshape(-1, 4)
    flat_age = np.swapaxes(age, 0, 1)[order].reshape(-1)
    flat_grip = np.swapaxes(grip, 0, 1)[order].reshape(-1)
    is_known = pl.Series("is_known", np.isfinite(flat_position[:, 0]))
    table = pl.DataFrame(
        {
            "episode_id": pl.repeat(EPISODE, n * k, dtype=pl.String, eager=True),
            "entity": pl.Series([entities[row] for row in order], dtype=pl.String).gather(
                np.repeat(np.arange(k), n)
            ),
            "tick_ns": np.tile(ticks, k),
            "position_xyz_m": pl.Series(flat_position, dtype=pl.Array(pl.Float64, 3)),
            "orientation_wxyz": pl.Series(flat_orientation, dtype=pl.Array(pl.Float64, 4)),
            "grip": pl.Series(flat_grip, dtype=pl.Float64).fill_nan(None),
            "pose_age_ns": pl.Series(flat_age, dtype=pl.Int64),
        }
    )
    shown = [
        pl.when(is_known).then(pl.col(name)).alias(name)
        for name in ("position_xyz_m", "orientation_wxyz", "pose_age_ns")
    ]
    return table.with_columns(shown)
