import polars as pl
import pytest

from demoplan.errors import DataError, UnknownNameError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.ask import ask, state_at
from demoplan.tables import Facts

DOMAIN = Domain(
    "d", TypeHierarchy.of({"Cube": "object", "Hand": "object"}), (Signature("on", ("Cube", "Cube")),), ()
)
OBJECTS = {"b": "Cube", "a": "Cube", "hand": "Hand"}
GOAL = [Literal(Atom("on", ("a", "b")))]


def test_a_problem_holds_what_it_was_asked():
    problem = ask(DOMAIN, [Atom("on", ("b", "a"))], OBJECTS, GOAL, "p")
    assert problem.objects == (("a", "Cube"), ("b", "Cube"), ("hand", "Hand"))
    assert problem.initial == {Atom("on", ("b", "a"))}
    assert problem.goal == frozenset(GOAL)
    assert problem.domain_name == "d"


@pytest.mark.parametrize(
    ("atom", "error", "words"),
    [
        (Atom("on", ("a", "z")), UnknownNameError, "object 'z'.*available: a, b, hand"),
        (Atom("under", ("a", "b")), UnknownNameError, "predicate 'under'.*available: on"),
        (Atom("on", ("a",)), DataError, "has 1 arguments; 'on' takes 2"),
        (Atom("on", ("a", "hand")), DataError, "'hand' is a 'Hand'; 'on' takes a 'Cube'"),
    ],
)
def test_what_the_domain_cannot_say_is_refused(atom, error, words):
    with pytest.raises(error, match=words):
        ask(DOMAIN, [], OBJECTS, [Literal(atom)], "p")
    with pytest.raises(error, match=words):
        ask(DOMAIN, [atom], OBJECTS, GOAL, "p")


def test_a_goal_that_contradicts_itself_is_refused():
    with pytest.raises(DataError, match=r"both on\(a,b\) and its negation"):
        ask(DOMAIN, [], OBJECTS, [GOAL[0], GOAL[0].negated()], "p")


def test_an_unknown_type_is_refused():
    with pytest.raises(UnknownNameError, match=r"type 'Ball'"):
        ask(DOMAIN, [], {**OBJECTS, "c": "Ball"}, GOAL, "p")


def facts():
    rows = [
        ("e", "on", ["a", "b"], 0, 10, "true"),
        ("e", "on", ["b", "a"], 10, 20, "true"),
        ("e", "on", ["a", "c"], 0, 20, "unknown"),
    ]
    return Facts.validate(pl.DataFrame(rows, schema=Facts.create_empty().schema, orient="row"))


def test_a_state_is_what_held_at_the_instant():
    assert state_at(facts(), "e", 9) == {Atom("on", ("a", "b"))}
    assert state_at(facts(), "e", 10) == {Atom("on", ("b", "a"))}


def test_an_instant_outside_the_episode_is_refused():
    with pytest.raises(DataError, match=r"instant 20 ns is outside episode 'e': it spans 0 to 20 ns"):
        state_at(facts(), "e", 20)
    with pytest.raises(UnknownNameError, match=r"episode 'f'.*available: e"):
        state_at(facts(), "f", 1)
