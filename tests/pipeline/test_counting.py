"""Counts of many episodes are those of all at once, however they came together."""

import pickle
import random

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import DemoplanError
from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.domains import counting
from demoplan.pipeline.episodes import activities, episode_tables, ingest, segmenters
from demoplan.stages.learn import LearnParams, learn
from demoplan.stages.learn.counting import count, grip_votes, ranks, sight, support_votes
from demoplan.store import EpisodeState, Store
from demoplan.tables import Transitions


@pytest.fixture(scope="module")
def shown(small_dataset, tmp_path_factory):
    """A vocabulary, and transitions of demonstrations: whole ones, and ones that end early."""
    folder, root = small_dataset
    opened = open_dataset(folder, root=root)
    store = Store(tmp_path_factory.mktemp("shown"))
    jobs = ingest.jobs_of(opened, store, opened.dataset.episodes)
    states = ingest.ingest(jobs, on_done=lambda _: None)
    states = activities.segment_episodes(
        opened, store, states, {state.episode_id: segmenters.rules() for state in states}
    )
    whole = [store.get(state.tables["transitions"], Transitions) for state in states]
    cut = [rows.filter(pl.col("start_ns") < rows["start_ns"].quantile(0.6)) for rows in whole]
    return opened.vocabulary, [Transitions.cast(rows) for rows in [*whole, *cut]]


@pytest.fixture(autouse=True)
def small_buckets(monkeypatch):
    monkeypatch.setattr(counting, "IN_BUCKET", 2)
    monkeypatch.setattr(counting, "SAMPLE", 3)


def stored(store, shown, contents):
    """Episodes, each with one of the demonstrations as its own."""
    _, demonstrations = shown
    states = []
    for name, number in sorted(contents.items()):
        rows = demonstrations[number].with_columns(episode_id=pl.lit(name))
        content = store.objects.put(Transitions.cast(rows), Transitions)
        states.append(EpisodeState(dataset="d", episode_id=name, tables={"transitions": str(content)}))
    return states


def at_once(store, shown, states):
    vocabulary, _ = shown
    predicates = [rule.signature for rule in vocabulary.predicates]
    transitions = episode_tables.tables_of(store, states, "transitions", Transitions)
    return learn(transitions, vocabulary.types, predicates)


def same(one, other):
    return all(a.equals(b) for a, b in zip(one[:3], other[:3], strict=True))


contents = st.dictionaries(
    st.sampled_from([f"e{k}" for k in range(9)]),
    st.integers(min_value=0, max_value=5),
    min_size=1,
    max_size=7,
)


@settings(max_examples=4, deadline=None)
@given(courses=st.lists(contents, min_size=2, max_size=3))
def test_adding_changing_and_forgetting_episodes_gives_what_a_full_recount_gives(
    courses, shown, tmp_path_factory
):
    grown = Store(tmp_path_factory.mktemp("grown"))
    for course in courses:
        states = stored(grown, shown, course)
        now = counting.learn_many(grown, states, shown[0])
        fresh = Store(tmp_path_factory.mktemp("fresh"))
        again = counting.learn_many(fresh, stored(fresh, shown, course), shown[0])
        assert all(one.equals(other) for one, other in zip(now, again, strict=True))
        assert same(now, at_once(grown, shown, states))


@settings(max_examples=8, deadline=None)
@given(course=contents, seed=st.integers(0, 1000))
def test_counts_do_not_depend_on_how_episodes_are_parted(course, seed, shown, tmp_path_factory):
    store = Store(tmp_path_factory.mktemp("parted"))
    states = stored(store, shown, course)
    random.Random(seed).shuffle(states)
    some = seed % len(states)
    parts = [part for part in (states[:some], states[some:]) if part]
    vocabulary, _ = shown
    call = vocabulary.types, [rule.signature for rule in vocabulary.predicates]

    def counted(parts):
        tables = [episode_tables.tables_of(store, part, "transitions", Transitions) for part in parts]
        grip = ranks([grip_votes(table, *call) for table in tables])
        support = ranks([support_votes(table, *call, grip) for table in tables])
        return count(pl.concat([sight(table, *call, grip, support).sightings for table in tables]))

    assert counted(parts).equals(counted([[state] for state in states]))
    assert counted(parts)["n_transitions"].sum() == sum(
        store.get(state.tables["transitions"], Transitions).height for state in states
    )


def test_one_changed_episode_counts_one_bucket_anew(shown, tmp_path):
    store = Store(tmp_path)
    names = [f"e{k:02d}" for k in range(16)]
    states = stored(store, shown, dict.fromkeys(names, 0))
    counting.learn_many(store, states, shown[0])
    before = {stage: len(store.timings.of(stage)) for stage in ("gather", "sight")}
    assert before["gather"] == len(counting.buckets_of(states)) > 4
    states = stored(store, shown, dict.fromkeys(names, 0) | {"e07": 1})
    counting.learn_many(store, states, shown[0])
    assert {stage: len(store.timings.of(stage)) - n for stage, n in before.items()} == {
        "gather": 1,
        "sight": 1,
    }


def test_buckets_hold_every_episode_once_and_stay_as_they_are_until_there_are_many_more():
    states = [EpisodeState(dataset="d", episode_id=f"e{k}") for k in range(12)]
    buckets = counting.buckets_of(states)
    assert sorted(s.episode_id for bucket in buckets for s in bucket) == sorted(s.episode_id for s in states)
    more = counting.buckets_of([*states, EpisodeState(dataset="d", episode_id="another")])
    assert sum(bucket not in buckets for bucket in more) == 1


def test_where_readings_have_to_be_mended_all_transitions_are_learned_from_at_once(
    shown, tmp_path, monkeypatch
):
    store = Store(tmp_path)
    states = stored(store, shown, {"e0": 0, "e1": 1, "e2": 2})
    monkeypatch.setattr(counting, "needs_mending", lambda *_: True)
    monkeypatch.setattr(counting, "count_buckets", lambda *_: pytest.fail("counted apart"))
    assert same(counting.learn_many(store, states, shown[0], LearnParams()), at_once(store, shown, states))


def test_a_crew_counts_many_buckets_and_the_result_is_the_same(shown, tmp_path, monkeypatch):
    monkeypatch.setattr(counting, "MANY_BUCKETS", 3)
    monkeypatch.setattr(counting, "IN_ORDER", 2)
    contents = {f"e{k:02d}": k % 6 for k in range(16)}
    alone, helped = Store(tmp_path / "alone"), Store(tmp_path / "helped")
    expected = counting.learn_many(alone, stored(alone, shown, contents), shown[0])
    given = []

    def crew(work, orders):
        work, orders = pickle.loads(pickle.dumps((work, orders)))  # as it crosses
        for order in reversed(orders):
            given.append((work.stage, len(order)))
            yield order, work(order)

    found = counting.learn_many(helped, stored(helped, shown, contents), shown[0], crew=crew)
    assert all(one.equals(other) for one, other in zip(found, expected, strict=True))
    assert {stage for stage, _ in given} == {"gather", "support", "sight"}
    assert all(1 <= n <= 2 for _, n in given)
    given.clear()
    again = counting.learn_many(helped, stored(helped, shown, contents), shown[0], crew=crew)
    assert given == []
    assert all(one.equals(other) for one, other in zip(again, expected, strict=True))


def test_buckets_over_which_workers_die_are_named(shown, tmp_path, monkeypatch):
    monkeypatch.setattr(counting, "MANY_BUCKETS", 2)
    store = Store(tmp_path)
    states = stored(store, shown, {f"e{k:02d}": 0 for k in range(8)})
    with pytest.raises(DemoplanError, match=r"gather: every process that counted .* died"):
        counting.learn_many(store, states, shown[0], crew=lambda _, orders: ((o, None) for o in orders))
