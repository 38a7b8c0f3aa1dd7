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
from demoplan.stages.denoise.beliefs import Beliefs
from demoplan.stages.denoise.params import DenoiseParams
from demoplan.stages.denoise.touches import Candidate, GroundCodes, Spans, Touches

_SURE = 0.9
"""Atoms believed more than this count as holding where an implication starts."""


@dataclass(frozen=True, eq=False)
class Snapshots:
    """Atoms that hold in some states, after noise is taken out."""

    n: int
    sure_state: Codes
    sure_code: Codes
    likely: Codes
    """Sorted ``code * n + state`` of all that is more likely true than not."""
    object_state: Codes
    """Snapshot of every declared object; with ``object_index`` and ``object_type``."""
    object_index: Codes
    object_type: tuple[str, ...]


def snapshots(
    traces: TraceSet,
    chosen: Spans,
    touches: Touches,
    beliefs: Beliefs,
    codes: GroundCodes,
    params: DenoiseParams,
) -> Snapshots:
    """States at even distances in each span, as far as the limit goes."""
    n_each = max(1, min(params.n_snapshots, params.max_snapshots // max(len(chosen.first), 1)))
    n_spans = min(len(chosen.first), params.max_snapshots)
    steps = np.linspace(0.0, 1.0, n_each) if n_each > 1 else np.array([0.5])
    states = np.round(chosen.first[:n_spans, None] + steps * (chosen.last - chosen.first)[:n_spans, None])
    state = np.unique(states.astype(np.int64))
    span = np.searchsorted(chosen.first, state, side="right") - 1
    code, probability, at = _touched(traces, touches, beliefs, state, span)
    still_code, still_span, still = _untouched(traces, chosen, touches, beliefs, codes, n_spans)
    # An atom that nothing touched holds in every snapshot of its span.
    order = np.argsort(still_span, kind="stable")
    low = np.searchsorted(still_span[order], span, side="left")
    high = np.searchsorted(still_span[order], span, side="right")
    sizes = high - low
    picked = order[np.repeat(low - np.r_[0, np.cumsum(sizes)[:-1]], sizes) + np.arange(sizes.sum())]
    code = np.concatenate([code, still_code[picked]])
    probability = np.concatenate([probability, still[picked]])
    at = np.concatenate([at, np.repeat(np.arange(len(state)), sizes)])
    is_sure = probability > _SURE
    declared = np.flatnonzero(np.isin(traces.declared_trace, traces.state_trace[state]))
    pairs = [
        (n, index)
        for n, trace in enumerate(traces.state_trace[state].tolist())
        for index in declared[traces.declared_trace[declared] == trace].tolist()
    ]
    object_row = np.array([index for _, index in pairs], dtype=np.int64)
    return Snapshots(
        n=len(state),
        sure_state=at[is_sure],
        sure_code=code[is_sure],
        likely=np.unique((code * len(state) + at)[probability > 1 / 2]),
        object_state=np.array([n for n, _ in pairs], dtype=np.int64),
        object_index=traces.declared_object[object_row],
        object_type=tuple(traces.declared_type[index] for index in object_row),
    )


def _touched(
    traces: TraceSet, touches: Touches, beliefs: Beliefs, state: Codes, span: Codes
) -> tuple[Codes, np.ndarray, Codes]:
    """Codes, probabilities and snapshots of atoms that some action touched."""
    by_span = np.argsort(touches.timeline_span, kind="stable")
    low = np.searchsorted(touches.timeline_span[by_span], span, side="left")
    high = np.searchsorted(touches.timeline_span[by_span], span, side="right")
    sizes = high - low
    timeline = by_span[np.repeat(low - np.r_[0, np.cumsum(sizes)[:-1]], sizes) + np.arange(sizes.sum())]
    at = np.repeat(np.arange(len(state)), sizes)
    key = touches.touch_timeline * traces.n_states + touches.touch_state
    last = np.searchsorted(key, timeline * traces.n_states + state[at], side="left") - 1
    is_after = (last >= 0) & (touches.touch_timeline[np.maximum(last, 0)] == timeline)
    messages = beliefs.messages
    probability = np.where(is_after, messages.true_after[np.maximum(last, 0)], messages.true_before[timeline])
    return touches.timeline_code[timeline], probability, at


def _untouched(
    traces: TraceSet, chosen: Spans, touches: Touches, beliefs: Beliefs, codes: GroundCodes, n_spans: int
) -> tuple[Codes, Codes, np.ndarray]:
    """Codes, spans and probabilities of atoms that nothing touched: one long segment each."""
    span = np.searchsorted(chosen.first, traces.true_state, side="right") - 1
    is_inside = (span >= 0) & (traces.true_state <= chosen.last[np.maximum(span, 0)]) & (span < n_spans)
    code = codes.of_atoms(traces)[traces.true_atom[is_inside]]
    key, n_true = np.unique(code * n_spans + span[is_inside], return_counts=True)
    touched = touches.timeline_code * n_spans + touches.timeline_span
    is_touched = np.isin(key, touched[touches.timeline_span < n_spans])
    key, n_true = key[~is_touched], n_true[~is_touched]
    code, span = key // n_spans, key % n_spans
    full = np.r_[0, np.cumsum(~traces.is_partial)]
    n_seen = np.maximum(full[chosen.last[span] + 1] - full[chosen.first[span]], n_true)
    predicate = codes.predicate_of(code)
    missed, imagined = beliefs.rates.missed[predicate], beliefs.rates.imagined[predicate]
    odds = n_true * np.log((1 - missed) / imagined) + (n_seen - n_true) * np.log(missed / (1 - imagined))
    return code, span, 1 / (1 + np.exp(-np.clip(odds, -50, 50)))


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
