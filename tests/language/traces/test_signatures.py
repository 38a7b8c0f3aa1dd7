"""Signatures come from text with names as written; contradictions are told; learned actions go back to text."""

import pytest

from demoplan.errors import PddlError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Signature
from demoplan.language.pddl import parse_domain
from demoplan.language.traces import infer_signatures, read_objects, read_signatures, render_strips

DOMAIN = """(define (domain Kitchen-2) ; a comment
  (:requirements :strips :typing)
  (:types Pan Pot - vessel vessel place - object)
  (:constants Stove - place)
  (:predicates (on ?v - vessel ?p - place) (hot ?v - vessel) (quiet))
  (:action move-Vessel :parameters (?v - vessel ?a ?b - place) :precondition (and ) :effect (and ))
  (:action listen :parameters () :precondition () :effect ()))
"""


def test_names_keep_their_letters():
    signatures, faults = read_signatures(DOMAIN, "domain.pddl")
    assert faults == ()
    assert signatures.domain_name == "Kitchen-2"
    assert signatures.constants == (("Stove", "place"),)
    assert signatures.types.is_subtype("Pan", "vessel")
    assert signatures.predicates[0] == Signature("on", ("vessel", "place"))
    assert [each.variable for each in signatures.actions[0].parameters] == ["?v", "?a", "?b"]
    assert [each.name for each in signatures.actions] == ["move-Vessel", "listen"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("(quiet)", "(quiet) (hot)", "domain.pddl:5: predicate 'hot' is declared twice, differently; the first declaration is used"),
        ("(:action listen", "(:action LISTEN :parameters (?v - vessel))(:action listen", "domain.pddl:7: action 'listen' is declared twice, differently; the first declaration is used"),
        ("?v - vessel ?a", "?v - boat ?a", "domain.pddl:6: unknown type 'boat', taken as 'object'; declared: Pan, Pot, object, place, vessel"),
        ("?a ?b", "?a ?a", "domain.pddl:6: parameter '?a' is declared twice"),
    ],
)  # fmt: skip
def test_contradictions_are_named_by_line_and_the_first_declaration_holds(old, new, message):
    _, faults = read_signatures(DOMAIN.replace(old, new), "domain.pddl")
    assert [str(fault) for fault in faults] == [message]


@pytest.mark.parametrize("text", ["", "(hello)", "(define (domain x)", "(define (domain x)))"])
def test_what_is_no_domain_is_refused_with_its_file(text):
    with pytest.raises(PddlError, match=r"domain\.pddl:"):
        read_signatures(text, "domain.pddl")


def test_types_in_a_circle_are_refused():
    with pytest.raises(PddlError, match="its own ancestor"):
        read_signatures("(define (domain x) (:types a - b b - a))", "domain.pddl")


PROBLEM = """(define (problem p) (:domain Kitchen-2)
(:objects P1 P2 - Pan shelf - place)
(:init (on P1 shelf)) (:goal (and )))"""


def test_objects_have_their_types_and_an_unknown_type_is_named():
    signatures, _ = read_signatures(DOMAIN, "domain.pddl")
    assert read_objects(PROBLEM, "p.pddl", signatures) == ({"P1": "Pan", "P2": "Pan", "shelf": "place"}, ())
    _, faults = read_objects(PROBLEM.replace("- Pan", "- Wok"), "p.pddl", signatures)
    assert str(faults[0]) == "p.pddl:2: unknown type 'Wok'; declared: Pan, Pot, object, place, vessel"


def test_objects_are_the_same_whatever_else_the_problem_holds():
    signatures, _ = read_signatures(DOMAIN, "domain.pddl")
    commented = PROBLEM.replace("(:init", "; (:objects x - Pan)\n(:init")
    assert read_objects(commented, "p.pddl", signatures) == read_objects(PROBLEM, "p.pddl", signatures)


def test_learned_actions_are_rendered_with_the_names_of_the_case():
    signatures, _ = read_signatures(DOMAIN, "domain.pddl")
    moved = (
        frozenset({Literal(Atom("on", ("?v", "?a"))), Literal(Atom("hot", ("?v",)), False)}),
        frozenset({Literal(Atom("on", ("?v", "?a")), False), Literal(Atom("on", ("?v", "Stove")))}),
    )
    text = render_strips(signatures, {"move-Vessel": moved})
    assert ":requirements :strips :typing :negative-preconditions" in text
    assert "(:action move-Vessel" in text
    assert "(and (on ?v ?a) (not (hot ?v)))" in text
    assert "(and (on ?v Stove) (not (on ?v ?a)))" in text
    assert "listen" not in text
    read_back = parse_domain(text)
    assert [len(each.preconditions) for each in read_back.operators] == [2]
    assert [len(each.effects) for each in read_back.operators] == [2]


TRACE = "(:trajectory (:state (at r1 kitchen) (holds r1 cup)) (:action (go r1 kitchen hall)) (:state (at r1 hall)))"


def test_signatures_are_inferred_from_use():
    signatures, faults = infer_signatures([(TRACE, "0_traj")])
    assert faults == ()
    arities = {each.name: each.argument_types for each in signatures.predicates}
    go = signatures.actions[0]
    assert go.name == "go"
    assert [each.type_name for each in go.parameters] == [*arities["at"], arities["at"][1]]
    assert len({*arities["at"], *arities["holds"]}) == 3


def test_uses_that_contradict_are_named():
    _, faults = infer_signatures([(TRACE, "0_traj"), ("(:trajectory\n(:state (at r1)))", "1_traj")])
    assert [str(fault) for fault in faults] == [
        "1_traj:2: predicate 'at' with 1 arguments; elsewhere it has 2"
    ]
