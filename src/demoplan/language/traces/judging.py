"""Atoms and actions of traces to codes, and which of them do not fit the signatures or a trace's objects."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from demoplan.language.traces.scanning import LEAF, short
from demoplan.language.traces.values import ABSENT, Codes, Signatures, padded
from demoplan.language.types import ROOT

Action = tuple[int, tuple[int, ...]]
"""An action's signature and its objects."""


@dataclass
class Declared:
    """Objects of a trace with their types, and what was found of atoms and actions under them.

    Traces often share their objects: what was found then holds for all of them.
    """

    types: dict[int, str]
    is_seen: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    """By atom: whether it was judged."""
    misfits: dict[int, str] = field(default_factory=dict)
    """What is wrong, by atom."""
    actions: dict[str, Action] = field(default_factory=dict)
    """Actions without fault, by their text."""


class AtomCodes(dict[str, int]):
    """Codes of atoms by their text; a text that is no atom of the domain has a negative code."""

    def __init__(self, signatures: Signatures) -> None:
        """Start without atoms."""
        super().__init__()
        self.predicates = {each.name.lower(): (n, each) for n, each in enumerate(signatures.predicates)}
        self.listed = ", ".join(sorted(each.name for each in signatures.predicates)) or "none"
        self.objects: dict[str, int] = {}
        """Codes of objects by their names."""
        self.atoms: dict[tuple[int, ...], int] = {}
        self.problems: list[str] = []
        """What is wrong with the texts whose codes are -1, -2, …"""
        self.rows: list[tuple[int, ...]] = []
        """Predicate and objects of each atom."""

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


class Judge:
    """Tells which atoms and actions do not fit a trace's objects."""

    def __init__(self, signatures: Signatures, codes: AtomCodes) -> None:
        """Look up types once.

        Args:
            signatures: What predicates and actions there are.
            codes: Atoms as they are read; grows meanwhile.
        """
        self._signatures, self._codes = signatures, codes
        self._names: list[str] = []
        self._actions = {each.name.lower(): (n, each) for n, each in enumerate(signatures.actions)}
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

    def judge(self, codes: Codes, declared: Declared) -> None:
        """Find atoms whose objects are undeclared or of the wrong type, among codes not judged before."""
        n = len(self._codes.rows)
        if len(declared.is_seen) < n:
            declared.is_seen = np.r_[declared.is_seen, np.zeros(n - len(declared.is_seen), dtype=np.bool_)]
        is_met = np.zeros(n, dtype=np.bool_)
        is_met[codes] = True
        unseen = np.flatnonzero(is_met & ~declared.is_seen)
        if not len(unseen):
            return
        declared.is_seen[unseen] = True
        if len(self._table) < n:
            self._table = np.r_[
                self._table, padded(self._codes.rows[len(self._table) :], self._table.shape[1])
            ]
        kind_of = np.full(len(self._codes.objects) + 1, len(self._kinds))
        kind_of[list(declared.types)] = [self._kinds[kind] for kind in declared.types.values()]
        rows = self._table[unseen]
        # The column of a missing argument fits every kind; the row of an undeclared object fits nothing else.
        is_fit = self._fits[kind_of[rows[:, 1:]], self._wanted[rows[:, 0]]].all(axis=1)
        for code in unseen[~is_fit].tolist():
            declared.misfits[code] = self._misfit(self._codes.rows[code], declared.types)

    def _misfit(self, key: tuple[int, ...], types: Mapping[int, str]) -> str:
        """What is wrong with an atom's objects."""
        signature = self._signatures.predicates[key[0]]
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
        if len(self._names) < len(self._codes.objects):
            self._names = list(self._codes.objects)
        return self._names[index]

    def action(self, body: str, declared: Declared | None) -> tuple[Action | None, str]:
        """The action's signature and objects, or what is wrong with them."""
        leaves = LEAF.findall(body)
        words = leaves[0].lower().split() if len(leaves) == 1 else []
        if not words:
            return None, f"expected one (action object …), found {short(body)!r}"
        index, signature = self._actions.get(words[0], (ABSENT, None))
        if signature is None:
            listed = ", ".join(sorted(each.name for each in self._signatures.actions)) or "none"
            return None, f"unknown action {words[0]!r}; declared: {listed}"
        wanted = len(signature.parameters)
        if len(words) - 1 != wanted:
            return None, f"action {signature.name!r} has {len(words) - 1} arguments; it takes {wanted}"
        objects = self._codes.objects
        codes = tuple(objects.setdefault(word, len(objects)) for word in words[1:])
        if declared is None:
            return (index, codes), ""
        for code, parameter in zip(codes, signature.parameters, strict=True):
            kind = declared.types.get(code)
            if kind is None:
                return None, f"undeclared object {self._name(code)!r} in action {signature.name!r}"
            if not self._is_subtype(kind, parameter.type_name):
                place = f"{parameter.variable} of {signature.name!r}"
                return None, f"object {self._name(code)!r} is a {kind}; {place} takes a {parameter.type_name}"
        return (index, codes), ""
