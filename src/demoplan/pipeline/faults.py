"""Faults to inject, from a file; each with its true class and severity, which no monitor gets to see.

A fault of the world happens once, when the step that its ``at`` names has run for ``delay_s``. A fault of the
operator model changes the domain that is planned with, from the start.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeAlias
from typing import Literal as Choice

import numpy as np
from pydantic import Field

from demoplan.engines.mujoco.scene import free_spot
from demoplan.engines.mujoco.session import (
    Fault,
    GripSlips,
    ObjectDropped,
    ObjectMoved,
    ObjectRemoved,
    PathBlocked,
    PlacingOffset,
    SensorBiased,
    SensorBlind,
    Session,
)
from demoplan.errors import ManifestError, PddlError, UnknownNameError, UsageError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain
from demoplan.manifests.loading import load_yaml
from demoplan.manifests.mapping import Strict
from demoplan.stages.diagnose import FailureClass

SafeName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$")]
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
    is_recoverable: bool = True
    """Whether the goal can still be reached by what the domain and the robot can do."""
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
    is_recoverable: bool = False


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

CLASS_OF_KIND: Mapping[str, FailureClass] = {
    "placing_offset": "execution_offset",
    "slip": "execution_offset",
    "drop": "execution_offset",
    "blocked_path": "motion",
    "flipped_predicate": "perception",
    "stale_predicate": "perception",
    "sensor_bias": "perception",
    "sensor_blind": "perception",
    "wrong_precondition": "operator_model",
    "wrong_effect": "operator_model",
    "object_moved": "exogenous",
    "object_removed": "exogenous",
}
"""The true class of each kind of fault."""


class FaultsFile(Strict):
    """The form of a faults file."""

    faults: tuple[AnyFault, ...]


def parse_faults(text: str, path: Path | str) -> tuple[AnyFault, ...]:
    """The faults that a file describes.

    Raises:
        ManifestError: If its form is wrong, or a name is used twice; with the line.
    """
    faults = load_yaml(text, path, FaultsFile).faults
    names: set[str] = set()
    for fault in faults:
        if fault.name in names:
            lines = [n for n, line in enumerate(text.splitlines(), 1) if fault.name in line]
            raise ManifestError(path, lines[-1] if lines else None, f"fault {fault.name!r} is named twice")
        names.add(fault.name)
        if isinstance(fault, WrongLiteralFault):
            try:
                _literal(fault.literal)
            except PddlError as error:
                line = next((n for n, row in enumerate(text.splitlines(), 1) if fault.literal in row), None)
                raise ManifestError(path, line, f"fault {fault.name!r}: {error}") from None
    return faults


def read_faults(path: Path) -> tuple[AnyFault, ...]:
    """The faults that a file describes; see :func:`parse_faults`."""
    try:
        return parse_faults(path.read_text(encoding="utf-8"), path)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: cannot be read: {error}") from None


def _literal(text: str) -> Literal:
    bare = text.strip()
    is_positive = not bare.startswith("not ")
    bare = bare if is_positive else bare[4:].strip().removeprefix("(").removesuffix(")")
    predicate, bracket, names = bare.removesuffix(")").partition("(")
    if not bracket:
        raise PddlError(f"not an atom: {text!r}; expected predicate(?variable, …), as in clear(?to)")
    plain = Atom.parse(f"{predicate}({names.replace('?', '')})")
    arguments = tuple(part.strip() for part in names.split(",")) if names.strip() else ()
    return Literal(Atom(plain.predicate, arguments), is_positive)


def changed_domain(domain: Domain, fault: AnyFault | None) -> Domain:
    """The domain as a fault of the operator model leaves it; the domain itself for any other fault.

    Raises:
        UnknownNameError: If the domain has no operator of the activity, or the operator no such variable.
        UsageError: If a literal to be dropped is not there.
    """
    if not isinstance(fault, WrongLiteralFault):
        return domain
    literal = _literal(fault.literal)
    if not any(each.activity == fault.activity for each in domain.operators):
        raise UnknownNameError(
            "activity", fault.activity, {each.activity for each in domain.operators}, f"fault {fault.name!r}"
        )
    changed = []
    for operator in domain.operators:
        if operator.activity != fault.activity:
            changed.append(operator)
            continue
        variables = {each.variable for each in operator.parameters}
        for name in literal.atom.arguments:
            if name not in variables:
                raise UnknownNameError("variable", name, variables, f"{operator.name}, {fault.name!r}")
        field = "preconditions" if fault.kind == "wrong_precondition" else "effects"
        literals: frozenset[Literal] = getattr(operator, field)
        if fault.change == "drop":
            if literal not in literals:
                raise UsageError(f"fault {fault.name!r}: {operator.name} has no {literal} to drop")
            kept = literals - {literal}
        else:
            kept = (literals - {literal.negated()}) | {literal}
        if field == "effects":
            changed.append(replace(operator, effects=kept))
        else:
            changed.append(replace(operator, preconditions=kept))
    return replace(domain, operators=tuple(changed))


def world_fault(
    fault: AnyFault,
    session: Session,
    *,
    hand: str,
    thing: str | None,
    support: str | None,
    planned: frozenset[str],
    rng: np.random.Generator,
) -> Fault | None:
    """What to inject into a session for a fault of the world, now.

    Args:
        fault: The fault; one of perception's symbols or of the operator model gives None.
        session: Where it happens.
        hand: Hand of the step at which it happens.
        thing: The step's object.
        support: What it is to come to rest on.
        planned: Objects that the plan speaks of.
        rng: Source of directions and places.
    """
    angle = float(rng.uniform(0.0, 2.0 * np.pi))
    aside = (float(np.cos(angle)), float(np.sin(angle)))
    if isinstance(fault, PlacingOffsetFault):
        return PlacingOffset(
            hand=hand, offset_xyz_m=(aside[0] * fault.offset_m, aside[1] * fault.offset_m, 0.0)
        )
    if isinstance(fault, SlipFault):
        return GripSlips(hand=hand, duration_s=fault.duration_s, friction=fault.friction)
    if isinstance(fault, DropFault):
        return ObjectDropped(hand=hand)
    if isinstance(fault, SensorBiasFault) and thing is not None:
        offset = (aside[0] * fault.offset_m, aside[1] * fault.offset_m, 0.0)
        return SensorBiased(entity=thing, offset_xyz_m=offset, duration_s=fault.duration_s)
    if isinstance(fault, SensorBlindFault) and thing is not None:
        return SensorBlind(entity=thing, duration_s=fault.duration_s)
    places = _places(session)
    if isinstance(fault, BlockedPathFault):
        target = places.get(support or thing or "")
        if target is None or hand not in places:
            return None
        middle = (places[hand] + target) / 2
        edge = fault.size_m
        return PathBlocked(
            name=f"block-{fault.name}",
            position_xyz_m=(float(middle[0]), float(middle[1]), 2 * edge),
            size_xyz_m=(edge / 2, edge / 2, 4 * edge),
            duration_s=fault.duration_s,
            is_seen=fault.is_seen,
        )
    if isinstance(fault, ObjectMovedFault | ObjectRemovedFault):
        others = sorted(set(session.scene.names) - planned)
        which = {"thing": thing, "support": support, "other": others[0] if others else None}[fault.which]
        if which is None or which not in places:
            return None
        if isinstance(fault, ObjectRemovedFault):
            return ObjectRemoved(object=which)
        occupied = np.stack([place[:2] for name, place in places.items() if name != hand])
        start = places[which][:2] + np.array(aside) * fault.distance_m
        spot = free_spot(occupied, start, rng)
        height = session.scene.require(which).size_xyz_m[2] / 2
        return ObjectMoved(object=which, position_xyz_m=(float(spot[0]), float(spot[1]), height))
    return None


def _places(session: Session) -> dict[str, np.ndarray]:
    """Where everything truly is, ``(3,)`` each."""
    frames = session.true_frames(session.time_ns - 200_000_000)
    places = {}
    for (name,), rows in frames.group_by("entity", maintain_order=True):
        seen = rows["position_xyz_m"].drop_nulls()
        if len(seen):
            places[str(name)] = np.asarray(seen.to_numpy()[-1], np.float64)
    return places
