"""A plan as a graph of what must wait for what, so that independent steps may run at once.

Source: the plan graph of ROSPlan's Esterel dispatcher, with condition and interference edges: M. Cashmore et
al., "ROSPlan: Planning in the Robot Operating System", ICAPS 2015. That the steps which support each
condition are all that a partial order needs to keep, besides threats to them: C. Bäckström,
"Computational aspects of reordering plans", JAIR 9, 1998, doi:10.1613/jair.477.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal as Choice
from typing import TypeAlias

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Plan
from demoplan.language.execution import GroundOperator, ground

EdgeKind: TypeAlias = Choice["condition", "interference"]


@dataclass(frozen=True, order=True)
class Edge:
    """A step waits until an earlier one has ended.

    ``condition``: the earlier step brings about what the later one needs. ``interference``: the order keeps
    one from destroying what the other needs or does, or both need the same hand. ``reasons`` names the
    literals, or the hand, sorted.
    """

    before: int
    after: int
    kind: EdgeKind
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class DispatchGraph:
    """Steps of a plan, numbered as in the plan, and the edges between them, sorted."""

    steps: tuple[GroundOperator, ...]
    edges: tuple[Edge, ...]

    @cached_property
    def _before(self) -> tuple[frozenset[int], ...]:
        before: list[set[int]] = [set() for _ in self.steps]
        for edge in self.edges:
            before[edge.after].add(edge.before)
        return tuple(map(frozenset, before))

    def predecessors(self, step: int) -> frozenset[int]:
        """Steps that a step waits for directly."""
        return self._before[step]

    def ready(self, ended: Collection[int], started: Collection[int] = ()) -> tuple[int, ...]:
        """Steps that may begin: neither ended nor started, and all that they wait for has ended; in order."""
        gone = set(ended) | set(started)
        return tuple(
            index
            for index in range(len(self.steps))
            if index not in gone and self._before[index] <= set(ended)
        )


def dispatch_graph(domain: Domain, plan: Plan, actors: Iterable[str] = ()) -> DispatchGraph:
    """What must wait for what in a plan.

    Every order of the steps that follows the edges is as good as the plan itself: each step's conditions hold
    when it begins, and the same state is reached. Edges that others imply are left out.

    Args:
        domain: Operators that the plan uses.
        plan: Steps in an order in which they work.
        actors: Instances that do one thing at a time, as hands: their steps keep the plan's order.
    """
    operators = {operator.name: operator for operator in domain.operators}
    steps = tuple(ground(operators[step.operator], step) for step in plan.steps)
    hands = frozenset(actors)
    effects = [_effects(step) for step in steps]
    found: dict[tuple[int, int], tuple[EdgeKind, set[str]]] = {}
    for after, step in enumerate(steps):
        for literal in sorted(step.preconditions):
            producer = _last_producer(literal, effects, after)
            if producer is not None:
                found.setdefault((producer, after), ("condition", set()))[1].add(str(literal))
        for before in range(after):
            reasons = _interference(steps[before], effects[before], step, effects[after], hands)
            if reasons:
                found.setdefault((before, after), ("interference", set()))[1].update(reasons)
    kept = _reduced(len(steps), set(found))
    return DispatchGraph(
        steps,
        tuple(
            sorted(
                Edge(before, after, found[before, after][0], tuple(sorted(found[before, after][1])))
                for before, after in kept
            )
        ),
    )


def _effects(step: GroundOperator) -> dict[Atom, bool]:
    """Value of each atom after the step; what it both deletes and adds holds."""
    return dict.fromkeys(step.deletes, False) | dict.fromkeys(step.adds, True)


def _last_producer(literal: Literal, effects: list[dict[Atom, bool]], after: int) -> int | None:
    """The last earlier step that makes a literal true; None if it holds from the start."""
    for index in reversed(range(after)):
        if effects[index].get(literal.atom) == literal.is_positive:
            return index
    return None


def _interference(
    first: GroundOperator,
    first_effects: dict[Atom, bool],
    second: GroundOperator,
    second_effects: dict[Atom, bool],
    actors: frozenset[str],
) -> set[str]:
    """Why two steps may not change places, beside one bringing about what the other needs."""
    reasons = {
        str(literal)
        for literal in first.preconditions
        if second_effects.get(literal.atom, literal.is_positive) != literal.is_positive
    }
    reasons |= {
        str(literal)
        for literal in second.preconditions
        if first_effects.get(literal.atom, literal.is_positive) != literal.is_positive
    }
    reasons |= {
        str(atom) for atom, value in first_effects.items() if second_effects.get(atom, value) != value
    }
    return reasons | (actors & set(first.step.arguments) & set(second.step.arguments))


def _reduced(n_steps: int, edges: set[tuple[int, int]]) -> set[tuple[int, int]]:
    """The edges that no path of others implies: the transitive reduction of an acyclic graph.

    Source: A. Aho, M. Garey, J. Ullman, "The transitive reduction of a directed graph", SIAM Journal on
    Computing 1, 1972, doi:10.1137/0201008.
    """
    reached: list[set[int]] = [set() for _ in range(n_steps)]
    kept = set()
    for after in range(n_steps):
        for before in sorted((b for b, a in edges if a == after), reverse=True):
            if before not in reached[after]:
                kept.add((before, after))
                reached[after] |= {before} | reached[before]
    return kept
