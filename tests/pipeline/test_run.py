import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import polars as pl
import pytest

from demoplan.pipeline.datasets import open_dataset, recall
from demoplan.pipeline.episodes.ingest import ingest, jobs_of
from demoplan.pipeline.run import run
from demoplan.store import Store
from demoplan.store.code_version import code_version
from demoplan.tables import Activities, Facts, Frames

CHECKOUT = Path(__file__).resolve().parents[2]


def contents(root):
    """Every table and every domain of a store, as bytes; histories say when."""
    files = [p for part in ("objects", "domains", "reports") for p in (root / part).rglob("*") if p.is_file()]
    return {
        p.relative_to(root).as_posix(): p.read_bytes()
        for p in files
        if p.suffix != ".lock" and p.name != "history.jsonl"
    }


@pytest.fixture(scope="module")
def finished(small_dataset, tmp_path_factory):
    folder, root = small_dataset
    store = Store(tmp_path_factory.mktemp("store"))
    opened = open_dataset(folder, root=root)
    return opened, store, run(opened, store)


def test_two_runs_from_scratch_give_the_same_bytes(finished, tmp_path):
    opened, store, _ = finished
    run(opened, Store(tmp_path), n_workers=1)
    assert contents(tmp_path) == contents(store.root)
    assert len(contents(tmp_path)) > 30


def test_each_episode_has_every_table_and_they_fit_together(finished):
    _, store, result = finished
    for state in result.states:
        assert {"samples", "frames", "facts", "labels", "activities", "transitions"} <= set(state.tables)
        frames = store.get(state.tables["frames"], Frames)
        activities = store.get(state.tables["activities"], Activities)
        facts = store.get(state.tables["facts"], Facts)
        first, last = frames["tick_ns"].min(), frames["tick_ns"].max()
        for _, track in activities.group_by("hand"):
            ordered = track.sort("start_ns")
            assert ordered["start_ns"][0] == first
            assert ordered["end_ns"][-1] > last
            assert (ordered["start_ns"][1:] == ordered["end_ns"][:-1]).all(), "no gap, no overlap"
        assert facts["start_ns"].min() >= first


def test_an_episode_is_segmented_by_what_never_saw_its_participant(finished, monkeypatch):
    from demoplan.pipeline.episodes import segmenters

    opened, store, result = finished
    seen = {}
    original = segmenters.trained

    def watched(opened, store, states, params):
        chosen = original(opened, store, states, params)
        seen[chosen.content] = {opened.episode(s.episode_id).participant for s in states}
        return chosen

    monkeypatch.setattr(segmenters, "trained", watched)
    found = segmenters.segmenters_for(opened, store, result.states, "decision_tree")
    for episode_id, chosen in found.items():
        assert opened.episode(episode_id).participant not in seen[chosen.content]


def test_true_labels_reach_no_table_that_is_learned_from(small_dataset, finished, tmp_path):
    """Without labels, the published rules give activities; with labels they give the very same."""
    folder, root = small_dataset
    opened = open_dataset(folder, root=root)
    blind = replace(
        opened,
        dataset=opened.dataset.model_copy(
            update={"episodes": tuple(e.model_copy(update={"labels": None}) for e in opened.dataset.episodes)}
        ),
    )
    with_labels = run(opened, Store(tmp_path / "a"), segmenter="rules")
    without = run(blind, Store(tmp_path / "b"), segmenter="rules")
    for one, other in zip(with_labels.states, without.states, strict=True):
        for name in ("frames", "facts", "activities", "transitions"):
            assert one.tables[name] == other.tables[name]
    assert {k: v.version.domain_id for k, v in with_labels.learned.items()} == {
        k: v.version.domain_id for k, v in without.learned.items()
    }


def test_a_changed_mapping_makes_only_what_depends_on_it_stale(finished, tmp_path):
    opened, _, _ = finished
    store = Store(tmp_path)
    first = ingest(jobs_of(opened, store, opened.dataset.episodes), n_workers=1, on_done=lambda _: None)
    slower = replace(opened, dataset=opened.dataset.model_copy(update={"tick_rate_hz": 50.0}))
    second = ingest(jobs_of(slower, store, slower.dataset.episodes), n_workers=1, on_done=lambda _: None)
    for before, after in zip(first, second, strict=True):
        assert before.keys["read"] == after.keys["read"]
        assert before.keys["align"] != after.keys["align"]


def test_a_log_whose_content_is_not_what_the_manifest_names_is_set_aside(finished, tmp_path):
    opened, _, _ = finished
    job = jobs_of(opened, Store(tmp_path), opened.dataset.episodes[:1])[0]
    job = replace(job, episode=job.episode.model_copy(update={"sha256": "0" * 64}))
    (state,) = ingest([job], n_workers=1, on_done=lambda _: None)
    assert state.status == "quarantined"
    assert "not what the manifest names" in state.reason


def test_a_store_remembers_the_dataset_that_it_was_made_from(finished):
    opened, store, _ = finished
    assert recall(store, "small").dataset == opened.dataset


def test_the_report_names_every_episode_and_every_domain(finished):
    _, _, result = finished
    text = Path(result.report).read_text()
    for state in result.states:
        assert state.episode_id in text
    for learned in result.learned.values():
        assert learned.version.domain_id in text or learned.version.name.split("--")[-1] in text


def test_code_versions_of_stages_differ(finished):
    stages = ("align", "perceive", "segment", "contrast", "learn")
    assert len({code_version(f"demoplan.stages.{stage}") for stage in stages}) == len(stages)


def test_scores_carry_n_and_intervals(finished):
    _, _, result = finished
    asked = pl.col("metric").is_in(["frame accuracy", "goals solved"])
    overall = result.scores.filter(asked & ((pl.col("subject") == "all") | (pl.col("suite") == "planning")))
    assert overall["suite"].n_unique() == 2
    assert (overall["n"] > 0).all()
    assert overall.filter(pl.col("low").is_null()).is_empty()


@pytest.mark.slow
def test_a_run_that_is_killed_again_and_again_loses_nothing_and_ends_the_same(
    small_dataset, finished, tmp_path
):
    folder, root = small_dataset
    _, reference, _ = finished
    command = [sys.executable, "-m", "demoplan", "run", str(folder), "--root", str(root)]
    command += ["--store", str(tmp_path), "--workers", "2"]
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT / "src")}
    rng = random.Random(7)
    for _ in range(12):
        process = subprocess.Popen(
            command,
            env=environment,
            stderr=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            process.wait(timeout=rng.uniform(0.5, 8.0))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        time.sleep(0.05)
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    store = Store(tmp_path)
    for path in (tmp_path / "objects").rglob("*.parquet"):
        if not path.name.startswith(".part-"):
            assert store.objects.is_intact(path.stem), path
    assert {n: b for n, b in contents(tmp_path).items() if ".part-" not in n} == contents(reference.root)
