"""Scenes from what was logged, in physics."""

from dataclasses import replace

import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.opening import open_session
from demoplan.errors import UsageError
from demoplan.pipeline.datasets import open_dataset, remember
from demoplan.pipeline.episodes.ingest import ingest, jobs_of
from demoplan.pipeline.execution.scenes import scene_of_state
from demoplan.store import Store


@pytest.fixture(scope="module")
def ingested(small_dataset, tmp_path_factory):
    folder, root = small_dataset
    opened = open_dataset(folder, root=root)
    opened = replace(
        opened, dataset=opened.dataset.model_copy(update={"episodes": opened.dataset.episodes[:1]})
    )
    store = Store(tmp_path_factory.mktemp("store") / "store")
    remember(opened, store)
    ingest(jobs_of(opened, store, opened.dataset.episodes), on_done=lambda _: None)
    return store


def test_what_was_stacked_in_the_log_stands_in_physics(ingested):
    start = open_session(scene_of_state(ingested, "p1-one-left@start"), seed=0)
    end = open_session(scene_of_state(ingested, "p1-one-left@end"), seed=0)
    assert set(start.scene.names) == {"cube_red", "cube_blue", "cube_green", "cube_yellow"}
    for session, support in ((start, "table"), (end, "cube_blue")):
        session.advance(0.5)
        assert session.is_resting_on("cube_red", support)
        assert session.is_resting_on("cube_blue", "table")


def test_an_instant_that_is_none_is_named(ingested):
    with pytest.raises(UsageError, match="the episode lasts"):
        scene_of_state(ingested, "p1-one-left@999")
    with pytest.raises(UsageError, match="no instant of an episode"):
        scene_of_state(ingested, "p1-one-left")
