"""What symbolic traces hold: signatures, states and actions as integer codes, and what was left out."""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from demoplan.language.domains import Parameter, Signature
from demoplan.language.types import TypeHierarchy

Codes = NDArray[np.int64]
"""Integer codes: indices into a table of names."""

ABSENT = -1
"""Stands in code tables where an atom or an action has fewer arguments than the table has columns."""


@dataclass(frozen=True, order=True)
class Fault:
    """Something in a file that could not be used, and was left out."""

    file: str
    line: int
    """Line of its first occurrence, from 1."""
    problem: str
    n_occurrences: int = 1

    def __str__(self) -> str:
        """As messages name it: ``file:line: problem``."""
        often = f" ({self.n_occurrences} times)" if self.n_occurrences > 1 else ""
        return f"{self.file}:{self.line}: {self.problem}{often}"


@dataclass(frozen=True)
class ActionSignature:
    """An action's name and its typed parameters, in order."""

    name: str
    parameters: tuple[Parameter, ...]


@dataclass(frozen=True)
class Signatures:
    """A domain without conditions and effects. Names are kept as written; they compare without case."""

    domain_name: str
    types: TypeHierarchy
    constants: tuple[tuple[str, str], ...]
    """(instance, type) pairs, in the order of their declaration."""
    predicates: tuple[Signature, ...]
    actions: tuple[ActionSignature, ...]


@dataclass(frozen=True, eq=False)
class TraceSet:
    """Traces as tables of codes; states of all traces are numbered through.

    Atoms, objects, predicates and actions are indices: predicates and actions into the signatures, objects
    into ``object_names``. An action stands between the state of its number and the next one, which belongs to
    the same trace.
    """

    signatures: Signatures
    trace_names: tuple[str, ...]
    object_names: tuple[str, ...]
    atom_predicate: Codes
    """``(n_atoms,)``"""
    atom_arguments: Codes
    """``(n_atoms, widest predicate)`` objects, ``ABSENT`` beyond the arity."""
    state_trace: Codes
    """``(n_states,)``, not decreasing."""
    is_partial: NDArray[np.bool_]
    """``(n_states,)``: what such a state does not list was not observed; in others it was observed false."""
    true_state: Codes
    """``(n_true,)``: state of each atom observed true."""
    true_atom: Codes
    false_state: Codes
    """``(n_false,)``: state of each atom that a partial state says is false."""
    false_atom: Codes
    action_state: Codes
    """``(n_actions,)``: the state before; ascending."""
    action_signature: Codes
    action_arguments: Codes
    """``(n_actions, widest action)`` objects, ``ABSENT`` beyond the arity."""
    declared_trace: Codes
    """``(n_declared,)``: trace of each declared object; with ``declared_object`` and ``declared_type``."""
    declared_object: Codes
    declared_type: tuple[str, ...]

    @property
    def n_states(self) -> int:
        """States of all traces together."""
        return len(self.state_trace)

    @property
    def n_actions(self) -> int:
        """Transitions of all traces together."""
        return len(self.action_state)

    def select(self, first: Codes, last: Codes) -> "TraceSet":
        """Some stretches of states, each a trace of its own; names, objects and atoms keep their codes.

        Args:
            first: First state of each stretch, ascending.
            last: Its last state. All states of a stretch belong to one trace.
        """
        sizes = last - first + 1
        kept = np.repeat(first - np.r_[0, np.cumsum(sizes)[:-1]], sizes) + np.arange(sizes.sum())
        new_state = np.full(self.n_states + 1, ABSENT, dtype=np.int64)
        new_state[kept] = np.arange(len(kept))
        new_trace = np.repeat(np.arange(len(first)), sizes)
        owner = self.state_trace[first]
        is_true, is_false = new_state[self.true_state] >= 0, new_state[self.false_state] >= 0
        before, after = new_state[self.action_state], new_state[self.action_state + 1]
        is_inside = (before >= 0) & (after == before + 1)
        is_inside[is_inside] = new_trace[before[is_inside]] == new_trace[after[is_inside]]
        order = np.argsort(self.declared_trace, kind="stable")
        low = np.searchsorted(self.declared_trace[order], owner, side="left")
        n_declared = np.searchsorted(self.declared_trace[order], owner, side="right") - low
        offset = low - np.r_[0, np.cumsum(n_declared)[:-1]]
        declared = order[np.repeat(offset, n_declared) + np.arange(n_declared.sum())]
        return replace(
            self,
            trace_names=tuple(self.trace_names[trace] for trace in owner),
            state_trace=new_trace,
            is_partial=self.is_partial[kept],
            true_state=new_state[self.true_state[is_true]],
            true_atom=self.true_atom[is_true],
            false_state=new_state[self.false_state[is_false]],
            false_atom=self.false_atom[is_false],
            action_state=before[is_inside],
            action_signature=self.action_signature[is_inside],
            action_arguments=self.action_arguments[is_inside],
            declared_trace=np.repeat(np.arange(len(first)), n_declared),
            declared_object=self.declared_object[declared],
            declared_type=tuple(self.declared_type[row] for row in declared),
        )

    def join(self, later: "TraceSet") -> "TraceSet":
        """Both sets' traces, these first; both were taken from one reader, whose codes only ever grow."""

        def chained(one: Codes, other: Codes, offset: int = 0) -> Codes:
            return np.concatenate([one, other + offset])

        return replace(
            max(self, later, key=lambda each: (len(each.atom_predicate), len(each.object_names))),
            trace_names=self.trace_names + later.trace_names,
            state_trace=chained(self.state_trace, later.state_trace, len(self.trace_names)),
            is_partial=np.concatenate([self.is_partial, later.is_partial]),
            true_state=chained(self.true_state, later.true_state, self.n_states),
            true_atom=chained(self.true_atom, later.true_atom),
            false_state=chained(self.false_state, later.false_state, self.n_states),
            false_atom=chained(self.false_atom, later.false_atom),
            action_state=chained(self.action_state, later.action_state, self.n_states),
            action_signature=chained(self.action_signature, later.action_signature),
            action_arguments=chained(self.action_arguments, later.action_arguments),
            declared_trace=chained(self.declared_trace, later.declared_trace, len(self.trace_names)),
            declared_object=chained(self.declared_object, later.declared_object),
            declared_type=self.declared_type + later.declared_type,
        )


def padded(rows: list[tuple[int, ...]], widest: int = 0) -> Codes:
    """Rows of codes as a table, ``ABSENT`` beyond their ends."""
    widest = max(widest, max(map(len, rows), default=0))
    padding = [(ABSENT,) * (widest - n) for n in range(widest + 1)]
    flat = itertools.chain.from_iterable(row + padding[len(row)] for row in rows)
    return np.fromiter(flat, dtype=np.int64, count=len(rows) * widest).reshape(len(rows), widest)
