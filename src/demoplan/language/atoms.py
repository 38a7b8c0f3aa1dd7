"""Atoms and literals: a predicate over names, and its negation."""

import re
from dataclasses import dataclass

from demoplan.errors import PddlError

_ATOM = re.compile(r"\s*([A-Za-z][\w-]*)\s*\(\s*([^()]*?)\s*\)\s*")


@dataclass(frozen=True, order=True)
class Atom:
    """A predicate over names; ground if the names are instances, lifted if they are ``?variables``."""

    predicate: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Canonical text: ``inHand(Right_hand,Cube_green1)``."""
        return f"{self.predicate}({','.join(self.arguments)})"

    @classmethod
    def parse(cls, text: str) -> "Atom":
        """The atom that canonical text names.

        >>> Atom.parse("onTop(a, b)")
        Atom(predicate='onTop', arguments=('a', 'b'))

        Raises:
            PddlError: If the text is not ``predicate(name, …)``.
        """
        match = _ATOM.fullmatch(text)
        if match is None:
            raise PddlError(
                f"not an atom: {text!r}; expected predicate(name, …), as in onTop(cube_red, table)"
            )
        names = tuple(name.strip() for name in match[2].split(",")) if match[2] else ()
        if any(not name for name in names):
            raise PddlError(f"empty argument in atom {text!r}")
        return cls(match[1], names)

    def substitute(self, names: dict[str, str]) -> "Atom":
        """The same atom with arguments renamed; names that are not keys stay."""
        return Atom(self.predicate, tuple(names.get(name, name) for name in self.arguments))


@dataclass(frozen=True, order=True)
class Literal:
    """An atom, or its negation."""

    atom: Atom
    is_positive: bool = True

    def __str__(self) -> str:
        """Canonical text: ``not onTop(a,b)`` for a negated literal."""
        return str(self.atom) if self.is_positive else f"not {self.atom}"

    def negated(self) -> "Literal":
        """The opposite literal."""
        return Literal(self.atom, not self.is_positive)

    def substitute(self, names: dict[str, str]) -> "Literal":
        """The same literal with arguments renamed."""
        return Literal(self.atom.substitute(names), self.is_positive)
