"""Many episodes at once are what each is alone; logs that change, workers that die, stores that are shared."""

import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.ids import ContentHash
from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.episodes import activities, episode_stages, ingest, seen, segmenters
from demoplan.pipeline.episodes.episode_tables import EpisodeTables
from demoplan.pipeline.episodes.segment_stages import CONTRAST
from demoplan.stages.contrast import contrast
from demoplan.store import Store
from demoplan.store.sweeping import sweep
from demoplan.store.verifying import verify
from demoplan.tables import Activities, Facts, Transitions


@pytest.fixture(scope="module")
def opened(small_dataset, tmp_path_factory):
    """Three episodes whose logs lie where a test may change them, and have lain there for a while."""
    folder, root = small_dataset
    copy = tmp_path_factory.mktemp("logs")
    shutil.copytree(root / "logs", copy / "logs", copy_function=shutil.copyfile)
    shutil.copytree(root / "labels", copy / "labels")
    found = open_dataset(folder, root=copy)
    episodes = tuple(each.model_copy(update={"sha256": None}) for each in found.dataset.episodes)
    return replace(found, dataset=found.dataset.model_copy(update={"episodes": episodes}))


def jobs_of(opened, store):
    return ingest.jobs_of(opened, store, opened.dataset.episodes)


def in_groups_of(n):
    """A crew that takes orders in groups of another size, as workers elsewhere would."""

    def crew(work, orders):
        flat = [order for group in orders for order in group]
        for start in range(0, len(flat), n):
            group = tuple(flat[start : start + n])
            yield group, work(group)

    return crew


@pytest.fixture(scope="module")
def one_by_one(opened, tmp_path_factory):
    """Every episode by itself, through all stages, in a store of its own."""
    states = []
    for number in range(len(opened.dataset.episodes)):
        store = Store(tmp_path_factory.mktemp("alone"))
        state = ingest.ingest_episode(jobs_of(opened, store)[number])
        chosen = {state.episode_id: segmenters.rules()}
        states += activities.segment_episodes(opened, store, [state], chosen)
    return states


@pytest.mark.parametrize("size", [1, 2, 3])
def test_episodes_in_groups_give_the_bytes_that_each_gives_alone(opened, one_by_one, tmp_path, size):
    store = Store(tmp_path)
    states = ingest.ingest(jobs_of(opened, store), crew=in_groups_of(size), on_done=lambda _: None)
    chosen = {state.episode_id: segmenters.rules() for state in states}
    assert activities.segment_episodes(opened, store, states, chosen) == one_by_one
    assert store.manifest.episodes() == one_by_one


@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_transitions_of_many_episodes_are_those_of_each(data, opened, one_by_one, tables_of_small):
    some = data.draw(st.lists(st.sampled_from(range(3)), min_size=1, max_size=6))
    parts = [
        tuple(table.with_columns(episode_id=pl.lit(f"e{place}")) for table in tables_of_small[number])
        for place, number in enumerate(some)
    ]
    entities = segmenters.entity_types(opened)
    joined = (pl.concat([part[k] for part in parts]) for k in range(2))
    together = contrast(*(s.cast(t) for s, t in zip((Activities, Facts), joined, strict=True)), entities)
    alone = [contrast(Activities.cast(a), Facts.cast(f), entities, CONTRAST) for a, f in parts]
    assert together.equals(Transitions.cast(pl.concat(alone)))


@pytest.fixture(scope="module")
def tables_of_small(opened, tmp_path_factory):
    """Activities and facts of the three episodes."""
    store = Store(tmp_path_factory.mktemp("tables"))
    states = ingest.ingest(jobs_of(opened, store), on_done=lambda _: None)
    chosen = {state.episode_id: segmenters.rules() for state in states}
    states = activities.segment_episodes(opened, store, states, chosen)
    return [
        (store.get(s.tables["activities"], Activities), store.get(s.tables["facts"], Facts)) for s in states
    ]


def test_parameters_are_the_same_text_as_if_rendered_whole(opened, tmp_path):
    job = jobs_of(opened, Store(tmp_path))[0]
    whole = {"mapping": job.mapping.model_dump(mode="json"), "episode_id": 'a"b\u00e9'}
    assert episode_stages._texts_of(job).read('a"b\u00e9') == episode_stages.canonical_json(whole)


def test_the_second_time_no_log_is_read_and_nothing_is_given_away(opened, tmp_path, monkeypatch):
    monkeypatch.setattr(seen, "SETTLED_NS", 0)
    store = Store(tmp_path)
    first = ingest.ingest(jobs_of(opened, store), on_done=lambda _: None)
    monkeypatch.setattr(episode_stages, "fingerprint", lambda _: pytest.fail("a log was read"))

    def nobody(work, orders):
        assert not orders
        return iter(())

    assert ingest.ingest(jobs_of(opened, store), crew=nobody, on_done=lambda _: None) == first


def test_what_was_written_just_now_is_looked_at_again_by_its_content(opened, tmp_path):
    store = Store(tmp_path)
    job = jobs_of(opened, store)[0]
    os.utime(job.log)
    ingest.ingest([job], on_done=lambda _: None)
    assert seen.SeenLogs(store).sha256_of(job.dataset, job.episode.id, job.log) is None


def test_a_file_that_is_replaced_with_its_times_set_back_is_noticed(tmp_path):
    log = tmp_path / "a.mcap"
    log.write_bytes(b"one")
    before, times = seen.signature_of(log), log.stat()
    log.write_bytes(b"two")
    os.utime(log, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert seen.signature_of(log) != before


@pytest.mark.parametrize("n_changes", [1, 2])
def test_a_log_that_changes_while_it_is_read_is_read_once_more_and_then_set_aside(
    opened, tmp_path, monkeypatch, n_changes
):
    store = Store(tmp_path / "store")
    job = jobs_of(opened, store)[0]
    log = tmp_path / "growing.mcap"
    shutil.copyfile(job.log, log)
    real, opens = episode_stages.open_log, []

    def open_and_touch(*args, **options):
        stream = real(*args, **options)
        if len(opens) < n_changes:
            with log.open("ab") as file:
                file.write(b"\0")
        opens.append(stream)
        return stream

    monkeypatch.setattr(episode_stages, "open_log", open_and_touch)
    (state,) = ingest.ingest([replace(job, log=log)], on_done=lambda _: None)
    assert len(opens) == 2
    if n_changes == 1:
        assert state.status != "quarantined"
        assert "facts" in state.tables
    else:
        assert state.status == "quarantined"
        assert "changed while it was read" in state.reason
        assert not set(state.tables) - {"episodes"}, "no table of half a log is kept"


def test_a_file_that_is_no_part_of_a_log_may_come_while_it_is_read(opened, tmp_path, monkeypatch):
    job = jobs_of(opened, Store(tmp_path / "store"))[1]
    assert job.log.is_dir()
    log = shutil.copytree(job.log, tmp_path / "bag")
    real = episode_stages.open_log

    def open_and_add(*args, **options):
        (log / "notes.txt").write_text("a person's notes")
        return real(*args, **options)

    monkeypatch.setattr(episode_stages, "open_log", open_and_add)
    assert ingest.ingest_episode(replace(job, log=log)).status == "complete"


def test_of_a_group_whose_worker_dies_only_the_one_that_kills_it_is_set_aside(opened, tmp_path):
    store = Store(tmp_path)
    jobs = jobs_of(opened, store)
    deadly = jobs[1].episode.model_dump_json()
    tried = []

    def crew(work, orders):
        groups = [tuple(o for group in orders for o in group)] if not tried else orders
        for group in groups:
            tried.append(len(group))
            yield group, None if any(o.episode == deadly for o in group) else work(group)

    states = ingest.ingest(jobs, crew=crew, on_done=lambda _: None)
    assert [state.status == "quarantined" for state in states] == [False, True, False]
    assert tried == [3, 1, 1, 1]


def test_two_flows_on_one_store_lose_nothing_of_each_other(opened, one_by_one, tmp_path):
    def whole(_):
        store = Store(tmp_path)
        states = ingest.ingest(jobs_of(opened, store), on_done=lambda _: None)
        return activities.segment_episodes(
            opened, store, states, {state.episode_id: segmenters.rules() for state in states}
        )

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(whole, range(2))) == [one_by_one, one_by_one]
    assert Store(tmp_path).manifest.episodes() == one_by_one


def test_what_was_done_is_in_the_manifest_even_if_the_rest_fails(opened, tmp_path):
    def crew(work, orders):
        for number, group in enumerate(orders):
            if number == 2:
                raise RuntimeError("the cluster is gone")
            yield group, work(group)

    store = Store(tmp_path)
    with pytest.raises(RuntimeError, match="the cluster is gone"):
        ingest.ingest(jobs_of(opened, store), crew=crew, on_done=lambda _: None)
    assert len(store.manifest.episodes()) == 2


def test_a_row_that_was_swept_before_the_manifest_named_it_is_there_again(opened, tmp_path):
    store = Store(tmp_path)
    done = ingest._ingested(jobs_of(opened, store)[0], store)
    with ingest.Ledger(store) as ledger:
        sweep(store, grace_s=0.0)
        assert not store.objects.has(ContentHash(done.state.tables["episodes"]))
        ledger.note(done.state, done.seen, done.row)
    assert [fault for fault in verify(store) if not fault.is_harmless] == []


def test_the_manifest_is_written_rarely_however_many_episodes_end(tmp_path):
    class Slow:
        n = 0

        def update(self, states):
            Slow.n += 1
            time.sleep(0.02)

    store = Store(tmp_path)
    store.manifest = Slow()
    with ingest.Ledger(store, least_s=0.0) as ledger:
        start = time.monotonic()
        while time.monotonic() - start < 0.5:
            ledger.note(None)
            time.sleep(0.001)
    assert 1 <= Slow.n <= 4


def test_a_long_log_is_ingested_part_by_part_with_the_same_tables(opened, one_by_one, tmp_path, monkeypatch):
    monkeypatch.setattr(EpisodeTables, "long_rows", 1000)
    store = Store(tmp_path)
    states = [ingest.ingest_episode(job) for job in jobs_of(opened, store)]
    for state, whole in zip(states, one_by_one, strict=True):
        assert state.status == whole.status
        assert state.keys.items() <= whole.keys.items()
        assert state.tables.items() <= whole.tables.items()
