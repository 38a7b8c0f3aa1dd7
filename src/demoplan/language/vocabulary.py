"""A vocabulary: the types and predicates that a user may extend without touching code.

The file form is YAML (see ``schemas/vocabularies``); ``demoplan.manifests`` parses it into these values.
"""

from dataclasses import dataclass

from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy


@dataclass(frozen=True)
class PredicateRule:
    """How a predicate is seen: a named geometric definition and its numbers.

    ``definition`` names a function of ``demoplan.stages.perceive``; ``numbers`` are its thresholds with the
    unit in each name (``enter_m``, ``exit_m``, ``speed_m_per_s``), sorted by name. Hysteresis: an atom
    begins to hold at its ``enter`` number and ceases at its ``exit`` number.
    """

    signature: Signature
    definition: str
    numbers: tuple[tuple[str, float], ...] = ()
    description: str = ""
    source: str = ""


@dataclass(frozen=True)
class Shape:
    """The extent of a type's bodies, about the body's origin, in its own axes, in metres."""

    kind: str
    """``box``, ``cylinder``, ``sphere`` or ``point``."""
    size_xyz_m: tuple[float, float, float]
    """Full extents along the body's axes; a cylinder stands along z."""
    centre_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the body's middle lies, seen from the tracked origin."""


@dataclass(frozen=True)
class Vocabulary:
    """Types, shapes of types, and predicates with their definitions."""

    types: TypeHierarchy
    predicates: tuple[PredicateRule, ...]
    shapes: tuple[tuple[str, Shape], ...] = ()
    """(type, shape) pairs, sorted; a type without one takes its nearest ancestor's."""
