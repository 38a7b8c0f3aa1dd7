"""Planning from what is sensed: the first plan, every further one, and what is refused before it begins."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from demoplan.engines.fast_downward import Attempt, SolveParams, solve
from demoplan.engines.mujoco.skills import SkillTable
from demoplan.errors import DemoplanError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Plan, Problem
from demoplan.language.execution import GroundOperator
from demoplan.language.momentary import Momentary
from demoplan.language.possibility import impossibility
from demoplan.pipeline.execution.reaching import out_of_reach
from demoplan.pipeline.execution.senses import Senses
from demoplan.pipeline.sharing import beyond_reach, within_reach
from demoplan.stages.ask import ask
from demoplan.stages.monitor import SensedState


@dataclass(frozen=True, kw_only=True)
class Planned:
    """A plan, or why there is none."""

    plan: Plan | None
    domain: Domain
    """What the plan's steps mean: the domain itself, or what of it lasts."""
    outcome: str
    """``solved``, or an outcome of ``Runs``."""
    reason: str
    n_possible: int | None = None
    """How many of its steps could happen, if the laws of a tabletop forbid the one after them."""


def plan_from(
    domain: Domain,
    goal: frozenset[Literal],
    sensed: SensedState,
    senses: Senses,
    momentary: Momentary,
    params: SolveParams,
    skills: SkillTable,
    *,
    is_first: bool,
    gone: frozenset[str],
) -> Planned:
    """A plan from a sensed state.

    Args:
        domain: Operators.
        goal: What shall hold.
        sensed: The state to plan from.
        senses: Names and types of what is there.
        momentary: Which predicates tell of motions in progress. Where the full domain has no plan from the
            middle of things, what lasts of it is planned with.
        params: Limits.
        skills: What tells where the steps' objects go.
        is_first: Nothing has been done yet: the full domain must do.
        gone: Objects that are no longer there.
    """
    present = {name: kind for name, kind in senses.type_of.items() if name not in gone}
    needed = sorted({name for each in goal for name in each.atom.arguments} & gone)
    if needed:
        return Planned(
            plan=None, domain=domain, outcome="no_plan", reason=f"the goal needs {needed[0]}, which is gone"
        )
    known = {signature.name for signature in domain.predicates}
    state = momentary.state_to_plan_from(
        frozenset(
            atom for atom in sensed.held if atom.predicate in known and set(atom.arguments) <= set(present)
        )
    )
    beyond = beyond_reach(senses)
    whole = momentary.one_thing_at_a_time(domain)
    ladder = [whole] if is_first else [whole, momentary.lasting_domain(whole)]
    answer: Attempt | None = None
    for rung in ladder:
        start = state if rung is whole else momentary.lasting_state(state, present, domain.types)
        try:
            problem = ask(rung, start, present, goal, "execution")
        except DemoplanError as error:
            return Planned(plan=None, domain=domain, outcome="no_plan", reason=str(error))
        answer = solve(*within_reach(rung, problem, beyond), params)
        if answer.outcome == "unsolvable" and beyond:
            # A plan that asks too much of a hand can at least be shown, with what it cannot get to.
            answer = solve(rung, problem, params)
        if answer.plan is not None and answer.is_validated:
            return _checked(answer.plan, rung, problem, senses, skills)
        if answer.outcome != "unsolvable":
            break
    assert answer is not None
    outcome = "no_plan" if answer.outcome in {"unsolvable", "bad_input"} else "planner_failed"
    return Planned(plan=None, domain=domain, outcome=outcome, reason=f"{answer.outcome}: {answer.message}")


def _checked(plan: Plan, domain: Domain, problem: Problem, senses: Senses, skills: SkillTable) -> Planned:
    refuted = impossibility(problem, domain, plan)
    if refuted is not None:
        anywhere = replace(problem, goal=frozenset())
        n_possible = next(
            n
            for n in range(len(plan.steps) + 1)
            if n == len(plan.steps) or _is_refuted(plan, n, anywhere, domain)
        )
        return Planned(
            plan=plan,
            domain=domain,
            outcome="solved",
            reason=f"the plan could not happen: {refuted}",
            n_possible=n_possible,
        )
    places = {name: senses.position(name) for name in senses.objects}
    seen = {name: place for name, place in places.items() if place is not None}
    reason = out_of_reach(plan, domain, senses.session, seen, skills)
    if reason is not None:
        return Planned(plan=None, domain=domain, outcome="out_of_reach", reason=reason)
    return Planned(plan=plan, domain=domain, outcome="solved", reason="")


def _is_refuted(plan: Plan, n: int, problem: Problem, domain: Domain) -> bool:
    """Whether the step after the first ``n`` could not happen."""
    return impossibility(problem, domain, Plan(plan.steps[: n + 1])) is not None


def amended(
    domain: Domain,
    step: GroundOperator,
    missing: tuple[Literal, ...],
    extra: tuple[Literal, ...],
) -> Domain | None:
    """The domain with what an operator promised wrongly replaced by what is observed instead.

    Args:
        domain: What was planned with.
        step: A step of the operator, run with its motion as it should be.
        missing: Its effects that are observed not to come about: their opposites are put in their place.
        extra: Changes that it does not promise; those about its own arguments are put in.

    Returns:
        The corrected domain; None if there is nothing that an operator of those parameters could say.
    """
    operators = []
    is_changed = False
    for operator in domain.operators:
        if operator.name != step.step.operator:
            operators.append(operator)
            continue
        lifted = _variables_of(operator, step)
        effects = set(operator.effects)
        for literal in missing:
            said = literal.substitute(lifted)
            if said in effects:
                effects.discard(said)
                effects.add(said.negated())
                is_changed = True
        for literal in extra:
            if set(literal.atom.arguments) <= set(lifted):
                said = literal.substitute(lifted)
                effects.discard(said.negated())
                effects.add(said)
                is_changed = True
        # What a condition says already is no change.
        kept = frozenset(effects) - operator.preconditions
        operators.append(replace(operator, effects=kept))
    return replace(domain, operators=tuple(operators)) if is_changed else None


def _variables_of(operator: Operator, step: GroundOperator) -> dict[str, str]:
    return {
        name: parameter.variable
        for name, parameter in zip(step.step.arguments, operator.parameters, strict=True)
    }


def lifted_text(
    literals: tuple[Literal, ...], operator: Operator | None, step: GroundOperator | None
) -> tuple[str, ...]:
    """Literals in an operator's variables where they speak of its arguments, as sorted text."""
    names: Mapping[str, str] = {} if operator is None or step is None else _variables_of(operator, step)
    return tuple(sorted(str(literal.substitute(dict(names))) for literal in literals))


def emptied_hands(
    goal: frozenset[Literal], hands: tuple[str, ...], predicates: tuple[str, ...], domain: Domain
) -> frozenset[Literal]:
    """The goal, and that hands are open in the end where nothing else is asked of them.

    What a hand still holds has not been shown to stand by itself.
    """
    known = {signature.name for signature in domain.predicates}
    changed = {effect.atom.predicate for each in domain.operators for effect in each.effects}
    spoken_of = {name for literal in goal for name in literal.atom.arguments}
    return goal | {
        Literal(Atom(predicate, (hand,)))
        for predicate in predicates
        if predicate in known & changed
        for hand in hands
        if hand not in spoken_of
    }
