"""Faults files: what goes wrong in an execution, when, and how badly.

A fault of the world happens once, when the step that its ``at`` names has run for ``delay_s``. A fault of the
operator model changes the domain that is planned with, from the start.
"""

from pathlib import Path
from typing import Annotated, TypeAlias
from typing import Literal as Choice

from pydantic import Field, field_validator

from demoplan.errors import PddlError
from demoplan.language.atoms import Atom, Literal
from demoplan.manifests.dataset import SafeName
from demoplan.manifests.loading import load_yaml, read_text
from demoplan.manifests.mapping import Strict

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class When(Strict):
    """The moment at which a fault of the world happens."""

    activity: str = "Put"
    occurrence: int = Field(default=1, ge=1)
    """Which step of that activity, counted over the run."""
    delay_s: float = Field(default=0.0, ge=0.0)
    """After its dispatch."""


class _Fault(Strict):
    name: SafeName
    severity: Choice["mild", "moderate", "severe"] = "moderate"
    at: When = When()


class PlacingOffsetFault(_Fault):
    """The next object that is put down comes down beside the aim, in a direction drawn from the seed."""

    kind: Choice["placing_offset"]
    offset_m: Positive


class SlipFault(_Fault):
    """The fingers lose their friction for a while."""

    kind: Choice["slip"]
    duration_s: Positive = 1.0
    friction: Positive = 0.02
    at: When = When(delay_s=0.8)


class DropFault(_Fault):
    """The hand opens by itself."""

    kind: Choice["drop"]
    at: When = When(delay_s=0.8)


class BlockedPathFault(_Fault):
    """A box stands between the hand and where it is going; the robot does not know of it."""

    kind: Choice["blocked_path"]
    size_m: Positive = 0.10
    duration_s: Positive = 3.0
    is_seen: bool = False


class FlippedPredicateFault(_Fault):
    """Perception says the opposite about one predicate of the step's object."""

    kind: Choice["flipped_predicate"]
    predicate: str
    duration_s: Positive = 1.0


class StalePredicateFault(_Fault):
    """Perception goes on to say what it said about one predicate of the step's object."""

    kind: Choice["stale_predicate"]
    predicate: str
    duration_s: Positive = 4.0


class SensorBiasFault(_Fault):
    """Sensors see the step's object beside where it is."""

    kind: Choice["sensor_bias"]
    offset_m: Positive
    duration_s: Positive = 1.0


class SensorBlindFault(_Fault):
    """Sensors do not see the step's object."""

    kind: Choice["sensor_blind"]
    duration_s: Positive = 1.0


class WrongLiteralFault(_Fault):
    """An operator says something that is not so, or lacks something that is."""

    kind: Choice["wrong_precondition", "wrong_effect"]
    activity: str
    """Every operator of this activity is changed."""
    literal: str
    """In the operator's own variables: ``not handOpen(?hand)``."""
    change: Choice["add", "drop"] = "add"

    @field_validator("literal")
    @classmethod
    def _is_a_literal(cls, text: str) -> str:
        try:
            literal_of(text)
        except PddlError as error:
            raise ValueError(str(error)) from None
        return text


class ObjectMovedFault(_Fault):
    """Somebody puts an object elsewhere on the table."""

    kind: Choice["object_moved"]
    which: Choice["thing", "support", "other"] = "thing"
    """The step's object, what it is to be put on, or one that no step of the plan speaks of."""
    distance_m: Positive = 0.15


class ObjectRemovedFault(_Fault):
    """Somebody takes an object away for good."""

    kind: Choice["object_removed"]
    which: Choice["thing", "support", "other"] = "thing"


AnyFault: TypeAlias = Annotated[
    PlacingOffsetFault
    | SlipFault
    | DropFault
    | BlockedPathFault
    | FlippedPredicateFault
    | StalePredicateFault
    | SensorBiasFault
    | SensorBlindFault
    | WrongLiteralFault
    | ObjectMovedFault
    | ObjectRemovedFault,
    Field(discriminator="kind"),
]


class FaultsFile(Strict):
    """The form of a faults file."""

    faults: tuple[AnyFault, ...]


def parse_faults(text: str, path: Path | str) -> tuple[AnyFault, ...]:
    """The faults that a file describes.

    Raises:
        ManifestError: If its form is wrong, or a name is used twice; with the line.
    """
    return load_yaml(text, path, FaultsFile, unique={"faults": "name"}).faults


def read_faults(path: Path) -> tuple[AnyFault, ...]:
    """The faults that a file describes; see :func:`parse_faults`."""
    return parse_faults(read_text(path), path)


def literal_of(text: str) -> Literal:
    """The literal that a text says, in variables.

    Raises:
        PddlError: If it says none.
    """
    bare = text.strip()
    is_positive = not bare.startswith("not ")
    bare = bare if is_positive else bare[4:].strip().removeprefix("(").removesuffix(")")
    predicate, bracket, names = bare.removesuffix(")").partition("(")
    if not bracket:
        raise PddlError(f"not an atom: {text!r}; expected predicate(?variable, …), as in clear(?to)")
    plain = Atom.parse(f"{predicate}({names.replace('?', '')})")
    arguments = tuple(part.strip() for part in names.split(",")) if names.strip() else ()
    return Literal(Atom(plain.predicate, arguments), is_positive)
