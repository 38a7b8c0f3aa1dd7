from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.opening import open_session
from demoplan.engines.mujoco.scene import cube_names
from demoplan.engines.mujoco.scene_spec import (
    ObjectSpec,
    RandomSceneParams,
    SceneSpec,
    random_scene,
    read_scene,
    scene_of_poses,
)
from demoplan.errors import ManifestError, UnknownNameError, UsageError

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def test_a_scene_is_read_from_yaml_and_comes_to_rest_as_it_was_written(tmp_path: Path):
    path = tmp_path / "scene.yaml"
    path.write_text(
        "name: mine\nobjects:\n"
        "  - {name: brick, size_xyz_m: [0.1, 0.05, 0.04], position_xyz_m: [0, 0, 0.02]}\n"
        "  - {name: can, kind: cylinder, size_xyz_m: [0.05, 0.05, 0.1], position_xyz_m: [0, 0, 0.09]}\n"
        "  - {name: ball, kind: sphere, size_xyz_m: [0.06, 0.06, 0.06], position_xyz_m: [0.2, 0.1, 0.03]}\n"
    )
    session = open_session(read_scene(path), seed=0)
    session.advance(1.0)
    assert session.is_resting_on("can", "brick")
    assert session.is_resting_on("ball", "table")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("{name: table, position_xyz_m: [0, 0, 0.1]}", "no name for an object"),
        ("{name: '../a', position_xyz_m: [0, 0, 0.1]}", "give letters"),
        ("{name: a, position_xyz_m: [0, 0, .nan]}", "finite"),
        ("{name: a, size_xyz_m: [0, 1, 1], position_xyz_m: [0, 0, 1]}", "must be positive"),
        ("{name: a, kind: cone, position_xyz_m: [0, 0, 1]}", "'cone' is not allowed"),
        ("{name: a, orientation_wxyz: [0, 0, 0, 0], position_xyz_m: [0, 0, 1]}", "length 1"),
        ("{name: a}", "missing"),
    ],
)
def test_what_is_wrong_with_an_object_is_said_with_its_line(tmp_path: Path, line, says):
    path = tmp_path / "scene.yaml"
    path.write_text(f"name: mine\nobjects:\n  - {line}\n")
    with pytest.raises(ManifestError, match=says) as caught:
        read_scene(path)
    assert caught.value.line == 3


def test_a_missing_file_and_a_name_given_twice_are_refused(tmp_path: Path):
    with pytest.raises(ManifestError, match="no such scene file"):
        read_scene(tmp_path / "none.yaml")
    twin = ObjectSpec(name="a", position_xyz_m=(0.0, 0.0, 0.025))
    with pytest.raises(ValidationError, match="more than one object: a"):
        SceneSpec(objects=(twin, twin))


def test_a_random_scene_is_the_same_for_the_same_seed_and_stacks_cubes_of_different_sizes():
    names = cube_names(4)
    params = RandomSceneParams(edges_m=(0.03, 0.05, 0.06))
    stacked = [("cube_red", "cube_blue"), ("cube_green", "cube_red")]
    scene = random_scene(names, seed=3, stacked=stacked, params=params)
    assert scene == random_scene(names, seed=3, stacked=stacked, params=params)
    assert scene != random_scene(names, seed=4, stacked=stacked, params=params)
    session = open_session(scene, seed=0)
    session.advance(0.5)
    assert all(session.is_resting_on(above, below) for above, below in stacked)


def test_the_scene_of_a_logged_instant_has_its_objects_where_they_were():
    poses = {"cube_red": ((0.1, 0.2, 0.025), IDENTITY), "cube_blue": ((0.0, 0.0, 0.025), IDENTITY)}
    shapes = dict.fromkeys(poses, ("box", (0.05, 0.05, 0.05)))
    scene = scene_of_poses(poses, shapes, {"cube_red": "Cube"})
    assert scene.require("cube_red").type == "Cube"
    session = open_session(scene, seed=0)
    session.advance(0.1)
    red = session.true_frames().filter(entity="cube_red").row(-1, named=True)
    np.testing.assert_allclose(red["position_xyz_m"], (0.1, 0.2, 0.025), atol=0.001)
    with pytest.raises(UnknownNameError, match="shape of object 'cube_"):
        scene_of_poses(poses, {}, {})
    with pytest.raises(UsageError, match="at least one object"):
        scene_of_poses({}, {}, {})
