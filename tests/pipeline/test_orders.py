"""What is given to a worker is small, and says the same there as here."""

import pickle
from pathlib import Path

import pytest

from demoplan.errors import StoreError
from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.episodes import ingest as ingesting
from demoplan.pipeline.episodes.orders import setting_of
from demoplan.store import Store

DATASET = Path(__file__).resolve().parents[2] / "datasets" / "cube-stacking"


@pytest.fixture
def job(tmp_path):
    opened = open_dataset(DATASET)
    (job,) = ingesting.jobs_of(opened, Store(tmp_path), [opened.episode("p1-one-left")])
    return job


def orders_of(job):
    """What `ingest` gives to its crew, and what it does about a worker that died."""
    given = []

    def crew(work, orders):
        assert work is ingesting.ingest_group
        given.extend(orders)
        yield from ((order, None) for order in orders)

    return given, ingesting.ingest([job], crew=crew, on_done=lambda _: None)


def test_an_order_is_paths_and_hashes_and_gives_the_same_tables_as_the_job(job, tmp_path):
    given, _ = orders_of(job)
    ((order,),) = given
    assert len(pickle.dumps(order)) < 1500
    setting = setting_of(job.store, order.setting)
    assert (setting.mapping, setting.vocabulary) == (job.mapping, job.vocabulary)
    (there,) = ingesting.ingest_group((order,))
    assert there.state.status == "complete"
    assert there.state == ingesting.ingest_episode(job)


def test_an_episode_whose_workers_died_is_set_aside_with_the_reason_and_has_its_row(job, tmp_path):
    _, (state,) = orders_of(job)
    assert state.status == "quarantined"
    assert "every process that read it died" in state.reason
    from demoplan.tables import Episodes

    row = Store(tmp_path).get(state.tables["episodes"], Episodes)
    assert row["reason"][0] == state.reason


def test_a_setting_that_was_changed_or_is_not_there_is_refused(job, tmp_path):
    given, _ = orders_of(job)
    (path,) = (tmp_path / "settings").iterdir()
    path.write_text(path.read_text().replace("cube", "tube"))
    setting_of.cache_clear()
    with pytest.raises(StoreError, match="not what its name stands for"):
        ingesting.ingest_group(given[0])
    path.unlink()
    with pytest.raises(StoreError, match="every worker needs the store"):
        ingesting.ingest_group(given[0])


def test_segmenting_by_order_gives_what_segmenting_here_gives(job, tmp_path, monkeypatch):
    from demoplan.pipeline.episodes import activities, segmenters

    opened = open_dataset(DATASET)
    state = ingesting.ingest_episode(job)
    chosen = {state.episode_id: segmenters.rules()}
    given = []

    def crew(work, orders):
        for order in orders:
            given.append(order)
            yield order, work(pickle.loads(pickle.dumps(order)))

    monkeypatch.setattr(activities, "MANY", 1)
    (there,) = activities.segment_episodes(opened, Store(tmp_path), [state], chosen, crew=crew)
    assert len(given) == 1
    assert len(pickle.dumps(given[0])) < 2500
    (again,) = activities.segment_episodes(opened, Store(tmp_path), [state], chosen, crew=crew)
    assert len(given) == 1, "what is there is not given away"
    assert there == again
    fresh = ingesting.replace(job, store=str(tmp_path / "here"))
    (here,) = activities.segment_episodes(
        opened, Store(tmp_path / "here"), [ingesting.ingest_episode(fresh)], chosen
    )
    assert here == there


def test_a_segmenter_that_changed_after_the_order_was_given_is_refused(job, tmp_path):
    from demoplan.pipeline.episodes import activities

    order = activities.SegmentOrder(
        store=str(tmp_path),
        setting="",
        states=(ingesting.EpisodeState(dataset="d", episode_id="e"),),
        segmenter="rules",
        content="of another one",
        params=activities.SegmentParams(),
    )
    with pytest.raises(StoreError, match="not the segmenter that was chosen"):
        activities.segment_group(order)
