"""Every ground atom's course over time, given what is believed of the actions: forward and backward messages.

A timeline is a two-state hidden Markov chain over its segments; each touch is a step. Sums run over all
timelines at once, one step per rank of touch.

Source: Rabiner, A Tutorial on Hidden Markov Models and Selected Applications in Speech Recognition, Proc.
IEEE 77(2), 1989, section III, doi:10.1109/5.18626.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.stages.denoise.touches import Touches

Floats = NDArray[np.float64]

_LEAST = 1e-26
"""Likelihood ratios are cut off here; 26 decades decide any belief."""


@dataclass(frozen=True)
class FlipRates:
    """Per predicate: how often a true atom was not seen, and a false atom was seen."""

    missed: Floats
    imagined: Floats


@dataclass(frozen=True, eq=False)
class Evidence:
    """Likelihoods of segments, false and true, scaled so that the larger is 1: ``(n, 2)``."""

    before: Floats
    after: Floats


@dataclass(frozen=True, eq=False)
class Messages:
    """What each touch is told by its past and by its future, and segments' probabilities of being true."""

    forward: Floats
    """``(n_touches, 2)``: likelihood of all seen up to the touch, given the atom false or true before."""
    backward: Floats
    """``(n_touches, 2)``: likelihood of all seen afterwards, given the atom false or true after."""
    true_before: Floats
    """``(n_timelines,)``: probability that the atom held before its first touch."""
    true_after: Floats
    """``(n_touches,)``: probability that the atom held after the touch."""


def evidence(touches: Touches, rates: FlipRates) -> Evidence:
    """Likelihoods of what was seen in each segment."""
    log = np.log(np.stack([1 - rates.imagined, rates.missed, rates.imagined, 1 - rates.missed]))

    def likelihood(predicate: NDArray[np.int64], seen: Floats, unseen: Floats) -> Floats:
        false = unseen * log[0, predicate] + seen * log[2, predicate]
        true = unseen * log[1, predicate] + seen * log[3, predicate]
        both = np.stack([false, true], axis=1)
        return np.asarray(np.maximum(np.exp(both - both.max(axis=1, keepdims=True)), _LEAST))

    return Evidence(
        before=likelihood(touches.timeline_predicate, touches.before_true, touches.before_false),
        after=likelihood(
            touches.timeline_predicate[touches.touch_timeline], touches.after_true, touches.after_false
        ),
    )


def smooth(touches: Touches, seen: Evidence, steps: Floats) -> Messages:
    """Messages along all timelines.

    Args:
        touches: Touches, sorted along timelines.
        seen: Likelihoods of segments.
        steps: ``(n_touches, 2, 2)``: weight of the atom's value before (first) and after (second) each touch.
    """
    n = len(steps)
    forward, backward = np.empty((n, 2)), np.empty((n, 2))
    into = steps.transpose(0, 2, 1)
    first = touches.ranks[0] if touches.ranks else np.zeros(0, dtype=np.int64)
    forward[first] = _scaled(seen.before)
    for touch in touches.ranks[1:]:
        past = touch - 1
        forward[touch] = _scaled(_times(into[past], forward[past]) * seen.after[past])
    is_last = np.ones(n, dtype=np.bool_)
    is_last[:-1] = touches.touch_timeline[1:] != touches.touch_timeline[:-1]
    backward[is_last] = _scaled(seen.after[is_last])
    for touch in reversed(touches.ranks[1:]):
        past = touch - 1
        backward[past] = _scaled(_times(steps[touch], backward[touch]) * seen.after[past])
    after = _times(into, forward) * backward
    before = forward[first] * _times(steps[first], backward[first])
    return Messages(forward, backward, _scaled(before)[:, 1], _scaled(after)[:, 1])


def _times(matrices: Floats, vectors: Floats) -> Floats:
    """Matrix times vector, row by row; written out, as two by two is too small for the general routine."""
    return matrices[:, :, 0] * vectors[:, 0, None] + matrices[:, :, 1] * vectors[:, 1, None]


def _scaled(weights: Floats) -> Floats:
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def estimate_flips(
    touches: Touches, messages: Messages, n_predicates: int, n_prior: float
) -> tuple[FlipRates, float]:
    """Expected flips over expected values, per predicate, drawn to the rate of all; and that rate."""
    totals = np.zeros((4, n_predicates))
    for predicate, seen, unseen, is_true in (
        (touches.timeline_predicate, touches.before_true, touches.before_false, messages.true_before),
        (
            touches.timeline_predicate[touches.touch_timeline],
            touches.after_true,
            touches.after_false,
            messages.true_after,
        ),
    ):
        for row, weight in enumerate(
            (
                unseen * is_true,
                (seen + unseen) * is_true,
                seen * (1 - is_true),
                (seen + unseen) * (1 - is_true),
            )
        ):
            totals[row] += np.bincount(predicate, weight, n_predicates)
    missed, true, imagined, false = totals
    # Half a flip in fifty observations: without data the rate is one in a hundred.
    overall = float((missed.sum() + imagined.sum() + 0.5) / (true.sum() + false.sum() + 50))
    rates = FlipRates(
        missed=(missed + n_prior * overall) / (true + n_prior),
        imagined=(imagined + n_prior * overall) / (false + n_prior),
    )
    return rates, overall
