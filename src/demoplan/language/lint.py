"""What is suspicious about a domain: operators that can never be taken, dead ends, broken laws.

Nothing here says that a domain is wrong; each finding names what a person should look at, and why.

Source: for relaxed reachability, J. Hoffmann, B. Nebel, "The FF planning system: fast plan generation through
heuristic search", JAIR 14, 2001, doi:10.1613/jair.855, section 4.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator
from demoplan.language.invariants import ExclusiveGroup
from demoplan.language.types import ROOT, TypeHierarchy

ERROR, WARNING, NOTE = "error", "warning", "note"
MAX_GROUNDINGS = 200_000
"""Beyond so many ways to bind an operator's parameters, its reachability is not looked at."""


@dataclass(frozen=True, order=True, kw_only=True)
class LintFinding:
    """One thing to look at."""

    severity: str
    """``error``: cannot be meant. ``warning``: plans will likely suffer. ``note``: worth knowing."""
    rule: str
    operator: str
    """Empty where the domain as a whole is meant."""
    message: str

    def __str__(self) -> str:
        """One line."""
        where = f"{self.operator}: " if self.operator else ""
        return f"{self.severity}: {where}{self.message} [{self.rule}]"


def lint(
    domain: Domain,
    *,
    groups: Sequence[tuple[ExclusiveGroup, str]] = (),
    start: frozenset[Atom] | None = None,
    objects: Sequence[tuple[str, str]] = (),
) -> tuple[LintFinding, ...]:
    """Everything suspicious about a domain, errors first.

    Args:
        domain: What to look at.
        groups: Atoms that exclude each other, each with the type of object that it holds for, as the
            demonstrations showed them.
        start: A state from which operators should be reachable, if that is to be looked at.
        objects: Its (instance, type) pairs.
    """
    found = [
        *(each for operator in domain.operators for each in _of_operator(operator, domain, groups)),
        *_no_way_back(domain),
        *_never_made(domain),
        *_unused(domain),
        *_alike(domain),
    ]
    if start is not None:
        found += _unreachable(domain, start, objects)
    rank = {ERROR: 0, WARNING: 1, NOTE: 2}
    return tuple(
        sorted(found, key=lambda each: (rank[each.severity], each.rule, each.operator, each.message))
    )


def _of_operator(
    operator: Operator, domain: Domain, groups: Sequence[tuple[ExclusiveGroup, str]]
) -> Iterator[LintFinding]:
    for literal in sorted(operator.preconditions):
        if literal.is_positive and literal.negated() in operator.preconditions:
            yield LintFinding(
                severity=ERROR,
                rule="contradiction",
                operator=operator.name,
                message=f"asks for {literal.atom} and for its absence, so it can never be taken",
            )
    if not operator.effects - operator.preconditions:
        yield LintFinding(
            severity=WARNING, rule="no-effect", operator=operator.name, message="changes nothing"
        )
    type_of = {each.variable: each.type_name for each in operator.parameters} | dict(domain.constants)
    for group, key_type in groups:
        yield from _mutex(operator, group, key_type, type_of, domain.types)


def _mutex(
    operator: Operator, group: ExclusiveGroup, key_type: str, type_of: dict[str, str], types: TypeHierarchy
) -> Iterator[LintFinding]:
    """Where an operator needs, or leaves, two atoms of which demonstrations only ever show one."""

    def of_group(literals: Iterable[Literal]) -> list[Atom]:
        atoms = sorted(each.atom for each in literals if each.is_positive)
        return [
            atom
            for atom in atoms
            if (key := group.key(atom)) is not None and _meet(type_of[key], key_type, types)
        ]

    for one, other in combinations(of_group(operator.preconditions), 2):
        if group.key(one) == group.key(other):
            yield LintFinding(
                severity=ERROR,
                rule="mutex-condition",
                operator=operator.name,
                message=f"needs {one} and {other} at once; of these, one holds at a time",
            )
    deleted = {each.atom for each in operator.effects if not each.is_positive}
    before = [atom for atom in of_group(operator.preconditions) if atom not in deleted]
    added = of_group(operator.effects)
    for atom in added:
        for other in [*before, *(each for each in added if each > atom)]:
            if other != atom and group.key(other) == group.key(atom):
                yield LintFinding(
                    severity=ERROR,
                    rule="mutex-effect",
                    operator=operator.name,
                    message=f"leaves {other} and {atom} true at once; of these, one holds at a time",
                )
        in_exchange = any(each != atom and group.key(each) == group.key(atom) for each in deleted)
        is_exclusive_before = any(
            not each.is_positive and each.atom == atom for each in operator.preconditions
        )
        if not in_exchange and not before and not is_exclusive_before and len(group.members) == 1:
            yield LintFinding(
                severity=WARNING,
                rule="mutex-effect",
                operator=operator.name,
                message=f"adds {atom} and takes no other away: {group.key(atom)} may end up with two",
            )


def _meet(one: str, other: str, types: TypeHierarchy) -> bool:
    """Whether an object may be of both types."""
    return types.is_subtype(one, other) or types.is_subtype(other, one)


def _places(operator: Operator, literal: Literal, domain: Domain) -> tuple[str, ...]:
    type_of = {each.variable: each.type_name for each in operator.parameters} | dict(domain.constants)
    return tuple(type_of.get(name, ROOT) for name in literal.atom.arguments)


def _no_way_back(domain: Domain) -> Iterator[LintFinding]:
    """Effects that no operator undoes for objects of their types."""
    effects = [
        (operator, each, _places(operator, each, domain))
        for operator in domain.operators
        for each in sorted(operator.effects)
    ]
    for operator, effect, places in effects:
        is_undone = any(
            other.atom.predicate == effect.atom.predicate
            and other.is_positive != effect.is_positive
            and all(_meet(a, b, domain.types) for a, b in zip(places, their, strict=True))
            for _, other, their in effects
        )
        if is_undone:
            continue
        verb, opposite = ("adds", "removes") if effect.is_positive else ("removes", "adds")
        kinds = ", ".join(places)
        yield LintFinding(
            severity=WARNING,
            rule="no-way-back",
            operator=operator.name,
            message=f"{verb} {effect.atom}, and no operator {opposite} {effect.atom.predicate} of ({kinds}): "
            f"demonstrate an activity that {opposite} it",
        )


def _never_made(domain: Domain) -> Iterator[LintFinding]:
    """Conditions that no operator brings about: only a start can give them."""
    effects = {
        (each.atom.predicate, each.is_positive) for operator in domain.operators for each in operator.effects
    }
    for operator in domain.operators:
        for each in sorted(operator.preconditions):
            key = (each.atom.predicate, each.is_positive)
            if key in effects or each.atom.predicate == "=":
                continue
            is_lost = (each.atom.predicate, not each.is_positive) in effects
            if not each.is_positive and not is_lost:
                continue  # Nothing ever makes it true.
            yield LintFinding(
                severity=WARNING if is_lost else NOTE,
                rule="condition-never-made",
                operator=operator.name,
                message=f"needs {each}, which no operator brings about"
                + (" and others undo: it can be had only from the start" if is_lost else ""),
            )


def _unused(domain: Domain) -> Iterator[LintFinding]:
    used = {
        each.atom.predicate
        for operator in domain.operators
        for each in (*operator.preconditions, *operator.effects)
    }
    for signature in domain.predicates:
        if signature.name not in used:
            yield LintFinding(
                severity=NOTE,
                rule="unused-predicate",
                operator="",
                message=f"predicate {signature.name} is in no operator",
            )


def _alike(domain: Domain) -> Iterator[LintFinding]:
    for one, other in combinations(domain.operators, 2):
        if one.parameters == other.parameters and one.effects == other.effects:
            if one.preconditions <= other.preconditions:
                wide, narrow = one, other
            elif other.preconditions <= one.preconditions:
                wide, narrow = other, one
            else:
                continue
            yield LintFinding(
                severity=WARNING,
                rule="subsumed",
                operator=narrow.name,
                message=f"does what {wide.name} does, which asks for no more",
            )


def _unreachable(
    domain: Domain, start: frozenset[Atom], objects: Sequence[tuple[str, str]]
) -> Iterator[LintFinding]:
    """Operators that cannot be taken from a start, even if nothing that ever was so ceased to be."""
    true, false = set(start), set[Atom]()
    waiting = {operator.name: operator for operator in domain.operators}
    names = [*objects, *domain.constants]
    bindings = {operator.name: _bindings(operator, names, domain.types) for operator in domain.operators}
    too_many = {name for name, found in bindings.items() if found is None}
    is_growing = True
    while is_growing:
        is_growing = False
        for operator in domain.operators:
            for chosen in bindings[operator.name] or ():
                name_of = dict(zip((each.variable for each in operator.parameters), chosen, strict=True))
                conditions = [each.substitute(name_of) for each in operator.preconditions]
                if not all(
                    each.atom in true if each.is_positive else each.atom in false or each.atom not in start
                    for each in conditions
                    if each.atom.predicate != "="
                ):
                    continue
                waiting.pop(operator.name, None)
                for effect in (each.substitute(name_of) for each in operator.effects):
                    into = true if effect.is_positive else false
                    if effect.atom not in into:
                        into.add(effect.atom)
                        is_growing = True
    for name, operator in sorted(waiting.items()):
        if name in too_many:
            continue
        lacking = sorted(
            str(each)
            for each in operator.preconditions
            if each.is_positive and not any(atom.predicate == each.atom.predicate for atom in true)
        )
        why = f": nothing ever makes {', '.join(lacking)} true" if lacking else ""
        yield LintFinding(
            severity=WARNING,
            rule="unreachable",
            operator=name,
            message=f"cannot be taken from this start, whatever is done before{why}",
        )


def _bindings(
    operator: Operator, objects: Sequence[tuple[str, str]], types: TypeHierarchy
) -> list[tuple[str, ...]] | None:
    choices = [
        [name for name, kind in objects if types.is_subtype(kind, each.type_name)]
        for each in operator.parameters
    ]
    size = 1
    for each in choices:
        size *= len(each)
    if size > MAX_GROUNDINGS:
        return None
    return [chosen for chosen in product(*choices) if len(set(chosen)) == len(chosen)]
