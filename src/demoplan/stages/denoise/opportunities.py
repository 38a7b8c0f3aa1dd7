"""What an action could have been applied to and never was: the evidence for a negative condition.

That a literal was always false before an action mostly follows from the action's other conditions. Only where
those left it free, and it was true often enough that neither chance nor habit can have avoided it, is it
forbidden. How strong habits are is seen in the literals that were avoided at times: a walk at random meets
each literal as often as it is true; whoever pursues a goal does not.

A habit that is never broken looks like a rule, so beforehand the odds stand against rules. They stand less
against those on predicates that an action does nothing but undo: who unlocks a door to no other end shows
that something asks for open doors. Stated in vain, such a condition mostly costs a plan one step, since that
action can meet it.

Source: Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, section 5.3 (beta-binomial model).
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from demoplan.inference import Messages, Timelines
from demoplan.language.traces import TraceSet
from demoplan.language.traces.values import Codes
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.snapshots import Snapshots
from demoplan.stages.denoise.touches import Candidate, GroundCodes

_MAX_BINDINGS = 200_000
"""More ways to bind an action's parameters than these are not looked through."""


@dataclass(frozen=True)
class Occasions:
    """How often an action met a literal, and how often it was true then.

    An atom that does not change between two instances of the action is one occasion: whoever passed an open
    door twenty times met one open door.
    """

    n: int
    n_true: float
    """Expected."""

    @property
    def share(self) -> float:
        """Part of the occasions on which it was true."""
        return self.n_true / max(self.n, 1)


@dataclass(frozen=True)
class Opportunity:
    """A literal that an action's conditions leave free."""

    literal: Candidate
    met: Occasions
    share: float
    """How often it was true where the action could have been applied."""


def occasions(timelines: Timelines, messages: Messages, n_literals: int) -> tuple[Occasions, ...]:
    """Occasions of each literal."""
    timeline = timelines.touch_timeline
    is_true = np.r_[messages.true_before, messages.true_after] > 1 / 2
    n_lines = len(messages.true_before)
    is_changed = is_true[n_lines:] != is_true[timelines.touch_before + n_lines]
    # How often the atom had changed before each touch, going along all timelines by rank.
    n_changes = np.zeros(len(timeline), dtype=np.int64)
    for low, high in itertools.pairwise(timelines.bounds[1:].tolist()):
        past = timelines.touch_before[low:high]
        n_changes[low:high] = n_changes[past] + is_changed[past]
    touch, literal = timelines.entry_touch, timelines.entry_literal
    most = int(n_changes.max(initial=0)) + 1
    key = (literal * max(n_lines, 1) + timeline[touch]) * most + n_changes[touch]
    distinct, which = np.unique(key, return_inverse=True)
    held = np.bincount(which, messages.true_at(timelines)[touch], len(distinct)) / np.bincount(which)
    owner = distinct // (max(n_lines, 1) * most)
    n, n_true = np.bincount(owner, minlength=n_literals), np.bincount(owner, held, n_literals)
    return tuple(map(Occasions, n.tolist(), n_true.tolist()))


def opportunities(
    conditions: Sequence[Candidate],
    literals: Mapping[Candidate, Occasions],
    traces: TraceSet,
    seen: Snapshots,
    codes: GroundCodes,
    params: DenoiseParams,
) -> list[Opportunity]:
    """Literals of one action that its conditions leave free.

    Args:
        conditions: The action's positive conditions.
        literals: Its other literals, and how often it met them.
        traces: Where they come from.
        seen: Atoms that hold in some states, after noise is taken out.
        codes: Codes of ground atoms.
        params: How much must have been seen.
    """
    chances: _Bindings | None = _Bindings(np.arange(seen.n), {})
    for each in _ordered(conditions) if literals else []:
        chances = chances and chances.where(each, seen, codes)
    found: list[Opportunity] = []
    for each, met in literals.items():
        chosen = chances and chances.over(each, traces, seen)
        if chosen is None or len(chosen.state) < params.n_implied_min:
            continue
        code = codes.of(each.predicate, [chosen.objects[term] for term in each.terms], len(chosen.state))
        share = float(_is_in(code * seen.n + chosen.state, seen.likely).mean())
        # A literal that is true whenever the conditions hold was avoided by misreading, not by the action.
        if _LEAST_SHARE < share < 1 - _LEAST_SHARE:
            found.append(Opportunity(each, met, share))
    return found


def undone(effects: Iterable[tuple[str, Sequence[Candidate], Sequence[Candidate]]]) -> dict[int, str]:
    """Predicates that some action does nothing but undo, and the first such action.

    Of an action that undoes several it cannot be said which of them it is for.

    Args:
        effects: Of each action, its name, what it adds and what it deletes.
    """
    found: dict[int, str] = {}
    for action, adds, deletes in effects:
        predicates = {each.predicate for each in deletes}
        if len(predicates) == 1 and not adds:
            found.setdefault(predicates.pop(), action)
    return found


def forbidden(
    found: Sequence[Opportunity], by_undoing: Mapping[int, str], params: DenoiseParams
) -> dict[Candidate, tuple[float, str]]:
    """Those that are forbidden: how surely, and why.

    Args:
        found: All opportunities of a domain.
        by_undoing: Predicates that an action does nothing but undo, see :func:`undone`.
        params: Priors, and how much must have been seen.
    """
    weights = _habits(found)
    said: dict[Candidate, tuple[float, str]] = {}
    for each in found:
        n, n_true = each.met.n, each.met.n_true
        exceptions = params.implied_exceptions_max
        by_rule = n_true * math.log(exceptions) + (n - n_true) * math.log1p(-exceptions)
        by_habit = np.logaddexp.reduce(
            [math.log(max(weight, 1e-300)) + _log_met(each, steady) for steady, weight in weights.items()]
        )
        undoes = by_undoing.get(each.literal.predicate)
        prior = params.forbidden_prior if undoes is None else params.forbidden_prior_if_undone
        n_min = params.n_forbidden_min if undoes is None else params.n_forbidden_if_undone_min
        odds = float(by_rule - by_habit) - prior
        if odds > 0 and n >= n_min:
            why = f"avoided on {n} occasions where it held in {each.share:.0%} of the chances"
            why += "" if undoes is None else f"; {undoes} does nothing but undo it"
            said[each.literal] = 1 / (1 + math.exp(-min(odds, 700.0))), why
    return said


_STEADINESS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
"""How many occasions' worth of steadiness a demonstrator's choices may have: values tried. With few, what is
met is a matter of habit; with many, it is met as often as it is true."""
_LEAST_SHARE = 0.05
"""What is true in less of the chances, or false in less, says nothing of choices."""


def _habits(found: Sequence[Opportunity]) -> dict[float, float]:
    """Probability of each steadiness, by the literals that were met at times.

    What was met always or never may be a rule that was or was not found, and says nothing of habits.
    """
    logs = np.zeros(len(_STEADINESS))
    for each in found:
        n, n_true = each.met.n, each.met.n_true
        if 1 / 2 <= n_true <= n - 1 / 2:
            for row, steady in enumerate(_STEADINESS):
                ruled_out = sum(
                    math.exp(_log_met(Opportunity(each.literal, Occasions(n, extreme), each.share), steady))
                    for extreme in (0, n)
                )
                logs[row] += _log_met(each, steady) - math.log(max(1 - ruled_out, 1e-9))
    weights = np.exp(logs - logs.max())
    return dict(zip(_STEADINESS, (weights / weights.sum()).tolist(), strict=True))


def _log_met(each: Opportunity, steady: float) -> float:
    """Log probability of meeting the literal so often, each demonstrator choosing as often as it is true."""
    true, false = each.share * steady, (1 - each.share) * steady
    met = _log_beta(each.met.n_true + true, each.met.n - each.met.n_true + false)
    return met - _log_beta(true, false)


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


def _is_in(keys: Codes, among: Codes) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Whether each key is among sorted ones."""
    if not len(among):
        return np.zeros(len(keys), dtype=np.bool_)
    return np.asarray(among[np.minimum(np.searchsorted(among, keys), len(among) - 1)] == keys)


def _ordered(conditions: Sequence[Candidate]) -> list[Candidate]:
    """Conditions over parameters, each sharing as many parameters as can be with those before it."""
    waiting = sorted(conditions, key=lambda each: (len(each.terms), each.terms, each.predicate))
    waiting = [each for each in waiting if min(each.terms, default=0) >= 0]
    ordered: list[Candidate] = []
    bound: set[int] = set()
    while waiting:
        following = max(waiting, key=lambda one: sum(term in bound for term in one.terms))
        waiting.remove(following)
        ordered.append(following)
        bound |= set(following.terms)
    return ordered


@dataclass(frozen=True, eq=False)
class _Bindings:
    """Ways to bind parameters in snapshots; all columns have the same length."""

    state: Codes
    objects: dict[int, Codes]
    """By parameter."""

    def where(self, condition: Candidate, seen: Snapshots, codes: GroundCodes) -> "_Bindings | None":
        """Those in which a condition holds, with its parameters bound too."""
        rows = np.flatnonzero(codes.predicate_of(seen.sure_code) == condition.predicate)
        part = _Bindings(seen.sure_state[rows], {})
        is_fit = np.ones(len(rows), dtype=np.bool_)
        for position, term in enumerate(condition.terms):
            objects = codes.object_of(seen.sure_code[rows], position)
            is_fit &= part.objects.setdefault(term, objects) == objects
        return self._joined(part._at(np.flatnonzero(is_fit)), codes.base)

    def over(self, literal: Candidate, traces: TraceSet, seen: Snapshots) -> "_Bindings | None":
        """Those with the literal's parameters bound, to any object of their type where nothing binds them."""
        if min(literal.terms, default=0) < 0:
            return None
        bindings: _Bindings | None = self
        parameters = traces.signatures.actions[literal.action].parameters
        for term in literal.terms:
            if bindings is None or term in bindings.objects:
                continue
            kind, types = parameters[term].type_name, traces.signatures.types
            rows = np.flatnonzero([types.is_subtype(each, kind) for each in seen.object_type])
            part = _Bindings(seen.object_state[rows], {term: seen.object_index[rows]})
            bindings = bindings._joined(part, 1)
        return bindings

    def _at(self, rows: Codes) -> "_Bindings":
        return _Bindings(self.state[rows], {term: each[rows] for term, each in self.objects.items()})

    def _joined(self, other: "_Bindings", base: int) -> "_Bindings | None":
        """Every pair that agrees on state and shared parameters; nothing if there are too many."""
        key, other_key = self.state, other.state
        for term in sorted(self.objects.keys() & other.objects.keys()):
            key, other_key = key * base + self.objects[term], other_key * base + other.objects[term]
        order = np.argsort(other_key, kind="stable")
        low = np.searchsorted(other_key[order], key, side="left")
        sizes = np.searchsorted(other_key[order], key, side="right") - low
        if sizes.sum() > _MAX_BINDINGS:
            return None
        mine = np.repeat(np.arange(len(key)), sizes)
        theirs = order[np.repeat(low - np.r_[0, np.cumsum(sizes)[:-1]], sizes) + np.arange(len(mine))]
        return _Bindings(self.state[mine], other._at(theirs).objects | self._at(mine).objects)
