"""Commands that look at what a store holds or give it away: view, export, catalog, definitions."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from demoplan.cli.main import app
from demoplan.errors import UnknownNameError, UsageError
from demoplan.stages.perceive.registry import DEFINITIONS

CHECKOUT = Path(__file__).resolve().parents[2]


def call(*words):
    return CliRunner().invoke(app, [str(word) for word in words], env={"COLUMNS": "200"})


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store with one shipped episode, as one dataset with a licence and as one without."""
    root = CHECKOUT / "datasets/cube-stacking"
    text = (root / "dataset.yaml").read_text().replace("../../schemas", f"{CHECKOUT}/schemas")
    head, _, rest = text.partition("\nepisodes:\n")
    first = rest.split("\n  - id: ")[0]
    folder = tmp_path_factory.mktemp("looking")
    for name, licence in (("licensed", "Apache-2.0"), ("unlicensed", "ask us")):
        (folder / name).mkdir()
        head_of = head.replace("name: cube-stacking", f"name: {name}", 1)
        head_of = head_of.replace("licence: Apache-2.0", f"licence: {licence}", 1)
        (folder / name / "dataset.yaml").write_text(f"{head_of}\nepisodes:\n{first}\n")
        ended = call("ingest", folder / name, "--root", root, "--store", folder / "store", "--workers", 1)
        assert ended.exit_code == 0, ended.output
    return folder / "store"


def test_a_dataset_is_exported_by_name_and_the_command_says_what_it_wrote(store, tmp_path):
    ended = call("export", "lerobot", "licensed", tmp_path / "out", "--fps", 20, "--store", store, "--json")
    assert ended.exit_code == 0, ended.output
    said = json.loads(ended.stdout)
    assert (said["n_episodes"], said["splits"], said["left_out"]) == (1, {"train": "0:1"}, [])
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert (info["fps"], info["total_frames"]) == (20, said["n_frames"])
    assert info["features"]["observation.state"]["shape"] == [16]
    assert "subtask_index" not in info["features"]
    assert "license: apache-2.0" in (tmp_path / "out/README.md").read_text()


def test_data_without_a_licence_is_refused_unless_asked_for_and_then_warned_of(store, tmp_path):
    ended = call("export", "lerobot", "unlicensed", tmp_path / "out", "--store", store)
    assert isinstance(ended.exception, UsageError)
    assert "names no licence" in str(ended.exception)
    assert "'ask us'" in str(ended.exception)
    assert not (tmp_path / "out").exists()
    ended = call("export", "lerobot", "unlicensed", tmp_path / "out", "--store", store, "--allow-unlicensed")
    assert ended.exit_code == 0, ended.output
    assert "do not pass it on" in ended.stderr
    assert "license: unknown" in (tmp_path / "out/README.md").read_text()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("export", "lerobot", "nobody", "out"), "unknown dataset 'nobody'.*licensed"),
        (
            ("export", "lerobot", "licensed", "out", "--fps", "1000"),
            "100 ticks per second; --fps 1000 is more",
        ),
        (("export", "lerobot", "licensed", "out", "--hold-out", "p9"), "unknown participant 'p9'.*p1"),
        (("export", "lerobot", "licensed", "out", "--activities", "guessed"), "available: inferred, true"),
        (("view", "licensed/p1-one-left", "-o", "x.rrd", "--layers", "row"), "unknown layer 'row'.*raw"),
        (("view", "licensed/p1-one-left", "-o", "x.rrd", "--layers", ","), "names none"),
        (("view", "nobody"), "unknown episode 'nobody'"),
    ],
)
def test_what_cannot_be_done_is_refused_with_what_can(store, words, said):
    ended = call(*words, "--store", store)
    assert isinstance(ended.exception, UsageError)
    with pytest.raises(UsageError, match=said):
        raise ended.exception


def test_an_episode_is_viewed_by_layers_and_found_in_a_catalog(store, tmp_path):
    pytest.importorskip("datafusion", reason="queries need the extra 'catalog'")
    path = tmp_path / "recordings" / "p1.rrd"
    ended = call("view", "licensed/p1-one-left", "-o", path, "--layers", "predicates", "--store", store)
    assert ended.exit_code == 0, ended.output
    found = call("catalog", tmp_path / "recordings", "--where", "success == true", "--json")
    assert found.exit_code == 0, found.output
    (row,) = json.loads(found.stdout)
    assert (row["id"], row["participant"], row["kind"]) == ("p1-one-left", "p1", "demonstration")
    assert json.loads(call("catalog", path.parent, "--where", "success == false", "--json").stdout) == []


def test_definitions_are_listed_without_a_store_and_with_every_number_that_they_want():
    ended = call("tables", "definitions", "--json", "--store", "/nowhere")
    assert ended.exit_code == 0, ended.output
    rows = {row["definition"]: row for row in json.loads(ended.stdout)["definitions"]}
    assert set(rows) == set(DEFINITIONS)
    assert rows["rests_on"]["numbers"] == ["enter_m", "exit_m", "footprint_margin_m"]
    assert all(row["meaning"] for row in rows.values())
    assert "rests_on" in call("tables", "definitions").stdout


def test_no_table_is_hidden_by_the_word_for_definitions(store):
    ended = call("tables", "definition", "--store", store)
    assert isinstance(ended.exception, UnknownNameError)
