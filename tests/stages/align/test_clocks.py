import numpy as np
import pytest

from demoplan.stages.align.clocks import steady

S = 1_000_000_000
JUMP, PAUSE = S // 2, 3600 * S


def run(stamp_s, log_s):
    stamps, stretches = steady(
        np.round(np.array(stamp_s) * S).astype(np.int64),
        np.round(np.array(log_s) * S).astype(np.int64),
        JUMP,
        PAUSE,
    )
    return stamps / S, stretches


def test_steady_clocks_are_left_alone():
    stamps, stretches = run([5, 5.1, 5.2], [0, 0.3, 0.3])
    assert stamps.tolist() == [5, 5.1, 5.2]
    assert stretches.tolist() == [0, 0, 0]


@pytest.mark.parametrize("jump", [-4.0, 3.0, 1.7e9, -100.0])
def test_a_clock_that_was_set_goes_on_as_the_recorder_saw_it(jump):
    log = np.arange(100) / 10
    stamp = log + 50 + np.where(np.arange(100) >= 60, jump, 0.0)
    stamps, stretches = run(stamp, log)
    np.testing.assert_allclose(stamps, log + 50, atol=1e-6)
    assert stretches.tolist() == [0] * 60 + [1] * 40


def test_a_pause_of_the_recording_stays_a_pause():
    log = np.append(np.arange(10), np.arange(10) + 300.0)
    stamps, stretches = run(log + 7, log)
    np.testing.assert_allclose(stamps, log + 7)
    assert set(stretches) == {0}


def test_messages_that_were_held_up_keep_their_stamps():
    stamp = np.arange(40) / 10
    log = stamp.copy()
    log[10:25] = 2.5  # received in one go
    stamps, stretches = run(stamp, log)
    np.testing.assert_allclose(stamps, stamp)
    assert set(stretches) == {0}


def test_a_late_message_out_of_order_keeps_its_stamp():
    stamp, log = np.arange(40) / 10, np.arange(40) / 10
    stamp[30] = 1.05
    stamps, stretches = run(stamp, log)
    assert stamps[30] == 1.05
    assert set(stretches) == {0}


def test_a_single_stamp_from_nowhere_is_placed_where_it_was_received():
    stamp, log = np.arange(40) / 10, np.arange(40) / 10
    stamp[20] = 9e8
    stamps, _ = run(stamp, log)
    np.testing.assert_allclose(stamps, log, atol=1e-6)


def test_a_recorder_whose_own_clock_was_set_back_goes_on():
    log = np.append(np.arange(20) / 10, np.arange(20) / 10 - 30)
    stamps, stretches = run(log, log)
    np.testing.assert_allclose(stamps, np.arange(40) / 10, atol=1e-6)
    assert stretches.tolist() == [0] * 20 + [1] * 20


def test_nothing_is_interpolated_across_a_jump():
    from demoplan.stages.align.resampling import neighbours, positions_at

    near = neighbours(
        np.array([0, 10, 20, 30]), np.array([0, 0, 1, 1]), np.array([5, 12, 18, 25]), staleness_ns=100
    )
    np.testing.assert_allclose(
        positions_at(near, np.array([[0.0], [1.0], [8.0], [9.0]]))[:, 0], [0.5, 1, 8, 8.5]
    )
