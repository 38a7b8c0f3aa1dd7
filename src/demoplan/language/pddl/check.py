"""What has to hold of a domain or a problem before it may be written as PDDL."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Problem, Signature
from demoplan.language.types import ROOT, TypeHierarchy

EQUALITY = "="
"""Predicate of ``=(?a,?b)``: both are the same object. It may stand in conditions only."""

MAX_COST = 2**31 - 1
"""Fast Downward's search reads costs as 32-bit integers."""


def domain_faults(domain: Domain) -> tuple[str, ...]:
    """Sentences that say what is wrong with a domain; none if it may be rendered."""
    return tuple(_domain_faults(domain))


def problem_faults(problem: Problem, domain: Domain) -> tuple[str, ...]:
    """Sentences that say what is wrong with a problem; none if it may be rendered for the domain."""
    return tuple(_problem_faults(problem, domain))


def _duplicates(names: Iterable[str]) -> list[str]:
    return sorted(name for name, n in Counter(names).items() if n > 1)


def _known_type(name: str, types: TypeHierarchy) -> bool:
    return name == ROOT or name in types.names


def _domain_faults(domain: Domain) -> Iterator[str]:
    for name in _duplicates(signature.name for signature in domain.predicates):
        yield f"predicate {name!r} is declared twice"
    for name in _duplicates(operator.name for operator in domain.operators):
        yield f"operator {name!r} is declared twice"
    for name in _duplicates(name for name, _ in domain.constants):
        yield f"constant {name!r} is declared twice"
    for name, type_name in domain.constants:
        if name.startswith("?"):
            yield f"constant {name!r} has the name of a variable"
        if not _known_type(type_name, domain.types):
            yield f"constant {name!r} is of the unknown type {type_name!r}"
    for signature in domain.predicates:
        if signature.name == EQUALITY:
            yield "predicate '=' is built in and cannot be declared"
        for type_name in signature.argument_types:
            if not _known_type(type_name, domain.types):
                yield f"predicate {signature.name!r} has an argument of the unknown type {type_name!r}"
    signatures = {signature.name: signature for signature in domain.predicates}
    for operator in domain.operators:
        for fault in _operator_faults(operator, domain, signatures):
            yield f"operator {operator.name!r}: {fault}"


def _operator_faults(
    operator: Operator, domain: Domain, signatures: Mapping[str, Signature]
) -> Iterator[str]:
    types = dict(domain.constants)
    for parameter in operator.parameters:
        if not parameter.variable.startswith("?"):
            yield f"parameter {parameter.variable!r} does not start with '?'"
        if not _known_type(parameter.type_name, domain.types):
            yield f"parameter {parameter.variable!r} is of the unknown type {parameter.type_name!r}"
            return
        types[parameter.variable] = parameter.type_name
    for name in _duplicates(parameter.variable for parameter in operator.parameters):
        yield f"parameter {name!r} is declared twice"
    for literal in sorted(operator.preconditions):
        yield from atom_faults(literal.atom, types, signatures, domain.types)
    for literal in sorted(operator.effects):
        if literal.atom.predicate == EQUALITY:
            yield "'=' cannot be an effect"
        if literal.is_positive and literal.negated() in operator.effects:
            yield f"{literal} is both added and deleted"
        yield from atom_faults(literal.atom, types, signatures, domain.types)
    if not 0 <= operator.cost <= MAX_COST:
        yield f"cost {operator.cost} is outside of 0 … {MAX_COST}"


def atom_faults(
    atom: Atom, types: Mapping[str, str], signatures: Mapping[str, Signature], hierarchy: TypeHierarchy
) -> Iterator[str]:
    """What is wrong with an atom, given its names' types and the declared predicates."""
    signature = signatures.get(atom.predicate)
    if atom.predicate == EQUALITY:
        signature = Signature(EQUALITY, (ROOT, ROOT))
    if signature is None:
        declared = ", ".join(sorted(signatures)) or "none"
        yield f"{atom} has the unknown predicate {atom.predicate!r}; declared: {declared}"
        return
    wanted = signature.argument_types
    if len(wanted) != len(atom.arguments):
        yield f"{atom} has {len(atom.arguments)} arguments; {atom.predicate!r} takes {len(wanted)}"
        return
    for name, type_name in zip(atom.arguments, wanted, strict=True):
        found = types.get(name)
        if found is None:
            what = "variable" if name.startswith("?") else "object"
            yield f"{atom} names the unknown {what} {name!r}; declared: {', '.join(sorted(types)) or 'none'}"
        elif not hierarchy.is_subtype(found, type_name):
            yield f"{atom}: {name!r} is a {found}; {atom.predicate!r} takes a {type_name}"


def _problem_faults(problem: Problem, domain: Domain) -> Iterator[str]:
    types = dict(domain.constants)
    for name in _duplicates(name for name, _ in problem.objects):
        yield f"object {name!r} is declared twice"
    for name, type_name in problem.objects:
        if types.get(name, type_name) != type_name:
            yield f"object {name!r} is a {type_name} here and a {types[name]} in the domain"
        if name.startswith("?"):
            yield f"object {name!r} has the name of a variable"
        if not _known_type(type_name, domain.types):
            available = ", ".join(domain.types.names)
            yield f"object {name!r} is of the unknown type {type_name!r}; available: {available}"
            return
        types[name] = type_name
    if problem.domain_name != domain.name:
        yield f"the problem is for domain {problem.domain_name!r}, not {domain.name!r}"
    signatures = {signature.name: signature for signature in domain.predicates}
    for atom in sorted(problem.initial):
        if atom.predicate == EQUALITY:
            yield "'=' cannot be stated in an initial state"
        for fault in atom_faults(atom, types, signatures, domain.types):
            yield f"initial state: {fault}"
    for literal in sorted(problem.goal):
        for fault in _goal_faults(literal, types, signatures, domain.types):
            yield f"goal: {fault}"


def _goal_faults(
    literal: Literal, types: Mapping[str, str], signatures: Mapping[str, Signature], hierarchy: TypeHierarchy
) -> Iterator[str]:
    if literal.atom.predicate == EQUALITY:
        yield "'=' cannot be a goal"
    yield from atom_faults(literal.atom, types, signatures, hierarchy)
