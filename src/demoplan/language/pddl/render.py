"""Values to canonical PDDL text: the same value always gives the same bytes."""

import json
from collections.abc import Callable, Iterable

from demoplan.errors import DataError
from demoplan.ids import ContentHash, DomainId, content_hash
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Problem
from demoplan.language.pddl.check import EQUALITY, domain_faults, problem_faults
from demoplan.language.pddl.symbols import (
    SymbolMap,
    domain_symbols,
    problem_symbols,
    variable_symbols,
)
from demoplan.language.types import ROOT

_MAX_FAULTS_SHOWN = 5


def domain_id(domain: Domain) -> DomainId:
    """The domain's name among versions: first 16 hex digits of the hash of its canonical text."""
    return DomainId(content_hash(render_domain(domain))[:16])


def problem_id(problem: Problem, domain: Domain) -> ContentHash:
    """The hash of the problem's canonical text."""
    return content_hash(render_problem(problem, domain))


def render_domain(domain: Domain, *, has_costs: bool = True) -> str:
    """The domain as canonical PDDL.

    Args:
        domain: What to render.
        has_costs: Whether operators increase ``total-cost``. Without, the text is plain ``:strips :typing
            :negative-preconditions``, for readers that know no more, and every operator costs 1.

    Returns:
        Text that depends on the domain's content only. Names that PDDL cannot hold, activities and counts
        are kept in comments, from which :func:`parse_domain` restores them.

    Raises:
        DataError: If the domain names something that it does not declare, or types do not fit.
    """
    faults = domain_faults(domain)
    if faults:
        raise _refusal(f"domain {domain.name!r}", faults)
    symbols = domain_symbols(domain)
    blocks = [_requirements(domain, has_costs)]
    if domain.types.parents:
        blocks.append("(:types" + "".join(f"\n    {line}" for line in _type_lines(domain, symbols)) + ")")
    if domain.constants:
        blocks.append(_objects("constants", domain.constants, symbols))
    blocks.append(
        "(:predicates" + "".join(f"\n    {line}" for line in sorted(_signatures(domain, symbols))) + ")"
    )
    if has_costs:
        blocks.append("(:functions\n    (total-cost) - number)")
    blocks.extend(
        _action(operator, symbols, has_costs)
        for operator in sorted(domain.operators, key=lambda each: symbols.symbol("operator", each.name))
    )
    header = _name_comments(symbols.changed())
    body = "\n\n".join(f"  {block}" for block in blocks)
    return f"{header}(define (domain {symbols.symbol('domain', domain.name)})\n{body})\n"


def render_problem(problem: Problem, domain: Domain, *, has_costs: bool = True) -> str:
    """The problem as canonical PDDL; ``domain`` gives the names that it shares.

    Raises:
        DataError: If the problem does not fit the domain.
    """
    faults = problem_faults(problem, domain)
    if faults:
        raise _refusal(f"problem {problem.name!r}", faults)
    symbols = problem_symbols(problem, domain_symbols(domain))
    constants = {name for name, _ in domain.constants}
    objects = [pair for pair in problem.objects if pair[0] not in constants]
    blocks = [
        f"(:domain {symbols.symbol('domain', problem.domain_name)})",
        _objects("objects", objects, symbols),
    ]

    def ground(name: str) -> str:
        return symbols.symbol("object", name)

    facts = [_atom(atom, symbols, ground) for atom in problem.initial]
    lines = ["(= (total-cost) 0)"] * has_costs + sorted(facts)
    blocks.append("(:init" + "".join(f"\n    {line}" for line in lines) + ")")
    blocks.append(f"(:goal {_conjunction(problem.goal, symbols, ground, '    ')})")
    if has_costs:
        blocks.append("(:metric minimize (total-cost))")
    mentioned = {("problem", problem.name), ("domain", domain.name)}
    mentioned |= {("object", name) for name, _ in (*problem.objects, *domain.constants)}
    mentioned |= {("type", type_name) for _, type_name in problem.objects}
    atoms = (*problem.initial, *(literal.atom for literal in problem.goal))
    mentioned |= {("predicate", atom.predicate) for atom in atoms}
    used = SymbolMap(tuple(entry for entry in symbols.entries if entry[:2] in mentioned))
    body = "\n\n".join(f"  {block}" for block in blocks)
    title = f"(problem {symbols.symbol('problem', problem.name)})"
    return f"{_name_comments(used.changed())}(define {title}\n{body})\n"


def _refusal(what: str, faults: tuple[str, ...]) -> DataError:
    listed = "; ".join(faults[:_MAX_FAULTS_SHOWN])
    rest = f"; and {len(faults) - _MAX_FAULTS_SHOWN} more" if len(faults) > _MAX_FAULTS_SHOWN else ""
    return DataError(f"{what} cannot be written as PDDL: {listed}{rest}")


def _name_comments(pairs: Iterable[tuple[str, str]], indent: str = "", mark: str = "") -> str:
    # JSON strings are one line of ASCII whatever a log calls its objects, so no name can end its comment.
    return "".join(f"{indent}; {mark}{symbol} is {json.dumps(mark + name)}\n" for symbol, name in pairs)


def _requirements(domain: Domain, has_costs: bool) -> str:
    compares = any(
        literal.atom.predicate == EQUALITY
        for operator in domain.operators
        for literal in operator.preconditions
    )
    flags = [":strips", ":typing", ":negative-preconditions"]
    flags += [":equality"] * compares + [":action-costs"] * has_costs
    return f"(:requirements {' '.join(flags)})"


def _type_lines(domain: Domain, symbols: SymbolMap) -> list[str]:
    lines = []
    waiting = [ROOT]
    while waiting:
        parent = waiting.pop(0)
        children = [(symbols.symbol("type", name), name) for name in domain.types.children(parent)]
        children.sort()
        if children:
            parent_symbol = ROOT if parent == ROOT else symbols.symbol("type", parent)
            lines.append(f"{' '.join(symbol for symbol, _ in children)} - {parent_symbol}")
        waiting = [name for _, name in children] + waiting
    return lines


def _typed(pairs: Iterable[tuple[str, str]], symbols: SymbolMap) -> str:
    """(symbol, type) pairs as a typed list; a trailing ``object`` is left out: not every reader knows it."""
    ordered = list(pairs)
    n_typed = max((index for index, (_, kind) in enumerate(ordered, 1) if kind != ROOT), default=0)
    parts = [
        f"{symbol} - {ROOT if kind == ROOT else symbols.symbol('type', kind)}"
        for symbol, kind in ordered[:n_typed]
    ]
    return " ".join(parts + [symbol for symbol, _ in ordered[n_typed:]])


def _objects(keyword: str, pairs: Iterable[tuple[str, str]], symbols: SymbolMap) -> str:
    by_type: dict[str, list[str]] = {}
    for name, type_name in pairs:
        by_type.setdefault(type_name, []).append(symbols.symbol("object", name))
    lines = [
        f"{' '.join(sorted(names))} - {symbols.symbol('type', type_name)}"
        for type_name, names in sorted(by_type.items())
        if type_name != ROOT
    ]
    lines += [" ".join(sorted(by_type[ROOT]))] if ROOT in by_type else []
    return f"(:{keyword}" + "".join(f"\n    {line}" for line in lines) + ")"


def _signatures(domain: Domain, symbols: SymbolMap) -> list[str]:
    lines = []
    for signature in domain.predicates:
        pairs = [(f"?x{number}", kind) for number, kind in enumerate(signature.argument_types, 1)]
        arguments = f" {_typed(pairs, symbols)}" if pairs else ""
        lines.append(f"({symbols.symbol('predicate', signature.name)}{arguments})")
    return lines


def _action(operator: Operator, symbols: SymbolMap, has_costs: bool) -> str:
    variables = variable_symbols(operator)

    def term(name: str) -> str:
        if name.startswith("?"):
            return "?" + variables.symbol("variable", name[1:])
        return symbols.symbol("object", name)

    indent = "      "
    comments = _name_comments(variables.changed(), "    ", mark="?")
    if operator.activity or operator.count:
        comments = f"    ; activity {json.dumps(operator.activity)}, count {operator.count}\n{comments}"
    pairs = [(term(parameter.variable), parameter.type_name) for parameter in operator.parameters]
    increase = (f"(increase (total-cost) {operator.cost})",) if has_costs else ()
    return (
        f"(:action {symbols.symbol('operator', operator.name)}\n{comments}"
        f"    :parameters ({_typed(pairs, symbols)})\n"
        f"    :precondition {_conjunction(operator.preconditions, symbols, term, indent)}\n"
        f"    :effect {_conjunction(operator.effects, symbols, term, indent, increase)})"
    )


def _atom(atom: Atom, symbols: SymbolMap, term: Callable[[str], str]) -> str:
    head = EQUALITY if atom.predicate == EQUALITY else symbols.symbol("predicate", atom.predicate)
    return f"({' '.join((head, *map(term, atom.arguments)))})"


def _conjunction(
    literals: Iterable[Literal],
    symbols: SymbolMap,
    term: Callable[[str], str],
    indent: str,
    further: tuple[str, ...] = (),
) -> str:
    texts = sorted((not each.is_positive, _atom(each.atom, symbols, term)) for each in literals)
    lines = [f"(not {text})" if is_negated else text for is_negated, text in texts]
    return "(and" + "".join(f"\n{indent}{line}" for line in (*lines, *further)) + ")"
