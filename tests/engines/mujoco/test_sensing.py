import numpy as np
import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.sensing import RigParams, draw_rig, sense
from demoplan.geometry import conjugate, multiply, rotate

START_NS = 1_700_000_000_000_000_000
CLEAN = RigParams(
    position_noise_m=0.0,
    wander_m=0.0,
    orientation_noise_rad=0.0,
    trigger_noise=0.0,
    drop_probability=0.0,
    dropouts_per_minute=0.0,
)


@pytest.fixture
def seen(performed):
    who, demonstration = performed("one-right")
    rig = draw_rig(np.random.default_rng(1))

    def see(params=RigParams(), seed=2):
        return sense(demonstration, who, rig, START_NS, np.random.default_rng(seed), params)

    return who, demonstration, rig, see


def at(clocks, demonstration):
    return np.searchsorted(demonstration.time_s, (clocks.captured_ns - START_NS) / 1e9).clip(
        0, len(demonstration.time_s) - 1
    )


def test_rates_are_those_of_the_rig_and_few_messages_are_lost(seen):
    _, demonstration, _, see = seen
    sensed = see()
    length = demonstration.time_s[-1]
    assert len(sensed.cubes.clocks.captured_ns) == pytest.approx(100 * length, rel=0.03)
    for hand in sensed.hands.values():
        assert len(hand.clocks.captured_ns) == pytest.approx(120 * length, rel=0.08)
    assert len(see(CLEAN).cubes.clocks.captured_ns) > len(sensed.cubes.clocks.captured_ns)


def test_each_clock_runs_forward_and_receipt_follows_publication_but_for_the_constant_offset(seen):
    _, _, rig, see = seen
    sensed = see()
    streams = [sensed.cubes, *sensed.hands.values(), *sensed.triggers.values()]
    for clocks in (stream.clocks for stream in streams):
        assert (np.diff(clocks.captured_ns) > 0).all()
        assert (np.diff(clocks.published_ns) >= 0).all()
        assert (np.diff(clocks.received_ns) >= 0).all()
        assert (clocks.published_ns > clocks.captured_ns).all()
        transport_ns = clocks.received_ns - clocks.published_ns - rig.clock_offset_ns
        assert (transport_ns > 0).all() and transport_ns.max() < 80e6
        assert np.median(transport_ns) < 8e6


def test_hands_come_back_into_the_world_through_the_latched_transform(seen):
    _, demonstration, _, see = seen
    sensed = see(CLEAN)
    hand = sensed.hands["Right_hand"]
    column = sensed.static.names.index(hand.frame)
    turn = np.broadcast_to(sensed.static.orientation_wxyz[0, column], (len(hand.position_xyz_m), 4))
    world = rotate(turn, hand.position_xyz_m[:, 0]) + sensed.static.position_xyz_m[0, column]
    rows = at(hand.clocks, demonstration)
    truth = demonstration.hands["Right_hand"]
    assert np.abs(world - truth.position_xyz_m[rows]).max() < 0.006
    turned = multiply(turn, hand.orientation_wxyz[:, 0])
    error = multiply(conjugate(truth.orientation_wxyz[rows]), turned)
    assert np.abs(error[:, 1:]).max() < 0.02


def test_noise_has_the_size_that_was_asked_for(seen):
    _, demonstration, _, see = seen
    sensed = see(RigParams(position_noise_m=0.0008, wander_m=0.0, drop_probability=0.0))
    yellow = demonstration.cubes.index("cube_yellow")
    rows = at(sensed.cubes.clocks, demonstration)
    error = sensed.cubes.position_xyz_m[:, yellow] - demonstration.cube_position_xyz_m[rows, yellow]
    assert error.std() == pytest.approx(0.0008, rel=0.1)
    np.testing.assert_allclose(np.linalg.norm(sensed.cubes.orientation_wxyz, axis=-1), 1.0, atol=1e-9)


def test_a_lost_cube_is_missing_from_messages_for_a_while(seen):
    _, _, _, see = seen
    sensed = see(RigParams(dropouts_per_minute=60.0))
    missing = ~sensed.cubes.is_present
    assert 0 < missing.mean() < 0.5
    assert see(CLEAN).cubes.is_present.all()


def test_the_trigger_says_what_this_person_does_with_it(seen):
    who, _, _, see = seen
    readings = see(CLEAN).triggers["Right_hand"].trigger
    assert readings.min() == pytest.approx(who.trigger_open, abs=1e-6)
    assert readings.max() == pytest.approx(who.trigger_closed, abs=1e-6)
    assert len(np.unique(see().triggers["Left_hand"].trigger)) > 100
