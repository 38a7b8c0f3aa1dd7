"""Traces to touches: which ground atoms each action could have changed, and what was seen between.

Only an action that names all objects of an atom can change it, so an atom's course over a trace falls into
segments between such touches, within which it is constant. All that is needed of a segment is how often the
atom was seen true and false in it.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.inference import Timelines
from demoplan.language.atoms import Atom
from demoplan.language.traces import TraceSet
from demoplan.language.traces.values import Codes, Signatures
from demoplan.stages.denoise.params import DenoiseParams


@dataclass(frozen=True)
class Candidate:
    """A lifted atom that may be a condition or an effect of an action."""

    action: int
    predicate: int
    atom: Atom
    terms: tuple[int, ...]
    """Per argument: index of a parameter, or ``-1 - n`` for constant ``n``."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Timelines of ground atoms over spans, and which atom, span and state their rows stand for."""

    timelines: Timelines
    """Literals are candidates; a timeline is one ground atom in one span."""
    touch_state: Codes
    """``(n_touches,)``: the state before."""
    timeline_code: Codes
    """``(n_timelines,)`` code of the ground atom, see ``GroundCodes``."""
    timeline_span: Codes


@dataclass(frozen=True, eq=False)
class Spans:
    """Stretches of traces that are learned from: first and last state of each."""

    first: Codes
    last: Codes


class GroundCodes:
    """One integer per ground atom: mixed radix over the predicate and its objects."""

    def __init__(self, traces: TraceSet) -> None:
        """Choose the radix so that every atom of the traces has a code.

        Raises:
            DataError: If objects and arguments are so many that codes pass 63 bits.
        """
        self.base = len(traces.object_names) + 1
        self.width = max((len(each.argument_types) for each in traces.signatures.predicates), default=0)
        if len(traces.signatures.predicates) * self.base**self.width >= 2**62:
            raise DataError(
                f"{self.base - 1} objects in predicates of {self.width} arguments do not fit into codes; "
                "give objects of different traces the same names, or learn from fewer traces at a time"
            )

    def of(self, predicate: Codes | int, columns: list[Codes], n: int) -> Codes:
        """Codes of ``n`` atoms from the objects in each argument."""
        codes = np.zeros(n, dtype=np.int64) + predicate
        for position in range(self.width):
            codes = codes * self.base + (columns[position] + 1 if position < len(columns) else 0)
        return codes

    def predicate_of(self, codes: Codes) -> Codes:
        """Predicates of codes."""
        return np.asarray(codes // self.base**self.width)

    def object_of(self, codes: Codes, position: int) -> Codes:
        """Objects in one argument."""
        return np.asarray(codes // self.base ** (self.width - 1 - position) % self.base - 1)

    def of_atoms(self, traces: TraceSet) -> Codes:
        """Codes of a trace set's atoms."""
        columns = list(traces.atom_arguments.T)
        return self.of(traces.atom_predicate, columns, len(traces.atom_predicate))


def candidates(signatures: Signatures) -> tuple[Candidate, ...]:
    """Every well-typed atom over each action's parameters and the constants, but for those of constants only.

    Atoms without arguments count as over the parameters.
    """
    found: list[Candidate] = []
    for a, action in enumerate(signatures.actions):
        terms = [(n, each.variable, each.type_name) for n, each in enumerate(action.parameters)]
        terms += [(-1 - n, name, kind) for n, (name, kind) in enumerate(signatures.constants)]
        for p, predicate in enumerate(signatures.predicates):
            fitting = [
                [(n, name) for n, name, kind in terms if signatures.types.is_subtype(kind, wanted)]
                for wanted in predicate.argument_types
            ]
            for chosen in itertools.product(*fitting):
                if not chosen or any(n >= 0 for n, _ in chosen):
                    atom = Atom(predicate.name, tuple(name for _, name in chosen))
                    found.append(Candidate(a, p, atom, tuple(n for n, _ in chosen)))
    return tuple(found)


def spans(traces: TraceSet, params: DenoiseParams, n_before: Codes | None = None) -> Spans:
    """Spans of bounded length, in order, as many as the actions need.

    Args:
        traces: Traces to choose from.
        params: How long spans may be, and how many instances of an action are enough.
        n_before: Per action, instances that were chosen already.
    """
    if traces.n_states == 0:
        return Spans(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))
    states = np.arange(traces.n_states)
    is_start = np.r_[True, traces.state_trace[1:] != traces.state_trace[:-1]]
    start = np.maximum.accumulate(np.where(is_start, states, 0))
    first = np.flatnonzero(is_start | ((states - start) % params.max_span_states == 0))
    last = np.r_[first[1:] - 1, traces.n_states - 1]
    owner = np.searchsorted(first, traces.action_state, side="right") - 1
    # How many instances of the same action came before each one.
    order = np.argsort(traces.action_signature, kind="stable")
    n_actions = len(traces.signatures.actions)
    sizes = np.bincount(traces.action_signature, minlength=n_actions)
    seen = np.empty(traces.n_actions, dtype=np.int64)
    seen[order] = np.arange(traces.n_actions) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    is_needed = np.zeros(len(first), dtype=np.bool_)
    if n_before is not None:
        seen += n_before[traces.action_signature]
    is_needed[owner[seen < params.max_instances]] = True
    return Spans(first[is_needed], last[is_needed])


def touch(traces: TraceSet, chosen: Spans, over: tuple[Candidate, ...], codes: GroundCodes) -> Touches:
    """Touches of all candidates in the chosen spans."""
    n_spans, n_states = len(chosen.first), traces.n_states
    state_span = np.full(n_states, -1, dtype=np.int64)
    for_each = chosen.last - chosen.first + 1
    inside = np.repeat(chosen.first - np.r_[0, np.cumsum(for_each)[:-1]], for_each) + np.arange(
        for_each.sum()
    )
    state_span[inside] = np.repeat(np.arange(n_spans), for_each)
    state, code, candidate = _instances(traces, state_span, over, codes)
    code_values, code_index = np.unique(code, return_inverse=True)
    key, timeline = np.unique(code_index * n_spans + state_span[state], return_inverse=True)
    touch_key, entry_touch = np.unique(timeline * n_states + state, return_inverse=True)
    touch_timeline, touch_state = np.divmod(touch_key, max(n_states, 1))
    span = key % n_spans
    count = _Counter(traces, state_span, codes, code_values, key, n_spans)
    sizes = np.bincount(touch_timeline, minlength=len(key))
    starts = np.cumsum(sizes) - sizes
    before = count(np.arange(len(key)), chosen.first[span], touch_state[starts])
    is_last = np.zeros(len(touch_key), dtype=np.bool_)
    is_last[starts + sizes - 1] = True
    ends = np.where(is_last, chosen.last[span[touch_timeline]], np.r_[touch_state[1:], 0][: len(touch_key)])
    after = count(touch_timeline, touch_state + 1, ends)
    # So far timelines stood in order of their atoms, and touches in order of time; see ``Timelines``.
    order = np.argsort(-sizes, kind="stable")
    new_timeline = np.empty(len(key), dtype=np.int64)
    new_timeline[order] = np.arange(len(key))
    rank = np.arange(len(touch_key)) - starts[touch_timeline]
    n_by_rank = np.bincount(rank)
    place = (np.cumsum(n_by_rank) - n_by_rank)[rank] + new_timeline[touch_timeline]
    by_place = np.empty(len(touch_key), dtype=np.int64)
    by_place[place] = np.arange(len(touch_key))
    timeline_code = code_values[key[order] // n_spans]
    return Touches(
        timelines=Timelines(
            n_by_rank=tuple(n_by_rank.tolist()),
            timeline_predicate=codes.predicate_of(timeline_code),
            before_true=before[0][order],
            before_false=before[1][order],
            after_true=after[0][by_place],
            after_false=after[1][by_place],
            entry_literal=candidate,
            entry_touch=place[entry_touch],
        ),
        touch_state=touch_state[by_place],
        timeline_code=timeline_code,
        timeline_span=span[order],
    )


def _instances(
    traces: TraceSet, state_span: Codes, over: tuple[Candidate, ...], codes: GroundCodes
) -> tuple[Codes, Codes, Codes]:
    """State, ground atom and candidate of every entry."""
    # The state after must stand in the same span, or nothing is known of what the action did.
    span = state_span[traces.action_state]
    is_inside = (span >= 0) & (state_span[np.minimum(traces.action_state + 1, traces.n_states - 1)] == span)
    constant_index = {name.lower(): n for n, name in enumerate(traces.object_names)}
    constants = [constant_index.get(name.lower(), -1) for name, _ in traces.signatures.constants]
    states, grounds, which = (
        [np.zeros(0, dtype=np.int64)],
        [np.zeros(0, dtype=np.int64)],
        [np.zeros(0, dtype=np.int64)],
    )
    rows_of = {
        action: np.flatnonzero(is_inside & (traces.action_signature == action))
        for action in {each.action for each in over}
    }
    for index, each in enumerate(over):
        rows = rows_of[each.action]
        columns = [
            traces.action_arguments[rows, term] if term >= 0 else np.full(len(rows), constants[-1 - term])
            for term in each.terms
        ]
        states.append(traces.action_state[rows])
        grounds.append(codes.of(each.predicate, columns, len(rows)))
        which.append(np.full(len(rows), index))
    return np.concatenate(states), np.concatenate(grounds), np.concatenate(which)


class _Counter:
    """Counts how often the atoms of timelines were seen true and false between two states, both included."""

    def __init__(
        self,
        traces: TraceSet,
        state_span: Codes,
        codes: GroundCodes,
        code_values: Codes,
        keys: Codes,
        n_spans: int,
    ) -> None:
        self.n_states = traces.n_states
        atom_code = codes.of_atoms(traces)
        place = np.minimum(np.searchsorted(code_values, atom_code), max(len(code_values) - 1, 0))
        atom_index = np.where(code_values[place] == atom_code, place, -1) if len(code_values) else place - 1

        def located(state: Codes, atom: Codes) -> Codes:
            index, span = atom_index[atom], state_span[state]
            is_kept = (index >= 0) & (span >= 0)
            key = index[is_kept] * n_spans + span[is_kept]
            at = np.minimum(np.searchsorted(keys, key), max(len(keys) - 1, 0))
            hit = keys[at] == key
            return np.sort(at[hit] * self.n_states + state[is_kept][hit])

        self.true = located(traces.true_state, traces.true_atom)
        is_full = ~traces.is_partial[traces.true_state]
        self.true_in_full = (
            self.true if is_full.all() else located(traces.true_state[is_full], traces.true_atom[is_full])
        )
        self.false = located(traces.false_state, traces.false_atom)
        self.full = np.r_[0, np.cumsum(~traces.is_partial)]

    def __call__(
        self, timeline: Codes, first: Codes, last: Codes
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        low, high = timeline * self.n_states + first, timeline * self.n_states + last

        def between(keys: Codes) -> Codes:
            return np.searchsorted(keys, high, side="right") - np.searchsorted(keys, low, side="left")

        true = between(self.true)
        in_full = true if self.true_in_full is self.true else between(self.true_in_full)
        unlisted = self.full[last + 1] - self.full[first] - in_full
        false = unlisted + (between(self.false) if len(self.false) else 0)
        return true.astype(np.float64), false.astype(np.float64)
