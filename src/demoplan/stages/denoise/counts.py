"""How often each candidate was observed true and false right before and right after its action.

Everything is counted, not only what was learned from. Counts add up over traces, so they are taken in pieces
of bounded size.
"""

from dataclasses import dataclass

import numpy as np

from demoplan.language.traces import TraceSet
from demoplan.language.traces.values import Codes
from demoplan.stages.denoise.touches import Candidate, GroundCodes

_PIECE = 20_000
"""Instances of an action counted at a time."""


@dataclass(frozen=True, eq=False)
class Counts:
    """Per candidate, numbers of instances; what was not observed counts on neither side."""

    true_before: Codes
    false_before: Codes
    true_after: Codes
    false_after: Codes
    n_transitions: Codes
    """Per action."""

    def __add__(self, other: "Counts") -> "Counts":
        """Counts over both."""
        return Counts(
            self.true_before + other.true_before,
            self.false_before + other.false_before,
            self.true_after + other.true_after,
            self.false_after + other.false_after,
            self.n_transitions + other.n_transitions,
        )

    def __sub__(self, other: "Counts") -> "Counts":
        """Counts without what ``other`` counted."""
        return Counts(
            self.true_before - other.true_before,
            self.false_before - other.false_before,
            self.true_after - other.true_after,
            self.false_after - other.false_after,
            self.n_transitions - other.n_transitions,
        )


def count(traces: TraceSet, over: tuple[Candidate, ...], codes: GroundCodes) -> Counts:
    """Counts of all candidates over all transitions."""
    n_actions = len(traces.signatures.actions)
    out = np.zeros((4, len(over)), dtype=np.int64)
    ordered = _Observed(traces, codes)
    constant_index = {name.lower(): n for n, name in enumerate(traces.object_names)}
    constants = [constant_index.get(name.lower(), -1) for name, _ in traces.signatures.constants]
    by_action: dict[int, list[int]] = {}
    for index, each in enumerate(over):
        by_action.setdefault(each.action, []).append(index)
    for action, indices in by_action.items():
        rows = np.flatnonzero(traces.action_signature == action)
        for low in range(0, len(rows), _PIECE):
            piece = rows[low : low + _PIECE]
            for index in indices:
                each = over[index]
                columns = [
                    traces.action_arguments[piece, term]
                    if term >= 0
                    else np.full(len(piece), constants[-1 - term])
                    for term in each.terms
                ]
                atom = ordered.atom(codes.of(each.predicate, columns, len(piece)))
                state = traces.action_state[piece]
                out[0:2, index] += ordered.seen(state, atom)
                out[2:4, index] += ordered.seen(state + 1, atom)
    return Counts(out[0], out[1], out[2], out[3], np.bincount(traces.action_signature, minlength=n_actions))


class _Observed:
    """Looks up observations by state and atom."""

    def __init__(self, traces: TraceSet, codes: GroundCodes) -> None:
        self.n_atoms = len(traces.atom_predicate) + 1
        code = codes.of_atoms(traces)
        self.order = np.argsort(code, kind="stable")
        self.codes = code[self.order]
        self.true = np.sort(traces.true_state * self.n_atoms + traces.true_atom)
        self.false = np.sort(traces.false_state * self.n_atoms + traces.false_atom)
        self.is_partial = traces.is_partial

    def atom(self, code: Codes) -> Codes:
        """Index of each atom; one past the last for atoms that were never seen."""
        if not len(self.codes):
            return np.zeros(len(code), dtype=np.int64)
        place = np.minimum(np.searchsorted(self.codes, code), len(self.codes) - 1)
        return np.where(self.codes[place] == code, self.order[place], self.n_atoms - 1)

    def seen(self, state: Codes, atom: Codes) -> tuple[int, int]:
        """How many of the atoms were seen true, and how many false, each in its state."""
        key = state * self.n_atoms + atom
        is_true = _found(self.true, key)
        is_false = (~self.is_partial[state] & ~is_true) | _found(self.false, key)
        return int(is_true.sum()), int(is_false.sum())


def _found(keys: Codes, wanted: Codes) -> np.ndarray:
    if not len(keys):
        return np.zeros(len(wanted), dtype=np.bool_)
    place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.asarray(keys[place] == wanted)
