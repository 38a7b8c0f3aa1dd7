"""The executor on a session without physics, in which exactly one thing goes wrong."""

import weakref
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from demoplan.engines.mujoco.skills import read_skills
from demoplan.errors import ManifestError, PddlError, UnknownNameError, UsageError
from demoplan.manifests.faults import parse_faults, read_faults
from demoplan.pipeline.execution.execute import ExecuteParams, execute

ROOT = Path(__file__).resolve().parents[3]
TOWER = "onTop(cube_red, cube_blue) & onTop(cube_green, cube_red)"
ONE = "onTop(cube_red, cube_blue)"


@pytest.fixture
def run(learned_domain, tabletop, four_cubes, new_session):
    def go(goal, *, session=None, fault=None, monitor="full", params=None, **session_arguments):
        session = session or new_session(four_cubes, **session_arguments)
        chosen = replace(params or ExecuteParams(), monitor=monitor)
        return execute(learned_domain, goal, session, tabletop, fault=fault, params=chosen)

    return go


def fault(text):
    (only,) = parse_faults(f"faults:\n  - {text}\n", "faults.yaml")
    return only


def row(done):
    return done.run.row(0, named=True)


def named(done):
    return done.steps.filter(pl.col("failure").is_not_null())


def test_without_faults_one_plan_reaches_the_goal_and_nothing_is_said_to_be_wrong(run):
    done = run(TOWER)
    found = row(done)
    assert found["is_goal_reached"]
    assert (found["outcome"], found["n_plans"], found["n_discrepancies"], found["n_unsound"]) == (
        "reached",
        1,
        0,
        0,
    )
    assert found["diagnosed"] is None
    assert set(done.steps["state"]) == {"succeeded"}
    assert done.steps["extra"].list.len().sum() == 0


def test_a_plan_never_comes_back_to_an_object_that_the_hand_has_left(run):
    steps = run(TOWER).steps.filter(pl.col("activity").is_in(["Reach", "Take"]))
    order = list(zip(steps["activity"], steps["arguments"].list.last(), strict=True))
    for (first, one), (second, other) in zip(order[::2], order[1::2], strict=True):
        assert (first, second) == ("Reach", "Take")
        assert one == other


def test_two_hands_work_at_the_same_time(run):
    done = run(TOWER, hands=("Left_hand", "Right_hand"))
    assert row(done)["is_goal_reached"]
    reaches = done.steps.filter(pl.col("activity") == "Reach").sort("start_ns")
    assert reaches["hand"].n_unique() == 2
    assert reaches["start_ns"][1] < reaches["end_ns"][0]


def test_a_hand_that_is_through_goes_out_of_the_way_while_the_other_works(run):
    steps = run(TOWER, hands=("Left_hand", "Right_hand")).steps
    (retired,) = steps.filter(pl.col("operator") == "retire").iter_rows(named=True)
    assert retired["state"] == "succeeded"
    own = steps.filter((pl.col("hand") == retired["hand"]) & (pl.col("operator") != "retire"))
    others = steps.filter(pl.col("hand") != retired["hand"])
    assert retired["start_ns"] >= own["end_ns"].max()
    assert retired["start_ns"] < others["end_ns"].max()
    assert not run(TOWER).steps.filter(pl.col("operator") == "retire").height


def test_in_the_end_hands_are_empty(run, new_session, four_cubes):
    session = new_session(four_cubes, hands=("Left_hand", "Right_hand"))
    run(TOWER, session=session)
    assert set(session._held.values()) == {None}


def test_equal_seeds_give_identical_rows(run):
    one, other = run(TOWER, seed=3), run(TOWER, seed=3)
    assert_frame_equal(one.steps, other.steps)
    assert_frame_equal(one.run, other.run)
    assert_frame_equal(one.frames, other.frames)


FAULTS = {
    "placing_offset": ("{name: f, kind: placing_offset, offset_m: 0.04}", "execution_offset"),
    "drop": ("{name: f, kind: drop, at: {activity: Put, delay_s: 0.6}}", "execution_offset"),
    "moved": ("{name: f, kind: object_moved, which: thing, at: {activity: Take, delay_s: 0.1}}", "exogenous"),
    "support moved": (
        "{name: f, kind: object_moved, which: support, at: {activity: Put, delay_s: 0.8}}",
        "exogenous",
    ),
    "flip": ("{name: f, kind: flipped_predicate, predicate: onTop, duration_s: 1.0}", "perception"),
    "long flip": (
        "{name: f, kind: flipped_predicate, predicate: onTop, duration_s: 2.5}",
        "perception",
    ),
    "stale": (
        "{name: f, kind: stale_predicate, predicate: inHand, duration_s: 1.3, at: {activity: Take}}",
        "perception",
    ),
    "wrong effect": (
        "{name: f, kind: wrong_effect, activity: Take, literal: 'clear(?object)'}",
        "operator_model",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_rightly_and_recovered_from(run, name):
    text, truth = FAULTS[name]
    done = run(ONE, fault=fault(text))
    found = row(done)
    assert found["is_fault_injected"]
    assert found["diagnosed"] == found["fault_class"] == truth, named(done)["cause"].to_list()
    assert found["is_goal_reached"]
    assert found["outcome"] == "reached"


def test_open_loop_goes_on_after_an_offset_and_believes_that_it_is_done(run):
    done = row(run(ONE, fault=fault(FAULTS["placing_offset"][0]), monitor="none"))
    assert (done["outcome"], done["is_goal_reached"]) == ("reached", False)


def test_preconditions_alone_miss_what_later_steps_do_not_depend_on(run):
    # It goes when it is let go, which is the last step: no condition speaks of it any more.
    moved = fault("{name: f, kind: object_moved, which: thing, at: {activity: Release, delay_s: 0.3}}")
    found = row(run(ONE, fault=moved, monitor="preconditions"))
    assert (found["outcome"], found["is_goal_reached"], found["n_plans"]) == ("reached", False, 1)


def test_preconditions_alone_find_that_what_is_to_be_taken_is_somewhere_else(run):
    moved = fault("{name: f, kind: object_moved, which: thing, at: {activity: Reach, delay_s: 1.5}}")
    done = row(run(ONE, fault=moved, monitor="preconditions"))
    assert done["is_fault_injected"]
    assert done["n_plans"] > 1
    assert done["is_goal_reached"]


def test_an_object_that_is_gone_ends_the_run_with_the_reason(run):
    done = run(
        ONE, fault=fault("{name: f, kind: object_removed, which: thing, at: {activity: Take, delay_s: 0.1}}")
    )
    found = row(done)
    assert found["outcome"] == "no_plan"
    assert "gone" in found["reason"]
    assert found["diagnosed"] == "exogenous"


def test_three_equal_failures_end_honestly(run, new_session, four_cubes):
    session = new_session(four_cubes, failing=["reach"] * 9)
    found = row(run(ONE, session=session))
    assert found["outcome"] == "gave_up"
    assert "3 times" in found["reason"]
    assert found["diagnosed"] == "motion"
    assert found["n_plans"] == 3
    assert not found["is_goal_reached"]


def test_one_failing_motion_is_tried_again(run, new_session, four_cubes):
    found = row(run(ONE, session=new_session(four_cubes, failing=["carry"])))
    assert found["is_goal_reached"]
    assert found["n_plans"] == 2


def test_a_budget_of_plans_is_kept(run, new_session, four_cubes):
    params = ExecuteParams(max_plans=2, max_equal_failures=99)
    found = row(run(ONE, session=new_session(four_cubes, failing=["reach"] * 9), params=params))
    assert found["outcome"] == "gave_up"
    assert "budget of 2 plans" in found["reason"]


def test_a_goal_that_holds_already_needs_no_step(run):
    found = row(run("onTop(cube_red, table)"))
    assert (found["outcome"], found["n_steps"]) == ("reached", 0)


def test_a_tower_beyond_reach_is_refused_before_anything_moves(run, new_session, four_cubes):
    session = new_session(four_cubes, highest_m=0.1)
    found = row(run(TOWER, session=session))
    assert found["outcome"] == "out_of_reach"
    assert "higher than 0.1 m" in found["reason"]
    assert session.n_started == 0


def test_a_place_that_the_hand_cannot_come_down_to_is_out_of_reach_too(run, new_session, four_cubes):
    # The third cube's middle comes to 0.125 m; the hand has to come from a little above.
    session = new_session(four_cubes, highest_m=0.13)
    found = row(run(TOWER, session=session))
    assert (found["outcome"], session.n_started) == ("out_of_reach", 0)
    assert "come down" in found["reason"]


def test_a_goal_that_the_operators_cannot_express_has_no_plan(run):
    found = row(run("onTop(cube_red, cube_blue) & onTop(cube_blue, cube_red)"))
    assert found["outcome"] == "no_plan"


def test_a_plan_that_could_not_happen_is_put_down_to_the_operators(
    learned_domain, tabletop, four_cubes, new_session
):
    scene = four_cubes
    blue = scene.require("cube_blue").position_xyz_m
    moved = [
        each
        if each.name != "cube_yellow"
        else each.model_copy(update={"position_xyz_m": (blue[0], blue[1], 0.075)})
        for each in scene.objects
    ]
    session = new_session(scene.model_copy(update={"objects": tuple(moved)}))
    lax = fault("{name: f, kind: wrong_precondition, activity: Put, literal: 'clear(?to)', change: drop}")
    done = execute(learned_domain, ONE, session, tabletop, fault=lax)
    found = row(done)
    assert found["outcome"] == "no_plan"
    assert "could not happen" in found["reason"]
    assert found["diagnosed"] == "operator_model"
    assert not done.steps.filter((pl.col("activity") == "Put") & pl.col("start_ns").is_not_null()).height


def test_what_cannot_be_asked_is_refused_before_anything_moves(run):
    with pytest.raises(UnknownNameError, match="cube_pink"):
        run("onTop(cube_pink, cube_blue)")
    with pytest.raises(PddlError):
        run("onTop(cube_red")


def test_an_activity_without_a_skill_is_refused_with_what_there_is(run):
    table = read_skills()
    without = table.model_copy(
        update={"activities": {k: v for k, v in table.activities.items() if k != "Put"}}
    )
    with pytest.raises(UnknownNameError, match=r"'Put'.*Reach"):
        run(ONE, params=ExecuteParams(skills=without))


def test_the_shipped_faults_file_is_read_and_names_every_class():
    faults = read_faults(ROOT / "datasets/cube-stacking/faults.yaml")
    assert len({each.name for each in faults}) == len(faults) > 12


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("faults:\n  - {name: a, kind: slap}", 2, "slap"),
        ("faults:\n  - {name: a, kind: drop}\n  - {name: a, kind: drop}", 3, "twice; first on line 2"),
        ("faults:\n  - {name: a, kind: placing_offset, offset_m: -1}", 2, "greater than 0"),
        ("faults:\n  - {name: a, kind: drop, when: 3}", 2, "unknown key"),
        ("faults:\n  - {name: a, kind: wrong_effect, activity: Take, literal: 'clear'}", 2, "not an atom"),
    ],
)
def test_a_faults_file_that_is_wrong_is_refused_with_its_line(text, line, said):
    with pytest.raises(ManifestError) as refused:
        parse_faults(text, "faults.yaml")
    assert refused.value.line == line
    assert said in str(refused.value)


def test_a_fault_that_does_not_fit_the_domain_is_refused(run):
    with pytest.raises(UnknownNameError, match="Dance"):
        run(ONE, fault=fault("{name: f, kind: wrong_effect, activity: Dance, literal: 'clear(?object)'}"))
    with pytest.raises(UnknownNameError, match=r"\?thing"):
        run(ONE, fault=fault("{name: f, kind: wrong_effect, activity: Take, literal: 'clear(?thing)'}"))
    with pytest.raises(UsageError, match="has no"):
        run(
            ONE,
            fault=fault(
                "{name: f, kind: wrong_effect, activity: Take, literal: 'handOpen(?hand)', change: drop}"
            ),
        )


@pytest.mark.parametrize(
    ("text", "arguments"),
    [
        (None, {}),
        (None, {"failing": ["carry"], "hands": ("Left_hand", "Right_hand")}),
        ("{name: f, kind: drop, at: {activity: Put, delay_s: 0.6}}", {}),
        ("{name: f, kind: object_removed, which: thing, at: {activity: Take, delay_s: 0.1}}", {}),
    ],
)
def test_a_run_that_is_over_keeps_nothing_of_its_session(
    run, new_session, four_cubes, no_collector, text, arguments
):
    session = new_session(four_cubes, **arguments)
    seen = weakref.ref(session)
    done = run(ONE, session=session, fault=None if text is None else fault(text))
    del session
    assert done.run.height == 1
    assert seen() is None
