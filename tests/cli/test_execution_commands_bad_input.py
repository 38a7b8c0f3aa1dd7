"""What cannot be run, through the command line: one clear message, a row that says so, nothing moved."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from demoplan.cli.main import app
from demoplan.engines.fast_downward import solve as solve_function
from demoplan.engines.mujoco.skills import read_skills
from demoplan.errors import DemoplanError, ManifestError, SimulationError, UnknownNameError, UsageError
from demoplan.language.pddl import parse_domain
from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.store import Store

pytest.importorskip("mujoco")

CHECKOUT = Path(__file__).resolve().parents[2]
ONE = "onTop(cube_red, cube_blue)"


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Runs a command on a store with one learned domain and its vocabulary; gives exit, row and error."""
    text = (CHECKOUT / "tests/golden/execution/learned-domain.pddl").read_text()
    version = SimpleNamespace(name="learned", dataset="cubes", domain_id="0" * 16)
    learned = SimpleNamespace(domain=parse_domain(text), text=text, version=version)
    path = CHECKOUT / "schemas/vocabularies/tabletop.yaml"
    known = SimpleNamespace(vocabulary=parse_vocabulary(path.read_text(), path))
    monkeypatch.setattr("demoplan.pipeline.domains.learning.stored_domain", lambda *_: learned)
    monkeypatch.setattr("demoplan.pipeline.datasets.recall", lambda *_: known)
    Store(tmp_path)

    def run(*words):
        ended = CliRunner().invoke(
            app, ["execute", "-d", "learned", *words, "--store", str(tmp_path), "--json"]
        )
        if ended.exception is not None and not isinstance(ended.exception, SystemExit | DemoplanError):
            raise ended.exception
        row = json.loads(ended.stdout)["run"] if ended.stdout else None
        return SimpleNamespace(code=ended.exit_code, row=row, error=ended.exception, steps=ended.stdout)

    return run


@pytest.fixture
def scene(tmp_path):
    def write(*places):
        path = tmp_path / "scene.yaml"
        names = ("cube_red", "cube_blue", "cube_green")
        lines = [
            f"  - {{name: {name}, position_xyz_m: [{x}, {y}, {z}]}}\n"
            for name, (x, y, z) in zip(names, places, strict=False)
        ]
        path.write_text("objects:\n" + "".join(lines))
        return path

    return write


def test_a_goal_with_an_unknown_object_is_refused_with_those_that_are_there(command):
    ended = command("-g", "onTop(cube_pink, cube_blue)")
    assert isinstance(ended.error, UnknownNameError)
    assert ended.row["outcome"] == "not_started"
    for said in (str(ended.error), ended.row["reason"]):
        assert "cube_pink" in said
        assert "cube_green" in said


def test_objects_that_stand_in_each_other_are_named(command, scene):
    ended = command("-g", ONE, "--scene", scene((0.0, 0.1, 0.025), (0.0, 0.11, 0.025)))
    assert isinstance(ended.error, SimulationError)
    assert ended.row["outcome"] == "not_started"
    assert "cube_red and cube_blue" in ended.row["reason"]


def test_an_object_out_of_reach_is_said_to_be_so_before_anything_moves(command, scene):
    pytest.importorskip("mink")
    ended = command("-g", ONE, "--robot", "tiago", "--scene", scene((0.38, 0.48, 0.025), (0.0, 0.1, 0.025)))
    assert ended.code == 1
    assert (ended.row["outcome"], ended.row["n_steps"]) == ("out_of_reach", 0)
    assert "for cube_red" in ended.row["reason"]


def test_a_robot_whose_package_is_missing_is_said_to_be_so(command, monkeypatch):
    def missing(*_, **__):
        raise SimulationError("robot 'tiago' needs its description; install it with: pip install …")

    monkeypatch.setattr("demoplan.engines.mujoco.opening.open_session", missing)
    ended = command("-g", ONE, "--robot", "tiago")
    assert isinstance(ended.error, SimulationError)
    assert "needs its description" in ended.row["reason"]


def test_an_activity_without_a_skill_in_your_own_table_is_refused(command, tmp_path):
    table = read_skills()
    cases = {
        k: [case.model_dump(mode="json") for case in v] for k, v in table.activities.items() if k != "Put"
    }
    (tmp_path / "skills.yaml").write_text(json.dumps({"name": "mine", "activities": cases}))
    ended = command("-g", ONE, "--skills", tmp_path / "skills.yaml")
    assert isinstance(ended.error, UnknownNameError)
    assert ended.row["outcome"] == "not_started"
    assert "'Put' in skills table 'mine'" in ended.row["reason"]


def test_a_skills_table_that_is_wrong_is_refused_with_its_line(command, tmp_path):
    (tmp_path / "skills.yaml").write_text("name: mine\nactivities:\n  Put: [{skill: juggle}]\n")
    refused = command("-g", ONE, "--skills", tmp_path / "skills.yaml").error
    assert isinstance(refused, ManifestError)
    assert refused.line == 3
    assert isinstance(command("-g", ONE, "--skills", tmp_path / "none.yaml").error, UsageError)


@pytest.mark.parametrize(
    ("trouble", "said"),
    [("missing", "is not installed"), ("killed", "signal 9"), ("memory", "memory"), ("time", "s")],
)
def test_a_planner_that_fails_is_a_row_that_says_how(command, monkeypatch, tmp_path, trouble, said):
    module = __import__("sys").modules[solve_function.__module__]
    real = module.translate

    def translate(arguments, **options):
        if trouble == "killed":
            return replace(real(arguments, **options), exit_code=-9)
        changes = {"memory": {"memory_bytes": 20 * 2**20}, "time": {"wall_s": 0.0}}.get(trouble, {})
        return real(arguments, **(options | changes))

    monkeypatch.setattr(module, "translate", translate)
    if trouble == "missing":
        monkeypatch.setattr(module, "find_installation", lambda: None)
    ended = command("-g", ONE)
    assert ended.code == 1
    assert (ended.row["outcome"], ended.row["n_steps"]) == ("planner_failed", 0)
    assert said in ended.row["reason"]
