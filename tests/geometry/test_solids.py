import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from demoplan.geometry import Solid, heights, nearest_points, normalised, surface_distances, top_beneath


def random_solid(kind, rng, n, spread=0.12):
    size = rng.uniform(0.02, 0.2, 3)
    if kind in ("cylinder", "sphere"):
        size[1] = size[0]
    turns = normalised(rng.normal(size=(n, 4)))
    return Solid.placed(kind, size, rng.normal(size=3) * 0.01, rng.normal(size=(n, 3)) * spread, turns)


def box_distances_by_optimisation(a, b):
    """Nearest points of two boxes as a bounded least-squares problem: another way to the same number."""
    result = []
    for row in range(len(a.position_xyz_m)):
        axes = np.hstack([a.rotation[row], -b.rotation[row]])
        apart = b.position_xyz_m[row] - a.position_xyz_m[row]
        reach = np.concatenate([a.half_xyz_m, b.half_xyz_m])
        found = lsq_linear(axes, apart, bounds=(-reach, reach), tol=1e-14)
        result.append(np.sqrt(2.0 * found.cost))
    return np.array(result)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_distance_of_two_boxes_is_that_of_their_nearest_points(seed):
    rng = np.random.default_rng(seed)
    a, b = random_solid("box", rng, 12), random_solid("box", rng, 12)
    np.testing.assert_allclose(surface_distances(a, b), box_distances_by_optimisation(a, b), atol=1e-7)


def test_boxes_that_are_parallel_or_share_a_face_have_their_gap_as_distance():
    turn = np.tile([1.0, 0, 0, 0], (4, 1))
    a = Solid.placed("box", np.full(3, 0.1), np.zeros(3), np.zeros((4, 3)), turn)
    where = np.array([[0.13, 0, 0], [0.13, 0.14, 0], [0.1, 0, 0], [0.05, 0, 0]])
    b = Solid.placed("box", np.full(3, 0.1), np.zeros(3), where, turn)
    np.testing.assert_allclose(surface_distances(a, b), [0.03, 0.05, 0.0, 0.0], atol=1e-12)


def sampled_surface(solid, row, n=25):
    """Points all over a cylinder or box, in the world."""
    if solid.kind == "box":
        axis = np.linspace(-1, 1, n)
        grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    else:
        angle, radius, z = np.meshgrid(
            np.linspace(0, 2 * np.pi, 48), np.linspace(0, 1, 8), np.linspace(-1, 1, n)
        )
        grid = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    return grid * solid.half_xyz_m @ solid.rotation[row].T + solid.position_xyz_m[row]


@pytest.mark.parametrize("other", ["box", "cylinder"])
def test_a_cylinder_is_as_far_from_a_solid_as_its_nearest_sampled_point(other):
    rng = np.random.default_rng(4)
    a, b = random_solid("cylinder", rng, 40, 0.15), random_solid(other, rng, 40, 0.15)
    found = surface_distances(a, b)
    for row in range(40):
        points = sampled_surface(a, row)
        many = Solid(
            b.kind,
            b.half_xyz_m,
            np.repeat(b.position_xyz_m[row : row + 1], len(points), axis=0),
            np.repeat(b.rotation[row : row + 1], len(points), axis=0),
        )
        sampled = np.linalg.norm(nearest_points(many, points) - points, axis=1).min()
        # Sampling overestimates by at most half its spacing; the projections by what they promise.
        assert found[row] <= sampled + 0.02 * 2 * min(a.half_xyz_m.min(), b.half_xyz_m.min()) + 1e-9
        assert found[row] >= sampled - 0.02


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(["box", "cylinder", "sphere", "point"]),
    st.sampled_from(["box", "cylinder", "sphere", "point"]),
    st.floats(0.005, 0.2),
)
def test_distance_is_symmetric_and_a_cheap_one_is_right_below_its_limit(seed, one, other, limit):
    rng = np.random.default_rng(seed)
    a, b = random_solid(one, rng, 8), random_solid(other, rng, 8)
    exact = surface_distances(a, b)
    np.testing.assert_allclose(exact, surface_distances(b, a), atol=3e-3)
    cheap = surface_distances(a, b, exact_below_m=limit)
    np.testing.assert_allclose(cheap[cheap < limit], exact[cheap < limit], atol=1e-12)
    assert np.all(exact[cheap >= limit] >= limit - 1e-9)


def test_where_a_pose_is_not_known_a_distance_is_not_known():
    here = np.array([[0.0, 0, 0], [np.nan] * 3])
    turn = np.full((2, 4), np.nan)
    for kind in ("box", "cylinder", "sphere", "point"):
        a = Solid.placed(kind, np.full(3, 0.1), np.zeros(3), here, turn)
        b = Solid.placed("box", np.full(3, 0.1), np.zeros(3), np.array([[0.3, 0, 0]] * 2), turn)
        distance = surface_distances(a, b)
        assert np.isfinite(distance[0]), kind
        assert np.isnan(distance[1]), kind


def test_the_top_beneath_a_point_is_found_on_a_box_turned_on_its_side():
    quarter = np.array([[np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]])
    box = Solid.placed("box", np.array([0.1, 0.2, 0.4]), np.zeros(3), np.zeros((1, 3)), quarter)
    # Turned about x: what was y (0.2) now stands, what was z (0.4) lies along y.
    np.testing.assert_allclose(top_beneath(box, np.array([[0.04, 0.19, 5.0]])), [0.1])
    assert np.isnan(top_beneath(box, np.array([[0.04, 0.21, 5.0]])))[0]
    np.testing.assert_allclose(top_beneath(box, np.array([[0.04, 0.21, 5.0]]), margin_m=0.02), [0.1])
    low, high = heights(box)
    np.testing.assert_allclose([low[0], high[0]], [-0.1, 0.1])
