"""An execution's view: plans, steps per hand, trouble, diagnoses; and parts of a view by layers."""

import dataclasses

import numpy as np
import polars as pl
import pytest

from demoplan.errors import UnknownNameError
from demoplan.pipeline.execution.execute import run_rows, step_rows
from demoplan.tables import Frames
from demoplan.viewers import rerun_adapter
from demoplan.viewers.compose import compose_episode
from demoplan.viewers.episode import save_episode
from demoplan.viewers.execution_lanes import FAILED, plan_lanes_of, step_lanes_of
from demoplan.viewers.lanes import relation_lanes_of
from demoplan.viewers.sources import EpisodeTables, EpisodeViewParams

RUN = "0123456789abcdef"


def step(plan, index, operator, start_s, end_s, *, state="succeeded", hand="Right_hand", **more):
    return {
        "run_id": RUN,
        "plan_index": plan,
        "step_index": index,
        "operator": operator,
        "arguments": [hand, "cube_red", "table", "cube_blue"][: 4 if operator.startswith("put") else 2],
        "hand": hand,
        "activity": operator.split("_")[0].capitalize(),
        "state": state,
        "start_ns": None if start_s is None else int(start_s * 1e9),
        "end_ns": None if end_s is None else int(end_s * 1e9),
        "unmet": [],
        "missing": [],
        "extra": [],
        "failure": None,
        "cause": None,
        "tracking_error_m": None,
        "peak_force_n": None,
        "n_collisions": None,
        **more,
    }


@pytest.fixture
def steps():
    slipped = {
        "state": "failed",
        "failure": "execution_offset",
        "cause": "cube_red left the hand",
        "missing": ["onTop(cube_red, cube_blue)"],
        "tracking_error_m": 0.004,
    }
    return step_rows(
        [
            step(0, 0, "reach_1", 0.5, 2.0),
            step(0, 1, "put_1", 2.0, 3.0, **slipped),
            step(0, 2, "release_1", None, None, state="not_executed"),
            step(0, 3, "recover_release", 4.0, 5.0),
            step(1, 0, "reach_1", 6.0, 7.0),
            step(1, 1, "put_1", 7.0, 9.0),
        ]
    )


@pytest.fixture
def run():
    row = {
        "run_id": RUN,
        "domain_id": "d" * 16,
        "domain_name": "cubes",
        "goal": "onTop(cube_red, cube_blue)",
        "robot": "gripper",
        "monitor": "full",
        "seed": 3,
        "fault": "slip",
        "fault_kind": "slip",
        "fault_class": "execution_offset",
        "severity": "mild",
        "is_recoverable": True,
        "is_fault_injected": True,
        "is_goal_reached": True,
        "is_goal_sensed": True,
        "outcome": "reached",
        "reason": None,
        "n_plans": 2,
        "n_steps": 5,
        "n_discrepancies": 1,
        "n_passed": 0,
        "n_false_alarms": 0,
        "n_unsound": 0,
        "diagnosed": "execution_offset",
        "simulated_s": 9.0,
    }
    return run_rows([row])


@pytest.fixture
def tables(run, steps):
    return EpisodeTables(episode_id=RUN, frames=Frames.create_empty(), entities=(), run=run, steps=steps)


def state_at(lane, second):
    at = int(np.searchsorted(lane.ticks_ns, int(second * 1e9), side="right")) - 1
    return lane.states[at] if at >= 0 else None


def test_the_plan_lane_says_which_plan_was_followed_and_when_it_was_replaced(steps):
    plan, _ = plan_lanes_of(steps, 10 * 10**9)
    assert plan.path == ("execution", "plan")
    found = [state_at(plan, s) for s in (0.4, 0.6, 5.9, 6.1, 9.9, 10.1)]
    assert found == [None, "plan 1", "plan 1", "plan 2 (replanned)", "plan 2 (replanned)", None]


def test_trouble_lasts_from_the_failure_to_the_next_plan(steps):
    _, trouble = plan_lanes_of(steps, 10 * 10**9)
    said = "execution_offset: cube_red left the hand"
    assert [state_at(trouble, s) for s in (2.9, 3.1, 5.9, 6.1)] == [None, said, said, None]
    assert dict(trouble.colours) == {said: FAILED}


def test_trouble_that_nothing_follows_lasts_to_the_end(steps):
    first = steps.filter((pl.col("plan_index") == 0) & (pl.col("operator") != "recover_release"))
    _, trouble = plan_lanes_of(first, 10 * 10**9)
    assert [state_at(trouble, s) is not None for s in (2.9, 3.1, 9.9, 10.1)] == [False, True, True, False]


def test_a_plan_without_trouble_has_no_trouble_lane(steps):
    assert len(plan_lanes_of(steps.filter(pl.col("failure").is_null()), 0)) == 1


def test_a_step_that_failed_is_red_and_says_so_and_one_that_was_not_begun_is_not_there(steps):
    (lane,) = step_lanes_of(steps)
    assert lane.path == ("Right_hand", "step")
    assert state_at(lane, 2.5) == "FAILED Put cube_red → cube_blue"
    assert state_at(lane, 3.5) is None
    assert state_at(lane, 4.5) == "recover: Recover cube_red"
    assert state_at(lane, 8.0) == "Put cube_red → cube_blue"
    assert dict(lane.colours)["FAILED Put cube_red → cube_blue"] == FAILED
    assert not any("Release" in (state or "") for state in lane.states)


def test_the_events_tell_the_failure_the_new_plan_and_the_end_in_order(tables):
    (events, why) = compose_episode(tables).logs
    texts = [note.text for note in events.notes]
    assert texts[0] == "plan 1: 4 steps"
    assert texts.index("put_1 failed; execution_offset: cube_red left the hand") < texts.index(
        "plan 2 (replanned): 2 steps"
    )
    assert texts[-1] == "reached; by physics the goal is reached"
    ticks = [note.tick_ns for note in events.notes]
    assert ticks == sorted(ticks)
    assert [note.level for note in events.notes if "failed" in note.text] == ["ERROR"]
    assert [note.text for note in why.notes] == [
        "put_1(Right_hand, cube_red, table, cube_blue): execution_offset: cube_red left the hand",
        "expected and not sensed: onTop(cube_red, cube_blue)",
        "hand off its course by at most 0.004 m",
    ]


def test_a_recording_is_found_by_what_it_is_and_success_is_what_physics_says(tables, run):
    view = compose_episode(tables)
    found = dict(view.properties)
    assert (found["kind"], found["id"], found["success"]) == ("execution", RUN, True)
    assert (found["robot"], found["fault"], found["goal"]) == (
        "gripper",
        "slip",
        "onTop(cube_red, cube_blue)",
    )
    unharmed = run.with_columns(pl.lit(None, dtype=pl.String).alias("fault"))
    assert "fault" not in dict(compose_episode(dataclasses.replace(tables, run=unharmed)).properties)


def test_an_execution_whose_poses_were_not_kept_has_lanes_and_no_scene(tables, tmp_path):
    path = save_episode(tmp_path / "run.rrd", tables)
    assert set(rerun_adapter.viewer_paths(path)) == {
        "/execution/plan",
        "/execution/trouble",
        "/Right_hand/step",
        "/log/events",
        "/log/why",
    }


@pytest.mark.parametrize(
    ("layers", "expected"),
    [
        (("execution",), {"/execution/plan", "/execution/trouble", "/Right_hand/step", "/log/events"}),
        (("explanation",), {"/log/why"}),
        (("raw", "predicates", "activities"), set()),
    ],
)
def test_only_the_layers_that_are_asked_for_are_recorded(tables, tmp_path, layers, expected):
    path = save_episode(tmp_path / "run.rrd", tables, EpisodeViewParams(layers=layers))
    assert set(rerun_adapter.viewer_paths(path)) == expected


def test_an_unknown_layer_is_refused_with_those_that_there_are(tables):
    with pytest.raises(UnknownNameError, match=r"unknown layer .plan.*explanation"):
        compose_episode(tables, EpisodeViewParams(layers=("plan",)))


def facts_of(*rows):
    return pl.DataFrame(
        [
            ("e", predicate, list(arguments), start, end, value)
            for predicate, arguments, start, end, value in rows
        ],
        schema=["episode_id", "predicate", "arguments", "start_ns", "end_ns", "value"],
        orient="row",
    )


def test_a_relation_lane_shows_the_other_thing_and_what_could_not_be_seen():
    (lane,) = relation_lanes_of(
        facts_of(
            ("onTop", ("red", "table"), 0, 10, "true"),
            ("onTop", ("red", "blue"), 10, 20, "true"),
            ("onTop", ("red", "green"), 15, 30, "unknown"),
        )
    )
    assert lane.path == ("onTop", "red")
    found = [
        lane.states[int(np.searchsorted(lane.ticks_ns, t, side="right")) - 1] for t in (5, 12, 17, 25, 30)
    ]
    assert found == ["table", "blue", "blue; not observed: green", "not observed: green", None]


def test_predicates_that_relate_to_several_things_at_once_are_left_to_the_lanes_of_atoms():
    facts = facts_of(
        ("inTouch", ("red", "blue"), 0, 10, "true"),
        ("inTouch", ("red", "table"), 5, 10, "true"),
        ("inHand", ("hand", "red"), 0, 10, "true"),
        ("clear", ("red",), 0, 10, "true"),
    )
    assert [lane.path for lane in relation_lanes_of(facts)] == [("inHand", "hand")]
    (only,) = relation_lanes_of(facts.filter(pl.col("predicate") == "inTouch"))
    assert "blue, table" in only.states
