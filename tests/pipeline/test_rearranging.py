"""The dataset that adds taking apart to stacking."""

from pathlib import Path

import pytest

from demoplan.logs import fingerprint
from demoplan.manifests.dataset import parse_dataset

CHECKOUT = Path(__file__).resolve().parents[2]
FOLDER = CHECKOUT / "datasets/cube-rearranging"


def _dataset(name):
    path = CHECKOUT / "datasets" / name / "dataset.yaml"
    return parse_dataset(path.read_text(), path)


def test_it_is_the_twelve_of_cube_stacking_and_three_more_of_the_same_people():
    stacking, whole = _dataset("cube-stacking"), _dataset("cube-rearranging")
    known = {episode.id: episode.sha256 for episode in stacking.episodes}
    added = [episode for episode in whole.episodes if episode.id not in known]
    assert {e.id: e.sha256 for e in whole.episodes if e.id in known} == known
    assert [episode.participant for episode in added] == ["p1", "p2", "p3"]
    assert whole.mapping == stacking.mapping
    for episode in added:
        assert str(fingerprint(FOLDER.parent / episode.file)) == episode.sha256
        assert (FOLDER.parent / (episode.labels or "")).is_file()


@pytest.mark.slow
def test_what_is_learned_from_it_executes_every_goal_beyond_the_study(tmp_path):
    pytest.importorskip("up_fast_downward")
    pytest.importorskip("mujoco")
    from demoplan.manifests.goals import read_goals
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.execution.evaluate import evaluate, jobs_of
    from demoplan.pipeline.run import run
    from demoplan.store import Store

    opened, store = open_dataset(FOLDER), Store(tmp_path / "store")
    learned = run(opened, store).learned["combined"]
    goals = read_goals(CHECKOUT / "datasets/cube-stacking/goals-beyond.yaml")
    jobs = jobs_of(
        store,
        [("combined", learned.text)],
        goals,
        vocabulary=opened.vocabulary,
        seeds=(31,),
        robot="gripper",
    )
    for row in evaluate(jobs, n_workers=1).runs.iter_rows(named=True):
        assert row["is_goal_reached"], f"{row['goal']}: {row['outcome']}: {row['reason']}"
        assert row["n_plans"] == 1, row["goal"]
