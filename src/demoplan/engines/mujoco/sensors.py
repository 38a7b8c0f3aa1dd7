"""Simulated tracking of hands and objects: noise, lost readings, times of not seeing, latency."""

from bisect import bisect_right
from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class _Faults:
    """What is wrong with seeing, per entity; replaced as a whole when it changes."""

    blind_until_ns: NDArray[np.int64]
    biased_until_ns: NDArray[np.int64]
    bias_xyz_m: Array
    is_removed: NDArray[np.bool_]


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
        k = len(entities)
        # Each kind of chance has a stream of its own, so that when readings are worked out does not matter.
        self._noise_rng, self._chance_rng = rng.spawn(2)
        self._faults = _Faults(
            np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros((k, 3)), np.zeros(k, bool)
        )
        self._unseen_until_ns = np.zeros(k, dtype=np.int64)
        self._unseen_before_ns = np.zeros(k, dtype=np.int64)
        self._ticks: list[int] = []
        self._true: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        self._seen: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
        self._faults_at: list[_Faults] = []
        self._latency_ns = round(params.latency_s * 1e9)
        self._staleness_ns = round(params.staleness_s * 1e9)
        self._loss_probability = params.dropouts_per_minute / 60.0 / params.rate_hz

    def bias(self, entity: str, offset_xyz_m: Array, until_ns: int) -> None:
        """See one entity beside where it is, until then."""
        row = self.entities.index(entity)
        until, offsets = self._faults.biased_until_ns.copy(), self._faults.bias_xyz_m.copy()
        until[row], offsets[row] = until_ns, offset_xyz_m
        self._faults = replace(self._faults, biased_until_ns=until, bias_xyz_m=offsets)

    def blind(self, entity: str, until_ns: int) -> None:
        """Do not see one entity until then."""
        until = self._faults.blind_until_ns.copy()
        until[self.entities.index(entity)] = until_ns
        self._faults = replace(self._faults, blind_until_ns=until)

    def set_present(self, entity: str, is_present: bool) -> None:
        """Whether an entity is there to be seen at all."""
        removed = self._faults.is_removed.copy()
        removed[self.entities.index(entity)] = not is_present
        self._faults = replace(self._faults, is_removed=removed)

    def observe(self, tick_ns: int, position_xyz_m: Array, orientation_wxyz: Array, grip: Array) -> None:
        """Take one reading of everything.

        Args:
            tick_ns: Now; later than the tick before.
            position_xyz_m: True positions ``(k, 3)``.
            orientation_wxyz: True orientations ``(k, 4)``.
            grip: True openings of the hands ``(h,)``.
        """
        self._ticks.append(tick_ns)
        for log, values in zip(self._true, (position_xyz_m, orientation_wxyz, grip), strict=True):
            log.append(values)
        self._faults_at.append(self._faults)

    def _work_out(self) -> None:
        """Turn what was observed since the last time into what was seen: all ticks at once."""
        begin, end = len(self._seen[0]), len(self._ticks)
        n, k, h = end - begin, len(self.entities), len(self._hands)
        if not n:
            return
        p = self._params
        noise = self._noise_rng.standard_normal((n, 6 * k + h))
        chance = self._chance_rng.random((n, k, 2))
        ticks = np.array(self._ticks[begin:end])
        faults = self._faults_at[begin:end]
        position, orientation, grip = (np.array(log[begin:end]) for log in self._true)
        lost = chance[..., 1] < p.drop_probability
        low, high = p.dropout_s
        for at, row in np.argwhere(self._is_object & (chance[..., 0] < self._loss_probability)):
            lasts = low + (high - low) * chance[at, row, 1]
            lost[:, row] |= (ticks >= ticks[at]) & (ticks < ticks[at] + 1e9 * lasts)
            self._unseen_until_ns[row] = max(self._unseen_until_ns[row], ticks[at] + round(1e9 * lasts))
        lost |= (ticks[:, None] < self._unseen_before_ns) & self._is_object
        self._unseen_before_ns = self._unseen_until_ns.copy()
        lost |= ticks[:, None] < np.array([each.blind_until_ns for each in faults])
        lost |= np.array([each.is_removed for each in faults])
        lost &= self._moving
        is_biased = ticks[:, None] < np.array([each.biased_until_ns for each in faults])
        bias = np.array([each.bias_xyz_m for each in faults])
        shakes = noise[:, : 6 * k].reshape(n, k, 6)
        moving = self._moving[:, None]
        seen = position + np.where(moving, p.position_noise_m * shakes[..., :3], 0.0)
        seen += np.where(is_biased[..., None], bias, 0.0)
        small = np.concatenate([np.ones((n, k, 1)), 0.5 * p.orientation_noise_rad * shakes[..., 3:]], axis=-1)
        turned = np.where(moving, multiply(orientation, normalised(small)), orientation)
        seen[lost] = np.nan
        turned[lost] = np.nan
        read = np.clip(grip + p.grip_noise * noise[:, 6 * k :], 0.0, 1.0)
        for log, values in zip(self._seen, (seen, turned, read), strict=True):
            log.extend(values)

    def believed(self, entity: str, now_ns: int, n_readings: int = 12) -> Belief | None:
        """Where an entity seems to be: the mean of the latest readings that agree with the last of them.

        None where it was not seen lately, which counts with latency.
        """
        self._work_out()
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
        self._work_out()
        end = self._n_readable(now_ns)
        begin = bisect_right(self._ticks, since_ns, hi=end)
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
        begin = bisect_right(self._ticks, since_ns)
        if begin >= len(self._ticks):
            return _table((), np.zeros(0, np.int64), *_nothing())
        position, orientation, grip = (np.array(log[begin:]) for log in self._true)
        is_gone = np.array([each.is_removed for each in self._faults_at[begin:]])
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
        return bisect_right(self._ticks, now_ns - self._latency_ns)


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
