"""Trace files to codes: one pass of compiled expressions over a text, names looked up once each.

A trace of a million states has tens of millions of atoms, so no value is made per atom: the innermost lists
of a state are found by one expression and looked up by their text. Lines are counted only for what is wrong.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from demoplan.language.traces.values import ABSENT, ActionSignature, Codes, Fault, Signatures, TraceSet
from demoplan.language.types import ROOT

_ITEM = re.compile(r"\(\s*(:state|:init|:action|:operator|operator:)(?=[\s()])", re.IGNORECASE)
_HEAD = re.compile(r"\s*\(\s*(?::?(?:trajectory|observation))?\s*", re.IGNORECASE)
_PARTIAL_HEAD = re.compile(
    r"\s*\(\s*(?::?(?:trajectory|observation))?\s*\(?\s*:partial\s*\)?\s*", re.IGNORECASE
)
_LEAF = re.compile(r"\(([^()]*)\)")
_NEGATION = re.compile(r"\(\s*not\s*\(([^()]*)\)\s*\)", re.IGNORECASE)
_CONJUNCTION = re.compile(r"\s*\(\s*and(?=[\s()])", re.IGNORECASE)
_COMMENT = re.compile(r";[^\n]*")
_MAX_TEXT = 60


@dataclass(frozen=True)
class _Item:
    """A state or an action as it stands in the text."""

    is_action: bool
    start: int
    """Where its contents begin."""
    body: str
    problem: str = ""


class _Codes(dict[str, int]):
    """Codes of atoms by their text; a text that is no atom of the domain has a negative code."""

    def __init__(self, signatures: Signatures, objects: dict[str, int]) -> None:
        super().__init__()
        self.predicates = {each.name.lower(): (n, each) for n, each in enumerate(signatures.predicates)}
        self.listed = ", ".join(sorted(each.name for each in signatures.predicates)) or "none"
        self.objects = objects
        self.atoms: dict[tuple[int, ...], int] = {}
        self.problems: list[str] = []

    def __missing__(self, text: str) -> int:
        words = text.lower().split()
        index, signature = self.predicates.get(words[0] if words else "", (ABSENT, None))
        if signature is None:
            problem = f"unknown predicate in ({_short(text)}); declared: {self.listed}"
        elif len(words) - 1 != len(signature.argument_types):
            wanted = len(signature.argument_types)
            problem = f"({_short(text)}) has {len(words) - 1} arguments; {signature.name!r} takes {wanted}"
        else:
            key = (index, *(self.objects.setdefault(word, len(self.objects)) for word in words[1:]))
            self[text] = code = self.atoms.setdefault(key, len(self.atoms))
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
        self._fits: dict[tuple[str, str], bool] = {}

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
        source = _Source(
            _COMMENT.sub(lambda match: " " * len(match[0]), text) if ";" in text else text, file, self
        )
        types = None if objects is None else self._declare(objects, source)
        self._sequence(source, types)

    def _declare(self, objects: Mapping[str, str], source: "_Source") -> dict[int, str]:
        declared = {name.lower(): kind for name, kind in (*self.signatures.constants, *objects.items())}
        types: dict[int, str] = {}
        for name, kind in declared.items():
            types[self._objects.setdefault(name, len(self._objects))] = kind
        source.types = types
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

    def _sequence(self, source: "_Source", types: Mapping[int, str] | None) -> None:
        """States and actions in turn; a break starts a new trace."""
        columns = self._columns
        n_states, n_actions = 0, 0
        trace = ABSENT
        last = "nothing"
        for item in source.items():
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
            array = np.unique(np.fromiter(codes, dtype=np.int64))
            sizes.append(len(array))
            atoms.append(array)

    def _state(
        self, item: _Item, source: "_Source", types: Mapping[int, str] | None
    ) -> tuple[list[int], list[int], bool]:
        if item.problem:
            source.fault(item.start, item.problem)
            return [], [], True
        body, denied = item.body, list[str]()
        if "not" in body.lower() and _NEGATION.search(body):
            denied = _NEGATION.findall(body)
            body = _NEGATION.sub("", body)
        true = list(map(self._codes.__getitem__, _LEAF.findall(body)))
        false = list(map(self._codes.__getitem__, denied))
        if min(true, default=0) < 0 or min(false, default=0) < 0:
            for text in (*_LEAF.findall(body), *denied):
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
        self, codes: list[int], item: _Item, source: "_Source", types: Mapping[int, str]
    ) -> list[int]:
        """Codes of atoms whose objects are declared and of the right types."""
        unseen = set(codes).difference(source.verdicts)
        if unseen:
            keys = source.keys_of(self._codes.atoms)
            for code in unseen:
                source.verdicts[code] = self._misfit(keys[code], types)
        misfits = source.misfits()
        if not misfits or not misfits.intersection(codes):
            return codes
        for code in sorted(misfits.intersection(codes)):
            source.fault(item.start, source.verdicts[code])
        return [code for code in codes if code not in misfits]

    def _misfit(self, key: tuple[int, ...], types: Mapping[int, str]) -> str:
        """What is wrong with an atom's objects; empty if nothing is."""
        signature = self.signatures.predicates[key[0]]
        for index, wanted in zip(key[1:], signature.argument_types, strict=True):
            kind = types.get(index)
            if kind is None:
                return f"undeclared object {self._name(index)!r} in an atom of {signature.name!r}"
            if not self._is_subtype(kind, wanted):
                return f"object {self._name(index)!r} is a {kind}; {signature.name!r} takes a {wanted}"
        return ""

    def _is_subtype(self, kind: str, wanted: str) -> bool:
        key = (kind, wanted)
        if key not in self._fits:
            self._fits[key] = wanted == ROOT or self.signatures.types.is_subtype(kind, wanted)
        return self._fits[key]

    def _name(self, index: int) -> str:
        if len(self._names) < len(self._objects):
            self._names = list(self._objects)
        return self._names[index]

    def _action(
        self, item: _Item, source: "_Source", types: Mapping[int, str] | None
    ) -> tuple[int, tuple[int, ...]] | None:
        """The action's signature and objects, or nothing after telling the fault."""
        leaves = _LEAF.findall(item.body)
        words = leaves[0].lower().split() if len(leaves) == 1 else []
        index, signature = self._actions.get(words[0] if words else "", (ABSENT, None))
        if item.problem or not words:
            source.fault(
                item.start, item.problem or f"expected one (action object …), found {_short(item.body)!r}"
            )
            return None
        if signature is None:
            listed = ", ".join(sorted(each.name for each in self.signatures.actions)) or "none"
            source.fault(item.start, f"unknown action {words[0]!r}; declared: {listed}")
            return None
        problem = _action_misfit(signature, words[1:])
        if problem:
            source.fault(item.start, problem)
            return None
        codes = tuple(self._objects.setdefault(word, len(self._objects)) for word in words[1:])
        if types is not None:
            for code, parameter in zip(codes, signature.parameters, strict=True):
                kind = types.get(code)
                if kind is None:
                    source.fault(
                        item.start, f"undeclared object {self._name(code)!r} in action {signature.name!r}"
                    )
                    return None
                if not self._is_subtype(kind, parameter.type_name):
                    source.fault(
                        item.start,
                        f"object {self._name(code)!r} is a {kind}; {parameter.variable} of {signature.name!r}"
                        f" takes a {parameter.type_name}",
                    )
                    return None
        return index, codes

    def note(self, file: str, line: int, problem: str) -> None:
        """Keep a fault; the same one again in the same file only counts."""
        first, n = self._faults.get((file, problem), (line, 0))
        self._faults[file, problem] = (first, n + 1)

    def result(self) -> TraceSet:
        """Everything read so far, as tables."""
        columns = self._columns
        states = np.arange(len(columns.state_trace))
        return TraceSet(
            signatures=self.signatures,
            trace_names=tuple(columns.trace_names),
            object_names=tuple(self._objects),
            atom_predicate=np.fromiter((key[0] for key in self._codes.atoms), dtype=np.int64),
            atom_arguments=_padded([key[1:] for key in self._codes.atoms]),
            state_trace=np.array(columns.state_trace, dtype=np.int64),
            is_partial=np.array(columns.is_partial, dtype=np.bool_),
            true_state=np.repeat(states, columns.true_sizes),
            true_atom=_joined(columns.true_atoms),
            false_state=np.repeat(states, columns.false_sizes),
            false_atom=_joined(columns.false_atoms),
            action_state=np.array(columns.action_state, dtype=np.int64),
            action_signature=np.array(columns.action_signature, dtype=np.int64),
            action_arguments=_padded(columns.action_arguments),
            declared_trace=np.array(columns.declared_trace, dtype=np.int64),
            declared_object=np.array(columns.declared_object, dtype=np.int64),
            declared_type=tuple(columns.declared_type),
        )


class _Source:
    """One file's text, its items, and the verdicts on its atoms."""

    def __init__(self, text: str, file: str, reader: TraceReader) -> None:
        self.text, self.file, self._reader = text, file, reader
        self.n_faults = 0
        self.is_partial = False
        self.types: dict[int, str] | None = None
        self.verdicts: dict[int, str] = {}
        self._misfits: tuple[int, set[int]] = (0, set())
        self._keys: list[tuple[int, ...]] = []

    def fault(self, position: int, problem: str) -> None:
        self.n_faults += 1
        self._reader.note(self.file, self.text.count("\n", 0, position) + 1, problem)

    def keys_of(self, atoms: dict[tuple[int, ...], int]) -> list[tuple[int, ...]]:
        if len(self._keys) < len(atoms):
            self._keys = list(atoms)
        return self._keys

    def misfits(self) -> set[int]:
        n_known, found = self._misfits
        if n_known != len(self.verdicts):
            found = {code for code, problem in self.verdicts.items() if problem}
            self._misfits = (len(self.verdicts), found)
        return found

    def items(self) -> Iterator[_Item]:
        """States and actions in order; what stands between them must be brackets that close."""
        openers = list(_ITEM.finditer(self.text))
        head = self.text[: openers[0].start()] if openers else self.text
        self.is_partial = _PARTIAL_HEAD.fullmatch(head) is not None
        if head.strip() and not self.is_partial and not _HEAD.fullmatch(head):
            self.fault(len(head) - len(head.lstrip()), f"expected (:trajectory …), found {_short(head)!r}")
        for n, opener in enumerate(openers):
            is_last = n + 1 == len(openers)
            body = self.text[opener.end() : len(self.text) if is_last else openers[n + 1].start()]
            is_action = opener[1].lower() in {":action", ":operator", "operator:"}
            yield _Item(is_action, opener.end(), body, _malformed(body, is_last=is_last))


def _malformed(body: str, *, is_last: bool) -> str:
    """What is wrong with the brackets of an item; empty if nothing is."""
    rest = _LEAF.sub("", body).strip()
    if rest == ")" or (is_last and rest.replace(")", "").strip() == "" and rest.count(")") == 2):
        return ""
    rest = _LEAF.sub("", _NEGATION.sub("", body))
    conjunction = _CONJUNCTION.match(rest)
    extra = (1 if conjunction else 0) + (1 if is_last else 0)
    rest = "".join((rest[conjunction.end() :] if conjunction else rest).split())
    if rest.strip(")"):
        return f"not an atom: {_short(rest.replace(')', ' ').strip())!r}"
    missing = 1 + extra - len(rest)
    return "" if missing == 0 else ("'(' is never closed" if missing > 0 else "')' without a '(' before it")


def _action_misfit(signature: ActionSignature, words: list[str]) -> str:
    wanted = len(signature.parameters)
    if len(words) == wanted:
        return ""
    return f"action {signature.name!r} has {len(words)} arguments; it takes {wanted}"


def _short(text: str) -> str:
    words = " ".join(text.split())
    return words if len(words) <= _MAX_TEXT else words[: _MAX_TEXT - 1] + "…"


def _joined(parts: list[Codes]) -> Codes:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)


def _padded(rows: list[tuple[int, ...]]) -> NDArray[np.int64]:
    widest = max(map(len, rows), default=0)
    flat = [code for row in rows for code in (*row, *(ABSENT,) * (widest - len(row)))]
    return np.array(flat, dtype=np.int64).reshape(len(rows), widest)
