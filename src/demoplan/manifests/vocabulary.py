"""Vocabulary files: types, their shapes, and predicates with their thresholds, from YAML to values."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from demoplan.errors import DataError, ManifestError
from demoplan.language.domains import Signature
from demoplan.language.types import ROOT, TypeHierarchy
from demoplan.language.vocabulary import PredicateRule, Shape, Vocabulary
from demoplan.manifests.loading import load_yaml
from demoplan.manifests.mapping import Strict

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]*$")]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Length = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]


class ShapeEntry(Strict):
    """Extent of a type's bodies."""

    kind: Literal["box", "cylinder", "sphere", "point"] = "box"
    size_xyz_m: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Full extents along the body's axes [m]; a cylinder stands along z, x and y are its diameter."""
    centre_xyz_m: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """Where the body's middle lies, seen from the tracked origin [m]."""


class TypeEntry(Strict):
    """A type of objects."""

    parent: Name = ROOT
    shape: ShapeEntry | None = None
    """Extent; a type without one takes its nearest ancestor's."""
    description: str = ""


class PredicateEntry(Strict):
    """A predicate and how it is seen."""

    arguments: tuple[Name, ...]
    """Types of the arguments, in order."""
    definition: Name
    """Geometric definition that it is an instance of."""
    numbers: dict[str, Finite] = Field(default={})
    """Thresholds of the definition; the unit stands in each name."""
    description: str = ""
    source: str = ""
    """Where the numbers come from."""


class VocabularyFile(Strict):
    """The form of a vocabulary file."""

    name: Name
    description: str = ""
    types: dict[Name, TypeEntry]
    predicates: dict[Name, PredicateEntry]


def parse_vocabulary(text: str, path: Path | str) -> Vocabulary:
    """The vocabulary that a file describes. That its definitions exist, ``perceive`` checks.

    Args:
        text: Content of the file, YAML.
        path: Where it comes from, for messages.

    Raises:
        ManifestError: If its form is wrong, a type does not exist, types form a circle, or a hysteresis is
            the wrong way round.
    """
    file = load_yaml(text, path, VocabularyFile)
    lines = text.splitlines()

    def refuse(problem: str, word: str) -> ManifestError:
        line = next((number for number, line in enumerate(lines, 1) if word in line), None)
        return ManifestError(path, line, problem)

    known = {ROOT, *file.types}
    for name, entry in file.types.items():
        if name == ROOT:
            raise refuse(f"types: {ROOT!r} is the root of all types and cannot be declared", f"{ROOT}:")
        if entry.parent not in known:
            raise refuse(
                f"types.{name}: parent {entry.parent!r} is not a type; types: {', '.join(sorted(known))}",
                entry.parent,
            )
    try:
        types = TypeHierarchy.of({name: entry.parent for name, entry in file.types.items()})
    except DataError as error:
        raise ManifestError(path, None, f"types: {error}") from None
    for name, predicate in file.predicates.items():
        for argument in predicate.arguments:
            if argument not in known:
                raise refuse(
                    f"predicates.{name}: argument type {argument!r} is not a type; "
                    f"types: {', '.join(sorted(known))}",
                    argument,
                )
    return Vocabulary(
        types=types,
        predicates=tuple(
            PredicateRule(
                signature=Signature(name, entry.arguments),
                definition=entry.definition,
                numbers=tuple(sorted(entry.numbers.items())),
                description=entry.description,
                source=entry.source,
            )
            for name, entry in sorted(file.predicates.items())
        ),
        shapes=tuple(
            (name, Shape(entry.shape.kind, entry.shape.size_xyz_m, entry.shape.centre_xyz_m))
            for name, entry in sorted(file.types.items())
            if entry.shape is not None
        ),
    )
