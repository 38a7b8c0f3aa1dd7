import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.robots.standing import StandingParams, standing_xy_m

PARAMS = StandingParams(usual_xy_m=(-0.555, 0.0), shoulders_xy_m=((0.1, 0.0),), reach_m=(0.35, 0.70))
SPOT = st.tuples(st.floats(-0.35, 0.35), st.floats(-0.45, 0.45))


def n_reached(base, points):
    away = np.linalg.norm(np.array(points) - base - [0.1, 0.0], axis=1)
    return int(((away >= 0.35 - 1e-9) & (away <= 0.70 + 1e-9)).sum())


@settings(max_examples=50, deadline=None)
@given(st.lists(SPOT, min_size=1, max_size=6))
def test_no_place_tried_at_random_reaches_more(points):
    base = standing_xy_m(points, 0.8, PARAMS)
    assert base[0] <= -0.455 + 1e-9
    rng = np.random.default_rng(0)
    others = np.column_stack([rng.uniform(-0.755, -0.455, 100), rng.uniform(-0.3, 0.3, 100)])
    # Places are tried on a grid: something at the very edge of the reach may be missed by one.
    assert n_reached(base, points) >= max(n_reached(each, points) for each in others) - 1


def test_it_stands_as_usual_where_that_is_as_good_and_before_the_edge_of_any_table():
    assert standing_xy_m([], 0.8, PARAMS) == pytest.approx([-0.555, 0.0])
    assert standing_xy_m([(0.07, 0.0)], 0.8, PARAMS) == pytest.approx([-0.555, 0.0], abs=0.01)
    assert standing_xy_m([(-0.2, 0.0)], 1.2, PARAMS)[0] <= -0.655 + 1e-9
