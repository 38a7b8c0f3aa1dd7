"""Plans on paper: the states that a plan runs through, and the first thing that is wrong with it.

This is the check of what a planner answers, so it shares nothing with planning: no PDDL text, no grounding,
only the semantics of STRIPS with negative conditions, as set algebra.

Source: R. Fikes, N. Nilsson, "STRIPS: A new approach to the application of theorem proving to problem
solving", Artificial Intelligence 2, 1971, doi:10.1016/0004-3702(71)90010-5. What an operator both deletes
and adds holds afterwards, as PDDL has it: M. Fox, D. Long, "PDDL2.1", JAIR 20, 2003, doi:10.1613/jair.1129,
definition 8.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from demoplan.errors import DataError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Plan, Problem, Step

State: TypeAlias = frozenset[Atom]
"""The atoms that are true; all others are false."""

_EQUALITY = "="


@dataclass(frozen=True)
class GroundOperator:
    """An operator with instances for its parameters."""

    step: Step
    preconditions: frozenset[Literal]
    adds: frozenset[Atom]
    deletes: frozenset[Atom]
    cost: int

    def unmet(self, state: State) -> tuple[Literal, ...]:
        """Preconditions that do not hold in a state, sorted."""
        return unmet(self.preconditions, state)

    def apply(self, state: State) -> State:
        """The state after it; whether its preconditions hold is not asked."""
        return (state - self.deletes) | self.adds


@dataclass(frozen=True)
class Violation:
    """The first thing that is wrong with a plan.

    ``step_index`` counts from 0; None stands for the goal, after the last step.
    """

    step_index: int | None
    step: Step | None
    problem: str
    unmet: tuple[Literal, ...] = ()

    def __str__(self) -> str:
        """One sentence."""
        if self.step is None or self.step_index is None:
            return f"after the last step, {self.problem}"
        return f"step {self.step_index + 1}, {self.step}: {self.problem}"


@dataclass(frozen=True)
class Execution:
    """A plan run on paper: ``states`` holds the start and the state after each step that could be taken."""

    states: tuple[State, ...]
    cost: int
    violation: Violation | None

    @property
    def is_valid(self) -> bool:
        """Whether every step could be taken and the goal is reached."""
        return self.violation is None


def holds(literal: Literal, state: State) -> bool:
    """Whether a ground literal is true in a state.

    >>> holds(Literal(Atom("clear", ("a",)), is_positive=False), frozenset())
    True
    """
    if literal.atom.predicate == _EQUALITY:
        return (len(set(literal.atom.arguments)) == 1) == literal.is_positive
    return (literal.atom in state) == literal.is_positive


def unmet(conditions: Iterable[Literal], state: State) -> tuple[Literal, ...]:
    """Conditions that are false in a state, sorted."""
    return tuple(sorted(literal for literal in conditions if not holds(literal, state)))


def ground(operator: Operator, step: Step) -> GroundOperator:
    """The operator with the step's instances bound to its parameters, in order.

    Raises:
        DataError: If the step is of another operator, or has another number of arguments.
    """
    if step.operator != operator.name or len(step.arguments) != len(operator.parameters):
        takes = ", ".join(f"{each.variable} - {each.type_name}" for each in operator.parameters)
        raise DataError(f"{step} does not fit {operator.name}({takes})")
    names = {each.variable: name for each, name in zip(operator.parameters, step.arguments, strict=True)}
    effects = [literal.substitute(names) for literal in operator.effects]
    return GroundOperator(
        step=step,
        preconditions=frozenset(literal.substitute(names) for literal in operator.preconditions),
        adds=frozenset(literal.atom for literal in effects if literal.is_positive),
        deletes=frozenset(literal.atom for literal in effects if not literal.is_positive),
        cost=operator.cost,
    )


def execute(domain: Domain, problem: Problem, plan: Plan) -> Execution:
    """Run a plan on paper, up to the first step that cannot be taken.

    Args:
        domain: Operators that the plan may use.
        problem: Where it starts, which objects there are, and what is to be reached.
        plan: The steps.

    Returns:
        The states on the way, the cost of the steps taken, and what is wrong first, if anything is.
    """
    operators = {operator.name: operator for operator in domain.operators}
    types = {**dict(domain.constants), **dict(problem.objects)}
    states = [frozenset(problem.initial)]
    cost = 0
    for index, step in enumerate(plan.steps):
        operator = operators.get(step.operator)
        fault = _misfit(step, operator, domain, types)
        if operator is None or fault:
            return Execution(tuple(states), cost, Violation(index, step, fault))
        action = ground(operator, step)
        false = action.unmet(states[-1])
        if false:
            wording = f"{false[0]} does not hold" if false[0].is_positive else f"{false[0].atom} holds"
            return Execution(
                tuple(states), cost, Violation(index, step, f"its condition fails: {wording}", false)
            )
        states.append(action.apply(states[-1]))
        cost += action.cost
    missing = unmet(problem.goal, states[-1])
    if missing:
        listed = ", ".join(map(str, missing))
        return Execution(tuple(states), cost, Violation(None, None, f"the goal lacks {listed}", missing))
    return Execution(tuple(states), cost, None)


def _misfit(step: Step, operator: Operator | None, domain: Domain, types: Mapping[str, str]) -> str:
    """Why a step does not fit its operator's parameters, given its objects' types; empty if it does."""
    if operator is None:
        available = ", ".join(each.name for each in domain.operators) or "none"
        return f"there is no operator {step.operator!r}; available: {available}"
    if len(step.arguments) != len(operator.parameters):
        return f"it has {len(step.arguments)} arguments; {operator.name} takes {len(operator.parameters)}"
    for name, parameter in zip(step.arguments, operator.parameters, strict=True):
        if name not in types:
            return f"there is no object {name!r}"
        if not domain.types.is_subtype(types[name], parameter.type_name):
            return f"{name} is a {types[name]}; {parameter.variable} takes a {parameter.type_name}"
    return ""
