import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.robots.grasps import grasps_of, stance_of, yaws_on
from demoplan.engines.mujoco.robots.paths import Upright, height_over, progress, way_through, ways_over

place = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.02, 0.4)).map(np.array)


def turned(yaw):
    return np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])


@given(st.lists(place, min_size=2, max_size=5), st.floats(-3, 3))
@settings(max_examples=50)
def test_a_way_begins_and_ends_where_it_should_and_is_dense(points, yaw):
    way = way_through(np.array(points), np.linspace(0.0, yaw, len(points)))
    np.testing.assert_allclose(way.position_xyz_m[0], points[0], atol=1e-9)
    np.testing.assert_allclose(way.position_xyz_m[-1], points[-1], atol=1e-9)
    assert way.yaw_rad[-1] == pytest.approx(yaw)
    assert np.linalg.norm(np.diff(way.position_xyz_m, axis=0), axis=1).max(initial=0.0) <= 0.0155


@given(st.floats(0.01, 2.0), st.floats(0.05, 1.0))
def test_no_step_of_a_way_is_faster_than_the_peak_speed_and_the_last_is_the_end(length, speed):
    done = progress(length, speed, 0.01)
    assert done[-1] == pytest.approx(length)
    assert np.diff(done, prepend=0.0).max() <= speed * 0.01 * 1.001


@given(place, place, st.lists(place, max_size=5))
@settings(max_examples=50)
def test_the_first_way_passes_over_everything_that_is_near_it(start, goal, towers):
    things = [Upright(f"t{i}", x, y, 0.035, z) for i, (x, y, z) in enumerate(towers)]
    ways = ways_over(
        start, goal, things, radius_m=0.06, below_m=0.02, clearance_m=0.05, approach_m=0.0, highest_m=2.0
    )
    corners = next(ways)
    np.testing.assert_array_equal(corners[0], start)
    np.testing.assert_array_equal(corners[-1], goal)
    top, _ = height_over(start[:2], goal[:2], things, 0.06)
    if top > 0.0:
        assert min(corners[1:-1, 2]) >= top + 0.05 + 0.02 - 1e-9


def test_a_way_that_is_too_high_is_not_offered():
    wall = [Upright("tower", 0.0, 0.0, 0.04, 0.5)]
    ways = ways_over(
        np.array([-0.2, 0.0, 0.1]),
        np.array([0.2, 0.0, 0.1]),
        wall,
        radius_m=0.06,
        below_m=0.02,
        clearance_m=0.05,
        approach_m=0.0,
        highest_m=0.4,
    )
    for corners in ways:
        assert np.abs(corners[:, 1]).max() > 0.1


@given(st.floats(-3.0, 3.0))
def test_a_cube_is_grasped_square_and_turned_the_least(yaw):
    stance = stance_of("box", np.full(3, 0.05), np.array([0.1, 0.0, 0.025]), turned(yaw))
    grasps = grasps_of(stance, near_yaw_rad=0.3, widest_m=0.09, finger_reach_m=0.014, palm_gap_m=0.05)
    assert len(grasps) == 4
    assert abs(grasps[0].yaw_rad - 0.3) <= np.pi / 4 + 1e-9
    assert np.sin(2 * (grasps[0].yaw_rad - yaw)) == pytest.approx(0.0, abs=1e-6)


def test_a_brick_is_grasped_across_its_narrow_side_only():
    stance = stance_of("box", np.array([0.12, 0.05, 0.05]), np.zeros(3), turned(0.0))
    grasps = grasps_of(stance, near_yaw_rad=0.0, widest_m=0.09, finger_reach_m=0.014, palm_gap_m=0.05)
    assert {round(grasp.width_m, 3) for grasp in grasps} == {0.05}
    # The hand closes along its y axis, which is then the brick's.
    assert abs(np.sin(grasps[0].yaw_rad)) < 1e-6


def test_a_tall_thing_is_grasped_so_high_that_the_palm_stays_clear():
    stance = stance_of("box", np.array([0.05, 0.05, 0.2]), np.array([0.0, 0.0, 0.1]), turned(0.0))
    grasps = grasps_of(stance, near_yaw_rad=0.0, widest_m=0.09, finger_reach_m=0.014, palm_gap_m=0.05)
    assert stance.top_m - grasps[0].position_xyz_m[2] < 0.05


@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_what_is_put_on_a_cube_is_turned_square_to_it_by_45_degrees_at_most(own, on):
    turns = yaws_on(
        stance_of("box", np.full(3, 0.05), np.zeros(3), turned(own)),
        stance_of("box", np.full(3, 0.05), np.zeros(3), turned(on)),
    )
    assert abs(turns[0]) <= np.pi / 4 + 1e-9
    assert np.sin(2 * (own + turns[0] - on)) == pytest.approx(0.0, abs=1e-6)
