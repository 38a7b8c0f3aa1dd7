"""Plans run on paper: states, costs, and the first thing that is wrong."""

import re

import pytest

from demoplan.errors import DataError
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Plan, Problem, Signature, Step
from demoplan.language.execution import execute, ground, holds
from demoplan.language.types import TypeHierarchy

A, B = Parameter("?a", "cube"), Parameter("?b", "cube")


def atom(text):
    return Atom.parse(text)


def literal(text):
    return Literal(Atom.parse(text.removeprefix("!")), not text.startswith("!"))


MOVE = Operator(
    "move",
    (A, B),
    frozenset({literal("clear(?a)"), literal("clear(?b)"), Literal(Atom("=", ("?a", "?b")), False)}),
    frozenset({literal("on(?a,?b)"), literal("!clear(?b)")}),
    cost=3,
)
SWAP = Operator("swap", (A, B), frozenset(), frozenset({literal("clear(?a)"), literal("!clear(?b)")}))
DOMAIN = Domain(
    "d",
    TypeHierarchy.of({"cube": "object", "hand": "object"}),
    (Signature("clear", ("cube",)), Signature("on", ("cube", "cube"))),
    (MOVE, SWAP),
)
PROBLEM = Problem(
    "p",
    "d",
    (("h", "hand"), ("x", "cube"), ("y", "cube"), ("z", "cube")),
    frozenset(map(atom, ["clear(x)", "clear(y)", "clear(z)"])),
    frozenset({literal("on(x,y)"), literal("on(y,z)")}),
)


def run(*steps):
    return execute(DOMAIN, PROBLEM, Plan(tuple(Step(*step) for step in steps)))


def test_a_valid_plan_gives_every_state_on_the_way():
    execution = run(("move", ("y", "z")), ("move", ("x", "y")))
    assert execution.is_valid
    assert execution.cost == 6
    assert execution.states == (
        PROBLEM.initial,
        frozenset(map(atom, ["clear(x)", "clear(y)", "on(y,z)"])),
        frozenset(map(atom, ["clear(x)", "on(x,y)", "on(y,z)"])),
    )


@pytest.mark.parametrize(
    ("steps", "index", "message"),
    [
        ([("move", ("y", "z")), ("move", ("x", "y")), ("move", ("z", "y"))], 2, r"step 3, move\(z,y\): its condition fails: clear\(y\) does not hold"),
        ([("move", ("x", "x"))], 0, r"step 1, move\(x,x\): its condition fails: =\(x,x\) holds"),
        ([("fly", ())], 0, r"there is no operator 'fly'; available: move, swap"),
        ([("move", ("x",))], 0, r"it has 1 arguments; move takes 2"),
        ([("move", ("x", "w"))], 0, r"there is no object 'w'"),
        ([("move", ("h", "x"))], 0, r"h is a hand; \?a takes a cube"),
        ([("move", ("y", "z"))], None, r"after the last step, the goal lacks on\(x,y\)"),
        ([], None, r"the goal lacks on\(x,y\), on\(y,z\)"),
    ],
)  # fmt: skip
def test_the_first_violation_is_named(steps, index, message):
    execution = run(*steps)
    assert not execution.is_valid
    assert execution.violation.step_index == index
    assert re.search(message, str(execution.violation))
    assert len(execution.states) == (len(steps) if index is None else index) + 1


def test_what_is_deleted_and_added_at_once_holds_afterwards():
    action = ground(SWAP, Step("swap", ("x", "x")))
    assert atom("clear(x)") in action.apply(frozenset())


def test_the_input_state_is_left_alone():
    state = set(PROBLEM.initial)
    ground(MOVE, Step("move", ("x", "y"))).apply(frozenset(state))
    assert state == set(PROBLEM.initial)


def test_a_step_must_fit_its_operator():
    with pytest.raises(DataError, match=r"swap\(x,y\) does not fit move\(\?a - cube, \?b - cube\)"):
        ground(MOVE, Step("swap", ("x", "y")))


def test_equality_is_judged_by_names():
    assert holds(Literal(Atom("=", ("a", "a"))), frozenset())
    assert holds(Literal(Atom("=", ("a", "b")), False), frozenset())
    assert not holds(Literal(Atom("=", ("a", "b"))), frozenset())
