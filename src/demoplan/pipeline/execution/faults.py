"""Faults as they happen: in the domain that is planned with, or in the world; and their true classes.

No monitor gets to see either.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

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
from demoplan.errors import UnknownNameError, UsageError
from demoplan.language.atoms import Literal
from demoplan.language.domains import Domain
from demoplan.manifests.faults import (
    AnyFault,
    BlockedPathFault,
    DropFault,
    ObjectMovedFault,
    ObjectRemovedFault,
    PlacingOffsetFault,
    SensorBiasFault,
    SensorBlindFault,
    SlipFault,
    WrongLiteralFault,
    literal_of,
)
from demoplan.stages.diagnose import FailureClass

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


def changed_domain(domain: Domain, fault: AnyFault | None) -> Domain:
    """The domain as a fault of the operator model leaves it; the domain itself for any other fault.

    Raises:
        UnknownNameError: If the domain has no operator of the activity, or the operator no such variable.
        UsageError: If a literal to be dropped is not there.
    """
    if not isinstance(fault, WrongLiteralFault):
        return domain
    literal = literal_of(fault.literal)
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
    angle_rad: float,
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
        angle_rad: Direction in which something goes aside, about the vertical [rad].
        rng: Source of free places.
    """
    aside = (float(np.cos(angle_rad)), float(np.sin(angle_rad)))
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
