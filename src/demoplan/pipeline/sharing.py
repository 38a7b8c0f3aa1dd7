"""Which hand may be asked for what: a plan for several hands gives each of them only what it gets to."""

from collections.abc import Collection
from dataclasses import replace

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Problem, Signature
from demoplan.pipeline.execution.senses import Senses

WITHIN_REACH = "withinReach"


def beyond_reach(senses: Senses) -> frozenset[tuple[str, str]]:
    """(hand, object) pairs of what is seen where the hand cannot get to; none for a robot with one hand.

    With one hand there is nothing to choose: that something is out of reach is then found in the plan, and
    said with the place.
    """
    session = senses.session
    if len(session.hands) < 2:
        return frozenset()
    places = {name: senses.position(name) for name in senses.objects}
    return frozenset(
        (hand, name)
        for hand in session.hands
        for name, place in places.items()
        if place is not None and session.can_reach(hand, (place[0], place[1], place[2])) is not None
    )


def within_reach(
    domain: Domain, problem: Problem, beyond: Collection[tuple[str, str]], hand_type: str = "Hand"
) -> tuple[Domain, Problem]:
    """The same domain and problem, but no operator asks of a hand what is beyond its reach.

    Args:
        domain: Operators; those with exactly one hand get a condition for each of their other arguments.
        problem: Its objects.
        beyond: (hand, object) pairs; all others are within reach.
        hand_type: Type of hands.
    """
    if not beyond:
        return domain, problem
    types = domain.types
    operators = []
    for operator in domain.operators:
        hands = [each for each in operator.parameters if types.is_subtype(each.type_name, hand_type)]
        others = [each for each in operator.parameters if each not in hands]
        asked = {
            Literal(Atom(WITHIN_REACH, (hands[0].variable, other.variable)))
            for other in others
            if len(hands) == 1
        }
        operators.append(replace(operator, preconditions=operator.preconditions | asked))
    signature = Signature(WITHIN_REACH, (hand_type, "object"))
    instances = dict(problem.objects) | dict(domain.constants)
    actors = [name for name, kind in instances.items() if types.is_subtype(kind, hand_type)]
    known = frozenset(
        Atom(WITHIN_REACH, (hand, name))
        for hand in actors
        for name in instances
        if name not in actors and (hand, name) not in beyond
    )
    predicates = tuple(sorted((*domain.predicates, signature), key=lambda each: each.name))
    return (
        replace(domain, predicates=predicates, operators=tuple(operators)),
        replace(problem, initial=problem.initial | known),
    )
