# ruff: noqa: PLC0415 (the package is found beside this file)
"""What an episode leaves behind: files and bytes by kind, before and after compacting; and a million of them.

One command prints the tables, in some minutes::

    python benchmarks/footprint.py

Episodes are those of ``synthetic.py``: logs of 30 s with two hands and six cubes, each different. They are
ingested, segmented and learned from, compacted, and what shards hold is swept. What is measured at two sizes
gives a line, and the line at a million episodes is printed: an extrapolation, not a measurement.
"""

import argparse
import os
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "benchmarks")]

MILLION = 1_000_000
SEED = 2026


def kinds(store: Path) -> dict[str, tuple[int, int]]:
    """Folder of the store → number of files, and their bytes."""
    found: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    for path in store.rglob("*"):
        if path.is_file():
            parts = path.relative_to(store).parts
            kind = parts[0] if len(parts) > 1 else "manifest and locks"
            found[kind][0] += 1
            found[kind][1] += path.stat().st_size
    return {kind: (n, size) for kind, (n, size) in sorted(found.items())}


def build(folder: Path, n_episodes: int) -> tuple[Path, dict[str, float]]:
    """A store of so many episodes, and what making it took, by CPU."""
    import synthetic
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.domains.learning import learn_domain
    from demoplan.pipeline.episodes import activities, ingest, segmenters
    from demoplan.store import Store

    synthetic.write_dataset(folder, n_episodes, "synthetic")
    recorded = synthetic.sides()
    n_bytes = 0
    for index in range(n_episodes):
        path = folder / synthetic.file_of(index)
        path.parent.mkdir(parents=True, exist_ok=True)
        synthetic.write_mcap(path, synthetic.streams_of(recorded, SEED, index))
        n_bytes += path.stat().st_size
    opened, store = open_dataset(folder), Store(folder / "store")
    start = time.process_time()
    jobs = ingest.jobs_of(opened, store, opened.dataset.episodes)
    states = ingest.ingest(jobs, on_done=lambda _: None)
    chosen = {state.episode_id: segmenters.rules() for state in states}
    states = activities.segment_episodes(opened, store, states, chosen)
    spent = time.process_time() - start
    learn_domain(store, states, opened.vocabulary, name="synthetic", dataset="synthetic")
    return folder / "store", {"log_bytes": n_bytes / n_episodes, "cpu_s": spent / n_episodes}


def compacted(store: Path) -> dict[str, tuple[int, int]]:
    """What is there after compacting, and after sweeping what shards hold."""
    from demoplan.store import Store
    from demoplan.store.compacting import compact
    from demoplan.store.sweeping import sweep

    compact(Store(store))
    sweep(Store(store), grace_s=0.0)
    return kinds(store)


def table(title: str, small: dict, large: dict, sizes: tuple[int, int]) -> None:
    """Measured at two sizes, and the line through both at a million."""
    from demoplan.store.compacting import SHARD_BYTES

    print(f"\n{title}\n")
    print(
        f"| kind | files, n = {sizes[0]} | n = {sizes[1]} | MB, n = {sizes[1]} | files at 10⁶ | GB at 10⁶ |"
    )
    print("| --- | --- | --- | --- | --- | --- |")
    for kind in sorted(small | large):
        (n_a, b_a), (n_b, b_b) = small.get(kind, (0, 0)), large.get(kind, (0, 0))
        steps = (MILLION - sizes[1]) / (sizes[1] - sizes[0])
        n_m, b_m = n_b + (n_b - n_a) * steps, b_b + (b_b - b_a) * steps
        if kind == "shards":  # few are not full
            n_m = b_m / SHARD_BYTES
        elif kind == "states":  # one for each dataset
            n_m = n_b
        print(f"| {kind} | {n_a} | {n_b} | {b_b / 1e6:.2f} | {n_m:,.0f} | {b_m / 1e9:.1f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs=2, default=[100, 400], help="episodes [100 400]")
    options = parser.parse_args()
    os.environ.setdefault("POLARS_MAX_THREADS", "1")
    before, after = [], []
    with tempfile.TemporaryDirectory(prefix="demoplan-") as temporary:
        for n_episodes in options.sizes:
            folder = Path(temporary) / str(n_episodes)
            folder.mkdir()
            store, per_episode = build(folder, n_episodes)
            before.append(kinds(store))
            after.append(compacted(store))
            print(
                f"n = {n_episodes}: {1e3 * per_episode['cpu_s']:.0f} ms of processor time and "
                f"{per_episode['log_bytes'] / 1e6:.2f} MB of log an episode",
                flush=True,
            )
    sizes = tuple(options.sizes)
    table("As written", *before, sizes)
    table("Compacted and swept", *after, sizes)


if __name__ == "__main__":
    main()
