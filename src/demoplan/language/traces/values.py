"""What symbolic traces hold: signatures, states and actions as integer codes, and what was left out."""

from dataclasses import dataclass

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
