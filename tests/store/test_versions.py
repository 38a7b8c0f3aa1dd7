"""What was written by other versions: older is migrated, newer is refused, and says so."""

import json

import polars as pl
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import StoreError
from demoplan.store import EpisodeState, Store
from demoplan.store.places import NewerError
from demoplan.tables import Activities, Runs
from demoplan.tables.migrating import MIGRATIONS, migrated, version_of

from .test_upkeep import activities, ingest


def rewritten(store, content, change, **metadata):
    """Put a changed copy of a table under the same name, as another version might have written it."""
    path = store.objects.path_of(content)
    table = pq.read_table(path)
    noted = {k: v for k, v in table.schema.metadata.items() if k != b"demoplan.table_version"}
    noted |= {f"demoplan.{k}".encode(): v.encode() for k, v in metadata.items()}
    pq.write_table(change(table).replace_schema_metadata(noted), path)


def run_row():
    values = {
        "run_id": "r", "domain_id": "d", "domain_name": "n", "goal": "g", "robot": "gripper",
        "monitor": "full", "seed": 1, "is_fault_injected": False, "is_goal_reached": True,
        "is_goal_sensed": True, "outcome": "reached", "simulated_s": 1.0,
    }  # fmt: skip
    schema = Runs.create_empty().schema
    for name in schema:
        if name.startswith("n_"):
            values.setdefault(name, 0)
        values.setdefault(name, None)
    return Runs.validate(pl.DataFrame([values], schema=schema), cast=True)


def test_runs_that_were_stored_before_the_time_of_a_fault_was_known_are_read_without_it(tmp_path):
    store = Store(tmp_path)
    content = store.objects.put(run_row(), Runs)
    rewritten(store, content, lambda table: table.drop_columns(["fault_ns"]))
    assert store.get(content, Runs).equals(run_row())
    assert store.get(content, Runs)["fault_ns"].to_list() == [None]


def test_tables_of_several_versions_are_read_together(tmp_path):
    store = Store(tmp_path)
    now = run_row()
    before = store.objects.put(now.with_columns(run_id=pl.lit("before")), Runs)
    rewritten(store, before, lambda table: table.drop_columns(["fault_ns"]))
    contents = [before, store.objects.put(now, Runs)]
    assert store.joined(contents, Runs)["run_id"].to_list() == ["before", "r"]


def test_a_table_says_its_version_once_it_has_more_than_one(tmp_path):
    store = Store(tmp_path)
    runs = pq.read_schema(store.objects.path_of(store.objects.put(run_row(), Runs)))
    assert runs.metadata[b"demoplan.table_version"] == b"2"
    first = pq.read_schema(store.objects.path_of(store.objects.put(activities("x"), Activities)))
    assert b"demoplan.table_version" not in first.metadata


@pytest.mark.parametrize(
    ("metadata", "told"),
    [
        ({"table_version": "2"}, r"Activities version 2; this version of demoplan reads 1 to 1"),
        ({"table_version": "0"}, "Activities version 0"),
        ({"table_version": "x"}, "Activities version x"),
        ({"table_format": "2"}, r"table format 2; this version of demoplan reads 1"),
    ],
)
def test_tables_of_unknown_versions_are_refused_with_what_is_known(tmp_path, metadata, told):
    store = Store(tmp_path)
    content = store.objects.put(activities("x"), Activities)
    rewritten(store, content, lambda table: table, **metadata)
    with pytest.raises(NewerError, match=told):
        store.get(content, Activities)


def test_a_table_that_lacks_what_its_version_declares_is_refused_and_not_filled(tmp_path):
    store = Store(tmp_path)
    content = store.objects.put(activities("x"), Activities)
    rewritten(store, content, lambda table: table.drop_columns(["end_ns"]))
    with pytest.raises(StoreError, match="is not what Activities version 1 declares"):
        store.get(content, Activities)


def test_a_newer_shard_a_newer_manifest_and_a_newer_snapshot_are_refused_and_left_alone(tmp_path):
    from demoplan.store.compacting import compact

    store = Store(tmp_path)
    state = ingest(store, "a")
    snapshot = store.snapshots.take([state], "ingest")
    compact(store)
    (shard,) = (tmp_path / "shards/activities").iterdir()
    table, contents = pq.read_table(shard), pq.read_metadata(shard).metadata[b"demoplan.contents"]
    noted = {b"demoplan.shard_format": b"9", b"demoplan.contents": contents}
    pq.write_table(table.replace_schema_metadata(noted), shard)
    with pytest.raises(NewerError, match="shard format 9"):
        Store(tmp_path).objects.contents()
    for name, content in (
        ("manifest.json", {"format": 9}),
        (f"snapshots/{snapshot}.json", {"format": 9, "lists": {}}),
    ):
        (tmp_path / name).write_text(json.dumps(content))
        before = (tmp_path / name).read_bytes()
        with pytest.raises(StoreError, match=r"format 9|not what its name says"):
            store.manifest.update([state]) if name == "manifest.json" else store.snapshots.get(snapshot)
        assert (tmp_path / name).read_bytes() == before


def test_a_manifest_of_format_1_is_read_and_becomes_format_2_with_the_first_update(tmp_path):
    store = Store(tmp_path)
    states = {f"e{n}": EpisodeState(dataset="d", episode_id=f"e{n}", tables={"t": "c"}) for n in range(3)}
    old = {"format": 1, "datasets": {"d": {name: vars(state) for name, state in states.items()}}}
    (tmp_path / "manifest.json").write_text(json.dumps(old))
    assert store.manifest.episodes() == list(states.values())
    new = EpisodeState(dataset="d", episode_id="e1", status="truncated")
    store.manifest.update([new])
    assert json.loads((tmp_path / "manifest.json").read_text())["format"] == 2
    assert store.manifest.episodes() == [states["e0"], new, states["e2"]]


def test_a_snapshot_of_format_1_is_still_read(tmp_path):
    from demoplan.ids import content_hash

    store = Store(tmp_path)
    state = EpisodeState(dataset="d", episode_id="e", tables={"t": "c"})
    body = json.dumps({"format": 1, "episodes": [vars(state)]}, sort_keys=True, indent=1) + "\n"
    name = content_hash(body)[:16]
    (tmp_path / "snapshots").mkdir()
    (tmp_path / f"snapshots/{name}.json").write_text(body)
    assert store.snapshots.get(name) == [state]


TOY = {
    "Toy": (
        lambda table: table.rename({"width_mm": "width_m"}).with_columns(pl.col("width_m") / 1000.0),
        lambda table: table.with_columns(is_wide=pl.col("width_m") > 0.05),
        lambda table: table.drop("note"),
    )
}


@settings(deadline=None)
@given(widths=st.lists(st.integers(0, 1000), max_size=20), stop=st.integers(1, 4))
def test_migrating_step_by_step_or_at_once_is_the_same_and_changes_nothing_given(widths, stop):
    first = pl.DataFrame(
        {"width_mm": widths, "note": ["n"] * len(widths)}, schema_overrides={"width_mm": pl.Int64}
    )
    kept = first.clone()
    at_once = migrated(first, "Toy", 1, TOY)
    midway = first
    for step in TOY["Toy"][: stop - 1]:
        midway = step(midway)
    assert migrated(midway, "Toy", stop, TOY).equals(at_once)
    assert at_once.columns == ["width_m", "is_wide"]
    assert at_once.height == len(widths)
    assert first.equals(kept)


def test_there_is_no_version_0_and_none_after_the_last():
    for version in (0, 5):
        with pytest.raises(ValueError, match="known: 1 to 4"):
            migrated(pl.DataFrame(), "Toy", version, TOY)


def test_every_migration_leads_to_a_declared_table():
    from demoplan import tables

    assert set(MIGRATIONS) <= set(tables.__all__)
    assert version_of("Runs") == 2
