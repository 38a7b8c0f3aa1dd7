"""The named geometric definitions that a vocabulary can build predicates from."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from demoplan.errors import DataError, UnknownNameError
from demoplan.language.vocabulary import PredicateRule, Vocabulary
from demoplan.stages.perceive import hands, holding, relations, support
from demoplan.stages.perceive.bodies import Bodies
from demoplan.stages.perceive.evidence import Evidence, Groundings, Known, Numbers

Function: TypeAlias = Callable[[Bodies, Groundings, Numbers, dict[str, Known]], Evidence]

COMMON_NUMBERS = ("hold_s", "min_false_s", "min_true_s")
"""Numbers that every predicate may state; see :func:`demoplan.stages.perceive.evidence.settled`."""


@dataclass(frozen=True, kw_only=True)
class Definition:
    """A geometric definition: its function, and what it must be told."""

    function: Function
    arity: int
    numbers: tuple[str, ...] = ()
    """Thresholds that the vocabulary must state, with the unit in each name."""
    needs: tuple[str, ...] = ()
    """Definitions whose settled states it is derived from."""
    is_by_tick: bool = True
    """Whether what it says of a tick depends on poses, velocities and states at that tick alone."""


DEFINITIONS: dict[str, Definition] = {
    "in_touch": Definition(function=support.in_touch, arity=2, numbers=("enter_m", "exit_m")),
    "rests_on": Definition(
        function=support.rests_on, arity=2, numbers=("enter_m", "exit_m", "footprint_margin_m")
    ),
    "nothing_on": Definition(function=support.nothing_on, arity=1, needs=("rests_on", "held")),
    "hand_open": Definition(function=hands.hand_open, arity=1, numbers=("enter_fraction", "exit_fraction")),
    "moving": Definition(function=hands.moving, arity=1, numbers=("enter_m_per_s", "exit_m_per_s")),
    "held": Definition(
        function=holding.held,
        arity=2,
        is_by_tick=False,
        numbers=(
            "enter_m",
            "exit_m",
            "closed_fraction",
            "open_fraction",
            "carry_m_per_s",
            "slip_m_per_s",
            "slip_ratio",
        ),
    ),
    "can_grasp": Definition(
        function=hands.can_grasp, arity=2, numbers=("enter_m", "exit_m"), needs=("hand_open", "held")
    ),
    "approached": Definition(
        function=hands.approached,
        arity=2,
        numbers=("enter_m", "exit_m", "approach_m_per_s", "recede_m_per_s", "heading_ratio", "rest_m"),
        needs=("held",),
    ),
    "near": Definition(function=relations.near, arity=2, numbers=("enter_m", "exit_m")),
    "inside": Definition(function=relations.inside, arity=2, numbers=("enter_m", "exit_m")),
    "above": Definition(
        function=relations.above, arity=2, numbers=("enter_m", "exit_m", "footprint_margin_m")
    ),
    "beside": Definition(
        function=relations.beside,
        arity=2,
        numbers=("enter_m", "exit_m", "direction_rad", "half_angle_rad", "reach_m"),
    ),
    "centred": Definition(function=relations.centred, arity=2, numbers=("enter_m", "exit_m")),
    "upright": Definition(function=relations.upright, arity=1, numbers=("enter_rad", "exit_rad")),
}


def check_definitions(vocabulary: Vocabulary) -> tuple[PredicateRule, ...]:
    """The vocabulary's predicates, those that others are derived from first.

    Raises:
        UnknownNameError: If a predicate names a definition that does not exist, or a number that its
            definition does not know.
        DataError: If it misses a number, has the wrong number of arguments, or needs a definition that no
            predicate of the vocabulary has.
    """
    present = {rule.definition for rule in vocabulary.predicates}
    for rule in vocabulary.predicates:
        name = rule.signature.name
        if rule.definition not in DEFINITIONS:
            raise UnknownNameError("definition", rule.definition, DEFINITIONS, f"predicate {name}")
        definition = DEFINITIONS[rule.definition]
        if len(rule.signature.argument_types) != definition.arity:
            raise DataError(
                f"predicate {name} has {len(rule.signature.argument_types)} arguments; its definition "
                f"{rule.definition!r} takes {definition.arity}"
            )
        stated = dict(rule.numbers)
        for number in stated:
            if number not in definition.numbers and number not in COMMON_NUMBERS:
                raise UnknownNameError(
                    "number", number, (*definition.numbers, *COMMON_NUMBERS), f"predicate {name}"
                )
        missing = [number for number in definition.numbers if number not in stated]
        if missing:
            raise DataError(f"predicate {name} ({rule.definition}) lacks {', '.join(missing)}")
        for needed in definition.needs:
            if needed not in present:
                raise DataError(
                    f"predicate {name} ({rule.definition}) is derived from a predicate with the definition "
                    f"{needed!r}; the vocabulary has none"
                )
    waiting = sorted(vocabulary.predicates, key=lambda rule: rule.signature.name)
    done: list[PredicateRule] = []
    while waiting:
        left = {rule.definition for rule in waiting}
        ready = [rule for rule in waiting if not left & set(DEFINITIONS[rule.definition].needs)]
        done += ready
        waiting = [rule for rule in waiting if rule not in ready]
    return tuple(done)
