"""Stores in a bucket, against a real S3 server process that can be told to misbehave."""

import os
import subprocess
import sys
import threading
import time

import pyarrow.parquet as pq
import pytest

from demoplan.errors import StoreError, UsageError
from demoplan.store import DomainVersion, EpisodeState, Store
from demoplan.store.places import AbsentError
from demoplan.store.sweeping import sweep
from demoplan.store.verifying import repair, verify
from demoplan.tables import Activities, Evidence, Literals, Operators

from .test_upkeep import activities, ingest


@pytest.fixture
def store(bucket_url):
    return Store(bucket_url)


def impatient(url, **changed):
    from demoplan.store.bucket import Bucket, BucketParams

    chosen = {"n_retries": 3, "first_pause_s": 0.01, "longest_pause_s": 0.05, "request_timeout_s": 0.3}
    return Bucket(url, BucketParams(**(chosen | changed)))


def test_a_bucket_and_a_folder_hold_the_same_bytes_under_the_same_names(store, tmp_path):
    here = Store(tmp_path)
    for each in (store, here):
        ingest(each, "a")
        ingest(each, "b")
        each.snapshots.take(each.manifest.episodes(), "ingest d")
    names = [name for name in here.place.names("") if not name.startswith(("timings/", "snapshots/log"))]
    assert [n for n in store.place.names("") if not n.startswith(("timings/", "snapshots/log"))] == names
    assert all(store.place.read(name) == here.place.read(name) for name in names)
    assert store.manifest.episodes() == here.manifest.episodes()
    assert len(store.timings.of("segment")) == 2
    assert verify(store) == []


def test_what_was_stored_by_one_is_found_by_another_and_read_back(store):
    state = ingest(store, "a")
    other = Store(store.location)
    assert other.manifest.episodes() == [state]
    assert other.get(state.tables["activities"], Activities).equals(activities("a 1"))
    assert other.index().find("segment", state.keys["segment"]).outputs == state.tables
    second = ingest(store, "b")
    contents = [each.tables["activities"] for each in (second, state)]
    assert other.joined(contents, Activities)["activity"].to_list() == ["b 1", "a 1"]
    with pytest.raises(AbsentError, match="is not in the store s3://"):
        other.get("0" * 64, Activities)


def test_a_table_in_a_bucket_is_read_in_parts_by_anything_that_reads_parquet(store):
    state = ingest(store, "a")
    with store.place.open(store.objects.name_of(state.tables["activities"])) as file:
        assert pq.ParquetFile(file).read().num_rows == 1


def test_writers_who_cannot_lock_keep_each_others_work(store):
    def write(number):
        mine = Store(store.location)
        for part in range(3):
            mine.manifest.update([EpisodeState(dataset="d", episode_id=f"{number}-{part}")])
            mine.snapshots.take(mine.manifest.episodes(), f"{number}-{part}")

    threads = [threading.Thread(target=write, args=(number,)) for number in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(store.manifest.episodes()) == 15
    assert verify(store) == []


def test_domain_versions_live_in_a_bucket(store):
    tables = (Operators.create_empty(), Literals.create_empty(), Evidence.create_empty())
    fields = {"parent": None, "dataset": "d", "episodes": ["a"], "params": "{}", "code_version": "c"}
    text = "(define (domain d))\n"
    from demoplan.ids import content_hash

    version = DomainVersion(
        domain_id=content_hash(text)[:16], name="d", snapshot="s", n_operators=0, tables={}, **fields
    )
    store.domains.put(version, text, *tables)
    assert store.domains.find("d").domain_id == version.domain_id
    assert store.domains.text(store.domains.latest("d")) == text
    assert verify(store) == []


def test_a_damaged_object_is_found_set_aside_and_made_again(store):
    state = ingest(store, "a")
    name = store.objects.name_of(state.tables["activities"])
    store.place.write(name, b"PAR1 not at all")
    assert [fault.kind for fault in verify(store)] == ["damaged"]
    (done,) = repair(store, verify(store))
    assert done.action == "set aside"
    assert store.place.read(f"damaged/{name}") == b"PAR1 not at all"
    assert {fault.kind for fault in verify(store)} == {"missing"}
    ingest(store, "a")
    assert verify(store) == []


def test_sweeping_a_bucket_needs_time_since_it_cannot_hold_writers_off(store):
    ingest(store, "a")
    content = store.objects.put(activities("nobody's"), Activities)
    with pytest.raises(UsageError, match="cannot hold writers off"):
        sweep(store, grace_s=60.0)
    assert sweep(store) == []
    (gone,) = sweep(store, now_s=time.time() + 2 * 86400)
    assert content in gone.path
    assert verify(store) == []


@pytest.mark.parametrize("kind", ["500", "500-after"])
def test_requests_that_fail_for_a_while_are_sent_again_and_nothing_is_done_twice(s3, bucket_url, kind):
    place = impatient(bucket_url)
    for method, act in (
        ("PUT", lambda: place.write("a", b"1")),
        ("GET", lambda: place.read("a")),
        ("PUT", lambda: place.create("b", b"2")),
        ("PUT", lambda: place.update("c", lambda found: found or b"once")),
    ):
        s3.break_down(n=2, method=method, kind=kind)
        act()
        assert s3.n_requests() >= 3
    s3.break_down(n=0)
    assert [place.read(name) for name in "abc"] == [b"1", b"2", b"once"]


def test_a_server_that_answers_slowly_is_asked_again_also_for_conditional_writes(s3, bucket_url):
    place = impatient(bucket_url)
    s3.break_down(n=2, method="PUT", kind="slow", delay_s=0.6)
    place.update("a", lambda found: found or b"once")
    assert place.read("a") == b"once"


@pytest.mark.parametrize(("kind", "method"), [("500", "GET"), ("500", "PUT"), ("slow", "PUT")])
def test_a_server_that_stays_broken_ends_in_one_clear_error_after_few_requests(s3, bucket_url, kind, method):
    place = impatient(bucket_url)
    s3.break_down(n=1000, method=method, kind=kind, delay_s=0.4)
    start = time.monotonic()
    with pytest.raises(StoreError, match=r"s3://lab-.*a: no use after 3 retries") as raised:
        place.read("a") if method == "GET" else place.create("a", b"1")
    assert time.monotonic() - start < 10
    assert s3.n_requests() <= 5
    assert os.environ["AWS_SECRET_ACCESS_KEY"] not in str(raised.value)


def test_a_bucket_that_is_not_there_is_said_to_be_missing(s3):
    with pytest.raises(StoreError, match="there is no such bucket"):
        impatient("s3://nobody-has-made-this").write("a", b"")


@pytest.mark.parametrize("url", ["s3://id:secret@lab/x", "s3:///x", "s3://lab/x?secret=1"])
def test_a_url_with_credentials_is_refused_without_repeating_them(url):
    pytest.importorskip("obstore", reason="the extra s3 is not installed")
    with pytest.raises(StoreError, match="expected s3://BUCKET/PREFIX") as raised:
        Store(url)
    assert "secret" not in str(raised.value)


def test_a_url_of_another_kind_is_refused_with_what_is_known():
    with pytest.raises(StoreError, match=r"unknown kind of store; known: a folder, s3://"):
        Store("gs://lab/x")


def command(*arguments, fails=False):
    done = subprocess.run(
        [sys.executable, "-m", "demoplan", *arguments],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        check=False,
        text=True,
    )
    assert os.environ["AWS_SECRET_ACCESS_KEY"] not in done.stdout + done.stderr
    assert (done.returncode != 0) == fails, done.stderr
    return done


@pytest.mark.slow
def test_every_command_that_takes_a_store_takes_a_url(small_dataset, bucket_url, tmp_path):
    at = ("--store", bucket_url)
    folder, root = small_dataset
    command("run", str(folder), "--root", str(root), *at, "--workers", "1")
    assert "0 stage runs are stale" in command("reprocess", *at).stdout
    assert '"p1-one-left"' in command("tables", *at, "--json").stdout
    assert "Reach" in command("tables", "activities", "-e", "p1-one-left", *at, "--json").stdout
    command("view", "p1-one-left", *at, "-o", str(tmp_path / "e.rrd"))
    assert (tmp_path / "e.rrd").stat().st_size > 10_000
    assert "0 faults" in command("store", "verify", *at).stdout
    assert "1 snapshots" in command("store", "log", *at).stdout
    command("store", "gc", *at)
    command("domain", "list", *at)
    command("domain", "show", "small", *at)


def test_a_command_on_an_empty_bucket_says_that_there_is_no_store(bucket_url):
    assert "no store here" in command("tables", "--store", bucket_url, fails=True).stderr
