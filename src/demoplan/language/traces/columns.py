"""What grows while traces are read, and the tables that it becomes."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from demoplan.language.traces.judging import Action, AtomCodes, Declared
from demoplan.language.traces.values import Codes, Signatures, TraceSet, padded


@dataclass
class Columns:
    """Lists, and lists of arrays that are joined at the end."""

    trace_names: list[str] = field(default_factory=list)
    state_trace: list[int] = field(default_factory=list)
    is_partial: list[bool] = field(default_factory=list)
    true_sizes: list[int] = field(default_factory=list)
    true_atoms: list[Codes] = field(default_factory=list)
    false_sizes: list[int] = field(default_factory=list)
    false_atoms: list[Codes] = field(default_factory=list)
    action_state: list[int] = field(default_factory=list)
    action_signature: list[int] = field(default_factory=list)
    action_arguments: list[tuple[int, ...]] = field(default_factory=list)
    declared_trace: list[int] = field(default_factory=list)
    declared_object: list[int] = field(default_factory=list)
    declared_type: list[str] = field(default_factory=list)

    def begin(self, name: str, declared: Declared | None) -> int:
        """Start another trace; returns its number."""
        self.trace_names.append(name)
        trace = len(self.trace_names) - 1
        types = {} if declared is None else declared.types
        self.declared_trace += [trace] * len(types)
        self.declared_object += types.keys()
        self.declared_type += types.values()
        return trace

    def add_state(self, trace: int, true: Iterable[int], false: Iterable[int], *, is_partial: bool) -> None:
        """One state, by its atoms."""
        self.state_trace.append(trace)
        self.is_partial.append(is_partial)
        for sizes, atoms, codes in (
            (self.true_sizes, self.true_atoms, true),
            (self.false_sizes, self.false_atoms, false),
        ):
            array = np.fromiter(codes, dtype=np.int64)
            sizes.append(len(array))
            atoms.append(array)

    def add_action(self, action: Action) -> None:
        """An action, of which the state before is the last one added."""
        self.action_state.append(len(self.state_trace) - 1)
        self.action_signature.append(action[0])
        self.action_arguments.append(action[1])

    def drop_action(self) -> None:
        """Forget the last action."""
        for column in (self.action_state, self.action_signature, self.action_arguments):
            column.pop()

    def add_trace(self, trace: int, sizes: Codes, atoms: Codes, actions: list[Action]) -> None:
        """Full states and the actions between them, all at once."""
        n_before = len(self.state_trace)
        self.state_trace += [trace] * len(sizes)
        self.is_partial += [False] * len(sizes)
        self.true_sizes += sizes.tolist()
        self.true_atoms.append(atoms)
        self.false_sizes += [0] * len(sizes)
        self.action_state += range(n_before, n_before + len(actions))
        self.action_signature += [index for index, _ in actions]
        self.action_arguments += [arguments for _, arguments in actions]

    def tables(self, signatures: Signatures, codes: AtomCodes) -> TraceSet:
        """All of it as tables."""
        n_atoms = max(len(codes.rows), 1)
        states = np.arange(len(self.state_trace))
        true = _distinct(np.repeat(states, self.true_sizes) * n_atoms + _joined(self.true_atoms))
        false = _distinct(np.repeat(states, self.false_sizes) * n_atoms + _joined(self.false_atoms))
        return TraceSet(
            signatures=signatures,
            trace_names=tuple(self.trace_names),
            object_names=tuple(codes.objects),
            atom_predicate=np.fromiter((key[0] for key in codes.rows), dtype=np.int64),
            atom_arguments=padded([key[1:] for key in codes.rows]),
            state_trace=np.array(self.state_trace, dtype=np.int64),
            is_partial=np.array(self.is_partial, dtype=np.bool_),
            true_state=true // n_atoms,
            true_atom=true % n_atoms,
            false_state=false // n_atoms,
            false_atom=false % n_atoms,
            action_state=np.array(self.action_state, dtype=np.int64),
            action_signature=np.array(self.action_signature, dtype=np.int64),
            action_arguments=padded(
                self.action_arguments,
                max((len(each.parameters) for each in signatures.actions), default=0),
            ),
            declared_trace=np.array(self.declared_trace, dtype=np.int64),
            declared_object=np.array(self.declared_object, dtype=np.int64),
            declared_type=tuple(self.declared_type),
        )


def _distinct(codes: Codes) -> Codes:
    """Sorted, each once: by sorting, which for codes is several times as fast as hashing them."""
    ordered = np.sort(codes)
    is_new = np.ones(len(ordered), dtype=np.bool_)
    is_new[1:] = ordered[1:] != ordered[:-1]
    return ordered[is_new]


def _joined(parts: list[Codes]) -> Codes:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)
