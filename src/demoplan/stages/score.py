"""How good activities are against true ones: shares of time, segments, and order.

Labels are compared as intervals, so the figures are exact and need no common clock: an accuracy over time is
what an accuracy over frames becomes when frames are dense.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.tables import Activities, Confusions, Scores

Array = NDArray[np.float64]
SUITE = "segmentation"
ALL = "all"


@dataclass(frozen=True, kw_only=True)
class ScoreParams:
    """What can be chosen about scoring."""

    overlaps: tuple[float, ...] = (0.10, 0.25, 0.50)
    """Least intersection over union at which a segment counts as found."""
    n_resamples: int = 2000
    """Bootstrap samples of episodes behind each interval."""
    seed: int = 0


def score_segmentation(
    predicted: dy.DataFrame[Activities],
    truth: dy.DataFrame[Activities],
    method: str,
    *,
    groups: Mapping[str, str] | None = None,
    params: ScoreParams = ScoreParams(),
) -> dy.DataFrame[Scores]:
    """Frame accuracy, macro F1, segmental F1 at several overlaps and edit score, per episode and in all.

    Frame accuracy and macro F1 weigh by time; the macro mean is over the activities that occur in truth or
    in prediction. Segments are matched per hand, one to one, by activity and overlap. The edit score is one
    minus the Levenshtein distance of the sequences of activities over the longer one's length, averaged over
    hands' tracks. Intervals for ``all`` come from resampling episodes.

    Source: C. Lea, M. D. Flynn, R. Vidal, A. Reiter, G. D. Hager, "Temporal convolutional networks for
    action segmentation and detection", CVPR 2017, doi:10.1109/CVPR.2017.113, section 4 (segmental F1, edit
    score); B. Efron, R. J. Tibshirani, "An introduction to the bootstrap", 1993, chapter 13 (percentiles).

    Args:
        predicted: Inferred activities.
        truth: True activities; only tracks (episode and hand) that they have are scored, only on time that
            they cover.
        method: Name of what inferred them.
        groups: Episode → group that was left out in training, for ``detail``.
        params: Overlaps and bootstrap.

    Returns:
        One row per subject and metric; ``n`` is the number of episodes for ``all`` (and tracks, for one
        episode); ``low`` and ``high`` are given for ``all`` if there are two episodes at least.

    Raises:
        DataError: If a true track has no inferred counterpart.
    """
    counts = _Counts.of(predicted, truth, params.overlaps)
    if not counts.episodes:
        return Scores.create_empty()
    groups = groups or {}
    rows: list[dict[str, object]] = []

    def add(subject: str, values: dict[str, float], n: int, detail: str | None) -> None:
        rows.extend(
            {
                "suite": SUITE,
                "method": method,
                "subject": subject,
                "metric": metric,
                "value": value,
                "n": n,
                "low": None,
                "high": None,
                "detail": detail,
            }
            for metric, value in values.items()
        )

    n_episodes = len(counts.episodes)
    each = _metrics(counts, np.eye(n_episodes), params.overlaps)
    for index, episode in enumerate(counts.episodes):
        group = groups.get(episode)
        detail = None if group is None else f"left out: {group}"
        add(episode, {k: float(v[index]) for k, v in each.items()}, int(counts.n_tracks[index]), detail)
    whole = _metrics(counts, np.ones((1, n_episodes)), params.overlaps)
    add(ALL, {k: float(v[0]) for k, v in whole.items()}, n_episodes, None)
    for index, name in enumerate(counts.names):
        in_all = counts.confusion.sum(axis=0)
        total = in_all[index].sum() + in_all[:, index].sum()
        add(ALL, {f"f1 {name}": float(2 * in_all[index, index] / total)}, n_episodes, None)
    if n_episodes > 1:
        rng = np.random.default_rng(params.seed)
        drawn = rng.multinomial(n_episodes, np.full(n_episodes, 1 / n_episodes), size=params.n_resamples)
        low_high = {
            metric: np.nanquantile(values, [0.025, 0.975])
            for metric, values in _metrics(counts, drawn.astype(np.float64), params.overlaps).items()
        }
        for row in rows:
            if row["subject"] == ALL and row["metric"] in low_high:
                row["low"], row["high"] = (float(v) for v in low_high[str(row["metric"])])
    table = pl.DataFrame(rows, schema=Scores.create_empty().schema)
    return Scores.validate(table.sort("suite", "method", "subject", "metric"), cast=True)


def confusion(
    predicted: dy.DataFrame[Activities], truth: dy.DataFrame[Activities], method: str
) -> dy.DataFrame[Confusions]:
    """How long each true activity was taken for which, per episode and in all.

    Raises:
        DataError: If a true track has no inferred counterpart.
    """
    counts = _Counts.of(predicted, truth, ())
    blocks = [*zip(counts.episodes, counts.confusion, strict=True)]
    if blocks:
        blocks.append((ALL, counts.confusion.sum(axis=0)))
    rows = [
        {
            "method": method,
            "subject": subject,
            "truth": counts.names[i],
            "predicted": counts.names[j],
            "duration_ns": int(block[i, j]),
            "share": float(block[i, j] / block[i].sum()),
        }
        for subject, block in blocks
        for i, j in np.argwhere(block > 0)
    ]
    table = pl.DataFrame(rows, schema=Confusions.create_empty().schema)
    return Confusions.validate(table.sort("method", "subject", "truth", "predicted"))


def majority_activities(truth: dy.DataFrame[Activities]) -> dy.DataFrame[Activities]:
    """The naive baseline: every track as one segment of the activity that lasts longest in all."""
    if not truth.height:
        return truth
    total = truth.group_by("activity").agg(time=(pl.col("end_ns") - pl.col("start_ns")).sum())
    most = total.sort(["time", "activity"], descending=[True, False]).item(0, "activity")
    none = pl.lit(None, dtype=pl.String)
    table = truth.group_by("episode_id", "hand").agg(pl.col("start_ns").min(), pl.col("end_ns").max())
    table = table.with_columns(activity=pl.lit(most), acted_on=none, in_hand=none)
    return Activities.validate(table.select(Activities.column_names()).sort("episode_id", "hand"))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Counts:
    """What every metric is made of, per episode, so that episodes can be left out or drawn twice."""

    names: tuple[str, ...]
    episodes: tuple[str, ...]
    confusion: Array
    """Time [ns] per episode, true and inferred activity ``(e, k, k)``."""
    n_tracks: Array
    """Hands' tracks ``(e,)``."""
    n_true: Array
    """True segments ``(e,)``."""
    n_predicted: Array
    n_found: Array
    """Segments matched at each overlap ``(e, overlaps)``."""
    edit: Array
    """Edit scores of an episode's tracks, added up ``(e,)``."""

    @classmethod
    def of(
        cls, predicted: dy.DataFrame[Activities], truth: dy.DataFrame[Activities], overlaps: tuple[float, ...]
    ) -> "_Counts":
        keys = ["episode_id", "hand"]
        found = {key: _Track.of(group) for key, group in _joined_runs(predicted).group_by(keys)}
        true = {key: _Track.of(group) for key, group in _joined_runs(truth).group_by(keys)}
        missing = sorted(f"{episode}/{hand}" for episode, hand in true.keys() - found.keys())
        if missing:
            raise DataError(f"no inferred activities for {missing}; scoring needs them for every true track")
        scored = {key: found[key].within(track) for key, track in true.items()}
        names = tuple(
            sorted(
                {str(n) for tracks in (scored, true) for t in tracks.values() for n in t.activity.tolist()}
            )
        )
        episodes = tuple(sorted({str(key[0]) for key in true}))
        row = {episode: index for index, episode in enumerate(episodes)}
        n, k = len(episodes), len(names)
        counts = cls(
            names=names,
            episodes=episodes,
            confusion=np.zeros((n, k, k)),
            n_tracks=np.zeros(n),
            n_true=np.zeros(n),
            n_predicted=np.zeros(n),
            n_found=np.zeros((n, len(overlaps))),
            edit=np.zeros(n),
        )
        for key in sorted(true):
            e, t, p = row[str(key[0])], true[key], scored[key]
            shared, _ = _overlap(t, p)
            code = {name: index for index, name in enumerate(names)}
            rows = np.asarray([code[name] for name in t.activity])
            columns = np.asarray([code[name] for name in p.activity], dtype=np.int64)
            np.add.at(counts.confusion[e], (rows[:, None], columns[None]), shared)
            counts.n_tracks[e] += 1
            counts.n_true[e] += len(t.activity)
            counts.n_predicted[e] += len(p.activity)
            counts.n_found[e] += [_n_found(t, p, overlap) for overlap in overlaps]
            counts.edit[e] += _edit_score(rows, columns)
        return counts


@dataclass(frozen=True, eq=False)
class _Track:
    """Segments of one hand in one episode, in order."""

    start_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    activity: NDArray[np.object_]

    @classmethod
    def of(cls, rows: pl.DataFrame) -> "_Track":
        rows = rows.sort("start_ns")
        return cls(
            rows.get_column("start_ns").to_numpy(),
            rows.get_column("end_ns").to_numpy(),
            np.asarray(rows.get_column("activity").to_list(), dtype=object),
        )

    def within(self, other: "_Track") -> "_Track":
        """The same segments, cut to the time from another track's beginning to its end."""
        start = np.maximum(self.start_ns, other.start_ns[0])
        end = np.minimum(self.end_ns, other.end_ns[-1])
        is_left = start < end
        return _Track(start[is_left], end[is_left], self.activity[is_left])


def _joined_runs(activities: pl.DataFrame) -> pl.DataFrame:
    """Rows in which neighbours that touch and do the same (to whatever object) are one segment."""
    keys = ["episode_id", "hand"]
    ordered = activities.sort(*keys, "start_ns")
    is_new = (
        (pl.col("activity") != pl.col("activity").shift(1).over(keys))
        | (pl.col("start_ns") != pl.col("end_ns").shift(1).over(keys))
    ).fill_null(value=True)
    return (
        ordered.with_columns(run=is_new.cum_sum().over(keys))
        .group_by(*keys, "run", maintain_order=True)
        .agg(pl.col("start_ns").first(), pl.col("end_ns").last(), pl.col("activity").first())
    )


def _overlap(a: _Track, b: _Track) -> tuple[Array, Array]:
    """Shared time of every pair of segments ``(a, b)``, and its share of the time of both together."""
    end = np.minimum(a.end_ns[:, None], b.end_ns[None])
    start = np.maximum(a.start_ns[:, None], b.start_ns[None])
    shared = np.maximum(end - start, 0).astype(np.float64)
    union = (a.end_ns - a.start_ns)[:, None] + (b.end_ns - b.start_ns)[None] - shared
    return shared, shared / union


def _n_found(truth: _Track, predicted: _Track, least: float) -> int:
    """Inferred segments that match a true one of their activity; each true one is found once at most."""
    _, share = _overlap(truth, predicted)
    share = np.where(truth.activity[:, None] == predicted.activity[None], share, 0.0)
    is_free = np.ones(len(truth.activity), dtype=bool)
    n = 0
    for column in range(share.shape[1]):
        best = int(share[:, column].argmax())
        if share[best, column] >= least and is_free[best]:
            is_free[best] = False
            n += 1
    return n


def _edit_score(a: NDArray[np.int64], b: NDArray[np.int64]) -> float:
    """One minus the Levenshtein distance over the longer length: 1 for equal sequences."""
    row = np.arange(len(b) + 1)
    steps = np.arange(len(b) + 1)
    for index, value in enumerate(a):
        change = row[:-1] + (b != value)
        least = np.minimum(np.concatenate(([index + 1], change)), np.concatenate(([index + 1], row[1:] + 1)))
        # An insertion costs one per step to the right: a running minimum of what is left after paying it.
        row = np.minimum.accumulate(least - steps) + steps
    return 1.0 - float(row[-1]) / max(len(a), len(b), 1)


def _metrics(counts: _Counts, weights: Array, overlaps: tuple[float, ...]) -> dict[str, Array]:
    """Every metric for each weighting of episodes ``(samples, e)``; one value per sample."""
    with np.errstate(divide="ignore", invalid="ignore"):
        confused = np.einsum("se,eij->sij", weights, counts.confusion)
        right = np.einsum("sii->si", confused)
        total = confused.sum(axis=2) + confused.sum(axis=1)
        found = {
            "frame accuracy": right.sum(axis=1) / confused.sum(axis=(1, 2)),
            "macro F1": np.nanmean(np.where(total > 0, 2 * right / total, np.nan), axis=1),
        }
        n_segments = weights @ (counts.n_true + counts.n_predicted)
        for index, overlap in enumerate(overlaps):
            found[f"F1@{round(overlap * 100)}"] = 2 * (weights @ counts.n_found[:, index]) / n_segments
        found["edit score"] = (weights @ counts.edit) / (weights @ counts.n_tracks)
    return found
