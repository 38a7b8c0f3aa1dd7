"""A folder of recordings is served and queried, through rerun's own client as well, and nothing stays behind."""

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from demoplan.errors import DemoplanError, UsageError
from demoplan.viewers.catalog import matching, served
from demoplan.viewers.episode import save_episode
from demoplan.viewers.rerun_adapter import PROPERTIES
from demoplan.viewers.sources import EpisodeTables

CHECKOUT = Path(__file__).resolve().parents[2]

pytest.importorskip("datafusion", reason="queries need the extra 'catalog'")


def write(path, name, **properties):
    path.parent.mkdir(parents=True, exist_ok=True)
    with rr.RecordingStream("demoplan", recording_id=name, send_properties=False) as recording:
        recording.save(str(path))
        recording.send_property(PROPERTIES, rr.AnyValues(id=name, **properties))
        recording.log("note", rr.TextLog("here"))
        recording.flush()
        recording.disconnect()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("catalog") / "recordings"
    write(root / "cubes" / "a.rrd", "a", success=True, participant="p1", duration_s=12.5)
    write(root / "cubes" / "b.rrd", "b", success=False, participant="p2", duration_s=8.0)
    write(root / "cubes" / "c.rrd", "c", participant="p3")
    write(root / "runs" / "d.rrd", "d", success=False, robot="gripper", fault="slip")
    return root


@pytest.mark.parametrize(
    ("where", "expected"),
    [
        ("success = false", ["b", "d"]),
        ("success == false", ["b", "d"]),
        ("success IS NULL", ["c"]),
        ("success = false AND robot = 'gripper'", ["d"]),
        ("duration_s > 10", ["a"]),
        ("folder = 'cubes'", ["a", "b", "c"]),
        ("participant = 'p9'", []),
    ],
)
def test_recordings_are_found_by_their_properties(folder, where, expected):
    with served(folder) as catalogue:
        assert catalogue.n_recordings == {"cubes": 3, "runs": 1}
        rows = matching(catalogue, where)
    assert rows["id"].to_list() == expected
    for url in rows["url"]:
        assert url.startswith(catalogue.url)


def test_a_condition_that_is_none_is_refused_with_the_columns_that_there_are(folder):
    with served(folder) as catalogue, pytest.raises(UsageError, match=r"columns: .*participant.*success"):
        matching(catalogue, "sucess = false")


def test_a_dataset_opens_with_the_layout_of_its_largest_recording(folder, tmp_path, frames):
    episode = EpisodeTables(episode_id=str(frames["episode_id"][0]), frames=frames, entities=())
    save_episode(tmp_path / "with" / "large.rrd", episode)
    write(tmp_path / "with" / "small.rrd", "small", success=True)
    (layout,) = RrdReader(tmp_path / "with" / "large.rrd").blueprints()
    with served(tmp_path) as catalogue:
        dataset = catalogue.server.client().get_dataset("with")
        assert dataset.default_blueprint() == layout.recording_id
        assert len(dataset.segment_ids()) == 2
    with served(folder) as catalogue:
        assert catalogue.server.client().get_dataset("runs").default_blueprint() is None


def test_recordings_that_come_or_change_are_taken_up_and_half_written_ones_wait(tmp_path):
    write(tmp_path / "cubes" / "a.rrd", "a", success=True)
    with served(tmp_path) as catalogue:
        assert catalogue.take_up() == []
        write(tmp_path / "cubes" / "b.rrd", "b", success=False)
        write(tmp_path / "runs" / "c.rrd", "c", success=False)
        whole = (tmp_path / "runs" / "c.rrd").read_bytes()
        (tmp_path / "runs" / "d.rrd").write_bytes(b"not a recording")
        assert catalogue.take_up() == [tmp_path / "cubes" / "b.rrd", tmp_path / "runs" / "c.rrd"]
        assert catalogue.n_recordings == {"cubes": 2, "runs": 1}
        assert matching(catalogue, "success = false")["id"].to_list() == ["b", "c"]

        write(tmp_path / "cubes" / "b.rrd", "b", success=True, participant="p1")
        (tmp_path / "runs" / "d.rrd").unlink()
        assert catalogue.take_up() == [tmp_path / "cubes" / "b.rrd"]
        assert matching(catalogue, "success = false")["id"].to_list() == ["c"]
        assert matching(catalogue, "participant = 'p1'")["id"].to_list() == ["b"]
        assert (tmp_path / "runs" / "c.rrd").read_bytes() == whole


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no recordings"), served(tmp_path):
        pass
    with pytest.raises(UsageError, match="no such folder"), served(tmp_path / "none"):
        pass


def test_a_port_that_is_taken_is_said_to_be(folder):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with (
            pytest.raises(DemoplanError, match="does not serve"),
            served(folder, port=taken.getsockname()[1]),
        ):
            pass


def test_the_command_serves_until_it_is_asked_to_end_and_reruns_client_can_query_it(folder):
    child = subprocess.Popen(
        [sys.executable, "-m", "demoplan", "catalog", str(folder), "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={"PATH": os.environ["PATH"], "PYTHONPATH": str(CHECKOUT / "src"), "HOME": "/nonexistent"},
    )
    try:
        text = ""
        while True:
            text += child.stdout.readline()
            try:
                said = json.loads(text)
                break
            except ValueError:
                assert child.poll() is None, text
        assert said["url"].startswith("rerun+http://127.0.0.1:")
        assert [(d["name"], d["n_recordings"]) for d in said["datasets"]] == [("cubes", 3), ("runs", 1)]
        from datafusion import col, lit

        # Queries need the client for as long as they run.
        client = rr.catalog.CatalogClient(said["url"])
        segments = client.get_dataset("cubes").segment_table()
        failed = segments.filter(col(f'"property:{PROPERTIES}:success"')[0] == lit(False))
        assert failed.select(col('"rerun_segment_id"')).to_pydict() == {"rerun_segment_id": ["b"]}
    finally:
        child.send_signal(signal.SIGINT)
        child.stdout.close()
        assert child.wait(timeout=30) == 0
