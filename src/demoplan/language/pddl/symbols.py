"""Names as logs have them, and the names that stand for them in PDDL text.

PDDL is not case-sensitive, and its readers disagree about what a name may hold. So every name of a domain and
a problem is mapped to one of the form ``[a-z][a-z0-9_-]*``: ``inHand`` becomes ``in_hand``, ``Right_hand``
becomes ``right_hand``. Names that have this form already stay as they are, so that domains made elsewhere
keep theirs; a name that has to change never takes a form that is in use. The map depends on the set of names
only, and can be read backwards.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache

from demoplan.errors import UnknownNameError
from demoplan.ids import content_hash
from demoplan.language.domains import Domain, Operator, Problem
from demoplan.language.types import ROOT

_MAX_LENGTH = 64
_PLAIN = re.compile(r"[a-z][a-z0-9_-]{0,63}")
_WORD_BREAK = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")

RESERVED = frozenset(
    {
        *("and", "or", "not", "imply", "forall", "exists", "when", "either", "object", "number"),
        *("increase", "decrease", "assign", "scale-up", "scale-down", "minimize", "maximize"),
        *("define", "domain", "problem", "total-cost", "total-time", "undefined"),
    }
)
"""Words that readers of PDDL do not take as names. Words that benchmark domains use, as ``at``, stay out."""


def slug(name: str) -> str:
    """The form ``[a-z][a-z0-9_-]*`` that is nearest to a name; distinct names may share one.

    >>> slug("inHand"), slug("Right_hand"), slug("HTTPServer2"), slug("3d mug")
    ('in_hand', 'right_hand', 'http_server2', 'n_3d_mug')
    """
    if _PLAIN.fullmatch(name):
        return name
    plain = re.sub(r"[^a-z0-9_-]+", "_", _WORD_BREAK.sub("_", name).lower())
    plain = re.sub(r"_+", "_", plain).strip("_")
    if not plain or not "a" <= plain[0] <= "z":
        plain = f"n_{plain}" if plain else "n"
    if len(plain) > _MAX_LENGTH:
        digest = content_hash(name.encode(errors="surrogatepass"))
        plain = f"{plain[: _MAX_LENGTH - 9]}_{digest[:8]}"
    return plain


@dataclass(frozen=True)
class SymbolMap:
    """A map from (kind, name) to PDDL name, and back to the name.

    ``entries`` holds (kind, name, PDDL name), sorted. Kinds are ``domain``, ``type``, ``predicate``,
    ``operator``, ``object``, ``problem`` and ``variable``.
    """

    entries: tuple[tuple[str, str, str], ...]

    @classmethod
    def of(cls, names: Iterable[tuple[str, str]], beside: "SymbolMap | None" = None) -> "SymbolMap":
        """Map (kind, name) pairs.

        Args:
            names: What to map. Where several names want one form, they are numbered in this order.
            beside: A map that goes before; what it changed a name to is not given to another name.
        """
        ordered = list(dict.fromkeys(names))
        blocked = {*RESERVED, *(symbol for symbol, _ in (beside.changed() if beside else ()))}
        used = {*blocked, *(beside.symbols if beside else ())}
        chosen: dict[tuple[str, str], str] = {}
        for pair in ordered:
            if _PLAIN.fullmatch(pair[1]) and pair[1] not in blocked:
                chosen[pair] = pair[1]
                used.add(pair[1])
        for pair in ordered:
            if pair in chosen:
                continue
            wanted = candidate = slug(pair[1])
            number = 0
            while candidate in used:
                number += 1
                candidate = f"{wanted}_{number}"
            chosen[pair] = candidate
            used.add(candidate)
        return cls(tuple(sorted((kind, name, symbol) for (kind, name), symbol in chosen.items())))

    @cached_property
    def _symbols(self) -> dict[tuple[str, str], str]:
        return {(kind, name): symbol for kind, name, symbol in self.entries}

    @cached_property
    def _names(self) -> dict[str, str]:
        return {symbol: name for _, name, symbol in self.entries}

    @cached_property
    def symbols(self) -> frozenset[str]:
        """Every PDDL name in use."""
        return frozenset(self._names)

    def symbol(self, kind: str, name: str) -> str:
        """The PDDL name that stands for a name.

        Raises:
            UnknownNameError: If there is no such name of that kind.
        """
        found = self._symbols.get((kind, name))
        if found is None:
            raise UnknownNameError(kind, name, (known for other, known in self._symbols if other == kind))
        return found

    def name(self, symbol: str) -> str:
        """The name that a PDDL name stands for; PDDL names are compared without case.

        Raises:
            UnknownNameError: If it stands for none.
        """
        found = self._names.get(symbol.lower())
        if found is None:
            raise UnknownNameError("PDDL name", symbol, self._names)
        return found

    def changed(self) -> tuple[tuple[str, str], ...]:
        """(PDDL name, name) pairs that differ, sorted."""
        return tuple(sorted((symbol, name) for _, name, symbol in self.entries if symbol != name))


@lru_cache(maxsize=32)
def domain_symbols(domain: Domain) -> SymbolMap:
    """The names of a domain."""
    names = [("type", name) for name in domain.types.names if name != ROOT]
    names += [("predicate", name) for name in sorted({signature.name for signature in domain.predicates})]
    names += [("operator", name) for name in sorted({operator.name for operator in domain.operators})]
    names += [("object", name) for name in sorted({name for name, _ in domain.constants})]
    names.append(("domain", domain.name))
    return SymbolMap.of(names)


def problem_symbols(problem: Problem, domain: SymbolMap) -> SymbolMap:
    """The names of a domain, and those of a problem's objects beside them."""
    constants = {name for kind, name, _ in domain.entries if kind == "object"}
    names = [("object", name) for name in sorted({name for name, _ in problem.objects} - constants)]
    names.append(("problem", problem.name))
    added = SymbolMap.of(names, beside=domain)
    return SymbolMap(tuple(sorted((*domain.entries, *added.entries))))


def variable_symbols(operator: Operator) -> SymbolMap:
    """The variables of an operator, without their question marks."""
    return SymbolMap.of(
        ("variable", parameter.variable.removeprefix("?")) for parameter in operator.parameters
    )
