"""Conditions that say nothing new: implied by another condition in everything that was seen.

A robot's place is always reachable, a connection goes both ways. Among an action's conditions such literals
hold in every instance whether the action needs them or not, and stating them makes a domain longer and, where
a new problem breaks the habit, wrong.

That it was so in all that was seen is not enough: a planner finds the one way to break a habit that no
demonstrator tried. So an implication counts only if the learned actions keep it, whatever they are applied
to: what makes the one literal true must make the other true or need it, and what makes the other false must
make the one false. A literal that the action itself deletes is never left out.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from demoplan.language.traces import TraceSet
from demoplan.language.traces.values import Codes, Signatures
from demoplan.stages.denoise.opportunities import Occasions, Opportunity, opportunities
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.snapshots import Snapshots
from demoplan.stages.denoise.touches import Candidate, GroundCodes


@dataclass(frozen=True)
class Rules:
    """What the actions were found to need and to do, before anything is left out; by action."""

    conditions: Mapping[int, Sequence[Candidate]]
    adds: Mapping[int, Sequence[Candidate]]
    deletes: Mapping[int, Sequence[Candidate]]

    def keep(self, by: int, literal: int, places: tuple[int, ...], signatures: Signatures) -> bool:
        """Whether no action can break "``by`` implies ``literal``".

        Args:
            by: Predicate that implies.
            literal: Predicate that is implied.
            places: Per argument of ``literal``, which argument of ``by`` it is.
            signatures: Types, to tell which parameters may be the same object.
        """
        arity = len(signatures.predicates[by].argument_types)
        for action in self.adds:
            given = [*self.conditions[action], *self.adds[action]]
            for made in self.adds[action]:
                if made.predicate != by or _has(self.conditions[action], by, made.terms):
                    continue
                wanted = tuple(made.terms[place] for place in places)
                if not _has(given, literal, wanted):
                    return False
                if not _has(self.adds[action], literal, wanted) and any(
                    each.predicate == literal and _may_be_same(each.terms, wanted, action, signatures)
                    for each in self.deletes[action]
                ):
                    return False
            for lost in self.deletes[action]:
                if lost.predicate != literal:
                    continue
                if set(places) != set(range(arity)):
                    return False
                terms = tuple(lost.terms[places.index(place)] for place in range(arity))
                if not _has(self.deletes[action], by, terms):
                    return False
        return True

    def is_lost(self, predicate: int) -> bool:
        """Whether any action deletes atoms of a predicate."""
        return any(each.predicate == predicate for lost in self.deletes.values() for each in lost)


def _has(literals: Sequence[Candidate], predicate: int, terms: tuple[int, ...]) -> bool:
    return any(each.predicate == predicate and each.terms == terms for each in literals)


def _may_be_same(
    terms: tuple[int, ...], others: tuple[int, ...], action: int, signatures: Signatures
) -> bool:
    """Whether two atoms of one action can be the same ground atom."""
    types = signatures.types

    def kind(term: int) -> str:
        if term < 0:
            return signatures.constants[-1 - term][1]
        return signatures.actions[action].parameters[term].type_name

    return all(
        one == other
        or (
            not (one < 0 and other < 0)
            and (types.is_subtype(kind(one), kind(other)) or types.is_subtype(kind(other), kind(one)))
        )
        for one, other in zip(terms, others, strict=True)
    )


class Implications:
    """Answers whether one literal implies another; keeps what it has answered."""

    def __init__(
        self, traces: TraceSet, seen: Snapshots, rules: Rules, codes: GroundCodes, params: DenoiseParams
    ) -> None:
        """Keep what is asked about."""
        self._rules = rules
        self._traces, self._seen, self._codes, self._params = traces, seen, codes, params
        self._answers: dict[tuple[object, ...], bool] = {}
        predicate = codes.predicate_of(seen.sure_code)
        order = np.argsort(predicate, kind="stable")
        bounds = np.searchsorted(predicate[order], np.arange(len(traces.signatures.predicates) + 1))
        self._rows = [order[low:high] for low, high in itertools.pairwise(bounds)]

    def opportunities(
        self, conditions: Sequence[Candidate], literals: Mapping[Candidate, Occasions]
    ) -> list[Opportunity]:
        """Literals that an action's conditions leave free; see :func:`opportunities.opportunities`."""
        return opportunities(conditions, literals, self._traces, self._seen, self._codes, self._params)

    def frequency(self, literal: Candidate) -> float:
        """How many atoms of the literal's predicate hold, for each object that could be in them."""
        return len(self._rows[literal.predicate]) / max(self._seen.n, 1)

    def implied(self, by: Candidate, literal: Candidate) -> bool:
        """Whether wherever ``by`` holds, ``literal`` holds with the same objects."""
        if (
            not set(literal.terms) <= set(by.terms)
            or len(set(by.terms)) < len(by.terms)
            or min(by.terms, default=0) < 0
        ):
            return False
        places = tuple(by.terms.index(term) for term in literal.terms)
        key = (by.predicate, literal.predicate, places)
        if key not in self._answers:
            rows = self._rows[by.predicate]
            objects = [self._codes.object_of(self._seen.sure_code[rows], place) for place in places]
            self._answers[key] = self._holds(
                literal.predicate, objects, self._seen.sure_state[rows]
            ) and self._rules.keep(by.predicate, literal.predicate, places, self._traces.signatures)
        return self._answers[key]

    def universal(self, literal: Candidate) -> bool:
        """Whether a literal over at most one parameter holds for every object of the parameter's type."""
        terms = set(literal.terms)
        if len(terms) > 1 or min(terms, default=0) < 0 or self._rules.is_lost(literal.predicate):
            return False
        if not terms:
            return self._holds(literal.predicate, [], np.arange(self._seen.n))
        parameter = self._traces.signatures.actions[literal.action].parameters[literal.terms[0]]
        key = ("type", parameter.type_name, literal.predicate, len(literal.terms))
        if key not in self._answers:
            types = self._traces.signatures.types
            fits = [types.is_subtype(kind, parameter.type_name) for kind in self._seen.object_type]
            rows = np.flatnonzero(np.array(fits, dtype=np.bool_))
            objects = [self._seen.object_index[rows]] * len(literal.terms)
            self._answers[key] = self._holds(literal.predicate, objects, self._seen.object_state[rows])
        return self._answers[key]

    def _holds(self, predicate: int, objects: list[Codes], state: Codes) -> bool:
        if len(state) < self._params.n_implied_min:
            return False
        code = self._codes.of(predicate, objects, len(state)) * self._seen.n + state
        exceptions = 1 - float(np.isin(code, self._seen.likely).mean())
        return exceptions <= self._params.implied_exceptions_max


def needed(
    conditions: list[Candidate], is_deleted: Mapping[Candidate, bool], implications: Implications
) -> tuple[list[Candidate], dict[Candidate, str]]:
    """An action's conditions without those that others imply; and why each of those was left out.

    The least telling are tried first: few parameters, often true. Of two that imply each other and differ in
    predicate only, neither is left out: which of them is meant cannot be seen.
    """
    kept = sorted(
        conditions,
        key=lambda each: (-len(set(each.terms)), implications.frequency(each), each.terms, each.atom),
    )
    reasons: dict[Candidate, str] = {}
    for literal in reversed(list(kept)):
        if is_deleted[literal]:
            continue
        others = [each for each in kept if each != literal and implications.implied(each, literal)]
        by = [
            each
            for each in others
            if is_deleted[each]
            or each.predicate == literal.predicate
            or set(each.terms) != set(literal.terms)
            or not implications.implied(literal, each)
        ]
        if by:
            reasons[literal] = f"implied by {by[0].atom}"
        elif implications.universal(literal):
            reasons[literal] = "true of every such object"
        if literal in reasons:
            kept.remove(literal)
    return kept, reasons
