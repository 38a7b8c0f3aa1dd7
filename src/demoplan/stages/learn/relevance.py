"""Which literals an operator may state: what is about the hand and its object, and not about the scene."""

from demoplan.stages.learn.bind import FROM, HAND, OBJECT, TO
from demoplan.stages.learn.lift import LiftedAtom
from demoplan.stages.learn.merge import Relevance


def _is_effect(atom: LiftedAtom) -> bool:
    """Changes of the hand, of its object, or of a property of what the object was put on or taken from."""
    variables = atom.variables
    return HAND in variables or OBJECT in variables or len(variables) <= 1


def _is_condition(atom: LiftedAtom, is_positive: bool, is_changed: bool) -> bool:
    """Conditions on the hand, the hand with its object, the object alone, and on what the action takes away.

    What a support stands on, or what the object happened to touch, is the scene's and not the action's: one
    demonstration cannot tell that it does not matter, and would never build a tower if it were asked for.
    Where the hand was relative to other objects says how this demonstration went, not what is needed.
    """
    variables = atom.variables
    if variables == (HAND,):
        return True
    if HAND in variables:
        return is_positive and OBJECT in variables
    if variables == (OBJECT,):
        return is_positive
    return is_positive and is_changed and _is_effect(atom)


def _is_link(atom: LiftedAtom) -> bool:
    """The hand, the hand with its object, and whether a support is free: what one leaves, the next needs."""
    variables = atom.variables
    return variables in ((FROM,), (TO,)) or (HAND in variables and set(variables) <= {HAND, OBJECT})


def _never_a_negation(_atom: LiftedAtom, is_positive: bool, is_changed: bool) -> bool:
    return is_positive or is_changed


LOGGED = Relevance(
    is_effect=_is_effect,
    is_link=_is_link,
    is_condition=_is_condition,
)
"""For logs, in which roles are bound by what the hand does."""

TRACED = Relevance(is_effect=lambda _atom: True, is_link=lambda _atom: False, is_condition=_never_a_negation)
"""For symbolic traces, whose actions name all the objects that matter."""
