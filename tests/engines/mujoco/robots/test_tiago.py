import sys
import weakref

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("mink", reason="needs the extra 'robot'")

from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.robots import tiago_description
from demoplan.engines.mujoco.scene import cube_names
from demoplan.engines.mujoco.scene_spec import ObjectSpec, SceneSpec, random_scene
from demoplan.engines.mujoco.session import Motion
from demoplan.errors import SimulationError

RIGHT = "Right_hand"


@pytest.fixture(scope="module", autouse=True)
def described():
    try:
        tiago_description.description_path("tiago_no_hand.urdf")
    except SimulationError:
        pytest.skip("needs the extra 'robot'")


@pytest.mark.parametrize("seed", [1, 9])
def test_tiago_puts_a_cube_on_another_without_touching_anything_else(stacker, seed):
    session = open_session(random_scene(cube_names(4), seed=seed), "tiago", seed=seed)
    for cube, support in (("cube_red", "cube_blue"), ("cube_green", "cube_red")):
        reports = stacker.stack(session, RIGHT, cube, support)
        assert [report.state for report in reports] == ["succeeded"] * 5
        assert sum(report.n_collisions for report in reports) == 0
        assert max(report.tracking_error_m for report in reports) < 0.03
        assert session.is_resting_on(cube, support)


def test_tiago_does_the_same_twice_bit_for_bit(stacker):
    runs = []
    for _ in range(2):
        session = open_session(random_scene(cube_names(3), seed=2), "tiago", seed=2)
        stacker.stack(session, RIGHT, "cube_red", "cube_blue", n=3)
        runs.append(session.true_frames())
    assert runs[0].equals(runs[1])


def test_what_tiago_cannot_reach_it_says_before_moving():
    scene = SceneSpec(
        objects=(ObjectSpec(name="far", position_xyz_m=(0.37, 0.45, 0.025)),),
        table_size_xyz_m=(0.8, 1.0, 0.04),
    )
    session = open_session(scene, "tiago", seed=0)
    assert session.can_reach(RIGHT, (0.05, 0.0, 0.05)) is None
    assert "cannot hold its hand upright" in session.can_reach(RIGHT, (0.37, 0.45, 0.05))
    session.advance(0.2)
    report = session.start(RIGHT, Motion(activity="Reach", skill="reach", object="far"))
    assert (report.state, report.problem) == ("blocked", "out_of_reach")
    assert report.ended_ns == report.started_ns


def test_a_missing_description_is_named_with_what_to_install(monkeypatch):
    monkeypatch.setattr(tiago_description, "PACKAGE", "no-such-package")
    with pytest.raises(SimulationError, match="extra 'robot'"):
        tiago_description.description_path("tiago_no_hand.urdf")


def test_the_arms_encoders_agree_with_inverse_kinematics():
    session = open_session(random_scene(cube_names(2), seed=0), "tiago", seed=0)
    control = session.others_of("")[0]
    arm = control.arm
    start = arm.commanded()
    goal = control.position_xyz_m() + np.array([0.05, 0.02, -0.05])
    way = np.linspace(control.position_xyz_m(), goal, 10)
    found = arm.configurations(start, way, np.full(10, arm.rest_yaw_rad))
    for _ in range(100):
        arm.command(session.data, found[-1], 0.0)
        session.advance(0.01)
        arm.command(session.data, found[-1], 0.0)
    assert np.linalg.norm(control.position_xyz_m() - goal) < 0.003


def test_two_arms_stack_at_the_same_time_and_neither_reaches_everywhere(stacker, a_pair_each):
    session = open_session(a_pair_each, "tiago_dual", seed=0)
    assert session.can_reach(RIGHT, (0.0, -0.2, 0.03)) is None
    assert session.can_reach(RIGHT, (0.0, 0.25, 0.03)) is not None
    assert session.can_reach("Left_hand", (0.0, 0.2, 0.03)) is None
    left = stacker.motions("cube_green", "cube_yellow")
    right = stacker.motions("cube_red", "cube_blue")
    for one, other in zip(left, right, strict=True):
        session.start("Left_hand", one)
        session.start(RIGHT, other)
        while "running" in {session.report(hand).state for hand in session.hands}:
            session.advance(0.05)
        assert {session.report(hand).state for hand in session.hands} == {"succeeded"}
    session.advance(0.2)
    assert session.is_resting_on("cube_red", "cube_blue")
    assert session.is_resting_on("cube_green", "cube_yellow")


def test_an_arm_looks_out_for_its_own_body_its_own_links_and_the_table():
    session = open_session(random_scene(cube_names(1), seed=0), "tiago", seed=0)
    session.arrange()
    arm = session.others_of("")[0].arm
    assert session.checker.first_touch(arm, arm.rest_configuration[None], 0.08) is None
    # Its elbow bent farther than it can be: forearm on upper arm.
    folded = np.array([1.0, 0.0, -1.5, 2.9, 0.0, 0.0, 0.0])
    touch = session.checker.first_touch(arm, folded[None], 0.08)
    assert {touch.part, touch.other} == {"tiago/arm_3_link:solid", "tiago/arm_5_link:solid"}
    rng = np.random.default_rng(0)
    others = set()
    for configuration in rng.uniform(arm.space.low, arm.space.high, (600, 7)):
        touch = session.checker.first_touch(arm, configuration[None], 0.08)
        others |= set() if touch is None else {touch.other}
    assert {"table", "tiago/torso_lift_link:solid", "tiago/head_2_link:solid"} <= others


def test_room_that_is_asked_for_is_kept_and_the_model_left_as_it_was():
    session = open_session(random_scene(cube_names(1), seed=0), "tiago", seed=0)
    session.arrange()
    arm, margin = session.others_of("")[0].arm, session.model.geom_margin.copy()
    low = arm.rest_xyz_m - [0.0, 0.0, arm.rest_xyz_m[2] - arm.finger_reach_m - 0.006]
    posture = next(arm.postures(low, arm.rest_yaw_rad, np.random.default_rng(0)))[None]
    assert session.checker.first_touch(arm, posture, 0.08) is None
    assert session.checker.first_touch(arm, posture, 0.08, clearance_m=0.002) is None
    assert session.checker.first_touch(arm, posture, 0.08, clearance_m=0.010).other == "table"
    assert np.array_equal(session.model.geom_margin, margin)


def test_reach_is_refused_only_where_no_configuration_is_found_by_a_longer_search():
    session = open_session(random_scene(cube_names(1), seed=0), "tiago", seed=0)
    arm = session.others_of("")[0].arm
    x, y = arm.rest_xyz_m[:2] - [0.435, -0.30]
    for away, height, expected in ((0.50, 0.03, True), (0.50, 0.35, True), (0.90, 0.03, False)):
        place = np.array([x + 0.093 + away, y + 0.014, height])
        why = arm.reachable(place)
        assert (why is None) == expected
        rng = np.random.default_rng(1)
        searched = any(next(arm.postures(place, yaw, rng), None) is not None for yaw in np.linspace(-3, 3, 9))
        assert searched == expected
    assert "0.90 m from its shoulder" in why


def test_what_is_laid_on_the_table_is_laid_well_inside_the_reach(stacker):
    # The nearest free place to the cube is at the edge of the reach, towards the robot.
    scene = SceneSpec(
        objects=(
            ObjectSpec(name="under", position_xyz_m=(-0.12, 0.0, 0.025)),
            ObjectSpec(name="over", position_xyz_m=(-0.12, 0.0, 0.075)),
            ObjectSpec(name="far", position_xyz_m=(0.20, 0.10, 0.025)),
        )
    )
    session = open_session(scene, "tiago", seed=0)
    session.advance(0.2)
    for motion in stacker.motions("over", "table")[:4]:
        report = stacker.run(session, RIGHT, motion)
        assert report.state == "succeeded", report.reason
    arm = session.others_of("")[0].arm
    place = session.pose("over")[0]
    assert arm.room_m(place[:2]) > 0.04
    assert session.can_reach(RIGHT, tuple(place)) is None


def test_what_no_straight_way_leads_to_is_reached_through_joints(stacker):
    scene = random_scene(cube_names(2), seed=3)
    session = open_session(scene, "tiago", seed=3)
    session.advance(0.2)
    control = session.others_of("")[0]
    # No straight way: the space above the things is taken for higher than the arm can go.
    control.arm.highest_m = 0.0
    report = stacker.run(session, RIGHT, Motion(activity="Reach", skill="reach", object="cube_red"))
    assert report.state == "succeeded"
    assert report.n_collisions == 0


def test_missing_kinematics_are_named_with_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "mink", None)
    for module in ("tiago", "inverse"):
        monkeypatch.delitem(sys.modules, f"demoplan.engines.mujoco.robots.{module}", raising=False)
    with pytest.raises(SimulationError, match=r"TIAGo needs mink.*extra 'robot'"):
        open_session(random_scene(cube_names(1), seed=0), "tiago", seed=0)


def test_tiagos_models_go_with_the_session(stacker, no_collector):
    session = open_session(random_scene(cube_names(1), seed=0), "tiago", seed=0)
    stacker.run(session, RIGHT, stacker.motions("cube_red", "table")[0])
    arm = session.others_of("")[0].arm
    models = [weakref.ref(each) for each in (session.model, session.data, arm, arm._inverse)]
    models.append(weakref.ref(arm._inverse._configuration.model))
    del session, arm
    assert [model() for model in models] == [None] * len(models)
