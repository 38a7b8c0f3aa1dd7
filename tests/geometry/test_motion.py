import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import savgol_filter

from demoplan.geometry import (
    continuous,
    hysteresis,
    matrices,
    normalised,
    rotate,
    run_lengths,
    velocities,
    without_short_runs,
)


def test_without_gaps_a_velocity_is_the_savitzky_golay_derivative():
    path = np.cumsum(np.random.default_rng(1).normal(size=(200, 3)), axis=0) + 1e4
    expected = savgol_filter(path, 15, 2, deriv=1, delta=0.01, axis=0)
    np.testing.assert_allclose(velocities(path, 0.01, 0.14)[7:-7], expected[7:-7], rtol=1e-6, atol=1e-6)


def test_gaps_do_not_change_the_velocity_of_uniform_motion():
    path = np.outer(np.arange(60) * 0.01, [0.3, -0.1, 0.0])
    path[20:24] = np.nan
    path[40] = np.nan
    np.testing.assert_allclose(velocities(path, 0.01, 0.1), np.tile([0.3, -0.1, 0.0], (60, 1)), atol=1e-12)


def test_a_velocity_needs_two_readings():
    path = np.full((30, 3), np.nan)
    path[15] = 1.0
    assert np.isnan(velocities(path, 0.01, 0.1)).all()


@given(st.lists(st.sampled_from([0, 1, 2]), min_size=1, max_size=60))
def test_hysteresis_equals_its_step_by_step_definition(levels):
    level = np.array(levels)
    state, expected = False, []
    for value in levels:
        state = value >= 2 or (state and value >= 1)
        expected.append(state)
    assert hysteresis(level >= 2, level >= 1).tolist() == expected


@given(st.lists(st.lists(st.integers(0, 2), min_size=7, max_size=7), min_size=0, max_size=5))
def test_runs_tile_every_row_and_rebuild_it(rows):
    codes = np.array(rows, np.int8).reshape(-1, 7)
    row, start, end, value = run_lengths(codes)
    rebuilt = np.full(codes.shape, -1, np.int8)
    for r, s, e, v in zip(row, start, end, value, strict=True):
        assert (rebuilt[r, s:e] == -1).all()
        rebuilt[r, s:e] = v
    assert (rebuilt == codes).all()
    assert all(v != w or r != q for r, q, v, w in zip(row[1:], row[:-1], value[1:], value[:-1], strict=True))


def test_only_short_runs_between_their_opposite_are_dropped():
    codes = np.array([[1, 0, 0, 1, 0, 0, 0, 1, 2, 1, 0, 1]], np.int8)
    dropped = without_short_runs(codes, 1, 0, 2)
    assert dropped.tolist() == [[1, 0, 0, 0, 0, 0, 0, 1, 2, 1, 0, 1]]


def test_short_runs_are_judged_within_their_row():
    codes = np.array([[0, 0, 1], [0, 0, 0]], np.int8)
    assert without_short_runs(codes, 1, 0, 5).tolist() == codes.tolist()


def test_signs_are_continuous_and_orientations_unchanged():
    turns = normalised(np.random.default_rng(0).normal(size=(1, 4))) + np.linspace(0, 0.5, 50)[:, None]
    turns = normalised(turns) * np.where(np.arange(50) % 3 == 0, -1, 1)[:, None]
    turns[10] = np.nan
    smooth = continuous(turns)
    seen = smooth[np.isfinite(smooth).all(axis=1)]
    assert (np.sum(seen[1:] * seen[:-1], axis=1) > 0).all()
    np.testing.assert_allclose(np.abs(np.sum(np.delete(smooth * turns, 10, axis=0), axis=1)), 1.0)


def test_matrices_rotate_as_quaternions_do():
    rng = np.random.default_rng(3)
    turns, vectors = normalised(rng.normal(size=(20, 4))), rng.normal(size=(20, 3))
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", matrices(turns), vectors), rotate(turns, vectors), atol=1e-12
    )
