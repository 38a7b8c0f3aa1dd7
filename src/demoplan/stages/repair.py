"""No plan at all to what is missing: the smallest change of the start that would give one.

The question is compiled into planning itself. Before the first real step, auxiliary operators may assume an
atom or retract one, at a price that no plan of reasonable length reaches; a plan of least cost then makes the
fewest changes, and among those takes the fewest steps. What it assumes is what to demonstrate next: how this
comes about is what the domain does not know. Changes keep to what the operators themselves keep (a hand is
open or holds one thing): to assume that a hand holds a cube, it has to be retracted that it is open.

Source: for the question, M. Diehl, T. Chakraborti, K. Ramirez-Amaro, "Enabling robots to identify missing
steps in robot tasks for guided learning from demonstration", 2023, arXiv:2311.18355; for answering it by
planning, M. Göbelbecker, T. Keller, P. Eyerich, M. Brenner, B. Nebel, "Coming up with good excuses: what to
do when no plan can be found", ICAPS 2010.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product

from demoplan.errors import DataError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Plan, Problem, Signature
from demoplan.language.execution import execute
from demoplan.language.invariants import ExclusiveGroup, exclusive_groups
from demoplan.language.types import ROOT

_CHOOSING = Literal(Atom("choosing a start"))
_BEGIN = "begin with it"
_ASSUME = "assume "
_RETRACT = "retract "
# Names with a space cannot be typed in a vocabulary, so they never meet a domain's own.


@dataclass(frozen=True, kw_only=True)
class RepairParams:
    """What can be chosen about repairs."""

    change_cost: int = 1_000
    """Price of one change, in steps: fewest changes first, as long as plans are shorter than this."""
    max_candidates: int = 20_000
    """More atoms than this are not considered: the question is refused instead."""
    is_reflexive: bool = False
    """Whether an atom may be assumed that names one object twice, as onTop(a,a)."""


@dataclass(frozen=True, kw_only=True)
class Repair:
    """A change of the start after which there is a plan."""

    added: tuple[Atom, ...]
    removed: tuple[Atom, ...]
    plan: Plan
    is_minimal: bool
    """No smaller change gives a plan shorter than the price of a change; otherwise it is just one found.

    Compared are changes that keep to the groups of :mod:`demoplan.language.invariants`, and that none of the
    excluded literals is in.
    """
    is_trivial: bool
    """It assumes nothing but the goal itself."""

    @property
    def changes(self) -> frozenset[Literal]:
        """The change as literals that would have to hold at the start."""
        return frozenset(
            [*(Literal(atom) for atom in self.added), *(Literal(atom, False) for atom in self.removed)]
        )


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Why there is no plan, as far as it is known."""

    never_changed: tuple[Literal, ...]
    """Goal literals that do not hold, and that no operator has as an effect."""
    repairs: tuple[Repair, ...]
    """Best first: those that do not assume the goal, then fewer changes."""
    note: str = ""
    """Why repairs are missing or not proven smallest, if so."""


def never_changed(domain: Domain, problem: Problem) -> tuple[Literal, ...]:
    """Goal literals that do not hold and that no operator brings about, whatever its conditions; sorted."""
    effects = {
        (effect.atom.predicate, effect.is_positive)
        for operator in domain.operators
        for effect in operator.effects
    }
    return tuple(
        sorted(
            literal
            for literal in problem.goal
            if (literal.atom in problem.initial) != literal.is_positive
            and (literal.atom.predicate, literal.is_positive) not in effects
        )
    )


def ask_for_repair(
    domain: Domain,
    problem: Problem,
    params: RepairParams = RepairParams(),
    *,
    excluded: frozenset[Literal] = frozenset(),
) -> tuple[Domain, Problem]:
    """The planning task whose cheapest plan is the smallest repair.

    Args:
        domain: What the original problem could not be solved with.
        problem: Start and goal.
        params: Prices and limits.
        excluded: Literals that may not be assumed: the goal itself, or repairs found before.

    Returns:
        A domain and a problem; :func:`read_repair` reads their plans.

    Raises:
        DataError: If there are too many atoms to consider.
    """
    groups = dict(enumerate(exclusive_groups(domain, problem.initial)))
    assumable, retractable = _candidates(domain, problem, params, excluded, tuple(groups.values()))
    signatures = {signature.name: signature for signature in domain.predicates}
    changed = [(_ASSUME, name, True) for name in sorted({atom.predicate for atom in assumable})]
    changed += [(_RETRACT, name, False) for name in sorted({atom.predicate for atom in retractable})]
    operators = [
        replace(each, preconditions=each.preconditions | {_CHOOSING.negated()}, cost=1)
        for each in domain.operators
    ]
    operators += [
        _change(prefix, signatures[name], is_positive, params.change_cost, groups)
        for prefix, name, is_positive in changed
    ]
    operators.append(Operator(_BEGIN, (), frozenset({_CHOOSING}), frozenset({_CHOOSING.negated()}), cost=0))
    predicates = [*domain.predicates, Signature(_CHOOSING.atom.predicate, ())]
    predicates += [
        Signature(f"may {prefix}{name}", signatures[name].argument_types) for prefix, name, _ in changed
    ]
    predicates += [Signature(_free(number), (ROOT,)) for number in groups]
    allowed = {Atom(f"may {_ASSUME}{atom.predicate}", atom.arguments) for atom in assumable}
    allowed |= {Atom(f"may {_RETRACT}{atom.predicate}", atom.arguments) for atom in retractable}
    objects = {name for name, _ in (*domain.constants, *problem.objects)}
    for number, group in groups.items():
        taken = {group.key(atom) for atom in problem.initial}
        allowed |= {Atom(_free(number), (name,)) for name in objects - taken}
    return (
        replace(
            domain,
            predicates=tuple(sorted(predicates)),
            operators=tuple(sorted(operators, key=lambda each: each.name)),
        ),
        replace(problem, initial=problem.initial | allowed | {_CHOOSING.atom}),
    )


def read_repair(domain: Domain, problem: Problem, plan: Plan, *, is_cheapest: bool) -> Repair:
    """What a plan of the compiled task says of the original one.

    Args:
        domain: The original domain.
        problem: The original problem.
        plan: A plan of the task that :func:`ask_for_repair` gave.
        is_cheapest: Whether no plan of that task costs less.

    Raises:
        DataError: If the rest of the plan does not reach the goal from the changed start.
    """
    added, removed, steps = [], [], []
    for step in plan.steps:
        if step.operator.startswith(_ASSUME):
            added.append(Atom(step.operator.removeprefix(_ASSUME), step.arguments))
        elif step.operator.startswith(_RETRACT):
            removed.append(Atom(step.operator.removeprefix(_RETRACT), step.arguments))
        elif step.operator != _BEGIN:
            steps.append(step)
    costs = {operator.name: operator.cost for operator in domain.operators}
    rest = Plan(tuple(steps), sum(costs[step.operator] for step in steps))
    start = replace(problem, initial=(problem.initial - set(removed)) | set(added))
    execution = execute(domain, start, rest)
    if execution.violation is not None:
        raise DataError(f"the repaired start does not lead to the goal: {execution.violation}")
    repair = Repair(
        added=tuple(sorted(added)),
        removed=tuple(sorted(removed)),
        plan=rest,
        is_minimal=is_cheapest,
        is_trivial=False,
    )
    return replace(repair, is_trivial=bool(repair.changes) and repair.changes <= problem.goal)


def describe(diagnosis: Diagnosis, domain: Domain) -> str:
    """The diagnosis in words: what is missing, and what to demonstrate next; one finding a line."""
    return "\n".join(_lines(diagnosis, domain))


def _lines(diagnosis: Diagnosis, domain: Domain) -> Iterator[str]:
    for literal in diagnosis.never_changed:
        verb = "adds" if literal.is_positive else "removes"
        yield (
            f"no operator ever {verb} {literal.atom.predicate}, which the goal asks for in {literal}: "
            f"demonstrate an activity that {verb} it"
        )
    for repair in diagnosis.repairs:
        changes = [
            *(f"{atom} held" for atom in repair.added),
            *(f"{atom} did not hold" for atom in repair.removed),
        ]
        size = "the smallest change" if repair.is_minimal else "a change, not proven the smallest"
        if not changes:
            yield "nothing is missing: there is a plan"
            continue
        if repair.is_trivial:
            held = " and ".join(changes)
            yield f"only if {held} at the start, which is what the goal asks for (the trivial answer)"
            continue
        steps = ", ".join(map(str, repair.plan.steps)) or "nothing to do"
        yield f"if {' and '.join(changes)} at the start ({size}), there were a plan: {steps}"
        yield from dict.fromkeys(f"  {_advice(literal, domain)}" for literal in sorted(repair.changes))
    if diagnosis.note:
        yield diagnosis.note


def _advice(literal: Literal, domain: Domain) -> str:
    verb = "adds" if literal.is_positive else "removes"
    makers = [
        operator.name
        for operator in domain.operators
        if any(
            (each.atom.predicate, each.is_positive) == (literal.atom.predicate, literal.is_positive)
            for each in operator.effects
        )
    ]
    if not makers:
        return f"no operator ever {verb} {literal.atom.predicate}: demonstrate an activity that {verb} it"
    what = "adding" if literal.is_positive else "removing"
    has_to = "holds" if literal.is_positive else "ceases to hold"
    listed = " or ".join(makers)
    return (
        f"{what} {literal.atom.predicate} takes {listed}, which cannot be had in time from here: "
        f"demonstrate how {literal.atom} {has_to}"
    )


def _free(group_number: int) -> str:
    return f"free in group {group_number}"


def _change(
    prefix: str, signature: Signature, is_positive: bool, cost: int, groups: Mapping[int, ExclusiveGroup]
) -> Operator:
    variables = tuple(f"?x{number}" for number in range(1, len(signature.argument_types) + 1))
    target = Literal(Atom(signature.name, variables), is_positive)
    permission = Literal(Atom(f"may {prefix}{signature.name}", variables))
    keys = {number: group.key(target.atom) for number, group in groups.items()}
    free = frozenset(Literal(Atom(_free(number), (key,))) for number, key in keys.items() if key is not None)
    return Operator(
        name=f"{prefix}{signature.name}",
        parameters=tuple(
            Parameter(name, kind) for name, kind in zip(variables, signature.argument_types, strict=True)
        ),
        preconditions=frozenset({permission, target.negated(), _CHOOSING})
        | (free if is_positive else frozenset()),
        effects=frozenset({target}) | (frozenset(each.negated() for each in free) if is_positive else free),
        cost=cost,
    )


def _candidates(
    domain: Domain,
    problem: Problem,
    params: RepairParams,
    excluded: frozenset[Literal],
    groups: Iterable[ExclusiveGroup],
) -> tuple[list[Atom], list[Atom]]:
    """Atoms that it could help to assume, and atoms that it could help to retract, sorted."""
    relevant = _relevant(domain.operators, problem.goal)
    in_the_way = {predicate for group in groups for predicate, _ in group.members}
    retractable = sorted(
        atom
        for atom in problem.initial
        if ((atom.predicate, False) in relevant or atom.predicate in in_the_way)
        and Literal(atom, False) not in excluded
    )
    objects = sorted({*domain.constants, *problem.objects})
    assumable: list[Atom] = []
    for signature in domain.predicates:
        if (signature.name, True) not in relevant:
            continue
        choices = [
            [name for name, own in objects if domain.types.is_subtype(own, kind)]
            for kind in signature.argument_types
        ]
        for arguments in product(*choices):
            atom = Atom(signature.name, arguments)
            is_reflexive = len(set(arguments)) < len(arguments)
            if (
                atom in problem.initial
                or Literal(atom) in excluded
                or (is_reflexive and not params.is_reflexive)
            ):
                continue
            assumable.append(atom)
            if len(assumable) > params.max_candidates:
                raise DataError(
                    f"more than {params.max_candidates} atoms could be missing ({len(objects)} objects): "
                    "too many to look for the smallest change"
                )
    return sorted(assumable), retractable


def _relevant(operators: Iterable[Operator], goal: Iterable[Literal]) -> set[tuple[str, bool]]:
    """Predicates, with sign, that the goal asks for or that lead to it through operators' conditions."""
    relevant = {(literal.atom.predicate, literal.is_positive) for literal in goal}
    remaining = list(operators)
    while True:
        useful = [
            operator
            for operator in remaining
            if any((each.atom.predicate, each.is_positive) in relevant for each in operator.effects)
        ]
        if not useful:
            return relevant
        remaining = [operator for operator in remaining if operator not in useful]
        for operator in useful:
            relevant |= {(each.atom.predicate, each.is_positive) for each in operator.preconditions}
