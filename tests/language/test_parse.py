"""PDDL that is wrong is refused where it goes wrong."""

import pytest

from demoplan.errors import DataError, PddlError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature
from demoplan.language.pddl import parse_domain, parse_problem, render_domain, render_problem
from demoplan.language.types import TypeHierarchy

SMALL = """(define (domain d)
  (:requirements :strips :typing)
  (:types cube - object)
  (:predicates (clear ?c - cube) (on ?a - cube ?b - cube))
  (:action lift
    :parameters (?c - cube)
    :precondition (clear ?c)
    :effect (not (clear ?c))))
"""


def test_names_are_read_without_case():
    assert parse_domain(SMALL.upper()) == parse_domain(SMALL)


def test_a_domain_without_functions_costs_one_each():
    assert parse_domain(SMALL).operators[0].cost == 1


def test_an_action_that_increases_nothing_costs_nothing_where_costs_are_declared():
    text = SMALL.replace("(:action", "(:functions (total-cost) - number) (:action")
    assert parse_domain(text).operators[0].cost == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(clear ?c)\n", "(claer ?c)\n", r"line 7, column 19: claer\(\?c\) has the unknown predicate 'claer'; declared: clear, on"),
        ("(clear ?c)\n", "(clear ?c ?c)\n", r"line 7, column 19: .* has 2 arguments; 'clear' takes 1"),
        ("(clear ?c)\n", "(clear ?d)\n", r"line 7, column 19: .* unknown variable '\?d'; declared: \?c"),
        ("(clear ?c)\n", "(or (clear ?c))\n", r"line 7, column 20: 'or' is not supported here"),
        ("(clear ?c)\n", "(forall (?d - cube) (clear ?d))\n", r"line 7, column 20: 'forall' is not supported"),
        ("(clear ?c)\n", "(not (not (clear ?c)))\n", r"line 7, column 24: 'not' is supported before an atom only"),
        ("(clear ?c)\n", "clear\n", r"line 7, column 19: expected a list in brackets, found 'clear'"),
        ("(not (clear ?c))", "(when (clear ?c) (on ?c ?c))", r"line 8, column 14: 'when' is not supported"),
        ("(not (clear ?c))", "(increase (total-cost) 2)", r"line 8, column 13: .* not declared"),
        ("(not (clear ?c))", "(and (clear ?c) (not (clear ?c)))", r"clear\(\?c\) is both added and deleted"),
        ("?c - cube)\n    :pre", "?c - cub)\n    :pre", r"line 6, column 23: unknown type 'cub'; available: object, cube"),
        ("?c - cube)\n    :pre", "?c - (either cube object))\n    :pre", r"line 6, column 23: expected one type"),
        ("?c - cube)\n    :pre", "c - cube)\n    :pre", r"line 6, column 18: expected a variable"),
        (":typing", ":adl", r"line 2, column 26: requirement :adl is not supported"),
        ("(:types cube - object)", "(:types cube - object) (:types)", r"line 3, column 26: a second :types section"),
        ("(:types cube - object)", "(:derived (a) (b))", r"line 3, column 3: section :derived is not supported"),
        ("(:types cube - object)", "(:types a - b b - a cube)", r"line 3, column 3: type '.' is its own ancestor"),
        ("(domain d)", "(problem d)", r"line 1, column 9: expected \(domain name\), found"),
        ("))))\n", ")))\n", r"line 1, column 1: '\(' is never closed"),
        ("))))\n", ")))))\n", r"line 8, column 31: '\)' without a '\(' before it"),
        ("(define", "define", r"line 1, column 1: expected '\(', found 'define'"),
        ("lift", "läft", r"line 5, column 12: PDDL names are ASCII"),
        (":effect (not (clear ?c))", ":effect", r"line 8, column 5: nothing follows :effect"),
        (":effect", ":efect", r"line 8, column 5: expected each of .* once, found ':efect'"),
    ],
)  # fmt: skip
def test_faults_are_named_by_place(old, new, message):
    assert old in SMALL
    with pytest.raises(PddlError, match=message):
        parse_domain(SMALL.replace(old, new, 1))


@pytest.mark.parametrize("text", ["", "; only a comment", "(define (domain a)) (define (domain b))", "()"])
def test_what_is_not_one_definition_is_refused(text):
    with pytest.raises(PddlError, match="expected"):
        parse_domain(text)


def test_brackets_without_end_are_refused_before_they_hurt():
    with pytest.raises(PddlError, match="nest deeper than 64"):
        parse_domain("(" * 100_000)


def test_a_domain_without_operators_or_predicates_is_a_domain():
    domain = Domain("d", TypeHierarchy(()), (), ())
    assert parse_domain(render_domain(domain)) == domain


def test_a_problem_must_fit_its_domain():
    domain = parse_domain(SMALL)
    text = "(define (problem p) (:domain d) (:objects a - cube) (:init (clear a)) (:goal (on a {})))"
    assert parse_problem(text.format("a"), domain).goal == {Literal(Atom("on", ("a", "a")))}
    with pytest.raises(PddlError, match=r"goal: on\(a,b\) names the unknown object 'b'; declared: a"):
        parse_problem(text.format("b"), domain)
    with pytest.raises(PddlError, match="the problem is for domain 'e', not 'd'"):
        parse_problem(text.format("a").replace("(:domain d)", "(:domain e)"), domain)
    with pytest.raises(PddlError, match="no :init section"):
        parse_problem(text.format("a").replace("(:init (clear a))", ""), domain)
    with pytest.raises(PddlError, match="lists what is true"):
        parse_problem(text.format("a").replace("(clear a)", "(not (clear a))"), domain)


PREDICATES = (Signature("clear", ("Cube",)),)
TYPES = TypeHierarchy.of({"Cube": "Thing", "Hand": "object"})


@pytest.mark.parametrize(
    ("operator", "message"),
    [
        (Operator("o", (Parameter("?c", "Cup"),), frozenset(), frozenset()), r"unknown type 'Cup'"),
        (Operator("o", (Parameter("c", "Cube"),), frozenset(), frozenset()), r"does not start with '\?'"),
        (
            Operator(
                "o", (Parameter("?h", "Hand"),), frozenset({Literal(Atom("clear", ("?h",)))}), frozenset()
            ),
            r"operator 'o': clear\(\?h\): '\?h' is a Hand; 'clear' takes a Cube",
        ),
        (Operator("o", (), frozenset(), frozenset(), cost=-3), r"cost -3 is outside of 0 … 2147483647"),
        (Operator("o", (), frozenset(), frozenset(), cost=2**31), r"cost 2147483648 is outside"),
        (
            Operator("o", (), frozenset(), frozenset({Literal(Atom("=", ("a", "a")))})),
            r"'=' cannot be an effect",
        ),
    ],
)
def test_values_that_are_not_pddl_are_not_rendered(operator, message):
    with pytest.raises(DataError, match=message):
        render_domain(Domain("d", TYPES, PREDICATES, (operator,)))


def test_operators_of_one_name_are_not_rendered():
    operator = Operator("o", (), frozenset(), frozenset())
    with pytest.raises(DataError, match="operator 'o' is declared twice"):
        render_domain(Domain("d", TYPES, (), (operator, operator)))


def test_a_problem_with_an_unknown_predicate_is_not_rendered():
    problem = Problem("p", "d", (("a", "Cube"),), frozenset({Atom("on", ("a",))}), frozenset())
    with pytest.raises(
        DataError, match=r"initial state: on\(a\) has the unknown predicate 'on'; declared: clear"
    ):
        render_problem(problem, Domain("d", TYPES, PREDICATES, ()))
