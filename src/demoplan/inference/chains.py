"""Every ground atom's course over time, given what is believed of the actions: messages both ways.

A timeline is a two-state hidden Markov chain over its segments; each touch is a step. Messages are kept as
odds of true against false; one step of arithmetic takes all timelines from one rank of touches to the next.

Source: Rabiner, A Tutorial on Hidden Markov Models and Selected Applications in Speech Recognition, Proc.
IEEE 77(2), 1989, section III, doi:10.1109/5.18626.
"""

from dataclasses import dataclass

import numpy as np

from demoplan.inference.roles import Floats
from demoplan.inference.timelines import Timelines

_MOST = float(np.log(1e26))
"""Logarithm at which odds of evidence are cut off; 26 decades decide any belief."""


@dataclass(frozen=True)
class FlipRates:
    """Per predicate: how often a true atom was not seen, and a false atom was seen."""

    missed: Floats
    imagined: Floats


@dataclass(frozen=True, eq=False)
class Evidence:
    """Odds that segments are true, by what was seen in them."""

    before: Floats
    """``(n_timelines,)``"""
    after: Floats
    """``(n_touches,)``"""


@dataclass(frozen=True, eq=False)
class Steps:
    """What each touch does to its atom, by the atom's value before. All ``(n_touches,)``."""

    fit: Floats
    """Odds of true against false before, by the conditions of what happened."""
    true_if_false: Floats
    """Probability of true after, if false before."""
    true_if_true: Floats


@dataclass(frozen=True, eq=False)
class Messages:
    """What each touch is told by its past and by its future, and segments' probabilities of being true."""

    forward: Floats
    """``(n_touches,)``: odds of true before the touch, by all that was seen up to it."""
    backward: Floats
    """``(n_touches,)``: odds of true after the touch, by all that was seen afterwards."""
    true_before: Floats
    """``(n_timelines,)``: probability that the atom held before its first touch."""
    true_after: Floats
    """``(n_touches,)``: probability that the atom held after the touch."""

    def true_at(self, timelines: Timelines) -> Floats:
        """``(n_touches,)``: probability that the atom held before the touch."""
        n_first = len(self.true_before)
        earlier = self.true_after[timelines.touch_before[n_first:]]
        return np.concatenate([self.true_before, earlier])


def evidence(timelines: Timelines, rates: FlipRates) -> Evidence:
    """Odds of segments by what was seen in each."""
    for_seen = np.log(1 - rates.missed) - np.log(rates.imagined)
    for_unseen = np.log(rates.missed) - np.log(1 - rates.imagined)

    def odds(predicate: np.ndarray, seen: Floats, unseen: Floats) -> Floats:
        log = seen * for_seen[predicate] + unseen * for_unseen[predicate]
        return np.asarray(np.exp(np.clip(log, -_MOST, _MOST)))

    return Evidence(
        before=odds(timelines.timeline_predicate, timelines.before_true, timelines.before_false),
        after=odds(timelines.touch_predicate, timelines.after_true, timelines.after_false),
    )


def smooth(timelines: Timelines, seen: Evidence, steps: Steps) -> Messages:
    """Messages along all timelines."""
    n_touches, bounds = len(steps.fit), timelines.bounds
    forward, backward = np.empty(n_touches), np.empty(n_touches)
    first = slice(0, bounds[1] if len(bounds) > 1 else 0)
    false_if_false, false_if_true = 1 - steps.true_if_false, 1 - steps.true_if_true
    forward[first] = seen.before
    for rank, n in enumerate(timelines.n_by_rank[1:], start=1):
        past, now = slice(bounds[rank - 1], bounds[rank - 1] + n), slice(bounds[rank], bounds[rank + 1])
        odds = forward[past] * steps.fit[past]
        true = steps.true_if_false[past] + steps.true_if_true[past] * odds
        false = false_if_false[past] + false_if_true[past] * odds
        forward[now] = true / false * seen.after[past]
    np.copyto(backward, seen.after)
    for rank in range(len(timelines.n_by_rank) - 1, 0, -1):
        now, n = slice(bounds[rank], bounds[rank + 1]), timelines.n_by_rank[rank]
        past = slice(bounds[rank - 1], bounds[rank - 1] + n)
        odds = backward[now]
        if_true = false_if_true[now] + steps.true_if_true[now] * odds
        if_false = false_if_false[now] + steps.true_if_false[now] * odds
        backward[past] *= steps.fit[now] * if_true / if_false
    odds = forward * steps.fit
    true = (steps.true_if_false + steps.true_if_true * odds) * backward
    false = false_if_false + false_if_true * odds
    odds = odds[first] * (false_if_true[first] + steps.true_if_true[first] * backward[first])
    start = false_if_false[first] + steps.true_if_false[first] * backward[first]
    return Messages(forward, backward, odds / (odds + start), true / (true + false))


def estimate_flips(
    timelines: Timelines, messages: Messages, n_predicates: int, n_prior: float
) -> tuple[FlipRates, float]:
    """Expected flips over expected values, per predicate, drawn to the rate of all; and that rate."""
    totals = np.zeros((4, n_predicates))
    n_alike = timelines.n_alike
    for predicate, seen, unseen, is_true, weight in (
        (
            timelines.timeline_predicate,
            timelines.before_true,
            timelines.before_false,
            messages.true_before,
            n_alike,
        ),
        (
            timelines.touch_predicate,
            timelines.after_true,
            timelines.after_false,
            messages.true_after,
            None if n_alike is None else n_alike[timelines.touch_timeline],
        ),
    ):
        true, false = (is_true, 1 - is_true) if weight is None else (is_true * weight, (1 - is_true) * weight)
        both = seen + unseen
        for row, amount in enumerate((unseen * true, both * true, seen * false, both * false)):
            totals[row] += np.bincount(predicate, amount, n_predicates)
    missed, true, imagined, false = totals
    # Half a flip in fifty observations: without data the rate is one in a hundred.
    overall = float((missed.sum() + imagined.sum() + 0.5) / (true.sum() + false.sum() + 50))
    rates = FlipRates(
        missed=(missed + n_prior * overall) / (true + n_prior),
        imagined=(imagined + n_prior * overall) / (false + n_prior),
    )
    return rates, overall
