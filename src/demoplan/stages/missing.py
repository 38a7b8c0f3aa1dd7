"""No plan, and which demonstration would give one: the nearest things to what was shown that were not.

Who has seen a cube taken from a table has not seen one taken from another cube; but it is the nearest thing.
For every operator and every parameter, the operator is imagined for objects of another type. What does not
make sense for these objects is left out of it, and what they exchange is put in: in all that was seen, a cube
is clear or something is on it. Planning with the imagined operators, each at a price that no plan of
reasonable length reaches, says which of them a goal needs: that is what to demonstrate.

Source: for the question, M. Diehl, T. Chakraborti, K. Ramirez-Amaro, "Enabling robots to identify missing
steps in robot tasks for guided learning from demonstration", 2023, arXiv:2311.18355, who change the start
instead; :mod:`demoplan.stages.repair` does so.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Plan, Problem
from demoplan.language.invariants import ExclusiveGroup

_IMAGINED = " with "
# A name with a space never meets one of a domain.


@dataclass(frozen=True, kw_only=True)
class MissingParams:
    """What can be chosen about imagined operators."""

    price: int = 1_000
    """What using one costs: fewest first, as long as plans are cheaper than this."""
    resting: str = "onTop"
    """Predicate (object, support) that is put into words."""


@dataclass(frozen=True, order=True, kw_only=True)
class MissingDemonstration:
    """A demonstration that nobody gave."""

    activity: str
    operator: str
    """The known operator that is nearest to it."""
    changes: tuple[tuple[str, str], ...]
    """(variable, type) pairs: what it would stand for instead."""
    example: str
    """What it would show, with the objects of a problem."""

    @property
    def key(self) -> tuple[str, tuple[tuple[str, str], ...]]:
        """What makes two of them the same, whatever objects they are shown with."""
        return self.operator, self.changes

    def __str__(self) -> str:
        """A clause, as in "needed is …"."""
        changes = " and ".join(f"a {kind} for {variable}" for variable, kind in self.changes)
        return f"a demonstration of {self.example} ({self.activity}, as {self.operator}, but with {changes})"


def imagine(
    domain: Domain,
    problem: Problem,
    groups: Sequence[tuple[ExclusiveGroup, str]] = (),
    params: MissingParams = MissingParams(),
) -> Domain:
    """The domain with every operator also imagined for objects of other types.

    Args:
        domain: What was learned.
        problem: Whose objects to imagine it for.
        groups: Pairs of predicates that exclude each other, with the type of object that it holds for, as the
            demonstrations showed them.
        params: Price.
    """
    kinds = sorted({kind for _, kind in problem.objects})
    groups = (*groups, *_exchanges(domain))
    imagined: list[Operator] = []
    # One variable of another type first, then two: what is farther from anything shown costs more.
    latest = [(operator, -1) for operator in domain.operators]
    for n_changes in (1, 2):
        following = []
        for operator, last in latest:
            for place in range(last + 1, len(operator.parameters)):
                for kind in kinds:
                    if domain.types.is_subtype(kind, operator.parameters[place].type_name):
                        continue
                    other = _with_type(operator, place, kind, domain, groups)
                    if other is not None:
                        following.append((replace(other, cost=n_changes * params.price), place))
        imagined += [each for each, _ in following]
        latest = following
    operators = sorted((*domain.operators, *imagined), key=lambda each: each.name)
    return replace(domain, operators=tuple(operators))


def _exchanges(domain: Domain) -> tuple[tuple[ExclusiveGroup, str], ...]:
    """What operators themselves exchange: a relation that begins, for a property of an object that ends.

    A few demonstrations may not suffice to see that the two exclude each other.
    """
    found = set()
    for operator in domain.operators:
        type_of = {each.variable: each.type_name for each in operator.parameters}
        for added in operator.effects:
            if not added.is_positive or len(added.atom.arguments) < 2:
                continue
            for ended in operator.effects:
                if ended.is_positive or len(ended.atom.arguments) != 1:
                    continue
                variable = ended.atom.arguments[0]
                if variable == added.atom.arguments[-1] and variable in type_of:
                    position = len(added.atom.arguments) - 1
                    members = tuple(sorted([(added.atom.predicate, position), (ended.atom.predicate, 0)]))
                    found.add((ExclusiveGroup(members), type_of[variable]))
    return tuple(sorted(found))


def _with_type(
    operator: Operator,
    place: int,
    kind: str,
    domain: Domain,
    groups: Sequence[tuple[ExclusiveGroup, str]],
) -> Operator | None:
    variable = operator.parameters[place].variable
    parameters = (
        *operator.parameters[:place],
        Parameter(variable, kind),
        *operator.parameters[place + 1 :],
    )
    type_of = {each.variable: each.type_name for each in parameters} | dict(domain.constants)
    wanted = {each.name: each.argument_types for each in domain.predicates}

    def fits(literal: Literal) -> bool:
        return all(
            domain.types.is_subtype(type_of[name], needed)
            for name, needed in zip(literal.atom.arguments, wanted[literal.atom.predicate], strict=True)
        )

    about = [each for each in operator.effects if variable in each.atom.arguments[1:]]
    if not any(fits(each) for each in about) or _is_subject(variable, operator):
        return None
    conditions = {each for each in operator.preconditions if fits(each)}
    effects = {each for each in operator.effects if fits(each)}
    for effect in sorted(each for each in effects if variable in each.atom.arguments):
        for other in _exchanged(effect, groups, type_of, domain):
            effects.add(other)
            if not other.is_positive:
                conditions.add(other.negated())
    if any(each.negated() in effects for each in effects):
        return None
    return Operator(
        name=f"{operator.name}{_IMAGINED}{variable} {kind}",
        parameters=parameters,
        preconditions=frozenset(conditions),
        effects=frozenset(effects),
        activity=operator.activity,
    )


def _is_subject(variable: str, operator: Operator) -> bool:
    """Whether an operator is about what a variable does, and not about what is done to it.

    Its atoms with others begin with it: a hand holds, a cube rests. Of what touches each other, neither does.
    """
    atoms = {each.atom for each in operator.effects if len(each.atom.arguments) > 1}
    return any(
        atom.arguments[0] == variable and Atom(atom.predicate, atom.arguments[::-1]) not in atoms
        for atom in atoms
    )


def _exchanged(
    effect: Literal,
    groups: Sequence[tuple[ExclusiveGroup, str]],
    type_of: Mapping[str, str],
    domain: Domain,
) -> Iterable[Literal]:
    """What takes the place of an atom that ends, or ends as it begins: of an object's own properties."""
    arity = {each.name: len(each.argument_types) for each in domain.predicates}
    for group, key_type in groups:
        key = group.key(effect.atom)
        if key is None or not domain.types.is_subtype(type_of[key], key_type):
            continue
        for predicate, _ in group.members:
            if predicate != effect.atom.predicate and arity[predicate] == 1:
                yield Literal(Atom(predicate, (key,)), not effect.is_positive)


def read_missing(
    plan: Plan, domain: Domain, params: MissingParams = MissingParams()
) -> tuple[MissingDemonstration, ...]:
    """The demonstrations that a plan with imagined operators asks for, in its order, each once.

    Args:
        plan: A plan of the domain that :func:`imagine` gave.
        domain: The domain that it was imagined from.
        params: Words.
    """
    operators = {each.name: each for each in domain.operators}
    found: dict[object, MissingDemonstration] = {}
    for step in plan.steps:
        name, *changes = step.operator.split(_IMAGINED)
        if not changes:
            continue
        operator = operators[name]
        instance = dict(zip((each.variable for each in operator.parameters), step.arguments, strict=True))
        pairs = [tuple(each.split(" ", 1)) for each in changes]
        each = MissingDemonstration(
            activity=operator.activity,
            operator=name,
            changes=tuple((variable, kind) for variable, kind in pairs),
            example=" and ".join(_in_words(operator, variable, instance, params) for variable, _ in pairs),
        )
        found.setdefault(each.key, each)
    return tuple(found.values())


def _in_words(operator: Operator, variable: str, instance: Mapping[str, str], params: MissingParams) -> str:
    """What a demonstration shows about one of the objects."""
    effects = sorted(each for each in operator.effects if variable in each.atom.arguments)
    for effect in effects:
        if effect.atom.predicate == params.resting and effect.atom.arguments[-1] == variable:
            thing, support = (instance[name] for name in effect.atom.arguments)
            return (
                f"putting {thing} onto {support}"
                if effect.is_positive
                else (f"taking {thing} from on top of {support}")
            )
    texts = [str(each.substitute(dict(instance))) for each in effects]
    return f"making {' and '.join(texts)}"


def rank_missing(
    of_goals: Mapping[str, Sequence[MissingDemonstration]],
) -> tuple[tuple[MissingDemonstration, tuple[str, ...]], ...]:
    """Missing demonstrations with the goals that ask for them: those that the most goals need come first.

    Args:
        of_goals: What each goal without a plan lacks.
    """
    goals: dict[tuple[str, tuple[tuple[str, str], ...]], list[str]] = defaultdict(list)
    first: dict[object, MissingDemonstration] = {}
    for goal in sorted(of_goals):
        for each in of_goals[goal]:
            goals[each.key].append(goal)
            first.setdefault(each.key, each)
    ordered = sorted(goals, key=lambda key: (-len(goals[key]), key))
    return tuple((first[key], tuple(goals[key])) for key in ordered)
