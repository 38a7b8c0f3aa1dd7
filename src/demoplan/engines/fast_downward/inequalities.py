"""What differs, said in facts: the same problem, in words that the translator grounds sooner.

The translator first asks which facts and steps could ever be reached, by rules that take positive conditions
only. ``(not (= ?a ?b))`` is none, so a cube is first put onto itself, all that follows from it is grounded
too, and a later pass takes it out again. A positive condition beside it, true of each pair of different
objects, keeps such steps from being made. States, plans and costs stay what they are, since no operator
changes it; the inequality itself stays as well, since the translator reads it when it looks for mutually
exclusive facts.
"""

import itertools
from dataclasses import replace

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Problem, Signature
from demoplan.language.pddl.check import EQUALITY
from demoplan.language.types import ROOT

MAX_FACTS = 1000
"""More facts are not stated (32 objects of one type): reading them would cost more than they save."""

_WANTED_NAME = "different"


def state_inequalities(domain: Domain, problem: Problem) -> tuple[Domain, Problem]:
    """The domain and the problem with inequality as a predicate.

    Args:
        domain: Operators; conditions that two parameters differ are looked for.
        problem: Its objects may differ.

    Returns:
        Both with the same operator and object names, the same steps possible in every state and the same
        costs. Both as they were if there is nothing to state, or too much.
    """
    type_pairs = {types for operator in domain.operators for types in _differing(operator, domain).values()}
    if not type_pairs:
        return domain, problem
    types_of = {**dict(domain.constants), **dict(problem.objects)}
    pairs: set[tuple[str, str]] = set()
    for first_type, second_type in sorted(type_pairs):
        firsts, seconds = (
            [name for name, kind in types_of.items() if domain.types.is_subtype(kind, wanted)]
            for wanted in (first_type, second_type)
        )
        if len(firsts) * len(seconds) > MAX_FACTS:
            return domain, problem
        pairs |= {(one, other) for one, other in itertools.product(firsts, seconds) if one != other}
    if len(pairs) > MAX_FACTS:
        return domain, problem
    name = _free_name(domain)
    stated = replace(
        domain,
        predicates=tuple(sorted((*domain.predicates, Signature(name, (ROOT, ROOT))))),
        operators=tuple(_with_statements(operator, domain, name) for operator in domain.operators),
    )
    return stated, replace(problem, initial=problem.initial | {Atom(name, pair) for pair in pairs})


def _differing(operator: Operator, domain: Domain) -> dict[tuple[str, str], tuple[str, str]]:
    """Pairs of parameters that must differ, and their types; not those whose types see to it already."""
    types = {parameter.variable: parameter.type_name for parameter in operator.parameters}
    found = {}
    for literal in operator.preconditions:
        names = literal.atom.arguments
        if literal.atom.predicate != EQUALITY or literal.is_positive or not types.keys() >= set(names):
            continue
        one, other = (types[name] for name in names)
        if domain.types.is_subtype(one, other) or domain.types.is_subtype(other, one):
            found[names[0], names[1]] = one, other
    return found


def _with_statements(operator: Operator, domain: Domain, name: str) -> Operator:
    statements = {Literal(Atom(name, pair)) for pair in _differing(operator, domain)}
    return replace(operator, preconditions=operator.preconditions | statements) if statements else operator


def _free_name(domain: Domain) -> str:
    taken = {signature.name for signature in domain.predicates}
    numbered = (f"{_WANTED_NAME}_{number}" for number in itertools.count(2))
    return next(name for name in itertools.chain([_WANTED_NAME], numbered) if name not in taken)
