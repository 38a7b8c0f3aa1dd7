"""From a plan's step to a motion: which skill carries an activity out, and what it is about."""

from collections.abc import Mapping
from dataclasses import dataclass

from demoplan.engines.mujoco.session import Motion
from demoplan.errors import UnknownNameError
from demoplan.language.domains import Operator
from demoplan.language.execution import GroundOperator
from demoplan.language.types import TypeHierarchy

SKILLS: Mapping[str, str] = {
    "Idle": "rest",
    "Reach": "reach",
    "Take": "grasp",
    "Put": "carry",
    "Release": "release",
}
"""Activity → skill; give another table to :class:`demoplan.pipeline.execute.ExecuteParams` to extend it."""


@dataclass(frozen=True, kw_only=True)
class Roles:
    """The words by which a step says who does what to which object."""

    hand_type: str = "Hand"
    thing_type: str = "Graspable"
    holding: str = "inHand"
    """Predicate (hand, object)."""
    resting: str = "onTop"
    """Predicate (object, support)."""


@dataclass(frozen=True, kw_only=True)
class Bound:
    """Who does what in a step."""

    operator: Operator
    hand: str | None
    thing: str | None
    """What is reached for, taken, carried or let go."""
    support: str | None
    """What it comes to rest on."""


def bind(
    step: GroundOperator,
    operator: Operator,
    type_of: Mapping[str, str],
    types: TypeHierarchy,
    roles: Roles = Roles(),
) -> Bound:
    """Who does what in a step, from what it needs and changes rather than from its parameters' names.

    The hand is the first argument that is one. The object is what the step takes into the hand or needs there;
    else, what it puts somewhere; else, its first argument that can be grasped.
    """

    def of_type(wanted: str) -> list[str]:
        return [
            name
            for name in step.step.arguments
            if wanted in types.names and types.is_subtype(type_of[name], wanted)
        ]

    hand = next(iter(of_type(roles.hand_type)), None)
    needed = {literal.atom for literal in step.preconditions if literal.is_positive}
    placed = sorted(atom for atom in step.adds if atom.predicate == roles.resting)
    held = sorted(atom for atom in step.adds | needed if atom.predicate == roles.holding)
    if held:
        thing: str | None = held[0].arguments[1]
    elif placed:
        thing = placed[0].arguments[0]
    else:
        thing = next(iter(of_type(roles.thing_type)), None)
    support = next((atom.arguments[1] for atom in placed if atom.arguments[0] == thing), None)
    return Bound(operator=operator, hand=hand, thing=thing, support=support)


def motion_of(bound: Bound, skills: Mapping[str, str] = SKILLS) -> Motion:
    """The motion that carries a step out.

    Raises:
        UnknownNameError: If no skill is mapped to the step's activity.
    """
    activity = bound.operator.activity
    if activity not in skills:
        raise UnknownNameError("skill for activity", activity, skills, "the table of skills")
    return Motion(activity=activity, skill=skills[activity], object=bound.thing, support=bound.support)
