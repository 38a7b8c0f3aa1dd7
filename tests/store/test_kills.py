"""Processes that are killed at random while two of them work on one store; many more in benchmarks/kills.py."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
def test_nothing_is_lost_or_corrupt_after_twenty_random_kills():
    done = subprocess.run(
        [sys.executable, "benchmarks/kills.py", "--kills", "20", "--seed", "7", "--json"],
        cwd=CHECKOUT,
        env={**os.environ, "PYTHONPATH": "src"},
        capture_output=True,
        text=True,
        check=False,
    )
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["lost or corrupt"] == 0, result["troubles"]
    assert result["kills"] == 20
    assert result["stage runs promised"] >= 12, "the processes came far enough to lose something"
