"""Many small files into few large ones, and everything still as it was."""

import os
import subprocess

import duckdb
import pandas as pd
import polars as pl
import pyarrow.parquet as pq
import pytest

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store import Store
from demoplan.store.compacting import compact
from demoplan.store.objects import ObjectStore
from demoplan.store.store import StageOutput
from demoplan.store.sweeping import sweep
from demoplan.store.verifying import repair, verify
from demoplan.tables import Activities, Facts

from .test_upkeep import activities, files, ingest, kinds, old

N = 12


def named(episode_id, label="Reach"):
    return activities(label).with_columns(episode_id=pl.lit(episode_id))


@pytest.fixture
def store(tmp_path):
    from demoplan.store import EpisodeState

    store = Store(tmp_path / "store")
    for index in reversed(range(N)):
        name = f"e{index:02}"
        record = store.run(
            "segment",
            {"log": name},
            "{}",
            "c",
            lambda name=name: StageOutput(
                tables={
                    "activities": (named(name), Activities),
                    "facts": (Facts.create_empty(), Facts),
                }
            ),
        )
        state = EpisodeState(
            dataset="d", episode_id=name, tables=record.outputs, keys={"segment": record.key}
        )
        store.manifest.update([state])
    store.snapshots.take(store.manifest.episodes(), "ingest d")
    return store


def content_of(store, episode_id):
    return ContentHash(store.manifest.episode(episode_id).tables["activities"])


def shards(store, table="activities"):
    return sorted((store.root / "shards" / table).glob("*.parquet"))


def assert_everything_is_there(store):
    assert verify(store) == []
    for state in store.manifest.episodes():
        assert store.get(state.tables["activities"], Activities).equals(named(state.episode_id))
        assert store.get(state.tables["facts"], Facts).height == 0
        assert store.records.get("segment", state.keys["segment"]).outputs == state.tables


def test_compacting_and_sweeping_leave_few_files_and_every_table_and_record(store):
    before = len(files(store))
    made = compact(store)
    assert {(each.table, each.n_parts) for each in made} == {("activities", N), ("facts", 1), ("records", N)}
    assert_everything_is_there(store)
    sweep(store)
    fresh = Store(store.root)
    assert not list((store.root / "objects").rglob("*.parquet"))
    assert not list((store.root / "records").rglob("*.json"))
    assert len(files(fresh)) < before - 2 * N + 3
    assert_everything_is_there(fresh)
    assert compact(fresh) == []
    assert sweep(fresh) == []


def test_what_is_in_a_shard_counts_as_done(store):
    compact(store)
    sweep(store)
    fresh = Store(store.root)
    record = fresh.run("segment", {"log": "e03"}, "{}", "c", lambda: pytest.fail("ran again"))
    assert fresh.index().find("segment", record.key) == record
    assert fresh.index().has(record.outputs["activities"])


def test_other_readers_see_one_sorted_table_and_skip_by_statistics(store):
    compact(store)
    (path,) = shards(store)
    expected = [f"e{index:02}" for index in range(N)]
    assert pl.read_parquet(path)["episode_id"].to_list() == expected
    assert pd.read_parquet(path)["episode_id"].tolist() == expected
    assert pq.read_table(path)["episode_id"].to_pylist() == expected
    found = duckdb.sql(f"SELECT episode_id, end_ns FROM '{path}' WHERE episode_id = 'e07'").fetchall()
    assert found == [("e07", 10)]
    file = pq.ParquetFile(path)
    assert file.num_row_groups == N
    statistics = [file.metadata.row_group(group).column(0).statistics for group in range(N)]
    assert [(each.min, each.max) for each in statistics] == [(name, name) for name in expected]
    assert file.schema_arrow.field("end_ns").metadata[b"unit"] == b"ns"


def test_one_episode_is_read_from_its_row_groups_alone(store, tmp_path):
    """Every other byte of the pages may be gone."""
    compact(store)
    sweep(store)
    content = content_of(store, "e07")
    spot = Store(store.root).shards.find(content)
    path = store.root / spot.shard
    groups = pq.read_metadata(path)
    data = bytearray(path.read_bytes())
    for group in range(groups.num_row_groups):
        if group != spot.first_row_group:
            for index in range(groups.num_columns):
                column = groups.row_group(group).column(index)
                start = min(filter(None, (column.dictionary_page_offset, column.data_page_offset)))
                data[start : start + column.total_compressed_size] = b"\xff" * column.total_compressed_size
    path.write_bytes(bytes(data))
    assert Store(store.root).get(content, Activities).equals(named("e07"))
    with pytest.raises(StoreError, match="store repair"):
        Store(store.root).get(content_of(store, "e08"), Activities)


def test_a_table_from_a_shard_would_be_stored_under_the_same_hash(store, tmp_path):
    compact(store)
    sweep(store)
    content = content_of(store, "e05")
    other = Store(tmp_path / "other")
    assert other.objects.put(Store(store.root).get(content, Activities), Activities) == content


def test_what_comes_later_joins_small_shards_and_full_ones_are_left_alone(store):
    size = sum(store.objects.path_of(content_of(store, f"e{n:02}")).stat().st_size for n in range(N))
    compact(store, shard_bytes=size // 3)
    first = shards(store)
    assert 3 <= len(first) <= 5
    sweep(store)
    ingest(store, "zz")
    compact(store, shard_bytes=size // 3)
    sweep(store)
    full = [path for path in first if path in shards(store)]
    assert len(full) >= 2, "full shards are not written again"
    fresh = Store(store.root)
    assert verify(fresh) == []
    assert fresh.get(content_of(fresh, "zz"), Activities).height == 1


def test_a_reader_who_knows_a_shard_that_was_joined_finds_the_new_one(store):
    compact(store)
    sweep(store)
    reader = Store(store.root)
    content = content_of(reader, "e01")
    reader.get(content, Activities)
    ingest(store, "zz")
    compact(store)
    sweep(store)
    assert reader.get(content, Activities).equals(named("e01"))


def test_shards_of_what_nobody_names_go_after_the_grace_period(store):
    compact(store)
    sweep(store)
    for state in store.manifest.episodes():
        ingest(store, state.episode_id, "2")
    for path in (store.root / "snapshots").glob("*.json"):
        path.unlink()
    (store.root / "snapshots/log.jsonl").unlink()
    for path in (store.root / "shards/records").iterdir():
        path.unlink()
    assert not [each for each in sweep(store) if each.kind == "shard"]
    for path in shards(store):
        old(path)
    assert [each.kind for each in sweep(store) if "shards/activities" in each.path] == ["shard"]
    assert not kinds(verify(Store(store.root)))


def test_superseded_records_leave_their_packs_when_the_history_is_cut(store):
    compact(store)
    sweep(store, grace_s=0.0)
    (pack,) = (store.root / "shards" / "records").glob("*.parquet")
    before = store.manifest.episode("e00")
    now = ingest(store, "e00", "2")
    store.snapshots.take(store.manifest.episodes(), "reprocess d")
    assert sweep(store, n_snapshots=1, grace_s=3600.0, is_dry_run=True) != []
    assert "pack" not in {each.kind for each in sweep(store, n_snapshots=1, grace_s=3600.0)}, "it is young"

    for path in store.root.rglob("*.*"):
        old(path)
    ingest(store, "e00", "3")
    store.snapshots.take(store.manifest.episodes(), "reprocess d again")
    dry = sweep(store, n_snapshots=1, grace_s=3600.0, is_dry_run=True)
    assert pack.exists()
    assert sweep(store, n_snapshots=1, grace_s=3600.0) == dry
    assert {each.kind for each in dry} >= {"pack", "record", "table", "snapshot"}
    assert not pack.exists()
    fresh = Store(store.root)
    assert fresh.records.get("segment", before.keys["segment"]) is None
    assert fresh.records.get("segment", now.keys["segment"]) is None
    assert verify(fresh) == []
    for state in fresh.manifest.episodes():
        record = fresh.records.get("segment", state.keys["segment"])
        assert record.outputs["activities"] == state.tables["activities"]
    held = fresh.packs.keys()
    assert len(held) == N - 1
    assert sweep(fresh, n_snapshots=1, grace_s=3600.0) == []


def test_a_damaged_small_file_does_not_get_into_a_shard(store):
    path = store.objects.path_of(content_of(store, "e04"))
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(StoreError, match="is damaged, and is not put into a shard"):
        compact(store)
    repair(store, verify(store))
    compact(store)
    assert set(kinds(verify(store))) == {"missing"}


def test_nothing_is_removed_for_a_shard_that_is_damaged_and_its_tables_are_made_again(store):
    compact(store)
    (path,) = shards(store)
    data = bytearray(path.read_bytes())
    data[20] ^= 1
    path.write_bytes(bytes(data))
    sweep(store)
    for state in store.manifest.episodes():
        assert store.objects.has_loose(ContentHash(state.tables["activities"]))
    assert kinds(verify(store)) == ["damaged"]
    repair(store, verify(store))
    assert_everything_is_there(Store(store.root))


@pytest.mark.parametrize("keep", [0, 10, -20])
def test_a_shard_that_cannot_be_opened_stops_nobody_and_its_tables_count_as_missing(store, keep):
    compact(store)
    sweep(store)
    (path,) = shards(store)
    path.write_bytes(path.read_bytes()[:keep] if keep else b"")
    fresh = Store(store.root)
    assert not fresh.objects.has(content_of(fresh, "e00"))
    assert {"damaged", "missing"} == set(kinds(verify(fresh)))
    with pytest.raises(StoreError, match="Nothing was removed"):
        sweep(fresh)
    repair(fresh, verify(fresh))
    sweep(fresh)


def test_a_damaged_pack_of_records_is_found_and_set_aside(store):
    compact(store)
    sweep(store)
    (path,) = (store.root / "shards/records").iterdir()
    path.write_bytes(path.read_bytes().replace(b"PAR1", b"PAR2"))
    fresh = Store(store.root)
    assert fresh.find("segment", {"log": "e00"}, "{}", "c") is None
    assert {"damaged", "missing"} == set(kinds(verify(fresh)))
    repair(fresh, verify(fresh))
    assert not path.exists()


def test_a_compaction_that_ends_early_loses_nothing_and_the_next_one_finishes(store, monkeypatch):
    settled = []
    real = type(store.place).settle

    def settle(place, draft, name):
        if len(settled) == 1:
            raise OSError(28, "No space left on device")
        settled.append(name)
        real(place, draft, name)

    monkeypatch.setattr(type(store.place), "settle", settle)
    with pytest.raises(StoreError, match="No space left on device"):
        compact(store)
    monkeypatch.undo()
    assert_everything_is_there(store)
    sweep(store)
    assert_everything_is_there(Store(store.root))
    compact(store)
    sweep(store)
    assert_everything_is_there(Store(store.root))


def test_shards_live_in_a_bucket_too(bucket_url):
    store = Store(bucket_url)
    states = [ingest(store, name) for name in "abc"]
    compact(store)
    sweep(store)
    assert not [n for n in store.place.names("") if n.startswith(("objects/", "records/"))]
    fresh = Store(bucket_url)
    assert verify(fresh) == []
    assert fresh.get(states[1].tables["activities"], Activities).equals(activities("b 1"))


def test_the_command_says_how_many_files_there_were_and_are(store):
    import sys

    for arguments, told in ((("compact",), "3 shards"), (("gc",), "files before")):
        done = subprocess.run(
            [sys.executable, "-m", "demoplan", "store", *arguments, "--store", str(store.root)],
            env={**os.environ, "COLUMNS": "200"},
            capture_output=True,
            text=True,
            check=True,
        )
        assert told in done.stdout + done.stderr
    assert_everything_is_there(Store(store.root))


def test_objects_without_shards_are_as_they_were(tmp_path):
    store = Store(tmp_path)
    assert isinstance(store.objects, ObjectStore)
    assert store.shards.contents() == {}
    assert compact(store) == []
