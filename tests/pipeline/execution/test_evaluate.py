"""Batches: resumable, deterministic, and a row for everything that cannot be run."""

import weakref
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest
from polars.testing import assert_frame_equal

from demoplan.errors import ManifestError, UsageError
from demoplan.language.pddl import render_domain
from demoplan.manifests.faults import parse_faults
from demoplan.manifests.goals import GoalCase, parse_goals, read_goals
from demoplan.pipeline.execution import evaluate as evaluating
from demoplan.pipeline.execution.evaluate import evaluate, jobs_of
from demoplan.pipeline.execution.run_views import execution_report, record_run
from demoplan.stages.score_runs import fault_confusion, score_runs
from demoplan.store import Store

CHECKOUT = Path(__file__).resolve().parents[3]
ONE = GoalCase(name="one", goal="onTop(cube_red, cube_blue)")


@pytest.fixture
def jobs(tmp_path, learned_domain, tabletop):
    def make(*goals, **changes):
        chosen = {"vocabulary": tabletop, "seeds": [0], "robot": "gripper"} | changes
        return jobs_of(
            Store(tmp_path), [("learned", render_domain(learned_domain))], goals or [ONE], **chosen
        )

    return make


def test_a_robot_reaches_a_goal_by_physics_and_is_not_run_twice(jobs, monkeypatch):
    pytest.importorskip("mujoco")
    first = evaluate(jobs(), n_workers=1)
    (run,) = first.runs.iter_rows(named=True)
    assert run["is_goal_reached"]
    assert run["n_unsound"] == run["n_false_alarms"] == 0
    monkeypatch.setattr(evaluating, "carry_out", lambda *_, **__: pytest.fail("it was run again"))
    again = evaluate(jobs(), n_workers=1)
    assert_frame_equal(first.runs, again.runs)
    assert_frame_equal(first.steps, again.steps)


def test_equal_seeds_give_identical_executions(jobs, tmp_path):
    pytest.importorskip("mujoco")
    one = evaluate(jobs(), n_workers=1)
    other = evaluate([replace(job, store=tmp_path / "other") for job in jobs()], n_workers=1)
    assert_frame_equal(one.runs, other.runs)
    assert_frame_equal(one.steps, other.steps)


@pytest.mark.slow
def test_processes_give_what_one_process_gives(jobs, tmp_path):
    several = jobs(seeds=[0, 1])
    alone = evaluate([replace(job, store=tmp_path / "alone") for job in several], n_workers=1)
    together = evaluate(several, n_workers=2)
    assert_frame_equal(alone.runs, together.runs)
    assert_frame_equal(alone.steps, together.steps)


def test_what_cannot_be_run_is_a_row_that_says_so_and_the_others_go_on(jobs):
    pytest.importorskip("mujoco")
    apart = {"name": "a", "position_xyz_m": (0.0, 0.0, 0.025)}
    within = evaluating.SceneSpec.model_validate({"objects": [apart, apart | {"name": "b"}]})
    unknown = GoalCase(name="unknown", goal="onTop(cube_pink, cube_blue)")
    (good, bad) = jobs(ONE, unknown)
    (inside,) = jobs(GoalCase(name="inside", goal="onTop(a, b)"))
    result = evaluate([good, bad, replace(inside, scene=within)], n_workers=1)
    outcomes = {row["goal"]: (row["outcome"], row["reason"]) for row in result.runs.iter_rows(named=True)}
    assert outcomes["one"][0] == "reached"
    assert outcomes["unknown"][0] == "not_started"
    assert "cube_pink" in outcomes["unknown"][1]
    assert outcomes["inside"][0] == "not_started"


def test_a_process_that_makes_many_runs_keeps_the_physics_of_none(jobs, monkeypatch, no_collector):
    pytest.importorskip("mujoco")
    from demoplan.engines.mujoco import opening

    models, open_session = [], opening.open_session

    def watched(*arguments, **options):
        session = open_session(*arguments, **options)
        models.extend(weakref.ref(each) for each in (session.model, session.data, session.checker))
        return session

    monkeypatch.setattr(opening, "open_session", watched)
    (drop,) = parse_faults("faults:\n  - {name: d, kind: drop, at: {activity: Put, delay_s: 0.6}}\n", "f")
    unknown = GoalCase(name="unknown", goal="onTop(cube_pink, cube_blue)")
    result = evaluate(jobs(ONE, unknown, faults=[None, drop]), n_workers=1)
    assert set(result.runs["outcome"]) >= {"reached", "not_started"}
    assert len(models) == 3 * 6
    assert [model() for model in models] == [None] * len(models)


def test_nothing_to_run_is_refused():
    with pytest.raises(UsageError, match="at least one"):
        evaluate([], n_workers=1)


def test_scores_tell_faults_from_clean_runs_and_monitors_from_each_other(jobs):
    pytest.importorskip("mujoco")
    (offset,) = parse_faults(
        "faults:\n  - {name: gone, kind: object_moved, which: thing, at: {activity: Release, delay_s: 0.9}}",
        "f",
    )
    result = evaluate(jobs(faults=[None, offset], monitors=("full", "none")), n_workers=1)
    scores = score_runs(result.runs)
    values = {
        (r["method"], r["metric"]): r["value"] for r in scores.iter_rows(named=True) if r["subject"] == "all"
    }
    assert values["monitor: full", "recovered"] == 1.0
    assert values["monitor: none", "recovered"] == 0.0
    assert values["monitor: full", "class named rightly"] == 1.0
    assert values["monitor: full", "runs with a false alarm"] == 0.0
    assert fault_confusion(result.runs).rows() == [("exogenous", "exogenous", 1)]
    page = execution_report(result, title="a <title>")
    assert "a &lt;title&gt;" in page
    assert "http://" not in page.replace("http://www.w3.org", "")


def test_a_run_can_be_looked_at(learned_domain, tabletop, new_session, four_cubes, tmp_path):
    from demoplan.pipeline.execution.execute import execute

    done = execute(learned_domain, ONE.goal, new_session(four_cubes), tabletop)
    path = record_run(done.run, done.steps, done.frames, four_cubes, tabletop, tmp_path / "run.rrd")
    assert path.stat().st_size > 10_000


def test_the_shipped_goals_are_read():
    folder = CHECKOUT / "datasets/cube-stacking"
    assert read_goals(folder / "goals.yaml")[0].name == "one-on-one"
    assert len(read_goals(folder / "goals-beyond.yaml")) >= 5


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("goals:\n  - {name: a}", 2, "missing"),
        ("goals:\n  - {name: a, goal: x}\n  - {name: a, goal: y}", 3, "twice; first on line 2"),
        ("goals:\n  - {name: a, goal: x, tower: 3}", 2, "unknown key"),
    ],
)
def test_a_goals_file_that_is_wrong_is_refused_with_its_line(text, line, said):
    with pytest.raises(ManifestError) as refused:
        parse_goals(text, "goals.yaml")
    assert refused.value.line == line
    assert said in str(refused.value)


def test_a_run_of_an_unknown_kind_of_scene_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        read_goals(tmp_path / "nothing.yaml")


def test_every_run_has_a_key_of_its_own(jobs):
    every = jobs(ONE, seeds=[0, 1], monitors=("full", "none"))
    assert len({job.run_id for job in every}) == len(every)
    assert pl.Series([job.run_id for job in every]).str.len_chars().unique().to_list() == [32]
