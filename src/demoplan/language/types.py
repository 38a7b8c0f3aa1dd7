"""The hierarchy of object types."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from demoplan.errors import DataError, UnknownNameError

ROOT = "object"


@dataclass(frozen=True)
class TypeHierarchy:
    """A tree of types below ``object``; ``parents`` holds (type, parent) pairs, sorted by type."""

    parents: tuple[tuple[str, str], ...]

    @classmethod
    def of(cls, parents: Mapping[str, str]) -> "TypeHierarchy":
        """A hierarchy from ``{type: parent}``; parents that are not listed stand below ``object``.

        Raises:
            DataError: If the parents form a circle.
        """
        full = {name: parent for name, parent in parents.items() if name != ROOT}
        for parent in list(full.values()):
            if parent != ROOT:
                full.setdefault(parent, ROOT)
        hierarchy = cls(tuple(sorted(full.items())))
        for name in full:
            seen = {name}
            for ancestor in hierarchy._climb(name):
                if ancestor in seen:
                    raise DataError(f"type {name!r} is its own ancestor, through {ancestor!r}")
                seen.add(ancestor)
        return hierarchy

    @cached_property
    def _parent_of(self) -> dict[str, str]:
        return dict(self.parents)

    def _climb(self, name: str) -> Iterator[str]:
        while name != ROOT:
            name = self._parent_of[name]
            yield name

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Every type but the root, sorted."""
        return tuple(sorted(self._parent_of))

    def require(self, name: str) -> str:
        """The name itself, if it is a type.

        Raises:
            UnknownNameError: If it is not.
        """
        if name != ROOT and name not in self._parent_of:
            raise UnknownNameError("type", name, (ROOT, *self.names))
        return name

    def ancestors(self, name: str) -> tuple[str, ...]:
        """The type itself, then its parents, up to and with ``object``."""
        self.require(name)
        return (name, *self._climb(name))

    def is_subtype(self, name: str, of: str) -> bool:
        """Whether ``name`` is ``of`` or stands below it.

        >>> TypeHierarchy.of({"Cube": "Graspable"}).is_subtype("Cube", "Graspable")
        True
        """
        return of in self.ancestors(name)

    def children(self, name: str) -> tuple[str, ...]:
        """Direct subtypes, sorted."""
        return tuple(child for child, parent in self.parents if parent == name)

    def common_ancestor(self, *names: str) -> str:
        """The lowest type that all of ``names`` are subtypes of."""
        first, *rest = names
        for candidate in self.ancestors(first):
            if all(self.is_subtype(other, candidate) for other in rest):
                return candidate
        return ROOT
