"""Frames of an episode to vectors per exported frame: hands, objects, and which of them were seen."""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.exports.lerobot.content import DatasetFacts

Vectors: TypeAlias = NDArray[np.float32]
Flags: TypeAlias = NDArray[np.bool_]

POSE_NAMES = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
"""Position [m] and unit quaternion, body to world."""


@dataclass(frozen=True, kw_only=True)
class EpisodeVectors:
    """An episode on the exported clock: ``n`` frames, frame ``k`` at ``k / fps`` from the first tick."""

    ticks_ns: NDArray[np.int64]
    """``(n,)`` ticks that the frames are taken from."""
    state: Vectors
    """``(n, s)`` poses of hands, and their openings."""
    environment: Vectors
    """``(n, 7 o)`` poses of objects."""
    is_seen: Flags
    """``(n, h + g + o)`` whether each pose and opening was observed; if not, its last is held."""


def state_names(facts: DatasetFacts) -> list[str]:
    """Names of the state's components, in order."""
    return [
        f"{hand}.{part}"
        for hand in facts.hands
        for part in (*POSE_NAMES, *(("grip",) if hand in facts.gripping else ()))
    ]


def environment_names(facts: DatasetFacts) -> list[str]:
    """Names of the environment state's components, in order."""
    return [f"{thing}.{part}" for thing in facts.objects for part in POSE_NAMES]


def seen_names(facts: DatasetFacts) -> list[str]:
    """What each flag speaks of, in order."""
    return [*facts.hands, *(f"{hand}.grip" for hand in facts.gripping), *facts.objects]


def vectors_of(frames: pl.DataFrame, facts: DatasetFacts, fps: int) -> EpisodeVectors:
    """Sample an episode's frames.

    Each exported frame takes the tick nearest to its time, which is at most half a tick away. What was not
    observed keeps the pose that it was last seen in (before it is first seen: that one), and is flagged.

    Args:
        frames: Rows of ``Frames`` of one episode.
        facts: Names and order of hands and objects.
        fps: Frames per second of the export, at most the tick rate [Hz].

    Raises:
        DataError: If there are no frames, or the clock is slower than ``fps``.
    """
    ticks = frames["tick_ns"].unique().sort().to_numpy()
    if len(ticks) < 2:
        raise DataError(f"an episode of {len(ticks)} ticks is too short to export; at least 2 are needed")
    if fps > facts.tick_rate_hz:
        raise DataError(
            f"{fps} frames per second were asked for; the episodes have {facts.tick_rate_hz:g} ticks"
        )
    n = int((len(ticks) - 1) * fps / facts.tick_rate_hz + 1e-9) + 1
    chosen = np.rint(np.arange(n) * facts.tick_rate_hz / fps).astype(np.int64)
    tracks = {str(key[0]): part.sort("tick_ns") for key, part in frames.group_by("entity")}

    def pose(name: str) -> tuple[NDArray[np.float64], Flags]:
        return _pose(tracks.get(name), len(ticks))

    poses = {name: pose(name) for name in (*facts.hands, *facts.objects)}
    grips = {hand: _grip(tracks.get(hand), len(ticks)) for hand in facts.gripping}
    state = [
        part
        for hand in facts.hands
        for part in (poses[hand][0], *([grips[hand][0]] if hand in facts.gripping else []))
    ]
    environment = [poses[thing][0] for thing in facts.objects]
    flags = [
        *(poses[hand][1] for hand in facts.hands),
        *(grips[hand][1] for hand in facts.gripping),
        *(poses[thing][1] for thing in facts.objects),
    ]
    return EpisodeVectors(
        ticks_ns=ticks[chosen],
        state=_joined(state, len(ticks))[chosen],
        environment=_joined(environment, len(ticks))[chosen],
        is_seen=np.stack(flags, axis=1)[chosen],
    )


def action_of(state: Vectors) -> Vectors:
    """The state one frame later; the last frame's is its own. A demonstration holds no commands.

    >>> action_of(np.array([[1.0], [2.0], [4.0]], dtype=np.float32)).ravel().tolist()
    [2.0, 4.0, 4.0]
    """
    return np.concatenate((state[1:], state[-1:]))


def _joined(parts: list[NDArray[np.float64]], n: int) -> Vectors:
    if not parts:
        return np.zeros((n, 0), dtype=np.float32)
    return np.concatenate(parts, axis=1).astype(np.float32)


def _pose(track: pl.DataFrame | None, n: int) -> tuple[NDArray[np.float64], Flags]:
    """Poses ``(n, 7)`` without gaps, and ``(n,)`` where they were observed."""
    held = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (n, 1))
    if track is None:
        return held, np.zeros(n, dtype=bool)
    positions = _columns(track["position_xyz_m"], 3)
    turns = _columns(track["orientation_wxyz"], 4)
    is_seen = np.asarray(np.isfinite(positions).all(axis=1))
    held[:, :3] = _held(positions, is_seen, held[:, :3])
    is_turned = np.asarray(np.isfinite(turns).all(axis=1))
    held[:, 3:] = _continuous(_held(turns, is_turned, held[:, 3:]))
    return held, is_seen


def _grip(track: pl.DataFrame | None, n: int) -> tuple[NDArray[np.float64], Flags]:
    if track is None:
        return np.zeros((n, 1)), np.zeros(n, dtype=bool)
    openings = track["grip"].cast(pl.Float64).fill_null(float("nan")).to_numpy()[:, None]
    is_seen = np.asarray(np.isfinite(openings[:, 0]))
    return _held(openings, is_seen, np.zeros((n, 1))), is_seen


def _columns(series: pl.Series, width: int) -> NDArray[np.float64]:
    parts = [series.arr.get(k).fill_null(float("nan")).to_numpy() for k in range(width)]
    return np.column_stack(parts).astype(np.float64)


def _held(values: NDArray[np.float64], is_seen: Flags, otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Each row as it was last seen, and before that as it is first seen; ``otherwise`` if it never is."""
    if not is_seen.any():
        return otherwise
    last = np.maximum.accumulate(np.where(is_seen, np.arange(len(is_seen)), -1))
    kept: NDArray[np.float64] = values[np.where(last < 0, int(np.argmax(is_seen)), last)]
    return kept


def _continuous(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same rotations without jumps of sign: ``q`` and ``-q`` are one rotation, but not one number."""
    steps = np.einsum("ij,ij->i", turns[1:], turns[:-1])
    signs = np.cumprod(np.concatenate(([1.0 if turns[0, 0] >= 0 else -1.0], np.where(steps < 0, -1.0, 1.0))))
    turned: NDArray[np.float64] = turns * signs[:, None]
    return turned
