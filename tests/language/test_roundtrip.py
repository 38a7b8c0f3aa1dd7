"""What is rendered reads back as what it was, whatever the names."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature
from demoplan.language.pddl import parse_domain, parse_problem, render_domain, render_problem
from demoplan.language.pddl.symbols import RESERVED, SymbolMap, slug
from demoplan.language.types import ROOT, TypeHierarchy

HOSTILE = [
    "a) (and",
    "x\n(:action evil)",
    '; is "y"',
    "and",
    "not",
    "object",
    "Object",
    "ÆØÅ",
    "手",
    "",
    "inHand",
    "in_hand",
    "InHand",
    "in-hand",
    "9lives",
    "x" * 500,
    "X" * 500,
    "total-cost",
    "define",
    "\x00",
    "?",
]
names = st.sampled_from(HOSTILE) | st.text(max_size=12) | st.from_regex(r"[a-zA-Z][\w-]{0,8}", fullmatch=True)
object_names = names.filter(lambda name: not name.startswith("?"))


def distinct(strategy, **sizes):
    return st.lists(strategy, unique=True, **sizes)


@st.composite
def domains(draw):
    type_names = draw(distinct(names.filter(lambda name: name != ROOT), max_size=4))
    parents = {}
    for index, name in enumerate(type_names):
        parents[name] = draw(st.sampled_from([ROOT, *type_names[:index]]))
    types = TypeHierarchy.of(parents)
    kinds = st.sampled_from([ROOT, *type_names])
    predicates = tuple(
        Signature(name, tuple(draw(st.lists(kinds, max_size=3))))
        for name in sorted(draw(distinct(names.filter(lambda name: name != "="), max_size=4)))
    )
    constants = tuple((name, draw(kinds)) for name in sorted(draw(distinct(object_names, max_size=2))))

    def fitting(signature, typed):
        choices = [
            [name for name, own in typed if types.is_subtype(own, kind)] for kind in signature.argument_types
        ]
        return None if any(not choice for choice in choices) else choices

    def some_literals(typed):
        usable = [(each, fitting(each, typed)) for each in predicates]
        usable = [(each, choices) for each, choices in usable if choices is not None]
        found = {}
        if usable:
            for signature, choices in draw(st.lists(st.sampled_from(usable), max_size=4)):
                arguments = tuple(draw(st.sampled_from(choice)) for choice in choices)
                found[Atom(signature.name, arguments)] = draw(st.booleans())
        return frozenset(Literal(atom, sign) for atom, sign in found.items())

    operators = []
    for name in sorted(draw(distinct(names, max_size=3))):
        parameters = tuple(Parameter(f"?{each}", draw(kinds)) for each in draw(distinct(names, max_size=3)))
        typed = [(each.variable, each.type_name) for each in parameters] + list(constants)
        conditions = some_literals(typed)
        if len(parameters) > 1:
            pair = (parameters[0].variable, parameters[1].variable)
            conditions |= draw(st.sampled_from([frozenset(), frozenset({Literal(Atom("=", pair), False)})]))
        operators.append(
            Operator(
                name,
                parameters,
                conditions,
                some_literals(typed),
                draw(names),
                draw(st.integers(0, 2**31 - 1)),
                draw(st.integers(0, 10**6)),
            )
        )
    return Domain(draw(names), types, predicates, tuple(operators), constants)


@st.composite
def tasks(draw):
    domain = draw(domains())
    kinds = st.sampled_from([ROOT, *domain.types.names])
    taken = {name for name, _ in domain.constants}
    objects = tuple(
        (name, draw(kinds))
        for name in sorted(draw(distinct(object_names.filter(lambda name: name not in taken), max_size=4)))
    )
    typed = [*objects, *domain.constants]
    atoms = []
    for signature in domain.predicates:
        choices = [
            [name for name, own in typed if domain.types.is_subtype(own, kind)]
            for kind in signature.argument_types
        ]
        if all(choices):
            atoms.append(Atom(signature.name, tuple(draw(st.sampled_from(choice)) for choice in choices)))
    initial = frozenset(draw(st.lists(st.sampled_from(atoms), max_size=4))) if atoms else frozenset()
    goal = frozenset(
        Literal(atom, draw(st.booleans()))
        for atom in (draw(st.lists(st.sampled_from(atoms), unique=True)) if atoms else [])
    )
    return domain, Problem(draw(names), domain.name, objects, initial, goal)


@settings(max_examples=80, deadline=None)
@given(domains())
def test_a_domain_reads_back_as_it_was(domain):
    text = render_domain(domain)
    assert text.isascii()
    assert parse_domain(text) == domain
    assert render_domain(parse_domain(text)) == text


@settings(max_examples=60, deadline=None)
@given(tasks())
def test_a_problem_reads_back_as_it_was(task):
    domain, problem = task
    text = render_problem(problem, domain)
    assert text.isascii()
    assert parse_problem(text, domain) == problem


@settings(max_examples=30, deadline=None)
@given(domains(), st.randoms(use_true_random=False))
def test_the_order_in_which_things_are_given_leaves_the_bytes_alone(domain, random):
    def shuffled(items):
        items = list(items)
        random.shuffle(items)
        return tuple(items)

    other = Domain(
        domain.name,
        domain.types,
        shuffled(domain.predicates),
        shuffled(domain.operators),
        shuffled(domain.constants),
    )
    assert render_domain(other) == render_domain(domain)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["type", "object"]), names), unique=True))
def test_symbols_lead_back_to_names(pairs):
    symbols = SymbolMap.of(pairs)
    for kind, name in pairs:
        symbol = symbols.symbol(kind, name)
        assert re.fullmatch(r"[a-z][a-z0-9_-]*", symbol)
        assert len(symbol) <= 80
        assert symbol not in RESERVED
        assert symbols.name(symbol) == name


@pytest.mark.parametrize(
    ("name", "symbol"),
    [
        ("inHand", "in_hand"),
        ("Right_hand", "right_hand"),
        ("cube_red", "cube_red"),
        ("HTTPServer", "http_server"),
        ("3d mug", "n_3d_mug"),
        ("", "n"),
        ("手", "n"),
        ("a) (and", "a_and"),
    ],
)
def test_slugs_are_readable(name, symbol):
    assert slug(name) == symbol


def test_names_that_want_one_form_are_numbered_and_plain_names_go_first():
    symbols = SymbolMap.of([("predicate", "inHand"), ("predicate", "InHand"), ("predicate", "in_hand")])
    assert [symbols.symbol("predicate", name) for name in ("in_hand", "inHand", "InHand")] == [
        "in_hand",
        "in_hand_1",
        "in_hand_2",
    ]


def test_an_object_does_not_take_the_form_that_a_type_was_changed_to():
    domain = Domain("d", TypeHierarchy.of({"Table": "object"}), (), ())
    problem = Problem("p", "d", (("table", "Table"),), frozenset(), frozenset())
    assert "table_1 - table" in render_problem(problem, domain)


def test_names_of_domains_made_elsewhere_stay_as_they_are():
    text = """(define (domain ferry)
      (:requirements :strips :typing)
      (:types car place - object)
      (:constants quay - place)
      (:predicates (at ?c - car ?p - place) (car ?c - car))
      (:action at :parameters (?c - car) :precondition (at ?c quay) :effect (not (at ?c quay))))"""
    domain = parse_domain(text)
    again = render_domain(domain, has_costs=False)
    assert "(:action at\n" in again
    assert "(at ?x1 - car ?x2 - place)" in again
    assert "; " not in again
    assert parse_domain(again) == domain
