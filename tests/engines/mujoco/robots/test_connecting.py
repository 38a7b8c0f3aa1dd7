import numpy as np
import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.robots.connecting import ConnectParams, Space, connect, shortened

SPACE = Space(np.zeros(2), np.full(2, 10.0), np.full(2, 0.1))


def is_free(points):
    """A wall at x = 5 with a door at y > 8."""
    return (np.abs(points[:, 0] - 5.0) > 0.5) | (points[:, 1] > 8.0)


def count_free(line):
    blocked = ~is_free(line)
    return int(np.argmax(blocked)) if blocked.any() else len(line)


def length(path):
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


@pytest.mark.parametrize("seed", range(5))
def test_a_path_goes_through_the_door_touches_nothing_and_gets_no_longer(seed):
    start, goal = np.array([1.0, 1.0]), np.array([9.0, 1.0])
    rng = np.random.default_rng(seed)
    corners = connect(start, [goal], SPACE, count_free, rng, ConnectParams(n_samples=2000))
    assert corners is not None
    short = shortened(corners, SPACE, count_free, rng, 100)
    for path in (corners, short):
        assert (path[0] == start).all()
        assert (path[-1] == goal).all()
        assert is_free(SPACE.dense(path)).all()
    assert length(short) <= length(corners) + 1e-9
    # The shortest way is about 16.6; chance and a hundred shortcuts come near it.
    assert 16.1 < length(short) < 20.0


def test_what_can_be_seen_is_gone_to_straight_and_the_same_seed_gives_the_same_path():
    start, goals = np.array([1.0, 1.0]), [np.array([9.0, 1.0]), np.array([2.0, 6.0])]
    straight = connect(start, goals, SPACE, count_free, np.random.default_rng(0))
    assert np.array_equal(straight, [start, goals[1]])
    paths = [connect(start, goals[:1], SPACE, count_free, np.random.default_rng(0)) for _ in range(2)]
    assert paths[0] is not None
    assert np.array_equal(*paths)


def test_where_there_is_no_path_none_is_found():
    def shut(line):
        blocked = np.abs(line[:, 0] - 5.0) <= 0.5
        return int(np.argmax(blocked)) if blocked.any() else len(line)

    rng = np.random.default_rng(0)
    assert connect(np.array([1.0, 1.0]), [np.array([9.0, 1.0])], SPACE, shut, rng) is None
    assert connect(np.array([1.0, 1.0]), [], SPACE, shut, rng) is None
