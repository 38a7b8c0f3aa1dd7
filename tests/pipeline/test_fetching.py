"""Logs of a bucket come once, whole, and write over nothing."""

import hashlib

import pytest

from demoplan.errors import StoreError
from demoplan.pipeline.episodes.fetching import fetch_logs
from demoplan.store.folder import Folder
from demoplan.store.places import Entry

LATER = 4e9


@pytest.fixture
def bucket(tmp_path):
    """A place with two logs, a rosbag2 and something else."""
    place = Folder(tmp_path / "bucket")
    for name in ("a.mcap", "day/b.bag", "day/c/c_0.db3", "day/c/metadata.yaml", "notes.txt"):
        place.write(name, name.encode())
    return place


@pytest.fixture
def root(tmp_path):
    folder = tmp_path / "root"
    folder.mkdir()
    return folder


def test_logs_are_fetched_once_and_by_content(bucket, root):
    fetched = fetch_logs(bucket, root, now_s=LATER)
    names = ["a.mcap", "day/b.bag", "day/c/c_0.db3", "day/c/metadata.yaml"]
    assert [each.file for each in fetched] == names
    for each in fetched:
        content = (root / each.file).read_bytes()
        assert content == each.file.encode()
        assert each.sha256 == hashlib.sha256(content).hexdigest()
    assert not (root / "notes.txt").exists()
    assert not list(root.rglob(".part-*"))
    assert fetch_logs(bucket, root, now_s=LATER) == []


def test_what_was_fetched_is_an_arrival_at_once(bucket, root):
    fetch_logs(bucket, root, now_s=LATER)
    there, here = bucket.entry("a.mcap"), (root / "a.mcap").stat()
    assert here.st_mtime == pytest.approx(there.modified_s)


def test_a_log_that_is_arriving_is_left_with_all_its_parts(bucket, root):
    newest = bucket.entry("day/c/metadata.yaml").modified_s
    told = fetch_logs(bucket, root, quiet_s=30.0, now_s=newest + 1.0)
    assert {each.refusal for each in told} == {"is still arriving"}
    assert not list(root.rglob("*.*"))
    assert all(each.sha256 for each in fetch_logs(bucket, root, quiet_s=30.0, now_s=newest + 31.0))


def test_a_log_that_is_here_otherwise_is_told_and_stays(bucket, root):
    (root / "a.mcap").write_bytes(b"mine")
    told = {each.file: each for each in fetch_logs(bucket, root, now_s=LATER)}
    assert "logs are not replaced" in told["a.mcap"].refusal
    assert (root / "a.mcap").read_bytes() == b"mine"


class Lying(Folder):
    """Tells one length, and gives another."""

    def entries(self, folder):
        return [Entry(name=e.name, n_bytes=e.n_bytes + 1, modified_s=0.0) for e in super().entries(folder)]


class Leading(Folder):
    """Has a name that leads out of any folder."""

    def entries(self, folder):
        return [Entry(name="../../out.mcap", n_bytes=1, modified_s=0.0)]


def test_a_log_that_changes_while_it_is_fetched_is_not_kept(bucket, root):
    with pytest.raises(StoreError, match="changed meanwhile"):
        fetch_logs(Lying(bucket.root), root)
    assert not list(root.rglob("*.*"))


def test_a_name_that_leads_out_of_the_folder_is_refused(bucket, root):
    (told,) = fetch_logs(Leading(bucket.root), root)
    assert "leads out of" in told.refusal
    assert not (root.parent.parent / "out.mcap").exists()
