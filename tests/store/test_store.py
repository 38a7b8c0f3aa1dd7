import json

import polars as pl
import pytest

from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import DomainId
from demoplan.store import DomainVersion, EpisodeState, Store
from demoplan.store.code_version import code_version
from demoplan.store.store import StageOutput
from demoplan.tables import Activities, Evidence, Literals, Operators


def activities(label="Reach"):
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


def test_equal_tables_are_stored_once_and_read_back_equal(tmp_path):
    store = Store(tmp_path)
    first = store.objects.put(activities(), Activities)
    second = store.objects.put(activities(), Activities)
    assert first == second
    assert store.get(first, Activities).equals(activities())
    assert len(list((store.root / "objects").rglob("*.parquet"))) == 1


def test_units_and_descriptions_stand_in_the_field_metadata(tmp_path):
    import pyarrow.parquet as pq

    store = Store(tmp_path)
    content = store.objects.put(activities(), Activities)
    field = pq.read_schema(store.objects.path_of(content)).field("start_ns")
    assert field.metadata[b"unit"] == b"ns"
    assert field.metadata[b"description"]


def test_a_table_of_a_newer_form_is_refused(tmp_path, monkeypatch):
    store = Store(tmp_path)
    monkeypatch.setattr("demoplan.store.objects.TABLE_FORMAT", "2")
    content = store.objects.put(activities(), Activities)
    monkeypatch.undo()
    with pytest.raises(StoreError, match="format 2"):
        store.get(content, Activities)


def test_many_tables_are_read_as_one_after_the_other_would_be(tmp_path, monkeypatch):
    store = Store(tmp_path)
    tables = [activities(label) for label in ("Reach", "Take", "Reach")]
    contents = [store.objects.put(table, Activities) for table in tables]
    whole = store.joined(contents, Activities)
    assert whole.equals(pl.concat(tables))
    assert store.joined([], Activities).equals(Activities.create_empty())
    at_once = store.objects._at_once(contents, Activities)
    assert at_once is not None
    assert at_once.equals(whole)

    wrong = activities("Put").with_columns(end_ns=pl.lit(-5, pl.Int64))
    bad = store.objects.put(wrong, Activities)
    assert store.objects._at_once([contents[0], bad], Activities) is None
    with pytest.raises(StoreError, match="is not what Activities"):
        store.joined([contents[0], bad], Activities)
    monkeypatch.setattr("demoplan.store.objects.TABLE_FORMAT", "2")
    newer = store.objects.put(activities("Newer"), Activities)
    monkeypatch.undo()
    with pytest.raises(StoreError, match="format 2"):
        store.joined([contents[0], newer], Activities)
    with pytest.raises(StoreError, match="not in the store"):
        store.joined([contents[0], "0" * 64], Activities)


def test_damaged_and_missing_tables_are_told_apart(tmp_path):
    store = Store(tmp_path)
    content = store.objects.put(activities(), Activities)
    assert store.objects.is_intact(content)
    path = store.objects.path_of(content)
    path.write_bytes(path.read_bytes()[:-20])
    assert not store.objects.is_intact(content)
    with pytest.raises(StoreError, match="not a readable table"):
        store.get(content, Activities)
    path.unlink()
    with pytest.raises(StoreError, match="not in the store"):
        store.get(content, Activities)


def test_a_stage_runs_once_for_the_same_input_parameters_and_code(tmp_path):
    store = Store(tmp_path)
    calls = []

    def run(**changes):
        arguments = {"inputs": {"a": "1"}, "params": "{}", "code_version": "c"} | changes

        def work():
            calls.append(changes)
            return StageOutput(tables={"activities": (activities(), Activities)})

        return store.run("segment", function=work, **arguments)

    assert run() == run()
    assert len(calls) == 1
    run(inputs={"a": "2"})
    run(params='{"x":1}')
    run(code_version="d")
    assert len(calls) == 4


def test_a_stage_runs_again_when_its_output_is_gone(tmp_path):
    store = Store(tmp_path)
    calls = []

    def work():
        calls.append(1)
        return StageOutput(tables={"activities": (activities(), Activities)})

    record = store.run("segment", {}, "{}", "c", work)
    store.objects.path_of(record.outputs["activities"]).unlink()
    store.run("segment", {}, "{}", "c", work)
    assert len(calls) == 2
    assert store.get(record.outputs["activities"], Activities).height == 1


def test_an_interrupted_stage_leaves_no_record_and_no_half_table(tmp_path):
    store = Store(tmp_path)

    def work():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        store.run("segment", {}, "{}", "c", work)
    assert not list(tmp_path.rglob("*.json"))
    assert not store.is_current("segment", {}, "{}", "c")


def test_updates_of_the_manifest_keep_what_others_wrote(tmp_path):
    store, other = Store(tmp_path), Store(tmp_path)
    store.manifest.update([EpisodeState(dataset="d", episode_id="a", tables={"facts": "1"})])
    other.manifest.update([EpisodeState(dataset="d", episode_id="b")])
    assert [state.episode_id for state in store.manifest.episodes("d")] == ["a", "b"]
    assert store.manifest.episode("d/a").tables == {"facts": "1"}
    with pytest.raises(UnknownNameError, match="d/a, d/b"):
        store.manifest.episode("c")


def test_an_episode_id_in_two_datasets_must_be_said_in_full(tmp_path):
    store = Store(tmp_path)
    store.manifest.update([EpisodeState(dataset=d, episode_id="a") for d in ("x", "y")])
    with pytest.raises(UnknownNameError, match="x/a, y/a"):
        store.manifest.episode("a")
    assert store.manifest.episode("y/a").dataset == "y"


def test_a_manifest_that_is_not_json_is_refused_and_kept(tmp_path):
    store = Store(tmp_path)
    (store.root / "manifest.json").write_text("{")
    with pytest.raises(StoreError, match="not a manifest"):
        store.manifest.update([EpisodeState(dataset="d", episode_id="a")])
    assert (store.root / "manifest.json").read_text() == "{"


def test_a_folder_that_cannot_be_written_is_said_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot"):
        Store(tmp_path / "file" / "store").manifest.update([EpisodeState(dataset="d", episode_id="a")])


def version(domain_id, **changes):
    fields = {
        "domain_id": DomainId(domain_id),
        "name": "stack",
        "parent": None,
        "dataset": "d",
        "episodes": ["a"],
        "snapshot": "s",
        "params": "{}",
        "code_version": "c",
        "n_operators": 0,
        "tables": {},
    }
    return DomainVersion(**(fields | changes))


def test_domain_versions_are_added_with_their_parent_and_never_overwritten(tmp_path):
    domains = Store(tmp_path).domains
    tables = (Operators.create_empty(), Literals.create_empty(), Evidence.create_empty())
    first = domains.put(version("aaaa1111"), "(define one)", *tables)
    second = domains.put(version("bbbb2222"), "(define two)", *tables)
    again = domains.put(version("aaaa1111", dataset="other"), "(define changed)", *tables)
    assert (first.parent, second.parent) == (None, "aaaa1111")
    assert again == first
    assert domains.text(first) == "(define one)"
    assert [v.domain_id for v in domains.versions()] == ["aaaa1111", "bbbb2222"]
    assert domains.find("stack").domain_id == "aaaa1111", "what its evidence gave last, not what is newest"
    assert domains.find("aaaa").domain_id == "aaaa1111"
    with pytest.raises(UnknownNameError, match="stack bbbb2222"):
        domains.find("cccc")
    assert domains.tables(first)[0].height == 0
    folder = tmp_path / "domains/stack/aaaa1111"
    assert sorted(path.name for path in folder.iterdir()) == [
        "domain.pddl",
        "evidence.parquet",
        "literals.parquet",
        "metadata.json",
        "operators.parquet",
    ]
    assert not [path for path in tmp_path.rglob("*") if path.name.startswith(".part-")]


def test_stored_files_can_be_read_by_others(tmp_path):
    store = Store(tmp_path)
    content = store.objects.put(activities(), Activities)
    assert oct(store.objects.path_of(content).stat().st_mode & 0o777) == "0o644"


def test_the_code_version_follows_what_code_does_and_what_it_imports():
    assert code_version("demoplan.store.store") != code_version("demoplan.store.atomic")
    assert code_version("demoplan.ids") == code_version("demoplan.ids")


def test_comments_and_docstrings_do_not_make_anything_stale(tmp_path, monkeypatch):
    from demoplan.store import code_version as module

    versions = []
    for body in ('"""One."""\nx = 1\n', '"""Two."""\n# why\nx  =  1\n', '"""One."""\nx = 2\n'):
        name = f"demoplan_probe_{len(versions)}"
        (tmp_path / f"{name}.py").write_text(body)
        monkeypatch.syspath_prepend(str(tmp_path))
        versions.append(module._module(name)[0])
    assert versions[0] == versions[1] != versions[2]


def test_records_are_readable_json(tmp_path):
    store = Store(tmp_path)
    record = store.run("s", {"i": "1"}, "{}", "c", lambda: StageOutput(tables={}, notes={"status": "ok"}))
    content = json.loads(store.place.read(store.records.name_of("s", record.key)))
    assert content["inputs"] == {"i": "1"}
    assert content["notes"] == {"status": "ok"}
