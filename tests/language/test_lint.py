"""What `domain lint` finds in domains that were made to be suspicious."""

import pytest

from demoplan.language.atoms import Atom
from demoplan.language.invariants import parse_group
from demoplan.language.lint import lint
from demoplan.language.pddl import parse_domain

TEMPLATE = """
(define (domain blocks)
  (:requirements :strips :typing :negative-preconditions)
  (:types cube table - thing thing - object)
  (:predicates (on ?x - cube ?y - thing) (clear ?x - cube) (held ?x - cube) (free) (painted ?x - cube))
  (:action take
    :parameters (?x - cube ?y - thing)
    :precondition (and (on ?x ?y) (clear ?x) (free))
    :effect (and (held ?x) (not (on ?x ?y)) (not (free))))
  (:action put
    :parameters (?x - cube ?y - thing)
    :precondition (and (held ?x))
    :effect (and (on ?x ?y) (free) (not (held ?x))))
  {more})
"""


def rules(more="", **arguments):
    domain = parse_domain(TEMPLATE.format(more=more))
    return {(each.rule, each.operator): each for each in lint(domain, **arguments)}


def test_a_domain_with_nothing_suspicious_but_an_unused_predicate_says_so():
    found = rules()
    assert set(found) == {("unused-predicate", ""), ("condition-never-made", "take")}
    assert found["condition-never-made", "take"].severity == "note"
    assert "needs clear(?x)" in found["condition-never-made", "take"].message


@pytest.mark.parametrize(
    ("more", "rule", "words"),
    [
        (
            "(:action odd :parameters (?x - cube) :precondition (and (held ?x) (not (held ?x)))"
            " :effect (and (free)))",
            "contradiction",
            "can never be taken",
        ),
        (
            "(:action odd :parameters (?x - cube) :precondition (and (held ?x)) :effect (and (held ?x)))",
            "no-effect",
            "changes nothing",
        ),
        (
            "(:action odd :parameters (?x - cube) :precondition (and (held ?x)) :effect (and (painted ?x)))",
            "no-way-back",
            "no operator removes painted of (cube)",
        ),
        (
            "(:action odd :parameters (?x - cube ?y - thing) :precondition (and (held ?x) (clear ?x))"
            " :effect (and (on ?x ?y) (free) (not (held ?x))))",
            "subsumed",
            "does what put does",
        ),
    ],
)
def test_what_is_odd_about_an_operator_is_named(more, rule, words):
    assert words in rules(more)[rule, "odd"].message


def test_conditions_and_effects_that_break_a_group_are_errors():
    group = (parse_group("on(#,·)"), "cube")
    more = (
        "(:action stuck :parameters (?x - cube ?y ?z - thing) :precondition (and (on ?x ?y) (on ?x ?z))"
        " :effect (and (held ?x)))"
        "(:action double :parameters (?x - cube ?y ?z - thing) :precondition (and (on ?x ?y))"
        " :effect (and (on ?x ?z)))"
    )
    found = rules(more, groups=[group])
    assert found["mutex-condition", "stuck"].severity == "error"
    assert "needs on(?x,?y) and on(?x,?z) at once" in found["mutex-condition", "stuck"].message
    assert "leaves on(?x,?y) and on(?x,?z) true at once" in found["mutex-effect", "double"].message
    assert ("mutex-effect", "take") not in found


def test_operators_out_of_reach_are_named_for_a_start():
    objects = [("a", "cube"), ("b", "cube"), ("t", "table")]
    on_table = {Atom("on", ("a", "t")), Atom("on", ("b", "t")), Atom("free")}
    clear = frozenset(on_table | {Atom("clear", ("a",))})
    assert not any(rule == "unreachable" for rule, _ in rules(start=clear, objects=objects))
    found = rules(start=frozenset(on_table), objects=objects)
    assert "nothing ever makes clear(?x) true" in found["unreachable", "take"].message
    assert ("unreachable", "put") in found


def test_findings_come_errors_first_and_in_the_same_order():
    domain = parse_domain(
        TEMPLATE.format(
            more="(:action odd :parameters (?x - cube) :precondition (and (free) (not (free)))"
            " :effect (and (painted ?x)))"
        )
    )
    found = lint(domain)
    assert found == lint(domain)
    assert [each.severity for each in found] == sorted(
        (each.severity for each in found), key=["error", "warning", "note"].index
    )
