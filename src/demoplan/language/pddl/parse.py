"""PDDL text to values: strict, small, and exact about where a text goes wrong.

What is read is what the package writes and its neighbours use: ``:strips``, ``:typing``,
``:negative-preconditions``, ``:equality``, ``:action-costs``. Anything else (``either``, quantifiers,
conditional effects, axioms, numbers, time) is refused by name and place, never skipped.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import NoReturn

from demoplan.errors import DataError, PddlError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature
from demoplan.language.pddl.check import EQUALITY, atom_faults, domain_faults, problem_faults
from demoplan.language.pddl.expressions import Expression, Node, Place, Word, read, shown
from demoplan.language.pddl.symbols import domain_symbols
from demoplan.language.types import ROOT, TypeHierarchy

_REQUIREMENTS = frozenset({":strips", ":typing", ":negative-preconditions", ":equality", ":action-costs"})
_NAME = re.compile(r"[a-z][a-z0-9_-]*")
_NAME_COMMENT = re.compile(r'; (\??[a-z][a-z0-9_-]*) is (".*")')
_ORIGIN_COMMENT = re.compile(r'; activity (".*"), count (\d{1,18})')


@dataclass(frozen=True)
class _Names:
    """The names that comments give back to PDDL names."""

    original: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, comments: Iterable[str]) -> "_Names":
        return cls(dict(_restored(comments)))

    def __call__(self, symbol: str) -> str:
        return self.original.get(symbol, symbol)


def _restored(comments: Iterable[str]) -> Iterator[tuple[str, str]]:
    for comment in comments:
        match = _NAME_COMMENT.fullmatch(comment.rstrip())
        name = _json_string(match[2]) if match else None
        if match and name is not None:
            yield match[1], name


def _json_string(text: str) -> str | None:
    try:
        value = json.loads(text)
    except ValueError:
        return None
    return value if isinstance(value, str) else None


def parse_domain(text: str) -> Domain:
    """The domain that a PDDL text states.

    Names are lower-case, as PDDL does not tell case apart, unless the comments that :func:`render_domain`
    writes say what they were.

    Raises:
        PddlError: If the text is not a domain of the supported fragment; the message names line and column.
    """
    define, comments = _definition(text, "domain")
    names = _Names.of(comments)
    sections = _sections(define, names_repeatable={":action"})
    known = {":requirements", ":types", ":constants", ":predicates", ":functions", ":action"}
    for keyword, entries in sections.items():
        if keyword not in known:
            _fail(
                entries[0].place, f"section {keyword} is not supported; supported: {', '.join(sorted(known))}"
            )
    for entry in sections.get(":requirements", ()):
        _check_requirements(entry)
    types = _types(sections.get(":types", ()), names)
    constants = tuple(
        (names(name.text), kind)
        for entry in sections.get(":constants", ())
        for name, kind in _typed_list(entry.items[1:], types, names)
    )
    predicates = tuple(
        _signature(item, types, names)
        for entry in sections.get(":predicates", ())
        for item in entry.items[1:]
    )
    has_costs = _has_costs(sections.get(":functions", ()))
    readers = [_ActionReader(entry, types, names, has_costs) for entry in sections.get(":action", ())]
    signatures = {signature.name: signature for signature in predicates}
    constant_types = dict(constants)
    operators = [reader.operator(signatures, constant_types) for reader in readers]
    domain = Domain(
        name=names(_word(_list(define.items[1]).items[1], "a domain name").text),
        types=types,
        predicates=tuple(sorted(predicates)),
        operators=tuple(sorted(operators, key=lambda each: each.name)),
        constants=tuple(sorted(constants)),
    )
    _refuse(define.place, domain_faults(domain))
    return domain


def parse_problem(text: str, domain: Domain) -> Problem:
    """The problem that a PDDL text states for a domain.

    Args:
        text: PDDL of a problem. Its names are PDDL names of the domain, or are restored by comments.
        domain: The domain that it belongs to.

    Raises:
        PddlError: If the text is not a problem, or does not fit the domain.
    """
    define, comments = _definition(text, "problem")
    # The domain's own names come first; what the problem's comments say of its objects is added to them.
    of_domain = {symbol: name for _, name, symbol in domain_symbols(domain).entries}
    names = _Names({**of_domain, **_Names.of(comments).original})
    sections = _sections(define, names_repeatable=set())
    known = {":domain", ":requirements", ":objects", ":init", ":goal", ":metric"}
    for keyword, entries in sections.items():
        if keyword not in known:
            _fail(
                entries[0].place, f"section {keyword} is not supported; supported: {', '.join(sorted(known))}"
            )
    for required in (":domain", ":init", ":goal"):
        if required not in sections:
            _fail(define.place, f"the problem has no {required} section")
    domain_entry = sections[":domain"][0]
    if len(domain_entry.items) != 2:
        _fail(domain_entry.place, "expected (:domain name)")
    objects = {
        names(name.text): kind
        for entry in sections.get(":objects", ())
        for name, kind in _typed_list(entry.items[1:], domain.types, names)
    }
    initial = frozenset(_initial(sections[":init"][0], names))
    goal_entry = sections[":goal"][0]
    if len(goal_entry.items) != 2:
        _fail(goal_entry.place, "expected (:goal condition)")
    goal = frozenset(literal for literal, _ in _literals(goal_entry.items[1], names, names))
    for entry in sections.get(":metric", ()):
        _check_metric(entry)
    problem = Problem(
        name=names(_word(_list(define.items[1]).items[1], "a problem name").text),
        domain_name=names(_word(domain_entry.items[1], "a domain name").text),
        objects=tuple(sorted(objects.items())),
        initial=initial,
        goal=goal,
    )
    _refuse(define.place, problem_faults(problem, domain))
    return problem


def parse_condition(text: str) -> tuple[Literal, ...]:
    """The literals of a goal such as ``(and (on_top a b) (not (in_hand h a)))``, with names as they stand.

    Raises:
        PddlError: If the text is not one condition.
    """
    expressions, _ = read(text)
    if len(expressions) != 1:
        raise PddlError(f"expected one condition, as in (and (p a) (not (q b))), found {len(expressions)}")
    return tuple(literal for literal, _ in _literals(expressions[0], str, str))


def _fail(place: Place, problem: str) -> NoReturn:
    raise PddlError(f"{place}: {problem}")


def _refuse(place: Place, faults: tuple[str, ...]) -> None:
    if faults:
        _fail(place, "; ".join(faults[:5]))


def _definition(text: str, what: str) -> tuple[Expression, list[str]]:
    expressions, comments = read(text)
    if len(expressions) != 1:
        raise PddlError(f"expected one (define ({what} name) …), found {len(expressions)} top-level lists")
    define = expressions[0]
    head = define.items[0] if define.items else None
    if not (isinstance(head, Word) and head.text == "define"):
        _fail(define.place, f"expected (define ({what} name) …), found {shown(define)}")
    title = _list(define.items[1]) if len(define.items) > 1 else define
    if not (len(title.items) == 2 and isinstance(title.items[0], Word) and title.items[0].text == what):
        _fail(title.place, f"expected ({what} name), found {shown(title)}")
    return define, [*comments, *define.comments]


def _sections(define: Expression, names_repeatable: set[str]) -> dict[str, list[Expression]]:
    sections: dict[str, list[Expression]] = {}
    for item in define.items[2:]:
        entry = _list(item)
        keyword = _word(
            entry.items[0] if entry.items else entry, "a section keyword, as in (:predicates …)"
        ).text
        if keyword in sections and keyword not in names_repeatable:
            _fail(entry.place, f"a second {keyword} section")
        sections.setdefault(keyword, []).append(entry)
    return sections


def _list(node: Node) -> Expression:
    if isinstance(node, Word):
        _fail(node.place, f"expected a list in brackets, found {node.text!r}")
    return node


def _word(node: Node, wanted: str) -> Word:
    if isinstance(node, Expression):
        _fail(node.place, f"expected {wanted}, found {shown(node)}")
    return node


def _name(node: Node, wanted: str) -> Word:
    word = _word(node, wanted)
    if not _NAME.fullmatch(word.text):
        _fail(word.place, f"expected {wanted}, found {word.text!r}")
    return word


def _check_requirements(entry: Expression) -> None:
    for item in entry.items[1:]:
        word = _word(item, "a requirement")
        if word.text not in _REQUIREMENTS:
            supported = ", ".join(sorted(_REQUIREMENTS))
            _fail(word.place, f"requirement {word.text} is not supported; supported: {supported}")


def _types(entries: Iterable[Expression], names: _Names) -> TypeHierarchy:
    parents: dict[str, str] = {}
    place = Place(1, 1)
    for entry in entries:
        place = entry.place
        for name, parent in _pairs(entry.items[1:]):
            if name.text == ROOT:
                continue
            _name(name, "a type name")
            kind = names(parent.text) if parent and parent.text != ROOT else ROOT
            if parents.get(names(name.text), kind) != kind:
                _fail(name.place, f"type {name.text!r} has two parents")
            parents[names(name.text)] = kind
    try:
        return TypeHierarchy.of(parents)
    except DataError as error:
        raise PddlError(f"{place}: {error}") from error


def _pairs(items: list[Node]) -> Iterator[tuple[Word, Word | None]]:
    """(name, type) pairs of a typed list, with None for names without a type."""
    waiting: list[Word] = []
    position = 0
    while position < len(items):
        word = _word(items[position], "a name")
        if word.text == "-":
            if not waiting or position + 1 == len(items):
                _fail(word.place, "expected names before '-' and a type after it")
            following = items[position + 1]
            if isinstance(following, Expression):
                _fail(
                    following.place, f"expected one type, found {shown(following)}; 'either' is not supported"
                )
            yield from ((name, _name(following, "a type name")) for name in waiting)
            waiting = []
            position += 2
        else:
            waiting.append(word)
            position += 1
    yield from ((name, None) for name in waiting)


def _typed_list(
    items: list[Node], types: TypeHierarchy, names: _Names, *, is_variable: bool = False
) -> list[tuple[Word, str]]:
    result = []
    seen: set[str] = set()
    for name, parent in _pairs(items):
        kind = names(parent.text) if parent and parent.text != ROOT else ROOT
        if parent and kind != ROOT and kind not in types.names:
            _fail(parent.place, f"unknown type {parent.text!r}; available: {', '.join((ROOT, *types.names))}")
        if is_variable:
            if not (name.text.startswith("?") and _NAME.fullmatch(name.text[1:])):
                _fail(name.place, f"expected a variable, as ?x, found {name.text!r}")
        else:
            _name(name, "a name")
        if name.text in seen:
            _fail(name.place, f"{name.text!r} stands twice in one list")
        seen.add(name.text)
        result.append((name, kind))
    return result


def _signature(node: Node, types: TypeHierarchy, names: _Names) -> Signature:
    entry = _list(node)
    head = _name(entry.items[0] if entry.items else entry, "a predicate name")
    pairs = _typed_list(entry.items[1:], types, names, is_variable=True)
    return Signature(names(head.text), tuple(kind for _, kind in pairs))


def _has_costs(entries: Iterable[Expression]) -> bool:
    has_costs = False
    for entry in entries:
        for item in entry.items[1:]:
            if isinstance(item, Word):  # "- number" after the function
                if item.text not in {"-", "number"}:
                    _fail(item.place, f"expected (total-cost) - number, found {item.text!r}")
                continue
            words = [each.text for each in item.items if isinstance(each, Word)]
            if words != ["total-cost"] or len(item.items) != 1:
                _fail(item.place, f"the only supported function is (total-cost), found {shown(item)}")
            has_costs = True
    return has_costs


def _check_metric(entry: Expression) -> None:
    words = [item.text for item in entry.items if isinstance(item, Word)]
    last = entry.items[-1] if entry.items else entry
    inner = (
        [item.text for item in last.items if isinstance(item, Word)] if isinstance(last, Expression) else []
    )
    if words != [":metric", "minimize"] or inner != ["total-cost"]:
        _fail(entry.place, "the only supported metric is (:metric minimize (total-cost))")


def _initial(entry: Expression, names: _Names) -> Iterator[Atom]:
    for item in entry.items[1:]:
        fact = _list(item)
        head = fact.items[0] if fact.items else None
        if isinstance(head, Word) and head.text == EQUALITY:
            _check_initial_cost(fact)
            continue
        for literal, place in _literals(fact, names, names):
            if not literal.is_positive:
                _fail(place, "an initial state lists what is true; what is not listed is false")
            yield literal.atom


def _check_initial_cost(fact: Expression) -> None:
    function = fact.items[1] if len(fact.items) == 3 else None
    words = (
        [item.text for item in function.items if isinstance(item, Word)]
        if isinstance(function, Expression)
        else []
    )
    number = fact.items[-1]
    if words != ["total-cost"] or not (isinstance(number, Word) and re.fullmatch(r"0+(\.0*)?", number.text)):
        _fail(fact.place, "the only supported value in an initial state is (= (total-cost) 0)")


def _literals(
    node: Node, names: Callable[[str], str], terms: Callable[[str], str]
) -> Iterator[tuple[Literal, Place]]:
    """The literals of a conjunction, with their places."""
    entry = _list(node)
    if not entry.items:  # () is an empty condition
        return
    head = _word(entry.items[0], "a predicate, 'and' or 'not'")
    if head.text == "and":
        for item in entry.items[1:]:
            yield from _literals(item, names, terms)
    elif head.text == "not":
        if len(entry.items) != 2:
            _fail(entry.place, "expected (not (predicate …))")
        inner = _list(entry.items[1])
        first = inner.items[0] if inner.items else inner
        if isinstance(first, Word) and first.text in {"and", "not"}:
            _fail(inner.place, f"'not' is supported before an atom only, found {shown(inner)}")
        for literal, place in _literals(inner, names, terms):
            yield literal.negated(), place
    elif head.text in {
        "or",
        "imply",
        "forall",
        "exists",
        "when",
        "increase",
        "decrease",
        "assign",
        "preference",
    }:
        _fail(head.place, f"{head.text!r} is not supported here; supported: and, not, predicates")
    else:
        if head.text != EQUALITY:
            _name(head, "a predicate name")
        arguments = []
        for item in entry.items[1:]:
            word = _word(item, "a variable or an object")
            if not _NAME.fullmatch(word.text.removeprefix("?")):
                _fail(word.place, f"expected a variable or an object, found {word.text!r}")
            arguments.append(terms(word.text))
        predicate = EQUALITY if head.text == EQUALITY else names(head.text)
        yield Literal(Atom(predicate, tuple(arguments))), entry.place


class _ActionReader:
    """Reads one action; kept as a class since its parts share the names in force."""

    def __init__(self, entry: Expression, types: TypeHierarchy, names: _Names, has_costs: bool) -> None:
        self._entry = entry
        self._types = types
        self._names = names
        self._variables = _Names.of(entry.comments)
        self._has_costs = has_costs

    def _term(self, symbol: str) -> str:
        return self._variables(symbol) if symbol.startswith("?") else self._names(symbol)

    def operator(self, signatures: Mapping[str, Signature], constants: Mapping[str, str]) -> Operator:
        """The operator, checked literal by literal so that a fault is named where it stands."""
        entry = self._entry
        if len(entry.items) < 2:
            _fail(entry.place, "expected (:action name …)")
        name = _name(entry.items[1], "an action name")
        parts = self._parts(entry.items[2:])
        pairs = _typed_list(_list(parts[":parameters"]).items, self._types, self._names, is_variable=True)
        parameters = tuple(Parameter(self._term(word.text), kind) for word, kind in pairs)
        known = {**constants, **{each.variable: each.type_name for each in parameters}}
        preconditions = list(_literals(parts[":precondition"], self._names, self._term))
        effects, cost = self._effects(parts[":effect"])
        for literal, place in (*preconditions, *effects):
            _refuse(place, tuple(atom_faults(literal.atom, known, signatures, self._types)))
        activity, count = self._origin()
        return Operator(
            name=self._names(name.text),
            parameters=parameters,
            preconditions=frozenset(literal for literal, _ in preconditions),
            effects=frozenset(literal for literal, _ in effects),
            activity=activity,
            cost=cost,
            count=count,
        )

    def _parts(self, items: list[Node]) -> dict[str, Node]:
        parts: dict[str, Node] = {}
        allowed = (":parameters", ":precondition", ":effect")
        for position in range(0, len(items), 2):
            keyword = _word(items[position], f"one of {', '.join(allowed)}")
            if keyword.text not in allowed or keyword.text in parts:
                _fail(keyword.place, f"expected each of {', '.join(allowed)} once, found {keyword.text!r}")
            if position + 1 == len(items):
                _fail(keyword.place, f"nothing follows {keyword.text}")
            parts[keyword.text] = items[position + 1]
        for keyword_text in allowed:
            parts.setdefault(keyword_text, Expression(self._entry.place))
        return parts

    def _effects(self, node: Node) -> tuple[list[tuple[Literal, Place]], int]:
        entry = _list(node)
        head = entry.items[0] if entry.items else None
        is_conjunction = isinstance(head, Word) and head.text == "and"
        members = entry.items[1:] if is_conjunction else [entry] if entry.items else []
        cost = 0 if self._has_costs else 1
        has_cost = False
        literals: list[tuple[Literal, Place]] = []
        for member in members:
            first = member.items[0] if isinstance(member, Expression) and member.items else None
            if isinstance(first, Word) and first.text == "increase":
                if has_cost:
                    _fail(first.place, "a second (increase (total-cost) …)")
                cost, has_cost = self._increase(_list(member)), True
            else:
                literals.extend(_literals(member, self._names, self._term))
        return literals, cost

    def _increase(self, entry: Expression) -> int:
        function = entry.items[1] if len(entry.items) == 3 else None
        words = (
            [item.text for item in function.items if isinstance(item, Word)]
            if isinstance(function, Expression)
            else []
        )
        number = entry.items[-1]
        if words != ["total-cost"] or not (
            isinstance(number, Word) and re.fullmatch(r"\d{1,18}", number.text)
        ):
            _fail(entry.place, "expected (increase (total-cost) N) with a non-negative integer N")
        if not self._has_costs:
            _fail(entry.place, "the cost is increased, but (:functions (total-cost)) is not declared")
        return int(number.text)

    def _origin(self) -> tuple[str, int]:
        for comment in self._entry.comments:
            match = _ORIGIN_COMMENT.fullmatch(comment.rstrip())
            activity = _json_string(match[1]) if match else None
            if match and activity is not None:
                return activity, int(match[2])
        return "", 0
