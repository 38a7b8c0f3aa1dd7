"""Trace files to codes: one pass of compiled expressions over a text, names looked up once each.

A trace of a million states has tens of millions of atoms, so no value is made per atom: the innermost lists
of a state are found by one expression and looked up by their text. Lines are counted only for what is wrong.
"""

import bisect
import itertools
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from demoplan.language.traces.scanning import (
    LEAF,
    NEGATION,
    Item,
    head_of,
    items,
    regular_parts,
    short,
    without_comments,
)
from demoplan.language.traces.values import ABSENT, Codes, Fault, Signatures, TraceSet
from demoplan.language.types import ROOT

_LINE_END = re.compile("\n")


class _Codes(dict[str, int]):
    """Codes of atoms by their text; a text that is no atom of the domain has a negative code."""

    def __init__(self, signatures: Signatures, objects: dict[str, int]) -> None:
        super().__init__()
        self.predicates = {each.name.lower(): (n, each) for n, each in enumerate(signatures.predicates)}
        self.listed = ", ".join(sorted(each.name for each in signatures.predicates)) or "none"
        self.objects = objects
        self.atoms: dict[tuple[int, ...], int] = {}
        self.problems: list[str] = []
        self.rows: list[tuple[int, ...]] = []

    def __missing__(self, text: str) -> int:
        words = text.lower().split()
        index, signature = self.predicates.get(words[0] if words else "", (ABSENT, None))
        if signature is None:
            problem = f"unknown predicate in ({short(text)}); declared: {self.listed}"
        elif len(words) - 1 != len(signature.argument_types):
            wanted = len(signature.argument_types)
            problem = f"({short(text)}) has {len(words) - 1} arguments; {signature.name!r} takes {wanted}"
        else:
            key = (index, *(self.objects.setdefault(word, len(self.objects)) for word in words[1:]))
            code = self.atoms.setdefault(key, len(self.atoms))
            if code == len(self.rows):
                self.rows.append(key)
            self[text] = code
            return code
        self.problems.append(problem)
        self[text] = code = -len(self.problems)
        return code


@dataclass
class _Columns:
    """What grows while traces are read; lists of arrays, joined at the end."""

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


class TraceReader:
    """Reads traces one after another into one set of tables; what it cannot use becomes faults.

    Where a trace breaks (an unknown action, a state without an action before it), it continues as another
    trace of the same name: nothing is learned across the break.
    """

    def __init__(self, signatures: Signatures) -> None:
        """Start without traces.

        Args:
            signatures: What predicates and actions there are; atoms and actions that do not fit are faults.
        """
        self.signatures = signatures
        self._objects: dict[str, int] = {}
        self._names: list[str] = []
        self._codes = _Codes(signatures, self._objects)
        self._actions = {each.name.lower(): (n, each) for n, each in enumerate(signatures.actions)}
        self._columns = _Columns()
        self._faults: dict[tuple[str, str], tuple[int, int]] = {}
        types = signatures.types
        self._kinds = {name: n for n, name in enumerate((ROOT, *types.names))}
        n_kinds, predicates = len(self._kinds), signatures.predicates
        widest = max((len(each.argument_types) for each in predicates), default=0)
        self._table = np.zeros((0, widest + 1), dtype=np.int64)
        self._fits = np.zeros((n_kinds + 1, n_kinds + 1), dtype=np.bool_)
        self._fits[:, n_kinds] = True
        for kind, n in self._kinds.items():
            self._fits[n, [self._kinds[each] for each in types.ancestors(kind)]] = True
        self._wanted = np.full((len(predicates), widest), n_kinds)
        for n, predicate in enumerate(predicates):
            self._wanted[n, : len(predicate.argument_types)] = [
                self._kinds[t] for t in predicate.argument_types
            ]
        self._verdicts: dict[tuple[tuple[str, str], ...], _Verdicts] = {}

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What was left out so far, by file and line."""
        return tuple(
            sorted(Fault(file, line, problem, n) for (file, problem), (line, n) in self._faults.items())
        )

    def add(self, text: str, file: str, objects: Mapping[str, str] | None = None) -> None:
        """Read one trace.

        Args:
            text: The trace.
            file: Its name, for messages and as the trace's name.
            objects: Types of its objects by name. Without them every object is taken as fitting.
        """
        source = _Source(without_comments(text), file, self)
        types = None if objects is None else self._declare(objects, source)
        if not self._quick(source, types):
            self._sequence(source, types)

    def _declare(self, objects: Mapping[str, str], source: "_Source") -> dict[int, str]:
        declared = {name.lower(): kind for name, kind in (*self.signatures.constants, *objects.items())}
        types: dict[int, str] = {}
        for name, kind in declared.items():
            types[self._objects.setdefault(name, len(self._objects))] = kind
        source.types = types
        # Traces often share their objects: what was found of atoms and actions then holds for all of them.
        source.verdicts = self._verdicts.setdefault(tuple(sorted(declared.items())), _Verdicts())
        return types

    def _begin(self, source: "_Source") -> int:
        columns = self._columns
        columns.trace_names.append(source.file)
        trace = len(columns.trace_names) - 1
        for index, kind in (source.types or {}).items():
            columns.declared_trace.append(trace)
            columns.declared_object.append(index)
            columns.declared_type.append(kind)
        return trace

    def _quick(self, source: "_Source", types: Mapping[int, str] | None) -> bool:
        """Read a trace that has nothing wrong with it; otherwise change nothing and say so."""
        regular = regular_parts(source.text)
        if regular is None:
            return False
        states, bodies = regular
        codes = np.fromiter(
            map(self._codes.__getitem__, itertools.chain.from_iterable(states)), dtype=np.int64
        )
        if len(codes) and codes.min() < 0:
            return False
        if types is not None:
            self._judge(_distinct(codes), source.verdicts, types)
            if source.verdicts.misfits and not source.verdicts.misfits.keys().isdisjoint(codes.tolist()):
                return False
        actions: list[tuple[int, tuple[int, ...]]] = []
        known = source.verdicts.actions
        for body in bodies:
            action = known.get(body)
            if action is None:
                found, problem = self._parsed_action(body, types)
                if problem or found is None:
                    return False
                action = known[body] = found
            actions.append(action)
        columns = self._columns
        trace, n_before = self._begin(source), len(columns.state_trace)
        columns.state_trace += [trace] * len(states)
        columns.is_partial += [False] * len(states)
        columns.true_sizes += map(len, states)
        columns.true_atoms.append(codes)
        columns.false_sizes += [0] * len(states)
        columns.action_state += range(n_before, n_before + len(actions))
        columns.action_signature += [index for index, _ in actions]
        columns.action_arguments += [arguments for _, arguments in actions]
        return True

    def _sequence(self, source: "_Source", types: Mapping[int, str] | None) -> None:
        """States and actions in turn; a break starts a new trace."""
        columns = self._columns
        n_states, n_actions = 0, 0
        trace = ABSENT
        last = "nothing"
        source.is_partial, problem = head_of(source.text)
        if problem:
            source.fault(len(source.text) - len(source.text.lstrip()), problem)
        for item in items(source.text):
            if item.is_action:
                action = self._action(item, source, types)
                if last == "nothing":
                    source.fault(item.start, "action without a state before it")
                    continue
                if last == "action":
                    source.fault(item.start, "action without a state between it and the one before")
                    self._add_state(trace, [], [], is_partial=True)
                if action is None:
                    trace, last = ABSENT, "nothing"
                    continue
                columns.action_state.append(len(columns.state_trace) - 1)
                columns.action_signature.append(action[0])
                columns.action_arguments.append(action[1])
                n_actions, last = n_actions + 1, "action"
                continue
            n_states += 1
            if last == "state":
                source.fault(item.start, "state without an action between it and the one before")
                trace = ABSENT
            if trace == ABSENT:
                trace = self._begin(source)
            true, false, is_partial = self._state(item, source, types)
            self._add_state(trace, true, false, is_partial=is_partial or source.is_partial)
            last = "state"
        if last == "action":
            source.fault(len(source.text), "action without a state after it")
            for column in (columns.action_state, columns.action_signature, columns.action_arguments):
                column.pop()
            n_actions -= 1
        if n_states == 0 and not source.n_faults:
            source.fault(0, "empty trace: no state in it")
        elif n_actions <= 0 and not source.n_faults:
            source.fault(0, "empty trace: no action between states in it")

    def _add_state(self, trace: int, true: Iterable[int], false: Iterable[int], *, is_partial: bool) -> None:
        columns = self._columns
        columns.state_trace.append(trace)
        columns.is_partial.append(is_partial)
        for sizes, atoms, codes in (
            (columns.true_sizes, columns.true_atoms, true),
            (columns.false_sizes, columns.false_atoms, false),
        ):
            array = np.fromiter(codes, dtype=np.int64)
            sizes.append(len(array))
            atoms.append(array)

    def _state(
        self, item: Item, source: "_Source", types: Mapping[int, str] | None
    ) -> tuple[list[int], list[int], bool]:
        if item.problem:
            source.fault(item.start, item.problem)
            return [], [], True
        body, denied = item.body, list[str]()
        if "not" in body.lower() and NEGATION.search(body):
            denied = NEGATION.findall(body)
            body = NEGATION.sub("", body)
        true = list(map(self._codes.__getitem__, LEAF.findall(body)))
        false = list(map(self._codes.__getitem__, denied))
        if min(true, default=0) < 0 or min(false, default=0) < 0:
            for text in (*LEAF.findall(body), *denied):
                code = self._codes[text]
                if code < 0:
                    source.fault(
                        item.start + max(item.body.find(f"({text})"), 0), self._codes.problems[-code - 1]
                    )
            true = [code for code in true if code >= 0]
            false = [code for code in false if code >= 0]
        if types is not None:
            true = self._fitting(true, item, source, types)
            false = self._fitting(false, item, source, types)
        return true, false, bool(denied)

    def _fitting(
        self, codes: list[int], item: Item, source: "_Source", types: Mapping[int, str]
    ) -> list[int]:
        """Codes of atoms whose objects are declared and of the right types."""
        self._judge(np.array(sorted(set(codes)), dtype=np.int64), source.verdicts, types)
        misfits = source.verdicts.misfits
        if not misfits or misfits.keys().isdisjoint(codes):
            return codes
        for code in sorted(misfits.keys() & set(codes)):
            source.fault(item.start, misfits[code])
        return [code for code in codes if code not in misfits]

    def _judge(self, codes: Codes, verdicts: "_Verdicts", types: Mapping[int, str]) -> None:
        """Find atoms whose objects are undeclared or of the wrong type, among codes not judged before."""
        n = len(self._codes.rows)
        if len(verdicts.is_seen) < n:
            verdicts.is_seen = np.r_[verdicts.is_seen, np.zeros(n - len(verdicts.is_seen), dtype=np.bool_)]
        unseen = codes[~verdicts.is_seen[codes]]
        if not len(unseen):
            return
        verdicts.is_seen[unseen] = True
        if len(self._table) < n:
            self._table = np.r_[
                self._table, _padded(self._codes.rows[len(self._table) :], self._table.shape[1])
            ]
        kind_of = np.full(len(self._objects) + 1, len(self._kinds))
        kind_of[list(types)] = [self._kinds[kind] for kind in types.values()]
        rows = self._table[unseen]
        # The column of a missing argument fits every kind; the row of an undeclared object fits nothing else.
        is_fit = self._fits[kind_of[rows[:, 1:]], self._wanted[rows[:, 0]]].all(axis=1)
        for code in unseen[~is_fit].tolist():
            verdicts.misfits[code] = self._misfit(self._codes.rows[code], types)

    def _misfit(self, key: tuple[int, ...], types: Mapping[int, str]) -> str:
        """What is wrong with an atom's objects."""
        signature = self.signatures.predicates[key[0]]
        for index, wanted in zip(key[1:], signature.argument_types, strict=True):
            kind = types.get(index)
            if kind is None:
                return f"undeclared object {self._name(index)!r} in an atom of {signature.name!r}"
            if not self._is_subtype(kind, wanted):
                return f"object {self._name(index)!r} is a {kind}; {signature.name!r} takes a {wanted}"
        return ""

    def _is_subtype(self, kind: str, wanted: str) -> bool:
        return bool(self._fits[self._kinds[kind], self._kinds[wanted]])

    def _name(self, index: int) -> str:
        if len(self._names) < len(self._objects):
            self._names = list(self._objects)
        return self._names[index]

    def _action(
        self, item: Item, source: "_Source", types: Mapping[int, str] | None
    ) -> tuple[int, tuple[int, ...]] | None:
        """The action's signature and objects, or nothing after telling the fault."""
        found, problem = self._parsed_action(item.body, types)
        if item.problem or problem:
            source.fault(item.start, item.problem or problem)
            return None
        return found

    def _parsed_action(
        self, body: str, types: Mapping[int, str] | None
    ) -> tuple[tuple[int, tuple[int, ...]] | None, str]:
        """The action's signature and objects, or what is wrong with them."""
        leaves = LEAF.findall(body)
        words = leaves[0].lower().split() if len(leaves) == 1 else []
        if not words:
            return None, f"expected one (action object …), found {short(body)!r}"
        index, signature = self._actions.get(words[0], (ABSENT, None))
        if signature is None:
            listed = ", ".join(sorted(each.name for each in self.signatures.actions)) or "none"
            return None, f"unknown action {words[0]!r}; declared: {listed}"
        wanted = len(signature.parameters)
        if len(words) - 1 != wanted:
            return None, f"action {signature.name!r} has {len(words) - 1} arguments; it takes {wanted}"
        codes = tuple(self._objects.setdefault(word, len(self._objects)) for word in words[1:])
        for code, parameter in zip(codes, signature.parameters, strict=True) if types is not None else ():
            kind = types.get(code) if types is not None else None
            if kind is None:
                return None, f"undeclared object {self._name(code)!r} in action {signature.name!r}"
            if not self._is_subtype(kind, parameter.type_name):
                place = f"{parameter.variable} of {signature.name!r}"
                return None, f"object {self._name(code)!r} is a {kind}; {place} takes a {parameter.type_name}"
        return (index, codes), ""

    def note(self, file: str, line: int, problem: str) -> None:
        """Keep a fault; the same one again in the same file only counts."""
        first, n = self._faults.get((file, problem), (line, 0))
        self._faults[file, problem] = (first, n + 1)

    @property
    def n_pending(self) -> int:
        """Atoms read since the last :meth:`take`, with repetitions: what memory is held for."""
        return sum(map(len, self._columns.true_atoms))

    def take(self) -> TraceSet:
        """Everything read since the last call, as tables, and forget it.

        Atoms and objects keep their codes: sets that one reader gave can be joined.
        """
        columns, self._columns = self._columns, _Columns()
        n_atoms = max(len(self._codes.rows), 1)
        states = np.arange(len(columns.state_trace))
        true = _distinct(np.repeat(states, columns.true_sizes) * n_atoms + _joined(columns.true_atoms))
        false = _distinct(np.repeat(states, columns.false_sizes) * n_atoms + _joined(columns.false_atoms))
        return TraceSet(
            signatures=self.signatures,
            trace_names=tuple(columns.trace_names),
            object_names=tuple(self._objects),
            atom_predicate=np.fromiter((key[0] for key in self._codes.rows), dtype=np.int64),
            atom_arguments=_padded([key[1:] for key in self._codes.rows]),
            state_trace=np.array(columns.state_trace, dtype=np.int64),
            is_partial=np.array(columns.is_partial, dtype=np.bool_),
            true_state=true // n_atoms,
            true_atom=true % n_atoms,
            false_state=false // n_atoms,
            false_atom=false % n_atoms,
            action_state=np.array(columns.action_state, dtype=np.int64),
            action_signature=np.array(columns.action_signature, dtype=np.int64),
            action_arguments=_padded(
                columns.action_arguments,
                max((len(each.parameters) for each in self.signatures.actions), default=0),
            ),
            declared_trace=np.array(columns.declared_trace, dtype=np.int64),
            declared_object=np.array(columns.declared_object, dtype=np.int64),
            declared_type=tuple(columns.declared_type),
        )


@dataclass
class _Verdicts:
    """What was found of atoms and actions under one set of declared objects."""

    is_seen: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    misfits: dict[int, str] = field(default_factory=dict)
    actions: dict[str, tuple[int, tuple[int, ...]]] = field(default_factory=dict)


class _Source:
    """One file's text, its items, and the verdicts on its atoms."""

    def __init__(self, text: str, file: str, reader: TraceReader) -> None:
        self.text, self.file, self._reader = text, file, reader
        self.n_faults = 0
        self.is_partial = False
        self.types: dict[int, str] | None = None
        self.verdicts = _Verdicts()
        self._line_ends: list[int] = []

    def fault(self, position: int, problem: str) -> None:
        self.n_faults += 1
        if not self._line_ends:
            self._line_ends = [match.start() for match in _LINE_END.finditer(self.text)] or [len(self.text)]
        self._reader.note(self.file, bisect.bisect_left(self._line_ends, position) + 1, problem)


def _distinct(codes: Codes) -> Codes:
    """Sorted, each once: by sorting, which for codes is several times as fast as hashing them."""
    ordered = np.sort(codes)
    is_new = np.ones(len(ordered), dtype=np.bool_)
    is_new[1:] = ordered[1:] != ordered[:-1]
    return ordered[is_new]


def _joined(parts: list[Codes]) -> Codes:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def _padded(rows: list[tuple[int, ...]], widest: int = 0) -> NDArray[np.int64]:
    widest = max(widest, max(map(len, rows), default=0))
    padding = [(ABSENT,) * (widest - n) for n in range(widest + 1)]
    flat = itertools.chain.from_iterable(row + padding[len(row)] for row in rows)
    return np.fromiter(flat, dtype=np.int64, count=len(rows) * widest).reshape(len(rows), widest)
