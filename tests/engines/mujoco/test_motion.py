import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.motion import (
    ArcParams,
    Hesitation,
    MovementClock,
    Path,
    Submovement,
    Tremor,
    arc,
    minimum_jerk,
)

metres = st.floats(-0.5, 0.5)
vectors = st.tuples(metres, metres, metres)
submovements = st.builds(Submovement, vectors, st.floats(0, 1), st.floats(0.1, 2))


def test_minimum_jerk_starts_and_ends_at_rest_and_without_acceleration():
    t = np.linspace(-0.1, 1.1, 12_001)
    way = minimum_jerk(t)
    speed = np.gradient(way, t)
    acceleration = np.gradient(speed, t)
    assert way[0] == 0 and way[-1] == 1
    for end in (0.0, 1.0):
        at = np.argmin(abs(t - end))
        assert abs(speed[at]) < 1e-5 and abs(acceleration[at]) < 0.05
    assert speed.max() == pytest.approx(1.875, abs=1e-3)


def test_minimum_jerk_has_less_jerk_than_its_neighbours():
    t = np.linspace(0, 1, 2001)

    def cost(way):
        jerk = way
        for _ in range(3):
            jerk = np.gradient(jerk, t)
        return np.sum(jerk[20:-20] ** 2)

    bump = 64 * (t * (1 - t)) ** 3
    best = cost(minimum_jerk(t))
    assert all(cost(minimum_jerk(t) + size * bump) > best for size in (-0.05, -0.01, 0.01, 0.05))


@given(st.lists(submovements, min_size=1, max_size=5), vectors, st.floats(0, 4))
def test_a_path_is_the_sum_of_its_submovements(parts, start, time_s):
    path = Path(np.array(start), parts)
    alone = [Path(np.zeros(3), [part]).at(time_s) for part in parts]
    np.testing.assert_allclose(path.at(time_s), np.array(start) + np.sum(alone, axis=0), atol=1e-12)
    np.testing.assert_allclose(path.at(path.duration_s), path.end_xyz_m, atol=1e-12)


@given(vectors, vectors, st.floats(0.03, 0.2), st.floats(-0.2, 0.2))
def test_an_arc_rises_over_its_ends_and_arrives(start, end, clearance_m, curvature):
    path = arc(
        np.array(start),
        np.array(end),
        ArcParams(duration_s=1.2, clearance_m=clearance_m, curvature=curvature),
    )
    way = np.array([path.at(t) for t in np.linspace(0, 1.2, 200)])
    np.testing.assert_allclose(way[0], start, atol=1e-12)
    np.testing.assert_allclose(way[-1], end, atol=1e-12)
    top = max(start[2], end[2]) + clearance_m
    assert way[:, 2].max() <= top + 1e-9
    assert way[:, 2].max() > max(start[2], end[2])


def test_a_hesitation_delays_by_what_it_takes_and_then_the_hand_goes_on():
    def arrival(hesitations):
        clock, ticks = MovementClock(hesitations), 0
        while clock.time_s < 1.0:
            clock.advance(0.004)
            ticks += 1
        return ticks * 0.004

    # The rate is zero for the middle half and falls and rises symmetrically in the outer quarters.
    assert arrival([Hesitation(0.5, 0.6, 1.0)]) - arrival([]) == pytest.approx(0.75 * 0.6, abs=0.02)


def test_a_brake_stops_the_clock_for_good():
    clock = MovementClock()
    for _ in range(50):
        clock.advance(0.004)
    clock.brake(0.1)
    for _ in range(25):
        clock.advance(0.004)
    assert clock.is_stopped
    stopped = clock.time_s
    clock.advance(0.004)
    assert clock.time_s == stopped
    assert 0.2 < stopped < 0.3


def test_tremor_has_the_size_that_was_asked_for_and_repeats():
    t = np.linspace(0, 60, 6000)
    rms = 0.0004

    def shifts(seed):
        tremor = Tremor(np.random.default_rng(seed), rms, 0.0)
        return np.array([tremor.at(each) for each in t])

    first = shifts(1)
    np.testing.assert_allclose(np.sqrt(np.mean(first**2, axis=0)), rms, rtol=0.3)
    np.testing.assert_array_equal(first, shifts(1))
    assert not np.array_equal(first, shifts(2))
