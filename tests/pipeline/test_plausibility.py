from dataclasses import replace

import pytest

from demoplan.manifests.mapping import GripTopic, PoseTopic
from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.episodes.ingest import ingest_episode, jobs_of
from demoplan.store import Store


@pytest.fixture
def job(small_dataset, tmp_path):
    folder, root = small_dataset
    opened = open_dataset(folder, root=root)
    return jobs_of(opened, Store(tmp_path), opened.dataset.episodes[:1])[0]


def with_topic(job, label, topic):
    topics = {**job.mapping.topics, label: topic}
    return replace(job, mapping=job.mapping.model_copy(update={"topics": topics}))


def test_the_shipped_mapping_is_plausible(job):
    assert ingest_episode(job).status == "complete"


def test_metres_that_are_mapped_as_millimetres_are_noticed(job):
    wrong = with_topic(job, "/hand/left/pose", PoseTopic(kind="pose", entity="Left_hand", unit="mm"))
    state = ingest_episode(wrong)
    assert state.status == "quarantined"
    assert "check the topic's `unit`" in state.reason


def test_positions_beyond_anyones_reach_are_noticed_with_the_unit_that_they_seem_to_have(job):
    from demoplan.errors import DataError
    from demoplan.logs import read
    from demoplan.pipeline.episodes.plausibility import PlausibilityParams, refuse_implausible

    reading = read(job.log, job.mapping, job.episode.id)
    with pytest.raises(DataError, match=r"farther than anything .* `unit: cm`"):
        refuse_implausible(
            reading.samples, reading.topics, job.mapping, PlausibilityParams(reach_m=0.1, least_extent_m=0.0)
        )


def test_a_required_topic_that_gives_nothing_is_refused_and_an_optional_one_is_not(job):
    label = "/hand/left/joy"
    beyond = {"kind": "grip", "entity": "Left_hand", "field": "axes[7]", "open_at": 0.0, "closed_at": 1.0}
    state = ingest_episode(with_topic(job, label, GripTopic(**beyond)))
    assert state.status == "quarantined"
    assert "/hand/left/joy" in state.reason
    assert "messages gave a usable reading" in state.reason
    optional = ingest_episode(with_topic(job, label, GripTopic(**beyond, required=False)))
    assert optional.status == "complete"
