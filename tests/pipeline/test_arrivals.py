import os
import shutil
from pathlib import Path

import pytest

from demoplan.errors import UsageError
from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.episodes.arrivals import Arrival, ArrivalParams, enrol, find_arrivals

CHECKOUT = Path(__file__).resolve().parents[2]
LATER_S = 3600.0


@pytest.fixture
def folder(tmp_path):
    source = CHECKOUT / "datasets/cube-stacking"
    head = (source / "dataset.yaml").read_text().partition("\nepisodes:\n")[0]
    head = head.replace("../../schemas", f"{CHECKOUT}/schemas")
    entry = "  - {id: p1-one-left, file: logs/p1-one-left.mcap, participant: p1, task: one}  # the first\n"
    (tmp_path / "dataset.yaml").write_text(f"# kept\n{head}\nepisodes:\n{entry}")
    (tmp_path / "logs").mkdir()
    shutil.copy(source / "logs/p1-one-left.mcap", tmp_path / "logs")
    return tmp_path


def arrive(folder, name):
    path = folder / "logs" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"a log")
    return path


def find(folder, **params):
    path = folder / "logs/p1-one-left.mcap"
    return find_arrivals(open_dataset(folder), ArrivalParams(**params), now_s=path.stat().st_mtime + LATER_S)


def test_a_log_that_the_manifest_names_has_not_arrived(folder):
    assert find(folder) == []


def test_a_new_log_becomes_an_episode_named_after_it_and_the_file_keeps_its_comments(folder):
    arrive(folder, "p7-two-right.bag")
    (arrival,) = find(folder)
    assert arrival == Arrival("logs/p7-two-right.bag", "p7-two-right", "p7", "two-right")
    assert enrol(folder, [arrival]) == 1
    episode = open_dataset(folder).episode("p7-two-right")
    assert (episode.file, episode.participant, episode.task) == ("logs/p7-two-right.bag", "p7", "two-right")
    text = (folder / "dataset.yaml").read_text()
    assert text.startswith("# kept\n")
    assert "# the first" in text
    assert find(folder) == []
    assert enrol(folder, [arrival]) == 0, "a second time adds nothing"


def test_a_rosbag2_with_parts_is_one_log(folder):
    for name in ("metadata.yaml", "part_0.db3", "part_1.db3"):
        arrive(folder, f"p2-stack/{name}")
    assert [a.file for a in find(folder)] == ["logs/p2-stack"]


def test_a_log_that_is_being_written_is_left_alone_until_it_is_quiet(folder):
    path = arrive(folder, "p2-stack.mcap")
    now_s = (folder / "logs/p1-one-left.mcap").stat().st_mtime + LATER_S
    os.utime(path, (now_s - 5, now_s - 5))
    assert "less than 30 s ago" in find(folder)[0].refusal
    assert find(folder, quiet_s=4.0)[0].refusal == ""


@pytest.mark.parametrize(
    ("name", "words"), [("calibration.mcap", "does not fit"), ("p1-one-left.bag", "there already")]
)
def test_what_cannot_be_taken_is_told_and_not_written(folder, name, words):
    arrive(folder, name)
    before = (folder / "dataset.yaml").read_bytes()
    (arrival,) = find(folder)
    assert words in arrival.refusal
    assert enrol(folder, [arrival]) == 0
    assert (folder / "dataset.yaml").read_bytes() == before


@pytest.mark.parametrize(
    ("pattern", "words"), [("(", "not a regular expression"), ("(?P<task>.*)", "no group named participant")]
)
def test_a_pattern_that_cannot_be_used_is_refused(folder, pattern, words):
    with pytest.raises(UsageError, match=words):
        find(folder, pattern=pattern)
