"""Expected against sensed, on states written down by hand."""

import dataframely as dy
import polars as pl
import pytest

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Step
from demoplan.language.execution import GroundOperator
from demoplan.stages.monitor import (
    Deviation,
    MonitorParams,
    SensedState,
    after_step,
    before_step,
    confirmed,
    effects_of,
    is_done_already,
    rest_of_plan,
    sensed_state,
)
from demoplan.tables import Facts


def atoms(*texts):
    return frozenset(map(Atom.parse, texts))


def literal(text):
    return Literal(Atom.parse(text.removeprefix("not ")), not text.startswith("not "))


def step(name, needs, adds=(), deletes=()):
    return GroundOperator(Step(name), frozenset(map(literal, needs)), atoms(*adds), atoms(*deletes), 1)


def sensed(*held, unknown=()):
    return SensedState(0, atoms(*held), atoms(*unknown))


PUT = step("put", ["inHand(h,a)", "clear(b)"], ["onTop(a,b)"], ["clear(b)"])
LET_GO = step("release", ["inHand(h,a)"], ["open(h)"], ["inHand(h,a)"])
GOAL = frozenset({literal("onTop(a,b)")})


def test_conditions_that_are_false_are_unmet_and_those_that_are_unseen_unobserved():
    found = before_step(PUT, sensed("inHand(h,a)", unknown=["clear(b)"]))
    assert found == Deviation(unobserved=(literal("clear(b)"),))
    assert found.is_alarming
    assert before_step(PUT, sensed("clear(b)")).unmet == (literal("inHand(h,a)"),)
    assert not before_step(PUT, sensed("clear(b)", "inHand(h,a)")).is_alarming


def test_a_step_whose_effects_all_hold_is_done_already():
    assert is_done_already(PUT, sensed("onTop(a,b)"))
    assert not is_done_already(PUT, sensed("onTop(a,b)", "clear(b)"))
    assert not is_done_already(PUT, sensed("onTop(a,b)", unknown=["clear(b)"]))


def test_missing_and_extra_effects_are_named():
    found = after_step(
        PUT, sensed("inHand(h,a)", "clear(b)", "onTop(c,d)"), sensed("inHand(h,a)", "clear(b)")
    )
    assert found.missing == (literal("not clear(b)"), literal("onTop(a,b)"))
    assert found.extra == (literal("not onTop(c,d)"),)


def test_what_another_step_does_meanwhile_is_no_extra_change():
    other = step("other", [], ["onTop(c,d)"])
    found = after_step(PUT, sensed("clear(b)"), sensed("onTop(a,b)", "onTop(c,d)"), [other])
    assert found == Deviation()


def test_an_unexplained_change_alone_is_no_alarm():
    assert not Deviation(extra=(literal("onTop(c,d)"),)).is_alarming


def test_what_an_operator_both_deletes_and_adds_is_expected_to_hold():
    both = step("both", [], ["p(a)"], ["p(a)"])
    assert effects_of(both) == (literal("p(a)"),)


@pytest.mark.parametrize(
    ("held", "unknown", "lacking"),
    [
        (["inHand(h,a)", "clear(b)"], [], ()),
        (["inHand(h,a)"], [], ("clear(b)",)),
        (["inHand(h,a)"], ["clear(b)"], ()),
    ],
)
def test_the_rest_of_a_plan_is_held_against_what_is_sensed(held, unknown, lacking):
    found = rest_of_plan([PUT, LET_GO], GOAL, sensed(*held, unknown=unknown))
    assert found == tuple(map(literal, lacking))


def test_with_no_steps_left_it_is_the_goal_that_must_hold():
    assert rest_of_plan([], GOAL, sensed()) == (literal("onTop(a,b)"),)
    assert rest_of_plan([], GOAL, sensed("onTop(a,b)")) == ()


def test_a_change_that_the_rest_of_the_plan_does_not_need_breaks_nothing():
    assert rest_of_plan([PUT, LET_GO], GOAL, sensed("inHand(h,a)", "clear(b)", "onTop(x,y)")) == ()


def test_only_what_two_looks_agree_on_is_confirmed():
    one = Deviation(missing=(literal("onTop(a,b)"),), broken=(literal("clear(b)"),))
    other = Deviation(missing=(literal("onTop(a,b)"), literal("open(h)")))
    assert confirmed(one, other) == Deviation(missing=(literal("onTop(a,b)"),))
    assert not confirmed(one, Deviation(unmet=(literal("clear(b)"),))).is_alarming


def facts(*rows):
    table = pl.DataFrame(
        [
            {"episode_id": "e", "predicate": p, "arguments": list(a), "start_ns": s, "end_ns": e, "value": v}
            for p, a, s, e, v in rows
        ],
        schema={name: column.dtype for name, column in Facts.columns().items()},
    )
    return Facts.validate(table)


def test_a_state_is_debounced_by_the_larger_part_of_the_last_stretch():
    params = MonitorParams(debounce_s=100e-9)
    table = facts(
        ("steady", ["a"], 0, 1000, "true"),
        ("flickers", ["a"], 940, 950, "true"),
        ("flickers", ["a"], 970, 1000, "true"),
        ("begins", ["a"], 949, 1000, "true"),
        ("ended", ["a"], 0, 920, "true"),
        ("unseen", ["a"], 900, 1000, "unknown"),
    )
    state = sensed_state(table, 1000, params)
    assert state.held == atoms("steady(a)", "begins(a)")
    assert state.unknown == atoms("unseen(a)")
    assert state.says(literal("unseen(a)")) is None
    assert state.says(literal("not ended(a)")) is True


def test_no_facts_give_an_empty_state():
    empty: dy.DataFrame[Facts] = Facts.create_empty()
    assert sensed_state(empty, 1000).held == frozenset()
