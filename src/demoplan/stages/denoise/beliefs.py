"""What each literal is to its action: beliefs, by messages between literals and the courses of atoms.

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

from demoplan.stages.denoise.chains import (
    FlipRates,
    Floats,
    Messages,
    estimate_flips,
    evidence,
    smooth,
)
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.touches import Candidate, Touches

KEEP, ADD, DELETE = 0, 1, 2
"""What an action does to an atom."""

_TINY = 1e-30


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """The hypotheses in columns; roles group those that differ in chance only."""

    role: NDArray[np.int64]
    condition: NDArray[np.int64]
    """Per role: 1 true before, -1 false before, 0 neither."""
    effect: NDArray[np.int64]
    """Per role: ``KEEP``, ``ADD`` or ``DELETE``."""
    chance: Floats
    """Probability that the atom is true before."""
    log_share: Floats
    """Logarithm of the part of its role's weight."""
    weight: Floats
    """Per role, adding up to 1."""

    @classmethod
    def of(cls, params: DenoiseParams) -> "Hypotheses":
        """Hypotheses under the parameters' weights."""
        chances = np.array(params.chances)
        flat = np.full(len(chances), 1 / len(chances))
        # What is added mostly was false before, what is deleted mostly true, or nobody would do it.
        rising = (1 - chances) ** 2 / ((1 - chances) ** 2).sum()
        falling = chances**2 / (chances**2).sum()
        certain, never = np.array([1 - params.slip]), np.array([params.slip])
        one = np.ones(1)
        roles = [
            (1, KEEP, params.weight_required, certain, one),
            (1, DELETE, params.weight_consumed, certain, one),
            (-1, KEEP, params.weight_forbidden, never, one),
            (-1, ADD, params.weight_produced, never, one),
            (0, KEEP, params.weight_unrelated, chances, flat),
            (0, ADD, params.weight_added, chances, rising),
            (0, DELETE, params.weight_deleted, chances, falling),
        ]
        weight = np.array([role[2] for role in roles])
        return cls(
            role=np.repeat(np.arange(len(roles)), [len(role[3]) for role in roles]),
            condition=np.array([role[0] for role in roles]),
            effect=np.array([role[1] for role in roles]),
            chance=np.concatenate([role[3] for role in roles]),
            log_share=np.log(np.concatenate([role[4] for role in roles])),
            weight=weight / weight.sum(),
        )


@dataclass(frozen=True, eq=False)
class Beliefs:
    """Where message passing came to rest."""

    roles: Floats
    """``(n_candidates, n_roles)``: probability of each role."""
    hypotheses: Hypotheses
    rates: FlipRates
    flip_rate: float
    """Over all predicates."""
    messages: Messages
    n_rounds: int
    is_settled: bool


@dataclass(frozen=True, eq=False)
class _Effects:
    """What several independent literals do to one atom, by its value before (columns false, true)."""

    log_fit: Floats
    """Logarithm of how well the value before suits their conditions."""
    log_not_added: Floats
    log_kept: Floats

    def __sub__(self, other: "_Effects") -> "_Effects":
        return _Effects(
            self.log_fit - other.log_fit,
            self.log_not_added - other.log_not_added,
            self.log_kept - other.log_kept,
        )

    def at(self, index: NDArray[np.int64]) -> "_Effects":
        return _Effects(self.log_fit[index], self.log_not_added[index], self.log_kept[index])

    def summed(self, starts: NDArray[np.int64]) -> "_Effects":
        return _Effects(
            np.add.reduceat(self.log_fit, starts, axis=0),
            np.add.reduceat(self.log_not_added, starts, axis=0),
            np.add.reduceat(self.log_kept, starts, axis=0),
        )

    def parts(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Scaled fit, and probabilities of adding, keeping and deleting. What is added wins, as in PDDL."""
        fit = np.exp(self.log_fit - self.log_fit.max(axis=1, keepdims=True))
        not_added, kept = np.exp(self.log_not_added), np.exp(self.log_kept)
        return fit, 1 - not_added, kept, np.maximum(not_added - kept, 0)


def believe(
    touches: Touches, over: tuple[Candidate, ...], n_predicates: int, params: DenoiseParams
) -> Beliefs:
    """Beliefs about all candidates.

    Candidates without touches keep their prior.
    """
    hypotheses = Hypotheses.of(params)
    n_candidates, n_entries = len(over), len(touches.entry_touch)
    predicate = np.array([each.predicate for each in over], dtype=np.int64)
    starts = np.flatnonzero(np.diff(touches.entry_touch, prepend=-1))
    by_candidate = np.argsort(touches.entry_candidate, kind="stable")
    seen = np.bincount(touches.entry_candidate, minlength=n_candidates)
    seen_index = np.flatnonzero(seen)
    candidate_starts = (np.cumsum(seen) - seen)[seen_index]
    start = np.full(n_predicates, params.flip_start)
    rates, overall = FlipRates(start, start), params.flip_start
    log_prior = np.log(hypotheses.weight)[hypotheses.role] + hypotheses.log_share
    log_belief = np.tile(log_prior, (n_candidates, 1))
    told = np.zeros((n_entries, len(hypotheses.role)))
    roles = _roles(log_belief, hypotheses)
    messages, n_rounds, is_settled = None, 0, n_entries == 0
    while messages is None or not (is_settled or n_rounds >= params.n_rounds_max):
        each = _each(log_belief[touches.entry_candidate] - told, hypotheses)
        together = each.summed(starts)
        messages = smooth(touches, evidence(touches, rates), _steps(together, params.slip))
        new = _tell(together.at(touches.entry_touch) - each, messages, touches, hypotheses, params.slip)
        told = new if n_rounds == 0 else (1 - params.damping) * new + params.damping * told
        log_belief = np.tile(log_prior, (n_candidates, 1))
        if n_rounds > 1:
            weights = _weights(roles, predicate, seen > 0, n_predicates, hypotheses, params.n_prior_literals)
            log_belief = np.log(weights)[predicate][:, hypotheses.role] + hypotheses.log_share
        log_belief[seen_index] += np.add.reduceat(told[by_candidate], candidate_starts, axis=0)
        before, roles = roles, _roles(log_belief, hypotheses)
        rates, overall = estimate_flips(touches, messages, n_predicates, params.n_flip_prior)
        rates = FlipRates(
            np.clip(rates.missed, params.flip_min, params.flip_max),
            np.clip(rates.imagined, params.flip_min, params.flip_max),
        )
        n_rounds += 1
        is_settled = n_rounds > 4 and bool(np.abs(roles - before).max() < params.tolerance)
    return Beliefs(roles, hypotheses, rates, overall, messages, n_rounds, is_settled)


def _roles(log_belief: Floats, hypotheses: Hypotheses) -> Floats:
    """Probabilities of roles."""
    belief = np.exp(log_belief - log_belief.max(axis=1, keepdims=True))
    bounds = np.flatnonzero(np.diff(hypotheses.role, prepend=-1))
    roles = np.add.reduceat(belief, bounds, axis=1)
    return np.asarray(roles / roles.sum(axis=1, keepdims=True))


def _weights(
    roles: Floats,
    predicate: NDArray[np.int64],
    is_seen: NDArray[np.bool_],
    n_predicates: int,
    hypotheses: Hypotheses,
    n_prior: float,
) -> Floats:
    """Prior of each role, per predicate: what its literals turned out to be, drawn to the weights."""
    found = np.zeros((n_predicates, roles.shape[1]))
    np.add.at(found, predicate[is_seen], roles[is_seen])
    total = found.sum(axis=1, keepdims=True) + n_prior
    return np.asarray((found + n_prior * hypotheses.weight) / total)


def _each(log_belief: Floats, hypotheses: Hypotheses) -> _Effects:
    """What each entry's literal does to its atom, as believed without the entry itself."""
    belief = np.exp(log_belief - log_belief.max(axis=1, keepdims=True))
    effect = hypotheses.effect[hypotheses.role]
    is_effect = np.stack([effect == KEEP, effect == ADD, effect == DELETE], axis=1).astype(np.float64)
    true = belief @ (is_effect * hypotheses.chance[:, None])
    false = belief @ (is_effect * (1 - hypotheses.chance)[:, None])
    by_value = np.stack([false, true], axis=1)  # entries × value before × effect
    fit = by_value.sum(axis=2)
    norm = fit.sum(axis=1, keepdims=True)

    def log(part: Floats) -> Floats:
        return np.asarray(np.log(np.maximum(part / fit, 1e-12)))

    return _Effects(
        np.log(np.maximum(fit / norm, 1e-12)),
        log(by_value[:, :, KEEP] + by_value[:, :, DELETE]),
        log(by_value[:, :, KEEP]),
    )


def _steps(together: _Effects, slip: float) -> Floats:
    """Weights of values before and after each touch."""
    fit, added, kept, deleted = together.parts()
    steps = np.empty((len(fit), 2, 2))
    for before in (0, 1):
        true = added[:, before] + (kept[:, before] if before else 0)
        false = deleted[:, before] + (0 if before else kept[:, before])
        steps[:, before, 1] = fit[:, before] * (true * (1 - slip) + false * slip)
        steps[:, before, 0] = fit[:, before] * (false * (1 - slip) + true * slip)
    return steps


def _tell(
    others: _Effects, messages: Messages, touches: Touches, hypotheses: Hypotheses, slip: float
) -> Floats:
    """Log-likelihood of every hypothesis at every entry, the best one's being 0."""
    fit, added, kept, deleted = others.parts()
    past = messages.forward[touches.entry_touch] * fit
    future = messages.backward[touches.entry_touch]
    future = future * (1 - slip) + future[:, ::-1] * slip
    false_after, true_after = future[:, 0], future[:, 1]
    by_effect = np.empty((len(past), 3, 2))  # entries × effect × value before
    for before in (0, 1):
        same = true_after if before else false_after
        by_effect[:, KEEP, before] = (
            added[:, before] * true_after + kept[:, before] * same + deleted[:, before] * false_after
        )
        by_effect[:, ADD, before] = true_after
        by_effect[:, DELETE, before] = added[:, before] * true_after + (1 - added[:, before]) * false_after
    by_effect *= past[:, None, :]
    effect = hypotheses.effect[hypotheses.role]
    fits = by_effect[:, effect, 1] * hypotheses.chance + by_effect[:, effect, 0] * (1 - hypotheses.chance)
    fits /= fits.max(axis=1, keepdims=True)
    return np.asarray(np.log(np.maximum(fits, _TINY)))
