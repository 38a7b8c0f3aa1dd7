"""What can go wrong with a store while nobody looks: full disks, read-only disks, damage, rivals, clocks."""

import errno
import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import polars as pl
import pytest

from demoplan.errors import StoreError
from demoplan.ids import ContentHash
from demoplan.store import EpisodeState, Store
from demoplan.store.store import StageOutput
from demoplan.store.sweeping import sweep
from demoplan.store.verifying import repair, verify
from demoplan.tables import Activities

from .test_domains import publish
from .test_upkeep import activities, ingest, old, records

MANY_ROWS = """
    import polars as pl
    from demoplan.tables import Activities
    n = 300_000
    many = Activities.validate(
        pl.select(start_ns=pl.int_range(n)).with_columns(
            episode_id=pl.lit("e"), hand=pl.lit("h"), end_ns=pl.col("start_ns") + 1,
            activity=pl.col("start_ns").hash().cast(pl.String), acted_on=None, in_hand=None,
        ), cast=True,
    )
"""


def child(code, *arguments):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "PYTHONDONTWRITEBYTECODE": "1"},
    )


# Full disks


def test_a_disk_that_is_full_stops_with_one_error_and_what_was_there_stays(tmp_path):
    """The limit of a file's size is a full disk to the process: its writes fail in the middle."""
    store = Store(tmp_path)
    state = ingest(store, "a")
    done = child(
        textwrap.dedent(MANY_ROWS)
        + textwrap.dedent(
            """
            import resource, signal, sys
            from demoplan.errors import StoreError
            from demoplan.store import Store
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
            try:
                Store(sys.argv[1]).objects.put(many, Activities)
            except StoreError as error:
                sys.exit(f"refused: {error}")
            """
        ),
        tmp_path,
    )
    assert "refused: cannot write into" in done.stderr, done.stderr
    assert "File too large" in done.stderr
    assert verify(store) == []
    assert store.get(state.tables["activities"], Activities).height == 1


@pytest.mark.slow
def test_wherever_the_disk_is_full_nothing_is_half_done_and_the_next_try_goes_on(tmp_path, monkeypatch):
    """Each waiting for the disk fails once, from the first to the last that the work takes."""
    real = os.fsync
    for nth in range(1, 200):
        store = Store(tmp_path / str(nth % 7))
        before = ingest(store, "old", str(nth))
        n_calls = 0

        def fsync(descriptor, nth=nth):
            nonlocal n_calls
            n_calls += 1
            if n_calls == nth:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            real(descriptor)

        def work(store=store, nth=nth):
            with store.together():
                ingest(store, f"new-{nth}")
            store.snapshots.take(store.manifest.episodes(), f"ingest {nth}")
            publish(store, "ab"[nth % 2], f"s{nth}")

        monkeypatch.setattr(os, "fsync", fsync)
        try:
            work()
        except StoreError as error:
            assert "No space left on device" in str(error)
            is_finished = False
        else:
            is_finished = True
        monkeypatch.setattr(os, "fsync", real)
        assert [fault for fault in verify(store) if not fault.is_harmless] == []
        assert store.manifest.episode("old") == before
        work()
        assert verify(store) == []
        assert store.manifest.episode(f"new-{nth}").tables
        if is_finished:
            break
    assert 10 < nth < 199, "the work waits for the disk that often"


# Read-only stores


def test_a_store_that_cannot_be_written_can_be_read_and_says_where_it_cannot_be_written(tmp_path):
    for path in [tmp_path, *list(tmp_path.parents)[:3]]:
        path.chmod(0o755)
    store = Store(tmp_path / "store")
    state = ingest(store, "a")
    store.snapshots.take([state], "ingest")
    for path in [store.root, *store.root.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    done = child(
        """
        import os, sys
        from demoplan.errors import StoreError
        from demoplan.store import Store
        from demoplan.store.compacting import compact
        from demoplan.store.sweeping import sweep
        from demoplan.store.verifying import verify
        from demoplan.tables import Activities
        store = Store(sys.argv[1])
        if os.geteuid() == 0:  # nothing is read-only to the superuser
            os.setgroups([])
            os.setgid(65534)
            os.setuid(65534)
        (state,) = store.manifest.episodes()
        assert store.get(state.tables["activities"], Activities).height == 1
        assert verify(store) == []
        assert len(store.snapshots.log()) == 1
        for act in (
            lambda: store.objects.put(Activities.create_empty(), Activities),
            lambda: store.manifest.update([state]),
            lambda: store.timings.note("segment", "k", 1.0),
            lambda: compact(store),
            lambda: sweep(store),
        ):
            try:
                act()
            except StoreError as error:
                print(error)
            else:
                sys.exit("was written")
        """,
        store.root,
    )
    for path in [store.root, *store.root.rglob("*")]:
        path.chmod(0o755)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 5
    assert all("Permission denied" in line and str(store.root) in line for line in done.stdout.splitlines())


# Damage


@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"not a table at all", b"PAR1" + b"\x00" * 100 + b"PAR1"], ids=len
)
def test_a_table_that_is_not_parquet_is_refused_named_and_set_aside_with_the_reason(tmp_path, content):
    store = Store(tmp_path)
    state = ingest(store, "a")
    name = store.objects.name_of(ContentHash(state.tables["activities"]))
    (tmp_path / name).write_bytes(content)
    with pytest.raises(StoreError, match=r"not a readable table.*store repair.*demoplan reprocess"):
        store.get(state.tables["activities"], Activities)
    repair(store, verify(store))
    (line,) = (tmp_path / "damaged/reasons.jsonl").read_text().splitlines()
    told = json.loads(line)
    assert (told["was"], told["is"]) == (name, f"damaged/{name}")
    assert told["reason"] == "its bytes are not those that its name stands for"
    assert (tmp_path / told["is"]).read_bytes() == content
    assert ingest(store, "a") == state
    assert verify(store) == []


def test_a_file_that_a_power_cut_left_short_is_written_again(tmp_path):
    store = Store(tmp_path)
    content = store.objects.put(activities("x"), Activities)
    store.objects.path_of(content).write_bytes(b"")
    assert store.objects.put(activities("x"), Activities) == content
    assert verify(store) == []


@pytest.mark.parametrize("text", ["", "[]", '{"format": 2}', '{"format": 2, "lists": 1}', "\x00\x00"])
def test_a_manifest_that_makes_no_sense_is_refused_kept_and_restored(tmp_path, text):
    store = Store(tmp_path)
    state = ingest(store, "a")
    store.snapshots.take([state], "ingest")
    (tmp_path / "manifest.json").write_text(text)
    with pytest.raises(StoreError, match=r"not a manifest.*store repair"):
        store.manifest.update([state])
    assert (tmp_path / "manifest.json").read_text() == text, "what cannot be read is not overwritten"
    repair(store, verify(store))
    assert (tmp_path / "damaged/manifest.json").read_text() == text
    assert store.manifest.episodes() == [state]


# Rivals


@pytest.mark.slow
def test_two_processes_that_do_the_same_and_different_things_at_once_keep_all_of_it(tmp_path):
    code = """
        import sys
        sys.path.insert(0, sys.argv[3])
        from demoplan.store import Store
        from demoplan.store.compacting import compact
        from demoplan.store.sweeping import sweep
        from tests.store.test_domains import publish
        from tests.store.test_upkeep import ingest
        store, who = Store(sys.argv[1]), sys.argv[2]
        for n in range(10):
            with store.together():
                ingest(store, f"both-{n}")
                ingest(store, f"{who}-{n}")
            if n % 5 == 0:
                store.snapshots.take(store.manifest.episodes(), f"{who} {n}")
                publish(store, "ab"[n % 2], f"{who}-{n}")
                compact(store) if who == "one" else sweep(store, grace_s=0.0)
    """
    checkout = str(Path(__file__).resolve().parents[2])
    both = [
        subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code), str(tmp_path), who, checkout],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
            stderr=subprocess.PIPE,
            text=True,
        )
        for who in ("one", "two")
    ]
    for process in both:
        assert process.communicate()[1] == ""
    store = Store(tmp_path)
    names = {f"{who}-{n}" for who in ("one", "two", "both") for n in range(10)}
    assert {state.episode_id for state in store.manifest.episodes()} == names
    assert len(store.domains.history("stack")) == 4
    assert verify(store) == []


# Clocks


def test_nothing_rests_on_the_clock_but_what_people_read(tmp_path, monkeypatch):
    """Set back by a year between any two steps, the same comes out, in the same order."""
    ticking, jumping = Store(tmp_path / "ticking"), Store(tmp_path / "jumping")

    def work(store, after):
        ids = []
        for n in range(3):
            ingest(store, f"e{n}")
            ids.append(store.snapshots.take(store.manifest.episodes(), f"step {n}"))
            publish(store, "ab"[n % 2], f"s{n}")
            after()
        return ids

    expected = work(ticking, lambda: None)
    now_ns = [10**18]
    monkeypatch.setattr("time.time_ns", lambda: now_ns[0])
    monkeypatch.setattr("time.time", lambda: now_ns[0] / 1e9)

    def set_back():
        now_ns[0] -= 365 * 86_400 * 10**9

    assert work(jumping, set_back) == expected
    assert [e.snapshot_id for e in jumping.snapshots.log()] == expected
    assert [e.cause for e in jumping.snapshots.log()] == ["step 0", "step 1", "step 2"]
    assert jumping.manifest.episodes() == ticking.manifest.episodes()
    assert jumping.domains.latest("stack") == ticking.domains.latest("stack")
    assert [p.name for p in records(jumping)] == [p.name for p in records(ticking)]


def test_what_was_written_in_the_future_is_not_swept(tmp_path):
    store = Store(tmp_path)
    content = store.objects.put(activities("nobody's"), Activities)
    old(store.objects.path_of(content), days=-400)
    assert sweep(store) == []


def test_stages_that_ran_together_are_found_before_and_after_the_end(tmp_path):
    store, calls = Store(tmp_path), []

    def work():
        calls.append(1)
        return StageOutput(tables={"activities": (activities("x"), Activities)})

    with store.together():
        first = store.run("segment", {"i": "1"}, "{}", "c", work)
        assert store.run("segment", {"i": "1"}, "{}", "c", work) == first
        assert Store(tmp_path).records.get("segment", first.key) is None
        with store.together():
            assert store.find("segment", {"i": "1"}, "{}", "c") == first
    assert Store(tmp_path).find("segment", {"i": "1"}, "{}", "c") == first
    assert len(calls) == 1


def test_what_was_finished_before_an_error_inside_a_block_is_kept(tmp_path):
    store = Store(tmp_path)
    with pytest.raises(ZeroDivisionError), store.together():
        ingest(store, "a")
        _ = 1 / 0
    assert Store(tmp_path).index().has_record("segment", store.manifest.episode("a").keys["segment"])
    assert verify(store) == []


@pytest.mark.parametrize("n", [1, 128, 129, 700])
def test_a_manifest_of_any_size_holds_what_was_put_in_last(tmp_path, n):
    store = Store(tmp_path)
    for version in range(2):
        for start in range(0, n, 50):
            store.manifest.update(
                EpisodeState(dataset=f"d{k % 2}", episode_id=f"e{k:04}", tables={"t": f"{version}"})
                for k in range(start, min(start + 50, n))
            )
    states = store.manifest.episodes()
    assert len(states) == n
    assert {state.tables["t"] for state in states} == {"1"}
    assert len(list((tmp_path / "states").glob("*.json"))) <= 2, "superseded lists do not stay"
    assert pl.Series([state.episode_id for state in store.manifest.episodes("d0")]).is_sorted()
