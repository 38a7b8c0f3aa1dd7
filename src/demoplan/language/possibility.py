"""Whether a plan could happen: the laws of a tabletop, which no operator's conditions are asked about.

A learned domain may allow what no world does: put a cube onto a covered one, take one from under
another, hold two things in one hand. Simulating the plan with the domain's own operators cannot show it.
Here only what each step claims to change is looked at, and held against laws that were not learned.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from demoplan.language.atoms import Atom
from demoplan.language.domains import Domain, Plan, Problem
from demoplan.language.execution import ground
from demoplan.language.types import TypeHierarchy


@dataclass(frozen=True, kw_only=True)
class Laws:
    """The words in which the laws are put."""

    holding: str = "inHand"
    """Predicate (hand, object): the hand holds the object."""
    resting: str = "onTop"
    """Predicate (object, support): the object rests on the support."""
    roomy: str = "Surface"
    """Type of supports with room for many objects; any other carries one at a time."""


def impossibility(problem: Problem, domain: Domain, plan: Plan, laws: Laws = Laws()) -> str | None:
    """The first step of a plan that could not happen, and why; None if the plan could.

    The laws: a hand holds one object and an object is in one hand; an object that carries another can be
    neither taken nor moved; what is put down was held, and lands on something that carries nothing else,
    unless it has room; an object rests on one thing.

    Args:
        problem: Where the plan starts; its goal is held against the world that the laws lead to.
        domain: What the steps' names mean.
        plan: The steps.
        laws: The words.
    """
    world = _World(problem, domain.types, laws)
    operators = {operator.name: operator for operator in domain.operators}
    for number, step in enumerate(plan.steps, 1):
        grounded = ground(operators[step.operator], step)
        fault = world.fault(grounded.adds, grounded.deletes)
        if fault is not None:
            return f"step {number}, {step}: {fault}"
    for literal in sorted(problem.goal):
        if literal.atom.predicate == laws.resting:
            thing, support = literal.atom.arguments
            if (world.support.get(thing) == support) != literal.is_positive:
                found = world.support.get(thing, "nothing")
                return f"at the end {thing} is on {found}; the goal is {literal}"
    return None


class _World:
    """What is where, as the laws allow it."""

    def __init__(self, problem: Problem, types: TypeHierarchy, laws: Laws) -> None:
        self.laws = laws
        self.types = types
        self.type_of: Mapping[str, str] = dict(problem.objects)
        self.support = _pairs(problem.initial, laws.resting)
        self.held = _pairs(problem.initial, laws.holding)

    def _load_of(self, support: str) -> list[str]:
        return sorted(thing for thing, below in self.support.items() if below == support)

    def _has_room(self, support: str) -> bool:
        is_roomy = self.types.is_subtype(self.type_of[support], self.laws.roomy)
        return is_roomy or not self._load_of(support)

    def fault(self, added: frozenset[Atom], deleted: frozenset[Atom]) -> str | None:
        """What is impossible about a step that makes these changes; else the world changes so."""
        in_hand_at_start = set(self.held.values())
        for atom in sorted(deleted):
            if atom.predicate == self.laws.holding and self.held.get(atom.arguments[0]) == atom.arguments[1]:
                del self.held[atom.arguments[0]]
        for atom in sorted(added):
            if atom.predicate == self.laws.holding:
                fault = self._take(*atom.arguments)
                if fault is not None:
                    return fault
        for atom in sorted(deleted):
            if atom.predicate == self.laws.resting:
                thing, support = atom.arguments
                if self.support.get(thing) == support:
                    if self._load_of(thing):
                        return f"{thing} is lifted from under {self._load_of(thing)[0]}"
                    if thing not in in_hand_at_start | set(self.held.values()):
                        return f"{thing} leaves {support} in nobody's hand"
                    del self.support[thing]
        for atom in sorted(added):
            if atom.predicate == self.laws.resting:
                fault = self._put(*atom.arguments, was_held=atom.arguments[0] in in_hand_at_start)
                if fault is not None:
                    return fault
        return None

    def _take(self, hand: str, thing: str) -> str | None:
        if self.held.get(hand) == thing:
            return None
        if hand in self.held:
            return f"{hand} holds {self.held[hand]} and cannot take {thing}"
        if thing in self.held.values():
            return f"{thing} is in another hand"
        if self._load_of(thing):
            return f"{thing} is taken from under {self._load_of(thing)[0]}"
        self.held[hand] = thing
        return None

    def _put(self, thing: str, support: str, *, was_held: bool) -> str | None:
        if self.support.get(thing) == support:
            return None
        if thing in self.support:
            return f"{thing} is put onto {support} and still rests on {self.support[thing]}"
        if not was_held and thing not in self.held.values():
            return f"{thing} moves by itself"
        if thing == support or support in self.held.values():
            return f"{thing} is put onto {support}, which is in a hand or is itself"
        if not self._has_room(support):
            return f"{thing} is put onto {support}, which carries {self._load_of(support)[0]}"
        self.support[thing] = support
        return None


def _pairs(state: frozenset[Atom], predicate: str) -> dict[str, str]:
    return {atom.arguments[0]: atom.arguments[1] for atom in sorted(state) if atom.predicate == predicate}
