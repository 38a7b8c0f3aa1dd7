import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

mujoco = pytest.importorskip("mujoco")

from demoplan.engines.mujoco.hands import Hand, add_hand  # noqa: E402
from demoplan.engines.mujoco.scene import (  # noqa: E402
    CubeIndex,
    Layout,
    LayoutParams,
    Placement,
    SceneParams,
    build_scene,
    cube_names,
    draw_layout,
    is_resting_on,
)
from demoplan.errors import UnknownNameError, UsageError  # noqa: E402

DOWN = np.array([1.0, 0.0, 0.0, 0.0])


def placed(**where):
    return Layout(tuple(Placement(f"cube_{name}", xyz, 0.0) for name, xyz in where.items()))


def run(layout, seconds):
    model = build_scene(layout).compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    return data, CubeIndex.of(model, layout.names)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_cubes_start_apart_and_within_reach(seed, n_cubes):
    names = cube_names(n_cubes)
    layout = draw_layout(names, (), np.random.default_rng(seed))
    spots = np.array([placement.position_xyz_m[:2] for placement in layout.placements])
    gaps = np.linalg.norm(spots[:, None] - spots[None], axis=2)[~np.eye(n_cubes, dtype=bool)]
    assert layout.names == names
    assert (gaps >= 0.05 * np.sqrt(2) + LayoutParams().shortest_gap_m).all()
    assert (np.abs(spots) < 0.3).all()


def test_a_scene_is_at_rest_from_the_start():
    stacked = (("cube_red", "cube_blue"), ("cube_green", "cube_red"))
    layout = draw_layout(cube_names(4), stacked, np.random.default_rng(3))
    before, index = run(layout, 0.4)
    after, _ = run(layout, 3.0)
    for name in layout.names:
        shift = after.xpos[index.bodies[name]] - before.xpos[index.bodies[name]]
        assert np.linalg.norm(shift) < 1e-4
    for cube, support in stacked:
        assert is_resting_on(after, index, cube, support)
    assert is_resting_on(after, index, "cube_yellow", "table")
    assert not is_resting_on(after, index, "cube_green", "cube_blue")


@pytest.mark.parametrize(("offset_m", "stays"), [(0.0, True), (0.020, True), (0.028, False)])
def test_physics_decides_whether_a_cube_set_down_off_its_middle_stays(offset_m, stays):
    data, index = run(placed(red=(offset_m, 0.0, 0.0755), blue=(0.0, 0.0, 0.025)), 2.0)
    assert is_resting_on(data, index, "cube_red", "cube_blue") is stays
    if not stays:
        assert data.xpos[index.bodies["cube_red"]][2] < 0.06


def test_a_cube_in_the_air_does_not_rest():
    data, index = run(placed(red=(0.0, 0.0, 0.20)), 0.02)
    assert not is_resting_on(data, index, "cube_red", "table")


def test_a_tower_of_unknown_or_circular_cubes_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(UnknownNameError, match="cube_pink"):
        draw_layout(cube_names(2), (("cube_pink", "cube_red"),), rng)
    with pytest.raises(UsageError, match="circle"):
        draw_layout(cube_names(2), (("cube_red", "cube_blue"), ("cube_blue", "cube_red")), rng)
    with pytest.raises(UsageError, match="9 cubes"):
        cube_names(9)


def test_an_unknown_friction_cone_is_refused():
    with pytest.raises(UnknownNameError, match=r"round.*elliptic, pyramidal"):
        build_scene(placed(red=(0.0, 0.0, 0.025)), SceneParams(friction_cone="round"))


@pytest.fixture
def hand_over_cube():
    spec = build_scene(placed(red=(0.0, 0.0, 0.025)))
    add_hand(spec, "Right_hand", np.array([0.0, 0.0, 0.085]))
    model = spec.compile()
    data = mujoco.MjData(model)
    hand = Hand(model, data, "Right_hand")

    def act(height_m, closure, seconds):
        # As fast as people lift: a hand that is jerked up by 20 cm at once leaves the cube behind.
        heights = np.linspace(hand.position_xyz_m[2] or 0.085, height_m, round(seconds / model.opt.timestep))
        for height in heights:
            hand.command(np.array([0.0, 0.0, height]), DOWN, closure)
            mujoco.mj_step(model, data)
        return data.xpos[model.body("cube_red").id].copy()

    return act


def test_a_closed_hand_carries_a_cube_by_friction_and_an_opened_one_drops_it(hand_over_cube):
    hand_over_cube(0.085, 0.0, 0.2)
    hand_over_cube(0.085, 1.0, 0.4)
    hand_over_cube(0.285, 1.0, 1.0)
    lifted = hand_over_cube(0.285, 1.0, 0.3)
    held = hand_over_cube(0.285, 1.0, 3.0)
    assert lifted[2] == pytest.approx(0.225, abs=0.004)
    assert abs(held[2] - lifted[2]) < 0.001
    dropped = hand_over_cube(0.285, 0.0, 1.0)
    assert dropped[2] == pytest.approx(0.025, abs=0.001)


def test_a_hand_that_closes_above_a_cube_takes_nothing(hand_over_cube):
    hand_over_cube(0.135, 0.0, 0.3)
    hand_over_cube(0.135, 1.0, 0.4)
    left = hand_over_cube(0.285, 1.0, 1.0)
    assert left[2] == pytest.approx(0.025, abs=0.001)
