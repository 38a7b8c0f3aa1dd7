"""Goals as people type them, and as PDDL."""

import pytest

from demoplan.errors import PddlError, UnknownNameError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Signature
from demoplan.language.goals import goal_text, parse_goal
from demoplan.language.types import TypeHierarchy

TYPES = TypeHierarchy.of({"Hand": "object", "Cube": "Graspable", "Table": "object"})
PREDICATES = (
    Signature("inHand", ("Hand", "Graspable")),
    Signature("onTop", ("Graspable", "object")),
    Signature("isCalm", ()),
)
OBJECTS = {"Right_hand": "Hand", "cube_blue": "Cube", "cube_red": "Cube", "table": "Table"}
EXPECTED = frozenset(
    {
        Literal(Atom("onTop", ("cube_red", "cube_blue"))),
        Literal(Atom("inHand", ("Right_hand", "cube_red")), is_positive=False),
    }
)


def read(text):
    return parse_goal(text, PREDICATES, OBJECTS, TYPES)


@pytest.mark.parametrize(
    "text",
    [
        "onTop(cube_red, cube_blue) & !inHand(Right_hand, cube_red)",
        "onTop(cube_red,cube_blue) and not inHand(Right_hand,cube_red)",
        "  !inHand(Right_hand, cube_red) && onTop ( cube_red , cube_blue )  ",
        "(onTop(cube_red, cube_blue) ∧ (¬inHand(Right_hand, cube_red)))",
        "onTop(cube_red, cube_blue) & ~~~in_hand(right_hand, cube_red)",
        "(and (onTop cube_red cube_blue) (not (inHand Right_hand cube_red)))",
        "(and (on_top cube_red cube_blue) (not (in_hand right_hand cube_red)))",
        "(and(ON_TOP CUBE_RED CUBE_BLUE)(and (not (in_hand right_hand cube_red))))",
    ],
)
def test_every_form_reads_as_the_same_goal(text):
    assert read(text) == EXPECTED


def test_goal_text_reads_back():
    assert goal_text(EXPECTED) == "onTop(cube_red,cube_blue) & !inHand(Right_hand,cube_red)"
    assert read(goal_text(EXPECTED)) == EXPECTED
    assert read(goal_text(frozenset())) == frozenset()


def test_one_pddl_atom_and_an_atom_without_arguments_are_goals():
    assert read("(onTop cube_red table)") == {Literal(Atom("onTop", ("cube_red", "table")))}
    assert read("isCalm()") == read("(is_calm)") == {Literal(Atom("isCalm"))}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("onTop(cube_red, cube_pink)", r"unknown object 'cube_pink' in the goal; available: Right_hand, cube_blue, cube_red, table"),
        ("over(cube_red, table)", r"unknown predicate 'over' in the goal; available: inHand, isCalm, onTop"),
        ("(over cube_red table)", r"unknown predicate 'over'"),
    ],
)  # fmt: skip
def test_unknown_names_are_listed_with_what_there_is(text, message):
    with pytest.raises(UnknownNameError, match=message):
        read(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected an atom, found the end"),
        ("   ", "expected an atom, found the end"),
        ("onTop(cube_red, table) &", "expected an atom, found the end"),
        ("onTop(cube_red, table) onTop(cube_blue, table)", "column 24: expected '&' or the end"),
        ("onTop(cube_red, table) | onTop(cube_blue, table)", "only conjunctions can be asked for"),
        ("(or (onTop cube_red table))", "'or' is not supported here"),
        ("(onTop(cube_red, table)", "expected '\\)'"),
        ("!(onTop(cube_red, table) & isCalm())", "column 2: expected an atom"),
        ("onTop(cube_red)", "with 1 arguments; onTop takes 2: Graspable, object"),
        ("onTop(table, cube_red)", "where table is a Table; onTop takes a Graspable: cube_blue, cube_red"),
        ("isCalm() & !isCalm()", r"asks for isCalm\(\) and for its opposite"),
        ("(and (onTop cube_red table)", "never closed"),
        ("onTop(cube_red, table); rm -rf", "expected '&' or the end, found ';"),
        ("__import__('os')", "expected an atom"),
    ],
)
def test_what_is_not_a_goal_is_refused_with_the_reason(text, message):
    with pytest.raises(PddlError, match=message):
        read(text)


def test_hostile_object_names_can_be_asked_for_by_their_pddl_name():
    objects = {"a) (and": "Cube", "Cube A": "Cube"}
    assert parse_goal("onTop(a_and, cube_a)", PREDICATES, objects, TYPES) == {
        Literal(Atom("onTop", ("a) (and", "Cube A")))
    }
