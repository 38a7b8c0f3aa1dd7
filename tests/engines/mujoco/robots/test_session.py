import weakref

import numpy as np
import polars as pl
import pytest

from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.scene import cube_names
from demoplan.engines.mujoco.scene_spec import ObjectSpec, SceneSpec, random_scene
from demoplan.engines.mujoco.session import (
    GripSlips,
    Motion,
    ObjectDropped,
    ObjectMoved,
    ObjectRemoved,
    PathBlocked,
    PlacingOffset,
    SensorBiased,
    SensorBlind,
    SensorParams,
    SessionParams,
)
from demoplan.errors import SimulationError, UnknownNameError, UsageError
from demoplan.tables import Frames

RIGHT = "Right_hand"


def opened(seed=1, robot="gripper", n=4, **sensors):
    params = SessionParams(sensors=SensorParams(**sensors))
    return open_session(random_scene(cube_names(n), seed=seed), robot, seed=seed, params=params)


def place_of(session, entity):
    last = session.true_frames().filter(pl.col("entity") == entity).sort("tick_ns").row(-1, named=True)
    return np.array(last["position_xyz_m"])


@pytest.mark.parametrize("seed", range(3))
def test_a_cube_is_put_on_another_and_stays_there(stacker, seed):
    session = opened(seed)
    reports = stacker.stack(session, RIGHT, "cube_red", "cube_blue")
    assert [report.state for report in reports] == ["succeeded"] * 5
    assert session.is_resting_on("cube_red", "cube_blue")
    assert not session.is_resting_on("cube_red", "table")
    assert session.is_resting_on("cube_blue", "table")
    assert max(report.n_collisions for report in reports) == 0
    assert max(report.tracking_error_m for report in reports) < 0.02
    off = place_of(session, "cube_red")[:2] - place_of(session, "cube_blue")[:2]
    assert np.linalg.norm(off) < 0.004


def test_a_cube_is_taken_down_and_put_on_a_free_spot_of_the_table(stacker):
    scene = random_scene(cube_names(3), seed=4, stacked=[("cube_red", "cube_blue")])
    session = open_session(scene, seed=4)
    assert session.is_resting_on("cube_red", "cube_blue")
    stacker.stack(session, RIGHT, "cube_red", "table")
    assert session.is_resting_on("cube_red", "table")
    for other in ("cube_blue", "cube_green"):
        assert np.linalg.norm((place_of(session, "cube_red") - place_of(session, other))[:2]) > 0.08


def test_the_same_seed_gives_the_same_poses_bit_for_bit_and_however_often_one_looks(stacker):
    one, same = opened(5), opened(5)
    stacker.stack(one, RIGHT, "cube_red", "cube_blue")
    for motion in stacker.motions("cube_red", "cube_blue"):
        same.start(RIGHT, motion)
        while same.report(RIGHT).state == "running":
            same.advance(0.05)
            same.frames(same.time_ns - 100_000_000)
    same.advance(0.2)
    assert one.true_frames().equals(same.true_frames())
    assert one.frames().equals(same.frames())
    other = open_session(one.scene, seed=6)
    stacker.stack(other, RIGHT, "cube_red", "cube_blue")
    assert not one.frames().equals(other.frames())


def test_what_sensors_saw_are_valid_frames_close_to_the_truth_and_late():
    session = opened(2, latency_s=0.1, dropouts_per_minute=0.0, drop_probability=0.0)
    session.advance(1.0)
    seen, true = Frames.validate(session.frames()), Frames.validate(session.true_frames())
    assert set(seen["entity"]) == {RIGHT, "table", *cube_names(4)}
    assert seen["tick_ns"].max() <= session.time_ns - 100_000_000 < true["tick_ns"].max()
    both = seen.join(true, on=["entity", "tick_ns"], how="inner").filter(pl.col("entity") != "table")
    gap = both["position_xyz_m"].to_numpy() - both["position_xyz_m_right"].to_numpy()
    assert 0.0003 < gap.std() < 0.0007
    assert seen.filter(pl.col("entity") == RIGHT)["grip"].is_between(0.9, 1.0).all()
    since = session.frames(seen["tick_ns"].unique().sort()[-3])
    assert since["tick_ns"].n_unique() == 2


def test_a_lost_reading_is_the_last_one_before_it_until_that_is_stale():
    session = opened(2, drop_probability=0.0, dropouts_per_minute=0.0, latency_s=0.0, staleness_s=0.1)
    session.advance(0.5)
    session.inject(SensorBlind(entity="cube_red", duration_s=0.4))
    begin = session.time_ns
    session.advance(0.6)
    red = session.frames(begin).filter(pl.col("entity") == "cube_red").sort("tick_ns")
    ages = red["pose_age_ns"].to_list()
    assert 0 < ages[0] <= 100_000_000
    assert None in ages
    assert ages[-1] == 0
    missing = red.filter(pl.col("pose_age_ns").is_null())
    assert missing["position_xyz_m"].is_null().all()


def test_a_grasp_that_closes_on_nothing_says_so(stacker):
    session = opened(3)
    stacker.stack(session, RIGHT, "cube_red", "cube_blue", n=1)
    session.inject(ObjectMoved(object="cube_red", position_xyz_m=(0.3, 0.4, 0.025)))
    session.advance(0.3)
    report = stacker.run(session, RIGHT, Motion(activity="Take", skill="grasp", object="cube_red"))
    assert (report.state, report.problem) == ("failed", "grasped_nothing")


@pytest.mark.parametrize("fault", [GripSlips(hand=RIGHT, duration_s=2.0), ObjectDropped(hand=RIGHT)])
def test_what_slips_or_drops_while_it_is_carried_is_reported_lost(stacker, fault):
    session = opened(3)
    stacker.stack(session, RIGHT, "cube_red", "cube_blue", n=2)
    session.start(RIGHT, Motion(activity="Put", skill="carry", object="cube_red", support="cube_blue"))
    session.advance(0.9)
    session.inject(fault)
    while (report := session.report(RIGHT)).state == "running":
        session.advance(0.05)
    assert (report.state, report.problem) == ("failed", "object_lost")
    assert not session.is_resting_on("cube_red", "cube_blue")


def test_an_object_that_was_taken_away_is_not_seen_and_cannot_be_reached_for(stacker):
    session = opened(3)
    session.advance(0.3)
    session.inject(ObjectRemoved(object="cube_red"))
    session.advance(0.5)
    report = stacker.run(session, RIGHT, Motion(activity="Reach", skill="reach", object="cube_red"))
    assert (report.state, report.problem) == ("failed", "not_seen")
    gone = session.frames(session.time_ns - 200_000_000).filter(pl.col("entity") == "cube_red")
    assert gone["position_xyz_m"].is_null().all()
    assert not session.is_resting_on("cube_red", "table")


def test_a_placing_offset_puts_the_next_cube_beside_its_aim_only_once(stacker):
    session = opened(3)
    session.inject(PlacingOffset(hand=RIGHT, offset_xyz_m=(0.015, 0.0, 0.0)))
    stacker.stack(session, RIGHT, "cube_red", "cube_blue")
    off = place_of(session, "cube_red") - place_of(session, "cube_blue")
    assert off[0] == pytest.approx(0.015, abs=0.004)
    stacker.stack(session, RIGHT, "cube_green", "cube_yellow")
    off = place_of(session, "cube_green") - place_of(session, "cube_yellow")
    assert np.linalg.norm(off[:2]) < 0.004


def test_a_cube_that_is_seen_beside_its_place_is_grasped_there(stacker):
    session = opened(3)
    session.inject(SensorBiased(entity="cube_red", offset_xyz_m=(0.0, 0.1, 0.0)))
    session.advance(0.5)
    reports = stacker.stack(session, RIGHT, "cube_red", "cube_blue")
    assert reports[-1].problem == "grasped_nothing"


def test_a_wall_that_is_known_of_is_gone_over_and_a_tall_one_blocks_by_name(stacker):
    scene = SceneSpec(
        objects=(
            ObjectSpec(name="cube_red", position_xyz_m=(0.0, 0.2, 0.025)),
            ObjectSpec(name="cube_blue", position_xyz_m=(0.0, -0.2, 0.025)),
        )
    )
    low = open_session(scene, seed=0)
    low.inject(PathBlocked(name="wall", position_xyz_m=(0.0, 0.0, 0.1), size_xyz_m=(0.6, 0.02, 0.2)))
    low.advance(0.2)
    assert [report.state for report in stacker.stack(low, RIGHT, "cube_red", "cube_blue")] == [
        "succeeded"
    ] * 5
    assert low.is_resting_on("cube_red", "cube_blue")
    shut = open_session(scene, seed=0)
    shut.inject(PathBlocked(name="lid", position_xyz_m=(0.0, 0.2, 0.15), size_xyz_m=(0.3, 0.3, 0.1)))
    shut.advance(0.2)
    report = stacker.run(shut, RIGHT, Motion(activity="Reach", skill="reach", object="cube_red"))
    assert (report.state, report.problem) == ("blocked", "path_blocked")
    assert "lid" in report.reason


def test_a_wall_that_is_not_known_of_is_run_into_and_reported(stacker):
    scene = SceneSpec(objects=(ObjectSpec(name="cube_red", position_xyz_m=(0.1, 0.2, 0.025)),))
    session = open_session(scene, seed=0)
    wall = PathBlocked(
        name="wall", position_xyz_m=(-0.05, 0.0, 0.3), size_xyz_m=(0.8, 0.04, 0.6), is_seen=False
    )
    session.inject(wall)
    session.advance(0.2)
    report = stacker.run(session, RIGHT, Motion(activity="Reach", skill="reach", object="cube_red"))
    assert (report.state, report.problem) == ("failed", "off_course")
    assert report.n_collisions > 0
    assert report.peak_force_n > 5.0


def test_a_tower_of_five_is_built_and_not_swept_over(stacker):
    names = cube_names(5)
    session = open_session(random_scene(names, seed=7), seed=7)
    for above, below in zip(names[1:], names[:-1], strict=True):
        assert stacker.stack(session, RIGHT, above, below)[-1].state == "succeeded"
    assert all(
        session.is_resting_on(above, below) for above, below in zip(names[1:], names[:-1], strict=True)
    )


def test_cylinders_boxes_and_cubes_of_other_sizes_are_stacked(stacker):
    scene = SceneSpec(
        objects=(
            ObjectSpec(
                name="can", kind="cylinder", size_xyz_m=(0.05, 0.05, 0.08), position_xyz_m=(0.1, 0.2, 0.04)
            ),
            ObjectSpec(name="brick", size_xyz_m=(0.10, 0.05, 0.04), position_xyz_m=(0.0, -0.2, 0.02)),
            ObjectSpec(name="small", size_xyz_m=(0.035,) * 3, position_xyz_m=(0.0, 0.0, 0.0175)),
        )
    )
    session = open_session(scene, seed=0)
    stacker.stack(session, RIGHT, "can", "brick")
    stacker.stack(session, RIGHT, "small", "can")
    assert session.is_resting_on("can", "brick")
    assert session.is_resting_on("small", "can")


def test_a_thing_that_is_too_wide_is_said_to_be():
    scene = SceneSpec(
        objects=(ObjectSpec(name="slab", size_xyz_m=(0.2, 0.2, 0.03), position_xyz_m=(0.0, 0.0, 0.015)),)
    )
    session = open_session(scene, seed=0)
    session.advance(0.2)
    report = session.start(RIGHT, Motion(activity="Reach", skill="reach", object="slab"))
    assert (report.state, report.problem) == ("blocked", "out_of_reach")
    assert "200" in report.reason


def test_a_motion_can_be_cancelled_and_the_hand_stays_where_it_is():
    session = opened(3)
    session.advance(0.2)
    session.start(RIGHT, Motion(activity="Reach", skill="reach", object="cube_red"))
    session.advance(0.6)
    with pytest.raises(UsageError, match="still moving"):
        session.start(RIGHT, Motion(activity="Idle", skill="rest"))
    session.cancel(RIGHT)
    session.advance(0.3)
    before = place_of(session, RIGHT)
    session.advance(1.0)
    assert session.report(RIGHT).state == "cancelled"
    assert np.linalg.norm(place_of(session, RIGHT) - before) < 0.002


def test_two_hands_stack_at_the_same_time(stacker, a_pair_each):
    session = open_session(a_pair_each, "gripper_dual", seed=0)
    assert set(session.hands) == {"Left_hand", RIGHT}
    left = stacker.motions("cube_green", "cube_yellow")
    right = stacker.motions("cube_red", "cube_blue")
    for one, other in zip(left, right, strict=True):
        session.start("Left_hand", one)
        session.start(RIGHT, other)
        while "running" in {session.report(hand).state for hand in session.hands}:
            session.advance(0.05)
    session.advance(0.2)
    assert session.is_resting_on("cube_red", "cube_blue")
    assert session.is_resting_on("cube_green", "cube_yellow")
    assert session.time_ns < 14e9


def test_mistakes_of_the_caller_are_named():
    session = opened(3)
    with pytest.raises(UnknownNameError, match="unknown robot 'arm'"):
        open_session(session.scene, "arm", seed=0)
    with pytest.raises(UnknownNameError, match="unknown hand 'Left_hand'"):
        session.start("Left_hand", Motion(activity="Idle", skill="rest"))
    with pytest.raises(UnknownNameError, match="unknown skill 'dance'"):
        session.start(RIGHT, Motion(activity="Dance", skill="dance"))
    with pytest.raises(UnknownNameError, match="unknown object 'cup'"):
        session.start(RIGHT, Motion(activity="Reach", skill="reach", object="cup"))
    with pytest.raises(UsageError, match="needs an object"):
        session.start(RIGHT, Motion(activity="Reach", skill="reach"))
    with pytest.raises(UnknownNameError, match="skill parameter"):
        session.start(RIGHT, Motion(activity="Idle", skill="rest", parameters=(("zeal", 1.0),)))
    with pytest.raises(UnknownNameError, match="unknown object 'cup'"):
        session.inject(ObjectRemoved(object="cup"))


def test_objects_that_stand_in_each_other_are_no_scene():
    scene = SceneSpec(
        objects=(
            ObjectSpec(name="a", position_xyz_m=(0.0, 0.0, 0.025)),
            ObjectSpec(name="b", position_xyz_m=(0.02, 0.0, 0.025)),
        )
    )
    with pytest.raises(SimulationError, match="a and b by 30 mm"):
        open_session(scene, seed=0)


def test_the_light_robot_says_what_it_cannot_reach():
    session = opened(3)
    assert session.can_reach(RIGHT, (0.1, 0.1, 0.3)) is None
    assert "outside" in session.can_reach(RIGHT, (0.1, 0.1, 1.5))


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        ("box", (0.035, 0.035, 0.035)),
        ("box", (0.060, 0.060, 0.060)),
        ("box", (0.110, 0.045, 0.040)),
        ("cylinder", (0.050, 0.050, 0.090)),
        ("sphere", (0.050, 0.050, 0.050)),
    ],
)
def test_objects_of_every_kind_are_grasped_and_lifted_by_friction(stacker, kind, size):
    thing = ObjectSpec(name="thing", kind=kind, size_xyz_m=size, position_xyz_m=(0.05, 0.0, size[2] / 2))
    session = open_session(SceneSpec(objects=(thing,)), seed=1)
    session.advance(0.2)
    for skill in ("reach", "grasp", "lift"):
        report = stacker.run(session, RIGHT, Motion(activity=skill, skill=skill, object="thing"))
        assert report.state == "succeeded", report.reason
    assert place_of(session, "thing")[2] > size[2] / 2 + 0.05
    assert report.n_collisions == 0


def test_a_lying_cylinder_is_taken_across_and_put_elsewhere_on_the_table(stacker):
    lying = (float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)), 0.0)
    rod = ObjectSpec(
        name="rod",
        kind="cylinder",
        size_xyz_m=(0.03, 0.03, 0.10),
        position_xyz_m=(0.0, 0.0, 0.015),
        orientation_wxyz=lying,
    )
    post = ObjectSpec(name="post", position_xyz_m=(0.0, 0.2, 0.025))
    session = open_session(SceneSpec(objects=(rod, post)), seed=1)
    session.advance(0.2)
    for motion in stacker.motions("rod", "table")[:4]:
        report = stacker.run(session, RIGHT, motion)
        assert report.state == "succeeded", report.reason
    session.advance(0.3)
    assert session.is_resting_on("rod", "table")


def models_of(session):
    """What of a session holds the memory of physics, to be seen without being kept."""
    arms = [control.arm for control in session.others_of("")]
    return [weakref.ref(each) for each in (session.model, session.data, session.checker, *arms)]


@pytest.mark.parametrize("robot", ["gripper", "gripper_dual"])
def test_a_sessions_models_go_with_it(stacker, no_collector, robot):
    session = opened(robot=robot, n=2)
    stacker.stack(session, RIGHT, "cube_red", "cube_blue", n=2)
    models = models_of(session)
    assert all(model() is not None for model in models)
    del session
    assert [model() for model in models] == [None] * len(models)


def test_a_sessions_models_go_with_it_also_in_the_middle_of_a_motion(no_collector):
    session = opened(n=2)
    session.start(RIGHT, Motion(activity="Reach", skill="reach", object="cube_red"))
    session.advance(0.3)
    assert session.report(RIGHT).state == "running"
    models = models_of(session)
    del session
    assert [model() for model in models] == [None] * len(models)
