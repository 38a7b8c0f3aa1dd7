"""What each literal is to its action: messages between literals and the courses of atoms, until they agree.

A hypothesis says whether the literal is a condition (true, false or neither before) and what the action does
to it (nothing, add, delete); for neither, also how often it happens to hold. Each touch tells its literals
how well each hypothesis fits what came before and after, given what is believed of everything else; each
literal adds up what its touches say. This is belief propagation on a graph whose loops are the literals that
several touches share; damping settles it.

Source: Kschischang, Frey, Loeliger, Factor Graphs and the Sum-Product Algorithm, IEEE Trans. Information
Theory 47(2), 2001, doi:10.1109/18.910572.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.inference.chains import FlipRates, Messages, Steps, estimate_flips, evidence, smooth
from demoplan.inference.roles import ADD, DELETE, KEEP, BeliefParams, Floats, Ints, Roles
from demoplan.inference.timelines import Timelines

_TINY = 1e-30
_LEAST = 1e-12
"""Smallest part that is told apart from none."""


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Where message passing came to rest."""

    probabilities: Floats
    """``(n_literals, n_roles)``: probability of each role."""
    roles: Roles
    rates: FlipRates
    flip_rate: float
    """Over all predicates."""
    messages: Messages
    n_rounds: int
    is_settled: bool
    """Whether beliefs came to rest within the rounds allowed."""

    @property
    def required(self) -> Floats:
        """``(n_literals,)``: probability that it is a condition."""
        return np.asarray(self.probabilities[:, self.roles.condition == 1].sum(axis=1))

    @property
    def avoided(self) -> Floats:
        """``(n_literals,)``: probability that it is always false before."""
        return np.asarray(self.probabilities[:, self.roles.condition == -1].sum(axis=1))

    @property
    def effects(self) -> Floats:
        """``(n_literals, 3)``: probabilities that it is kept, added, deleted."""
        columns = [self.probabilities[:, self.roles.effect == each] for each in (KEEP, ADD, DELETE)]
        return np.stack([column.sum(axis=1) for column in columns], axis=1)


def believe(timelines: Timelines, predicate: Ints, n_predicates: int, params: BeliefParams) -> Beliefs:
    """Beliefs about all literals, and how often observations are wrong.

    Args:
        timelines: What was observed.
        predicate: ``(n_literals,)``: predicate of each literal.
        n_predicates: How many predicates there are.
        params: Priors and limits.

    Returns:
        Beliefs; a literal that no timeline has an entry of keeps its prior.
    """
    roles = Roles.of(params)
    graph = _Graph(timelines, len(predicate))
    prior = _Prior(predicate, graph.is_seen, n_predicates, roles, params.n_prior_literals)
    start = np.full(n_predicates, params.flip_start)
    rates, overall = FlipRates(start, start), params.flip_start
    log_belief = prior.of(roles.weight[:, None])
    told = np.zeros((len(roles.role), len(timelines.entry_touch)))
    probabilities = _probabilities(log_belief, roles)
    messages, n_rounds, is_settled = None, 0, not len(timelines.entry_touch)
    while messages is None or not (is_settled or n_rounds >= params.n_rounds_max):
        each = _each(graph.per_entry(log_belief) - told, roles)
        together = graph.per_touch(each)
        messages = smooth(timelines, evidence(timelines, rates), _steps(together, params.slip))
        others = together[:, timelines.entry_touch] - each
        new = _tell(others, messages, timelines.entry_touch, roles, params.slip)
        if n_rounds:
            new *= 1 - params.damping
            new += params.damping * told
        told = new
        weight = prior.weights(probabilities) if n_rounds > 1 else roles.weight[:, None]
        log_belief = prior.of(weight) + graph.per_literal(told)
        before, probabilities = probabilities, _probabilities(log_belief, roles)
        rates, overall = estimate_flips(timelines, messages, n_predicates, params.n_flip_prior)
        rates = FlipRates(
            np.clip(rates.missed, params.flip_min, params.flip_max),
            np.clip(rates.imagined, params.flip_min, params.flip_max),
        )
        n_rounds += 1
        is_settled = n_rounds > 4 and bool(np.abs(probabilities - before).max(initial=0.0) < params.tolerance)
    return Beliefs(probabilities.T.copy(), roles, rates, overall, messages, n_rounds, is_settled)


class _Graph:
    """Which literals and touches belong together: sums over entries, and values repeated over entries."""

    def __init__(self, timelines: Timelines, n_literals: int) -> None:
        counts = np.bincount(timelines.entry_literal, minlength=n_literals)
        self.n_entries = counts
        self.is_seen = counts > 0
        self._seen = np.flatnonzero(counts)
        self._literal_starts = (np.cumsum(counts) - counts)[self._seen]
        self._by_touch = np.argsort(timelines.entry_touch, kind="stable")
        self._touch_starts = np.flatnonzero(np.diff(timelines.entry_touch[self._by_touch], prepend=-1))
        self._weight = None
        if timelines.n_alike is not None:
            self._weight = timelines.n_alike[timelines.touch_timeline[timelines.entry_touch]]

    def per_entry(self, of_literals: Floats) -> Floats:
        """Each literal's column, at each of its entries."""
        return np.repeat(of_literals, self.n_entries, axis=1)

    def per_touch(self, of_entries: Floats) -> Floats:
        """Sums over the entries of each touch."""
        return np.asarray(np.add.reduceat(of_entries[:, self._by_touch], self._touch_starts, axis=1))

    def per_literal(self, of_entries: Floats) -> Floats:
        """Sums over the entries of each literal; each counts as often as its timeline stands for."""
        sums = np.zeros((len(of_entries), len(self.n_entries)))
        if len(self._seen):
            weighted = of_entries if self._weight is None else of_entries * self._weight
            sums[:, self._seen] = np.add.reduceat(weighted, self._literal_starts, axis=1)
        return sums


class _Prior:
    """What is believed of literals beforehand: they are like other literals of their predicate."""

    def __init__(
        self,
        predicate: Ints,
        is_seen: NDArray[np.bool_],
        n_predicates: int,
        roles: Roles,
        n_prior: float,
    ) -> None:
        self._roles, self._n_prior, self._predicate = roles, n_prior, predicate
        self._members = np.zeros((len(predicate), n_predicates))
        self._members[np.flatnonzero(is_seen), predicate[is_seen]] = 1

    def weights(self, probabilities: Floats) -> Floats:
        """``(n_roles, n_literals)``: weight of each role, drawn to the parameters' weights."""
        found = probabilities @ self._members + self._n_prior * self._roles.weight[:, None]
        found /= found.sum(axis=0)
        return np.asarray(found[:, self._predicate])

    def of(self, weight: Floats) -> Floats:
        """``(n_hypotheses, n_literals)``: logarithm of each hypothesis' prior."""
        log = np.log(weight)[self._roles.role] + self._roles.log_share[:, None]
        return np.broadcast_to(log, (len(log), len(self._predicate)))


def _probabilities(log_belief: Floats, roles: Roles) -> Floats:
    """Probability of each role: ``(n_roles, n_literals)``."""
    belief = np.exp(log_belief - log_belief.max(axis=0, initial=-np.inf))
    bounds = np.flatnonzero(np.diff(roles.role, prepend=-1))
    of_roles = np.add.reduceat(belief, bounds, axis=0)
    return np.asarray(of_roles / of_roles.sum(axis=0))


_FIT, _NOT_ADDED_FALSE, _NOT_ADDED_TRUE, _KEPT_TRUE = range(4)
"""Rows of what literals do to an atom, as logarithms, so that literals add up: odds of true before;
probability that it is not added, if false and if true before; that nothing is done, if true before."""


def _each(log_belief: Floats, roles: Roles) -> Floats:
    """What each entry's literal does to its atom, as believed without the entry: ``(4, n_entries)``."""
    belief = np.exp(log_belief - log_belief.max(axis=0, initial=-np.inf))
    effect = roles.effect[roles.role]
    true, false = roles.chance, 1 - roles.chance
    parts = np.stack([true, false, false * (effect != ADD), true * (effect != ADD), true * (effect == KEEP)])
    fit_true, fit_false, *rest = parts @ belief
    both = fit_true + fit_false
    each = np.empty((4, log_belief.shape[1]))
    for row, part, whole in (
        (_NOT_ADDED_FALSE, rest[0], fit_false),
        (_NOT_ADDED_TRUE, rest[1], fit_true),
        (_KEPT_TRUE, rest[2], fit_true),
    ):
        np.maximum(part / whole, _LEAST, out=each[row])
    each[_FIT] = np.maximum(fit_true / both, _LEAST) / np.maximum(fit_false / both, _LEAST)
    return np.asarray(np.log(each, out=each))


def _steps(together: Floats, slip: float) -> Steps:
    """What each touch does, now and then slipping."""
    added_false = 1 - np.exp(together[_NOT_ADDED_FALSE])
    not_deleted = 1 - _deleted(together)
    return Steps(
        fit=np.exp(together[_FIT]),
        true_if_false=added_false * (1 - 2 * slip) + slip,
        true_if_true=not_deleted * (1 - 2 * slip) + slip,
    )


def _deleted(log: Floats) -> Floats:
    """Probability that a true atom is deleted. What is added wins, as in PDDL."""
    return np.asarray(np.maximum(np.exp(log[_NOT_ADDED_TRUE]) - np.exp(log[_KEPT_TRUE]), 0))


def _tell(others: Floats, messages: Messages, touch: Ints, roles: Roles, slip: float) -> Floats:
    """Log-likelihood of hypotheses at entries, the best one's being 0: ``(n_hypotheses, n_entries)``.

    Args:
        others: What the touch's other literals do; rows as of ``_each``.
        messages: What was seen before and after.
        touch: Touch of each entry.
        roles: Hypotheses.
        slip: Probability that a transition contradicts its rules.
    """
    not_added_false, not_added_true = np.exp(others[_NOT_ADDED_FALSE]), np.exp(others[_NOT_ADDED_TRUE])
    deleted = _deleted(others)
    true_before = messages.forward[touch] * np.exp(others[_FIT])
    future = messages.backward[touch]
    true_after, false_after = future * (1 - slip) + slip, 1 - slip + future * slip
    # Values before are false or true; what the others do to the atom matters unless this literal adds it.
    unmade = (1 - not_added_false) * true_after + not_added_false * false_after
    kept = (1 - deleted) * true_after + deleted * false_after
    unadded = (1 - not_added_true) * true_after + not_added_true * false_after
    parts = np.stack(
        [unmade, true_after, kept * true_before, unadded * true_before, true_after * true_before], axis=0
    )
    effect = roles.effect[roles.role]
    true, false = roles.chance, 1 - roles.chance
    weights = np.stack(
        [
            false * (effect != ADD),
            false * (effect == ADD),
            true * (effect == KEEP),
            true * (effect == DELETE),
            true * (effect == ADD),
        ],
        axis=1,
    )
    fits = weights @ parts
    fits /= fits.max(axis=0, initial=0)
    np.maximum(fits, _TINY, out=fits)
    return np.asarray(np.log(fits, out=fits))
