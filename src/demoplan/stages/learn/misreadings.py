"""How often readings are wrong, and what was so instead: a hidden Markov model of every atom's course.

An atom holds or not; an activity may begin or end it, with a rate that belongs to the kind of step (which
predicate, which activity, what the arguments are to it); each reading may be wrong, with rates of its
predicate. All rates are estimated from the readings. What tells noise from change is that change is of a
kind: a hand that reaches for a cube becomes able to grasp it nearly always, while a misreading comes at any
step alike.

Source: L. E. Baum et al., "A maximization technique occurring in the statistical analysis of probabilistic
functions of Markov chains", Annals of Mathematical Statistics 41(1), 1970, doi:10.1214/aoms/1177697196, with
Beta priors on every rate.
"""

from dataclasses import dataclass, replace

import numpy as np

from demoplan.stages.learn.courses import Courses, Floats
from demoplan.stages.learn.encode import Ints

_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class MendParams:
    """What can be chosen about mending; how noisy the readings are is estimated."""

    rate_least: float = 1e-3
    """No reading is taken to be surer than this."""
    rate_most: float = 0.4
    needed_rate: float = 0.004
    """Readings are left as they are where the estimated rate of wrong ones is below this."""
    n_rate_prior: float = 200.0
    """Readings' worth of belief that a predicate is misread as often as all are."""
    change_mean: float = 0.02
    """Prior mean of the rate at which a step of some kind begins or ends an atom."""
    n_change_prior: float = 2.0
    """Steps' worth of that belief."""
    usual_change: float = 0.3
    """Rate of read changes from which estimation starts by believing in them."""
    sure: float = 0.9
    """An atom that is neither true nor false with this probability counts as unobserved for literals; what a
    hand holds and what an object rests on is read from what is likelier."""
    n_rounds: int = 12
    """Rounds of estimation."""
    n_exclusion_rounds: int = 3
    """Rounds of telling the members of a group that only one of them holds."""
    max_sample_steps: int = 400_000
    """Steps of courses that rates are estimated from: bounds time and memory."""
    steps_per_chunk: int = 1_000_000
    """Steps of courses that each thread mends at once: bounds memory, and changes no result."""
    n_threads: int = 2
    """Threads that mend; their number changes no result."""
    exclusion_log_odds: float = 4.0
    """Natural logarithm of the Bayes factor from which a group of atoms is taken to exclude each other: some
    hundred groups are looked at."""
    max_broken: float = 0.06
    """Share of states that may break a group nevertheless."""


@dataclass(frozen=True)
class Rates:
    """Estimated rates; shapes (predicates,) and (kinds,)."""

    missed: Floats
    """Probability that a true atom is read as false."""
    imagined: Floats
    """Probability that a false atom is read as true."""
    at_first: Floats
    """Probability that an atom holds at the first tick."""
    kinds: Ints
    """Kinds of steps, sorted; one more rate than kinds, the last for a kind that was never met."""
    begins: Floats
    ends: Floats

    @property
    def overall(self) -> float:
        """Typical rate of wrong readings."""
        return float(np.median(np.r_[self.missed, self.imagined])) if len(self.missed) else 0.0

    def step(self, kind: Ints) -> tuple[Floats, Floats]:
        """Rates at which steps of these kinds begin and end an atom; none beyond the end."""
        place = np.searchsorted(self.kinds, kind)
        place = np.where(np.isin(kind, self.kinds), np.minimum(place, max(len(self.kinds) - 1, 0)), -1)
        inside = kind >= 0
        return np.where(inside, self.begins[place], 0.0), np.where(inside, self.ends[place], 0.0)


@dataclass(frozen=True)
class Smoothed:
    """What is believed of courses; shapes (c, t + 1) and (c, t)."""

    log_odds: Floats
    """Of holding, at each time."""
    began: Floats
    """Probability that it did not hold and then did."""
    ended: Floats
    was_true: Floats
    """Probability that it held before the step."""

    @property
    def probability(self) -> Floats:
        """Of holding, at each time."""
        return np.asarray(1 / (1 + np.exp(-np.clip(self.log_odds, -500, 500))))


def read_log_odds(courses: Courses, rates: Rates) -> Floats:
    """What the readings alone say at each time, shape (c, t + 1)."""
    missed, imagined = rates.missed[courses.predicate], rates.imagined[courses.predicate]
    log_ratio = courses.n_true * np.log((1 - missed) / imagined)[:, None]
    log_ratio += courses.n_false * np.log(missed / (1 - imagined))[:, None]
    return np.asarray(log_ratio)


def smooth(
    log_ratio: Floats, start: Floats, steps: tuple[Floats, Floats], *, is_counted: bool = True
) -> Smoothed:
    """Forward and backward along every course at once.

    Args:
        log_ratio: Log odds of holding that readings and others tell at each time, shape (c, t + 1).
        start: Probability of holding at the first tick, before anything is read; shape (c,).
        steps: Rates at which each step begins and ends an atom; shapes (c, t).
        is_counted: Whether to say also how likely each step changed something; they are empty otherwise.
    """
    ratio = np.exp(np.clip(log_ratio, -60, 60))
    begins, ends = steps
    n_times = ratio.shape[1]
    held = np.empty_like(ratio)
    held[:, 0] = start * ratio[:, 0] / (start * ratio[:, 0] + 1 - start)
    for time in range(1, n_times):
        before = held[:, time - 1]
        now = before * (1 - ends[:, time - 1]) + (1 - before) * begins[:, time - 1]
        held[:, time] = now * ratio[:, time] / (now * ratio[:, time] + 1 - now)
    held = np.clip(held, _TINY, 1 - _TINY)
    future = np.ones(len(ratio))
    log_odds = np.log(held / (1 - held))
    n_counted = n_times - 1 if is_counted else 0
    began, ended, was_true = (np.empty((len(ratio), n_counted), order="F") for _ in range(3))
    for time in range(n_times - 1, 0, -1):
        ahead = ratio[:, time] * future
        begin, end, before = begins[:, time - 1], ends[:, time - 1], held[:, time - 1]
        if is_counted:
            stays, leaves = before * (1 - end) * ahead, before * end
            enters, without = (1 - before) * begin * ahead, (1 - before) * (1 - begin)
            total = stays + leaves + enters + without
            began[:, time - 1], ended[:, time - 1] = enters / total, leaves / total
            was_true[:, time - 1] = (stays + leaves) / total
        future = ((1 - end) * ahead + end) / (begin * ahead + 1 - begin)
        future = np.clip(future, _TINY, 1 / _TINY)
        log_odds[:, time - 1] += np.log(future)
    return Smoothed(log_odds, began, ended, was_true)


def smooth_readings(courses: Courses, rates: Rates) -> Smoothed:
    """Courses smoothed by what was read of each of them alone."""
    start = rates.at_first[courses.predicate]
    return smooth(read_log_odds(courses, rates), start, rates.step(courses.kind))


def estimate(courses: Courses, n_predicates: int, params: MendParams) -> Rates:
    """Rates of misreading and of change, by expectation and maximisation from a robust start."""
    rates = _start(courses, n_predicates, params)
    place = np.searchsorted(rates.kinds, courses.kind)
    inside = courses.kind >= 0
    for _ in range(params.n_rounds):
        rates = _maximised(courses, smooth_readings(courses, rates), rates, place, inside, params)
    return rates


def _start(courses: Courses, n_predicates: int, params: MendParams) -> Rates:
    """Rates to start from: misreadings as they look at most kinds of steps, changes where they are usual."""
    kinds = np.unique(courses.kind[courses.kind >= 0])
    read = np.where(courses.n_true + courses.n_false > 0, courses.n_true > courses.n_false, False)
    is_read = (courses.n_true + courses.n_false) > 0
    before, middle, after = read[:, :-2], read[:, 1:-1], read[:, 2:]
    whole = is_read[:, :-2] & is_read[:, 1:-1] & is_read[:, 2:]
    share = []
    for value in (True, False):
        # A reading between two that say the opposite: a misreading, unless its kind of step changes things.
        around = whole & (before == value) & (after == value)
        place = np.searchsorted(kinds, courses.kind[:, :-1])
        n_all = np.bincount(place[around], minlength=len(kinds))
        n_odd = np.bincount(place[around & (middle != value)], minlength=len(kinds))
        share.append(_typical(n_odd, n_all))
    missed, imagined = (float(np.clip(each, params.rate_least, params.rate_most)) for each in share)
    pair = is_read[:, :-1] & is_read[:, 1:] & (courses.kind >= 0)
    place = np.searchsorted(kinds, courses.kind)
    rates_of: list[Floats] = []
    for value, wrong in ((False, imagined), (True, missed)):
        from_value = pair & (read[:, :-1] == value)
        n_from = np.bincount(place[from_value], minlength=len(kinds)).astype(np.float64)
        n_changed = np.bincount(place[from_value & (read[:, 1:] != value)], minlength=len(kinds))
        # Those that were read so by mistake would seem to change back at once.
        n_not = np.bincount(place[pair & (read[:, :-1] != value)], minlength=len(kinds))
        other = missed if value is False else imagined
        by_mistake = 2 * other * (n_not + n_from) + 1
        changed = n_changed / np.maximum(n_from, 1)
        is_usual = (changed > max(params.usual_change, 2 * wrong)) & (n_from > by_mistake)
        rates_of.append(np.where(is_usual, changed, params.change_mean))
    first = np.bincount(courses.predicate[read[:, 0]], minlength=n_predicates)
    n_first = np.bincount(courses.predicate[is_read[:, 0]], minlength=n_predicates)
    return Rates(
        missed=np.full(n_predicates, missed),
        imagined=np.full(n_predicates, imagined),
        at_first=np.clip((first + 0.5) / (n_first + 1.0), 0.01, 0.99),
        kinds=kinds,
        begins=np.r_[rates_of[0], params.change_mean].clip(1e-3, 0.98),
        ends=np.r_[rates_of[1], params.change_mean].clip(1e-3, 0.98),
    )


def _typical(n_odd: Ints, n_all: Ints) -> float:
    """The median over kinds of the share of odd readings, each kind weighted by its readings."""
    known = n_all > 0
    if not known.any():
        return 0.0
    share, weight = n_odd[known] / n_all[known], n_all[known]
    order = np.argsort(share, kind="stable")
    half = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2)
    return float(share[order][min(half, len(order) - 1)])


def _maximised(
    courses: Courses, found: Smoothed, rates: Rates, place: Ints, inside: np.ndarray, params: MendParams
) -> Rates:
    n_predicates, n_kinds = len(rates.missed), len(rates.kinds)
    true = found.probability
    wrong = {"missed": (true, courses.n_false), "imagined": (1 - true, courses.n_true)}
    updated = {}
    for name, (belief, n_wrong) in wrong.items():
        n_bad = np.bincount(courses.predicate, (belief * n_wrong).sum(axis=1), n_predicates)
        n_all = np.bincount(
            courses.predicate, (belief * (courses.n_true + courses.n_false)).sum(axis=1), n_predicates
        )
        overall = n_bad.sum() / max(n_all.sum(), 1.0)
        rate = (n_bad + overall * params.n_rate_prior) / (n_all + params.n_rate_prior)
        updated[name] = np.clip(rate, params.rate_least, params.rate_most)
    steps, k = place[inside], n_kinds

    def change(n_changed: Floats, n_from: Floats) -> Floats:
        changed = np.bincount(steps, n_changed[inside], k)
        of = np.bincount(steps, n_from[inside], k)
        prior = params.n_change_prior
        return np.asarray(((changed + prior * params.change_mean) / (of + prior)).clip(1e-4, 0.995))

    first = np.bincount(courses.predicate, true[:, 0], n_predicates)
    n_first = np.bincount(courses.predicate, minlength=n_predicates)
    return replace(
        rates,
        missed=updated["missed"],
        imagined=updated["imagined"],
        at_first=((first + 0.5) / (n_first + 1.0)).clip(1e-3, 0.999),
        begins=np.r_[change(found.began, 1 - found.was_true), params.change_mean],
        ends=np.r_[change(found.ended, found.was_true), params.change_mean],
    )
