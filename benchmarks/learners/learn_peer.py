"""One peer learns one case: run by the peers' own interpreter, prints the learned domain's seconds.

``python learn_peer.py LEARNER CASE_DIR OUT.pddl RATE``; RATE is told to the learners that ask for it.
"""

import contextlib
import io
import os
import sys
import tempfile
import time
from pathlib import Path


def main() -> None:
    name, case, out, rate = (
        sys.argv[1],
        Path(sys.argv[2]).resolve(),
        Path(sys.argv[3]).resolve(),
        float(sys.argv[4]),
    )
    from amlgym.algorithms import get_algorithm  # noqa: PLC0415

    options = {"noise": rate} if name.lower() == "nolam" else {}
    traces = sorted((case / "trajectories").glob("*_traj"), key=lambda path: int(path.name.split("_")[0]))
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        os.chdir(folder)  # the adapters write a folder named tmp where they stand
        learner = get_algorithm(name, **options)
        start = time.perf_counter()
        learned = learner.learn(str(case / "domain.pddl"), [str(path) for path in traces])
        seconds = time.perf_counter() - start
    out.write_text(str(learned))
    print(f"{seconds:.3f}")


main()
