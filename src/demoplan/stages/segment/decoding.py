"""From probabilities per tick to a sequence: the likeliest course of activities as a whole.

Neighbouring ticks show nearly the same thing, so their evidence does not add up like independent
observations: it is counted once per ``evidence_s``. Changing the activity costs what it cost in the
training labels. Both are stated in seconds, so that the rate of a log does not matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Grammar:
    """What follows what: log-probabilities of beginning with, and of changing to, each activity."""

    initial: Array
    """``(k,)``."""
    change: Array
    """From row to column, given that there is a change ``(k, k)``; zero on the diagonal."""
    leave_per_s: Array
    """How often each activity ends: one over its mean duration ``(k,)`` [1/s]."""

    def costs(self, evidence_s: float) -> Array:
        """Log-probability of changing from row to column within ``evidence_s``; staying costs nothing."""
        leave = np.log(np.minimum(self.leave_per_s * evidence_s, 1.0))
        return np.where(np.eye(len(leave), dtype=np.bool_), 0.0, self.change + leave[:, None])


def grammar_of(
    sequences: Sequence[NDArray[np.int64]], durations_s: Sequence[Array], n_classes: int, prior: float
) -> Grammar:
    """What follows what, and how soon, in label sequences.

    Args:
        sequences: Classes of the segments of each labelled track, in order.
        durations_s: How long each of these segments lasts [s].
        n_classes: Number of classes, each of which occurs at least once.
        prior: Pseudo-count of every start and every change: what was never shown stays possible.
    """
    starts = np.full(n_classes, prior)
    changes = np.full((n_classes, n_classes), prior)
    for sequence in sequences:
        starts[sequence[0]] += 1.0
        np.add.at(changes, (sequence[:-1], sequence[1:]), 1.0)
    np.fill_diagonal(changes, 0.0)
    totals = np.maximum(changes.sum(axis=1, keepdims=True), prior)
    change = np.log(np.where(changes > 0, changes, totals) / totals)
    every = np.concatenate(sequences)
    total_s = np.bincount(every, weights=np.concatenate(durations_s), minlength=n_classes)
    return Grammar(
        initial=np.log(starts / starts.sum()),
        change=change,
        leave_per_s=np.bincount(every, minlength=n_classes) / total_s,
    )


def decoded(log_probability: Array, initial: Array, change: Array) -> NDArray[np.int64]:
    """The likeliest sequence, found over stretches of ticks that rank all classes alike.

    Where each pair of classes keeps its order, moving a change of class to one end of the stretch never
    costs anything: stretches can be decided as a whole. Long quiet recordings shrink to few stretches.

    Args:
        log_probability: Evidence ``(t, k)``, finite.
        initial: Log-probability of beginning with each class ``(k,)``.
        change: Log-probability of changing from row to column ``(k, k)``.

    Returns:
        Classes ``(t,)``.
    """
    n_ticks = len(log_probability)
    if n_ticks < 2:
        return viterbi(log_probability, initial, change)
    # Leaves repeat from tick to tick: only where the evidence changes can the ranking change.
    is_other = log_probability[1:, 0] != log_probability[:-1, 0]
    for k in range(1, log_probability.shape[1]):
        is_other |= log_probability[1:, k] != log_probability[:-1, k]
    changes = np.flatnonzero(np.append(True, is_other))
    ranking = np.argsort(log_probability[changes], axis=1, kind="stable")
    starts = changes[np.append(True, (ranking[1:] != ranking[:-1]).any(axis=1))]
    summed = np.add.reduceat(log_probability, starts, axis=0)
    return np.repeat(viterbi(summed, initial, change), np.diff(starts, append=n_ticks))


def viterbi(log_probability: Array, initial: Array, change: Array) -> NDArray[np.int64]:
    """The sequence of classes that maximises evidence plus grammar, exactly.

    Time is cut into about √t blocks. Within all blocks at once, the best score from every class at the
    block's entry to every class at each of its ticks is found step by step; the blocks are then chained, and
    all blocks trace back at once. That takes 3√t array operations where the textbook loop takes 2t.

    Source: A. J. Viterbi, "Error bounds for convolutional codes and an asymptotically optimum decoding
    algorithm", IEEE Transactions on Information Theory 13 (1967), doi:10.1109/TIT.1967.1054010; the blocks
    use that max-plus matrix products are associative.

    Args:
        log_probability: Evidence ``(t, k)``, finite.
        initial: Log-probability of beginning with each class ``(k,)``.
        change: Log-probability of changing from row to column between two ticks ``(k, k)``.

    Returns:
        Classes ``(t,)``.
    """
    n_ticks, k = log_probability.shape
    if n_ticks == 0:
        return np.zeros(0, dtype=np.int64)
    # The first tick is decided by the chain; the others fill whole blocks, padded with empty ticks.
    n_steps = max(1, int(np.sqrt(n_ticks - 1))) if n_ticks > 1 else 1
    n_blocks = -(-(n_ticks - 1) // n_steps)
    padded = np.zeros((n_blocks * n_steps, k))
    padded[: n_ticks - 1] = log_probability[1:]
    evidence = padded.reshape(n_blocks, n_steps, k)

    change_into = change.T  # (to, from)
    best = np.where(np.eye(k, dtype=bool), 0.0, -np.inf)[None].repeat(n_blocks, axis=0)  # (block, entry, now)
    came_from = np.empty((n_steps, n_blocks, k, k), dtype=np.int8)
    for step in range(n_steps):
        ways = best[:, :, None, :] + change_into  # (block, entry, to, from)
        chosen = ways.argmax(axis=3)
        came_from[step] = chosen
        best = np.take_along_axis(ways, chosen[..., None], axis=3)[..., 0] + evidence[:, step, None, :]

    score = initial + log_probability[0]
    entry_of = np.empty((n_blocks, k), dtype=np.int64)
    for block in range(n_blocks):
        ways = score[:, None] + best[block]
        entry_of[block] = ways.argmax(axis=0)
        score = ways.max(axis=0)

    exits = np.empty(n_blocks, dtype=np.int64)
    state = int(score.argmax())
    for block in range(n_blocks - 1, -1, -1):
        exits[block] = state
        state = int(entry_of[block, state])
    classes = np.empty(n_blocks * n_steps + 1, dtype=np.int64)
    classes[0] = state
    entries = np.concatenate(([state], exits[:-1])) if n_blocks else np.zeros(0, dtype=np.int64)
    blocks = np.arange(n_blocks)
    now = exits
    for step in range(n_steps - 1, -1, -1):
        classes[1 + blocks * n_steps + step] = now
        now = came_from[step, blocks, entries, now]
    return classes[:n_ticks]


def runs_of(classes: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First tick and class of each run of equal classes, in order."""
    starts = np.flatnonzero(np.diff(classes, prepend=classes[:1] - 1))
    return starts, classes[starts]


def without_short_runs(
    classes: NDArray[np.int64], log_probability: Array | None, min_ticks: int
) -> NDArray[np.int64]:
    """The same course without runs shorter than ``min_ticks``.

    The shortest run goes first; it joins the neighbour whose class its ticks speak for more (with no
    evidence, the longer neighbour), and equal neighbours become one. A single run stays, however short.
    """
    starts, values = runs_of(classes)
    bounds = [*starts.tolist(), len(classes)]
    labels = values.tolist()
    while len(labels) > 1:
        lengths = np.diff(bounds)
        shortest = int(lengths.argmin())
        if lengths[shortest] >= min_ticks:
            break
        first, last = bounds[shortest], bounds[shortest + 1]
        sides = [side for side in (shortest - 1, shortest + 1) if 0 <= side < len(labels)]
        if log_probability is None:
            worth = [float(lengths[side]) for side in sides]
        else:
            worth = [float(log_probability[first:last, labels[side]].sum()) for side in sides]
        labels[shortest] = labels[sides[int(np.argmax(worth))]]
        joined = [0, *(i for i in range(1, len(labels)) if labels[i] != labels[i - 1])]
        bounds = [*(bounds[i] for i in joined), len(classes)]
        labels = [labels[i] for i in joined]
    return np.repeat(np.asarray(labels, dtype=classes.dtype), np.diff(bounds))
