import polars as pl

from demoplan.language.atoms import Literal
from demoplan.language.domains import Parameter, Signature
from demoplan.language.pddl import parse_domain, render_domain
from demoplan.language.types import TypeHierarchy
from demoplan.stages.compose import compose, pruned, support_of
from demoplan.tables import Literals, Operators

TYPES = TypeHierarchy.of({"Hand": "object"})
PREDICATES = (Signature("q", ("Hand",)), Signature("p", ("Hand",)))


def operator(name, *, is_quarantined=False):
    return {
        "operator": name, "activity": "Go", "parameters": [{"variable": "?hand", "type": "Hand"}], "n_transitions": 3,
        "n_episodes": 1, "n_successes": 0, "n_failures": 0, "beta": 0.75, "cost": 7, "is_quarantined": is_quarantined, "note": None,
    }  # fmt: skip


def literal(name, role, predicate, *, is_positive=True, is_kept=True):
    return {
        "operator": name, "role": role, "predicate": predicate, "variables": ["?hand"], "is_positive": is_positive, "n_support": 3,
        "n_against": 0, "n_transitions": 3, "probability": 0.9, "is_kept": is_kept, "note": None,
    }  # fmt: skip


def tables(operators, literals):
    return (
        Operators.validate(pl.DataFrame(operators, schema=Operators.create_empty().schema)),
        Literals.validate(pl.DataFrame(literals, schema=Literals.create_empty().schema)),
    )


def test_only_kept_literals_of_operators_that_are_believed_are_stated():
    operators, literals = tables(
        [operator("go_2"), operator("go_1"), operator("go_3", is_quarantined=True)],
        [
            literal("go_1", "precondition", "p"),
            literal("go_1", "precondition", "q", is_kept=False),
            literal("go_1", "effect", "p", is_positive=False),
            literal("go_3", "effect", "q"),
        ],
    )
    domain = compose(operators, literals, TYPES, PREDICATES, "d")
    assert [each.name for each in domain.operators] == ["go_1", "go_2"]
    first = domain.operators[0]
    assert first.parameters == (Parameter("?hand", "Hand"),)
    assert {str(each) for each in first.preconditions} == {"p(?hand)"}
    assert {str(each) for each in first.effects} == {"not p(?hand)"}
    assert all(isinstance(each, Literal) for each in first.effects)
    assert (first.cost, first.count, first.activity) == (7, 3, "Go")
    assert [each.name for each in domain.predicates] == ["p", "q"]


def test_counts_of_stated_literals_can_be_looked_up():
    _, literals = tables(
        [], [literal("go_1", "effect", "p", is_positive=False), literal("go_1", "effect", "q", is_kept=False)]
    )
    assert support_of(literals) == {("go_1", "effect", "not p(?hand)"): (3, 0)}


def test_predicates_that_no_operator_speaks_of_are_pruned_and_the_operators_stay():
    domain = parse_domain(
        "(define (domain d) (:requirements :strips :typing :negative-preconditions) (:types cube - object)"
        " (:predicates (on ?x ?y - cube) (upright ?x - cube) (hot ?x - cube) (inside ?x ?y - cube))"
        " (:action tip :parameters (?x - cube) :precondition (and (not (hot ?x)))"
        " :effect (and (not (upright ?x)))))"
    )
    smaller = pruned(domain)
    assert [each.name for each in smaller.predicates] == ["hot", "upright"]
    assert smaller.operators == domain.operators
    assert parse_domain(render_domain(smaller)) == smaller
