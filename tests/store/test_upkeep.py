"""History, verification, repair and sweeping of a store."""

import os
import shutil
import threading

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import StoreError, UnknownNameError, UsageError
from demoplan.store import EpisodeState, Store
from demoplan.store.snapshots import difference
from demoplan.store.store import SWEEP, StageOutput
from demoplan.store.sweeping import sweep
from demoplan.store.timings import Estimates
from demoplan.store.verifying import repair, verify
from demoplan.tables import Activities, Evidence, Literals, Operators

DAY_S = 24 * 3600.0


def activities(label):
    return pl.DataFrame(
        {
            "episode_id": ["e"],
            "hand": ["Right_hand"],
            "start_ns": [0],
            "end_ns": [10],
            "activity": [label],
            "acted_on": ["cube"],
            "in_hand": [None],
        },
        schema_overrides={"in_hand": pl.String},
    )


def ingest(store, episode_id, version="1", status="complete"):
    """One episode whose single table depends on ``version``."""
    record = store.run(
        "segment",
        {"log": f"{episode_id}@{version}"},
        "{}",
        "c",
        lambda: StageOutput(tables={"activities": (activities(f"{episode_id} {version}"), Activities)}),
    )
    state = EpisodeState(
        dataset="d",
        episode_id=episode_id,
        tables=record.outputs,
        keys={"segment": record.key},
        status=status,
    )
    store.manifest.update([state])
    return state


@pytest.fixture
def store(tmp_path):
    store = Store(tmp_path / "store")
    for name in ("a", "b"):
        ingest(store, name)
    store.snapshots.take(store.manifest.episodes(), "ingest d")
    return store


def old(path, days=2):
    os.utime(path, (path.stat().st_atime - days * DAY_S, path.stat().st_mtime - days * DAY_S))


def files(store):
    return sorted(
        p.relative_to(store.root).as_posix()
        for p in store.root.rglob("*")
        if p.is_file() and p.suffix != ".lock"
    )


def records(store):
    return sorted((store.root / "records").rglob("*.json"))


def kinds(faults):
    return [fault.kind for fault in faults]


# History


def test_equal_states_have_one_snapshot_whoever_made_them(store, tmp_path):
    other = Store(tmp_path / "other")
    for name in ("b", "a"):
        ingest(other, name)
    taken = other.snapshots.take(other.manifest.episodes(), "something else")
    assert taken == store.snapshots.log()[0].snapshot_id


def test_nothing_is_added_to_the_history_when_nothing_changed(store):
    before = files(store)
    store.snapshots.take(store.manifest.episodes(), "run d")
    assert files(store) == before
    assert [entry.cause for entry in store.snapshots.log()] == ["ingest d"]


def test_the_history_says_what_was_lost_and_goes_back_and_forth(store):
    first = store.snapshots.log()[0].snapshot_id
    ingest(store, "b", "2", status="truncated")
    second = store.snapshots.take(store.manifest.episodes(), "reprocess d")
    ingest(store, "b", "1")
    assert store.snapshots.take(store.manifest.episodes(), "back") == first
    assert [(e.snapshot_id, e.n_lost) for e in store.snapshots.log()] == [(first, 0), (second, 1), (first, 0)]
    (change,) = difference(store.snapshots.get(first), store.snapshots.get(second))
    assert (change.episode_id, change.kind, change.tables) == ("b", "changed", ("activities",))
    assert change.status == "complete → truncated"


def test_difference_tells_added_removed_and_unchanged_apart(store):
    states = store.manifest.episodes()
    c = ingest(store, "c")
    assert [(x.episode_id, x.kind) for x in difference(states, [states[0], c])] == [
        ("b", "removed"),
        ("c", "added"),
    ]
    assert difference(states, reversed(states)) == []


def test_a_snapshot_is_found_by_the_start_of_its_id_or_refused_with_what_there_is(store):
    (snapshot_id,) = store.snapshots.ids()
    assert store.snapshots.find(snapshot_id[:5]) == snapshot_id
    with pytest.raises(UnknownNameError, match=snapshot_id):
        store.snapshots.find("zzzz")


def test_snapshots_taken_at_once_are_all_in_the_history(store):
    def take(number):
        states = [EpisodeState(dataset="d", episode_id=f"e{number}")]
        Store(store.root).snapshots.take(states, f"writer {number}")

    threads = [threading.Thread(target=take, args=(n,)) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {e.cause for e in store.snapshots.log()} == {"ingest d", *(f"writer {n}" for n in range(8))}


# Verification and repair


def test_a_store_as_it_was_written_has_no_fault(store):
    assert verify(store) == []


@given(st.data())
@settings(max_examples=25, deadline=None)
def test_any_flipped_bit_in_any_file_that_matters_is_found(data):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        ingest(store, "a")
        store.snapshots.take(store.manifest.episodes(), "ingest d")
        matter = [p for p in files(store) if p.startswith(("objects/", "snapshots/")) and "log" not in p]
        path = store.root / data.draw(st.sampled_from(matter))
        content = bytearray(path.read_bytes())
        content[data.draw(st.integers(0, len(content) - 1))] ^= 1 << data.draw(st.integers(0, 7))
        path.write_bytes(bytes(content))
        assert [fault.path for fault in verify(store)] == [path.relative_to(store.root).as_posix()]


def test_a_record_that_was_edited_does_not_pass_for_what_its_name_says(store):
    path = records(store)[0]
    path.write_text(path.read_text().replace('"params": "{}"', '"params": "{1}"'))
    assert kinds(verify(store)) == ["damaged"]


def test_a_damaged_table_is_set_aside_and_made_again(store):
    state = store.manifest.episode("a")
    path = store.objects.path_of(state.tables["activities"])
    path.write_bytes(path.read_bytes()[:-7])
    (done,) = repair(store, verify(store))
    assert done.action == "set aside"
    assert (store.root / "damaged" / path.relative_to(store.root)).is_file(), "nothing is deleted"
    assert set(kinds(verify(store))) == {"missing"}
    ingest(store, "a")
    assert verify(store) == []


def test_a_table_that_is_damaged_twice_does_not_overwrite_what_was_set_aside(store):
    state = store.manifest.episode("a")
    path = store.objects.path_of(state.tables["activities"])
    for text in ("one", "two"):
        path.write_text(text)
        repair(store, verify(store))
        ingest(store, "a")
    kept = sorted((store.root / "damaged").rglob("*.parquet*"))
    assert [file.read_text() for file in kept] == ["one", "two"]


def test_an_unreadable_manifest_is_restored_from_the_last_snapshot(store):
    expected = store.manifest.episodes()
    (store.root / "manifest.json").write_text('{"format": 1, "datasets"')
    done = repair(store, verify(store))
    assert [each.action for each in done if each.path == "manifest.json"] == ["restored", "set aside"]
    assert store.manifest.episodes() == expected
    assert verify(store) == []


def test_a_manifest_without_a_readable_snapshot_is_set_aside_and_it_is_said(store):
    (store.root / "manifest.json").write_text("{")
    shutil.rmtree(store.root / "snapshots")
    done = repair(store, verify(store))
    assert any("demoplan run" in each.detail for each in done)


def test_what_a_killed_process_left_is_removed_when_it_is_old_and_kept_while_it_is_young(store):
    leftover = store.root / "objects" / ".part-abc.parquet"
    leftover.write_bytes(b"half")
    faults = verify(store)
    assert kinds(faults) == ["leftover"]
    assert faults[0].is_harmless
    assert [each.action for each in repair(store, faults)] == ["left"]
    old(leftover)
    assert [each.action for each in repair(store, faults)] == ["removed"]
    assert not leftover.exists()


def test_a_half_written_domain_is_a_leftover_and_a_changed_one_is_damaged(store):
    from demoplan.ids import DomainId, content_hash
    from demoplan.store import DomainVersion

    text = "(define (domain d))\n"
    version = DomainVersion(
        domain_id=DomainId(content_hash(text)[:16]),
        name="d",
        parent=None,
        dataset="d",
        episodes=["a"],
        snapshot="s",
        params="{}",
        code_version="c",
        n_operators=0,
        tables={},
    )
    store.domains.put(
        version, text, Operators.create_empty(), Literals.create_empty(), Evidence.create_empty()
    )
    assert verify(store) == []
    folder = store.root / "domains" / "d" / version.domain_id
    shutil.copytree(folder, folder.parent / ".part-xyz")
    assert kinds(verify(store)) == ["leftover"]
    (folder / "domain.pddl").write_text("(define (domain e))\n")
    assert sorted(kinds(verify(store))) == ["damaged", "leftover"]
    repair(store, verify(store))
    assert not folder.exists()
    assert (store.root / "damaged/domains/d" / version.domain_id / "domain.pddl").is_file()


# Sweeping


def test_nothing_that_is_named_is_swept_however_old_it_is(store):
    for path in store.root.rglob("*.*"):
        old(path, days=1000)
    before = files(store)
    assert sweep(store, grace_s=0.0) == []
    assert files(store) == before


def test_an_unnamed_table_goes_after_the_grace_period_and_a_dry_run_leaves_it(store):
    content = store.objects.put(activities("nobody's"), Activities)
    path = store.objects.path_of(content)
    assert sweep(store) == []
    old(path)
    (found,) = sweep(store, is_dry_run=True)
    assert path.exists()
    assert sweep(store) == [found]
    assert (found.kind, found.n_bytes > 0, path.exists()) == ("table", True, False)
    assert verify(store) == []


def test_a_clock_that_was_set_back_removes_nothing(store):
    path = store.objects.path_of(store.objects.put(activities("nobody's"), Activities))
    assert sweep(store, now_s=path.stat().st_mtime - 10 * DAY_S) == []
    assert path.exists()


def test_the_history_keeps_superseded_tables_until_it_is_cut(store):
    ingest(store, "b", "2")
    store.snapshots.take(store.manifest.episodes(), "reprocess d")
    for path in store.root.rglob("*.*"):
        old(path)
    assert sweep(store) == []
    swept = sweep(store, n_snapshots=1)
    assert sorted(each.kind for each in swept) == ["record", "snapshot", "states", "table"]
    assert [entry.cause for entry in store.snapshots.log()] == ["reprocess d"]
    assert verify(store) == []
    for state in store.manifest.episodes():
        assert store.get(state.tables["activities"], Activities).height == 1


def test_nothing_is_swept_when_what_names_tables_cannot_be_read(store):
    path = store.objects.path_of(store.objects.put(activities("nobody's"), Activities))
    old(path)
    record = records(store)[0]
    record.write_text("{")
    with pytest.raises(StoreError, match="Nothing was removed"):
        sweep(store)
    assert path.exists()


def test_sweeping_waits_for_a_writer(store):
    ended = threading.Event()

    def sweep_now():
        sweep(Store(store.root))
        ended.set()

    with store.place.guard(SWEEP, is_shared=True):
        thread = threading.Thread(target=sweep_now)
        thread.start()
        assert not ended.wait(0.3)
    thread.join()
    assert ended.is_set()


def test_a_history_cannot_be_cut_to_nothing(store):
    with pytest.raises(UsageError, match="1 or more"):
        sweep(store, n_snapshots=0)


# Times


def test_an_estimate_is_the_last_time_of_the_same_key_else_the_median(store):
    for key, wall_s in (("k1", 9.0), ("k1", 1.0), ("k2", 3.0), ("k3", 8.0)):
        store.timings.note("align", key, wall_s)
    with (store.root / "timings" / "align.jsonl").open("a") as file:
        file.write('{"key": "k9", "wal')
    estimates = Estimates(store.timings)
    assert estimates.of("align", "k1") == 1.0
    assert estimates.of("align", "unknown") == 3.0
    assert estimates.of("never") is None


def test_times_are_no_part_of_tables_or_records(store):
    assert len(store.timings.of("segment")) == 2
    assert not [p for p in records(store) if "wall_s" in p.read_text()]
