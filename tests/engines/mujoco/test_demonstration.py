import itertools

import numpy as np
import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.labels import LabelParams, label

TASKS = ["one-left", "two-right", "unstack-left", "rebuild-right", "both: red>blue@left, green>yellow@right"]


@pytest.mark.parametrize("text", TASKS)
def test_a_steady_participant_reaches_the_goal(performed, text):
    _, demonstration = performed(text)
    assert demonstration.is_goal_reached
    assert demonstration.n_misses == 0


def test_the_same_source_gives_the_same_demonstration_and_another_one_another(performed):
    _, one = performed("one-left", seed=5)
    performed.cache_clear()
    _, same = performed("one-left", seed=5)
    _, other = performed("one-left", seed=6)
    assert one is not same
    np.testing.assert_array_equal(one.cube_position_xyz_m, same.cube_position_xyz_m)
    np.testing.assert_array_equal(
        one.hands["Left_hand"].position_xyz_m, same.hands["Left_hand"].position_xyz_m
    )
    assert not np.array_equal(one.cube_position_xyz_m[0], other.cube_position_xyz_m[0])


def test_cubes_neither_fly_nor_sink(performed):
    for text in TASKS:
        _, demonstration = performed(text)
        height = demonstration.cube_position_xyz_m[:, :, 2]
        step_s = demonstration.time_s[1]
        speed = np.linalg.norm(np.diff(demonstration.cube_position_xyz_m, axis=0), axis=2) / step_s
        assert height.min() > 0.0235
        assert height.max() < 0.45
        assert speed.max() < 2.5


def test_cubes_that_nobody_touches_stay_where_they_are(performed):
    _, demonstration = performed("one-right", seed=3)
    yellow = demonstration.cubes.index("cube_yellow")
    way = demonstration.cube_position_xyz_m[:, yellow] - demonstration.cube_position_xyz_m[0, yellow]
    assert np.abs(way).max() < 1e-4


def test_the_hand_that_does_not_act_only_trembles(performed):
    _, demonstration = performed("one-right")
    left = demonstration.hands["Left_hand"]
    assert np.ptp(left.position_xyz_m, axis=0).max() < 0.01
    assert (left.trigger == 0).all()
    assert [stretch.activity for stretch in label(demonstration, "Left_hand")] == ["Idle"]


def activities(demonstration, hand):
    return [stretch.activity for stretch in label(demonstration, hand)]


CYCLE = ["Reach", "Take", "Put", "Release"]


def test_one_cube_is_idle_reach_take_put_release_idle(performed):
    _, demonstration = performed("one-left")
    stretches = label(demonstration, "Left_hand")
    assert [s.activity for s in stretches] == ["Idle", *CYCLE, "Idle"]
    assert [(s.acted_on, s.in_hand) for s in stretches[1:5]] == [
        ("cube_red", None),
        ("cube_red", "cube_red"),
        ("cube_blue", "cube_red"),
        ("cube_red", None),
    ]


def test_a_rest_between_two_cubes_is_idle_and_turning_at_once_is_not(performed):
    _, rested = performed("two-left", pause_probability=1.0)
    _, turned = performed("two-left", pause_probability=0.0)
    assert activities(rested, "Left_hand") == ["Idle", *CYCLE, "Idle", *CYCLE, "Idle"]
    assert activities(turned, "Left_hand") == ["Idle", *CYCLE, *CYCLE, "Idle"]


@pytest.mark.parametrize("habit", ["hesitation_probability", "regrasp_probability", "careless_probability"])
def test_hesitations_regrasps_and_careless_putting_do_not_cut_an_activity(performed, habit):
    _, demonstration = performed("one-right", **{habit: 1.0})
    assert activities(demonstration, "Right_hand") == ["Idle", *CYCLE, "Idle"]


def test_who_hesitates_takes_longer_to_reach(performed):
    def reaching_s(probability):
        stretches = [
            label(performed("one-right", seed=seed, hesitation_probability=probability)[1], "Right_hand")[1]
            for seed in range(3)
        ]
        return sum(stretch.end_s - stretch.start_s for stretch in stretches)

    # Each hesitation lasts at least 0.25 s and takes at least half of the speed away.
    assert reaching_s(1.0) > reaching_s(0.0) + 3 * 0.1


def test_who_always_misses_never_puts_and_fails(performed):
    _, demonstration = performed("one-right", miss_probability=1.0)
    stretches = label(demonstration, "Right_hand")
    takes = [s for s in stretches if s.activity == "Take"]
    assert not demonstration.is_goal_reached
    assert demonstration.n_misses == len(takes) == 4
    assert "Put" not in {s.activity for s in stretches}
    assert all(take.in_hand is None for take in takes)


@pytest.mark.parametrize("seed", range(4))
def test_labels_tile_the_demonstration_and_say_what_physics_shows(performed, seed):
    _, demonstration = performed(
        "two-left", seed=seed, miss_probability=0.4, regrasp_probability=0.5, hesitation_probability=0.5
    )
    params = LabelParams()
    hand = demonstration.hands["Left_hand"]
    stretches = label(demonstration, "Left_hand", params)
    times = demonstration.time_s
    assert stretches[0].start_s == 0.0
    assert stretches[-1].end_s == pytest.approx(times[-1] + times[1])
    for one, following in itertools.pairwise(stretches):
        assert one.end_s == following.start_s
        assert one.activity != following.activity
    for stretch in stretches:
        rows = (times >= stretch.start_s - 1e-9) & (times < stretch.end_s - 1e-9)
        if stretch.activity == "Idle":
            assert (hand.speed_m_per_s[rows] <= params.moving_m_per_s).all()
            assert (hand.trigger[rows] < 0.05).all()
        if stretch.activity == "Reach":
            assert hand.trigger[rows].max() <= params.trigger_margin + 1e-9
        if stretch.activity == "Put":
            cube = demonstration.cubes.index(stretch.in_hand)
            gap = demonstration.cube_position_xyz_m[rows, cube] - hand.position_xyz_m[rows]
            assert np.linalg.norm(gap, axis=1).max() < 0.04
            assert (hand.trigger[rows] > 0.9).all()
