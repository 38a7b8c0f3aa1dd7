"""Executions that the store keeps are found by the start of their id, with what is needed to draw them."""

from types import SimpleNamespace

import pytest

from demoplan.engines.mujoco.scene_spec import ObjectSpec, SceneSpec
from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import content_hash
from demoplan.pipeline import viewing
from demoplan.pipeline.execution.execute import run_rows, step_rows
from demoplan.pipeline.viewing import stored_run
from demoplan.store import Store
from demoplan.store.store import StageOutput, canonical_json
from demoplan.tables import Executions, Runs

SCENE = SceneSpec(objects=(ObjectSpec(name="cube_red", position_xyz_m=(0.0, 0.0, 0.025)),))


def keep(store, seed, scene):
    """Keep a run as evaluation does; gives its id."""
    inputs, params = {"goal": "onTop(cube_red, cube_blue)"}, canonical_json({"seed": seed})
    run_id = content_hash(canonical_json(inputs), params)[:32]
    row = {
        **dict.fromkeys(Runs.column_names()),
        **{"run_id": run_id, "domain_id": "d", "domain_name": "cubes", "goal": "one", "robot": "gripper"},
        **{"monitor": "full", "seed": seed, "is_fault_injected": False, "outcome": "no_plan"},
        **{"is_goal_reached": False, "is_goal_sensed": False, "simulated_s": 0.0},
        **{name: 0 for name in Runs.column_names() if name.startswith("n_")},
    }
    tables = {"runs": (run_rows([row]), Runs), "executions": (step_rows([]), Executions)}
    store.run("execute", inputs, params, "code", lambda: StageOutput(tables=tables, notes={"scene": scene}))
    return run_id


@pytest.fixture
def store(tmp_path, monkeypatch):
    version = SimpleNamespace(version=SimpleNamespace(dataset="cubes"))
    monkeypatch.setattr(viewing, "stored_domain", lambda store, name: version)
    monkeypatch.setattr(viewing, "recall", lambda store, name: SimpleNamespace(vocabulary=None))
    return Store(tmp_path / "store")


def test_a_run_is_found_by_the_start_of_its_id_with_its_scene_and_goal(store):
    kept = [keep(store, seed, SCENE.model_dump_json()) for seed in range(3)]
    for run_id in kept:
        found = stored_run(store, run_id[:8])
        assert (found.run_id, found.run["run_id"][0]) == (run_id, run_id)
        assert (found.scene, found.goal, found.dataset) == (SCENE, "onTop(cube_red, cube_blue)", "cubes")
        assert found.frames is None


@pytest.mark.parametrize("asked", ["", "0", "zzzz", "0" * 32])
def test_a_run_that_is_not_there_or_not_named_clearly_is_refused(store, asked):
    keep(store, 0, SCENE.model_dump_json())
    with pytest.raises(UnknownNameError, match="unknown execution"):
        stored_run(store, asked)


def test_a_scene_that_cannot_be_read_is_said_to_be(store):
    run_id = keep(store, 0, "{")
    with pytest.raises(StoreError, match="its scene cannot be read"):
        stored_run(store, run_id)
