import os
import subprocess
import sys
from pathlib import Path

import pytest

import demoplan

PROBE = """
import resource, numpy as np
from demoplan.pipeline.episodes.memory import keep_memory
kept = {kept} and keep_memory() and keep_memory()
np.ones(3_000_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    np.ones(3_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux has these settings")
def test_memory_that_is_kept_is_used_again_without_the_system():
    environment = os.environ | {"PYTHONPATH": str(Path(demoplan.__file__).parents[1])}
    faults = {
        is_kept: int(
            subprocess.run(
                [sys.executable, "-c", PROBE.format(kept=is_kept)],
                check=True,
                capture_output=True,
                text=True,
                env=environment,
            ).stdout
        )
        for is_kept in (False, True)
    }
    assert faults[True] < 20 < faults[False]
