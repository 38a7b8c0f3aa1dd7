"""Two runs on one store at once: nothing is lost, and they share the work."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.episodes.ingest import ingest, jobs_of
from demoplan.store import Store
from demoplan.store.verifying import verify

CHECKOUT = Path(__file__).resolve().parents[2]
DATASET = CHECKOUT / "datasets" / "cube-stacking"


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-m", "demoplan", *arguments],
        env=os.environ | {"PYTHONPATH": str(CHECKOUT / "src")},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_two_commands_on_one_store_at_once_end_with_what_one_gives_and_share_the_work(tmp_path):
    there = tmp_path / "there"
    runs = [start("ingest", str(DATASET), "--store", str(there), "--workers", "1") for _ in range(2)]
    for run in runs:
        _, told = run.communicate(timeout=300)
        assert run.returncode == 0, told
    opened, here = open_dataset(DATASET), Store(tmp_path / "here")
    alone = ingest(jobs_of(opened, here, opened.dataset.episodes), on_done=lambda _: None)
    both = Store(there)
    assert both.manifest.episodes() == alone
    assert verify(both) == []
    n_read = len((there / "timings" / "read.jsonl").read_text().splitlines())
    assert 12 <= n_read <= 20, "each begins elsewhere: what is read twice is what both had in hand"
