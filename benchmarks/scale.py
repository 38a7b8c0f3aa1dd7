# ruff: noqa: PLC0415 (each part is imported only in the process that measures it)
"""How a store holds up with the number of episodes: from logs to activities, again, and after one change.

One command prints the tables; the default takes five minutes, ``--sizes 100 1000 10000`` half an hour and
40 GB of disk::

    python benchmarks/scale.py

Episodes are those of ``synthetic.py``: real MCAP logs of 30 s with two hands and six cubes, each different.
Logs are written before anything is measured. Then, in processes of their own:

- *first run*: read, align, perceive, segment, contrast on two workers, through the store, as `demoplan run`
  does it. *per episode* is wall time over episodes; *work* is the time that workers spend in their orders;
  *elsewhere* the share of the wall time that is not covered by work on all cores: starting processes,
  handing out, the manifest. On a machine that others use too, wall times say little: CPU time is beside them.
- *learn*: the domain of all episodes, for the first time; two workers count.
- *dry run*: `demoplan reprocess --dry-run` with nothing stale; the whole command, from start to exit.
- *one changed*: one log is replaced by another one, then `demoplan reprocess`: the whole command, with
  everything that depends on that episode, the domain included.

``--counts N`` instead aggregates operator counts over N activities from tables in the store, as many as there
are buckets, beside learning from all transitions at once: the transitions of the shipped episodes, again and
again under other names.
"""

import argparse
import itertools
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import synthetic

SEED = 2026
N_CORES = 2
_ONE_THREAD = {
    "POLARS_MAX_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # As the command line sets it.
    "_RJEM_MALLOC_CONF": "dirty_decay_ms:10000,muzzy_decay_ms:10000",
}


def write_logs(folder: Path, first: int, end: int) -> None:
    """Write the logs of some episodes."""
    recorded = synthetic.sides()
    for index in range(first, end):
        synthetic.write_mcap(folder / synthetic.file_of(index), synthetic.streams_of(recorded, SEED, index))


def generate(folder: Path, n_episodes: int) -> None:
    synthetic.write_dataset(folder, n_episodes, "synthetic")
    bounds = [n_episodes * k // N_CORES for k in range(N_CORES + 1)]
    workers = [
        get_context("spawn").Process(target=write_logs, args=(folder, *pair))
        for pair in itertools.pairwise(bounds)
    ]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
        assert worker.exitcode == 0


@dataclass(frozen=True)
class Measured:
    """Work with what it took, for a worker to do."""

    work: Callable[[Any], Any]

    def __call__(self, order: Any) -> tuple[Any, float, float, float]:
        """The result, wall time [s], CPU time [s], and peak memory of the process so far [MiB]."""
        start, cpu = time.perf_counter(), time.process_time()
        result = self.work(order)
        return result, time.perf_counter() - start, time.process_time() - cpu, peak_mib()


class MeasuringCrew:
    """Processes of this machine, and what each order took: wall [s], CPU [s], peak memory so far [MiB]."""

    def __init__(self, n_workers: int) -> None:
        self.n_workers = n_workers
        self.orders: list[tuple[float, float, float]] = []

    def __call__(self, work: Callable[[Any], Any], orders: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Each order with its result; see ``Crew``."""
        from demoplan.pipeline.crews import Processes

        for order, done in Processes(self.n_workers)(Measured(work), orders):
            self.orders.append(done[1:] if done is not None else (0.0, 0.0, 0.0))
            yield order, None if done is None else done[0]


def cpu_of_all_s() -> float:
    """CPU time [s] of this process and of those that it started and that have ended."""
    uses = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in uses)


def peak_mib() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def first_run(folder: Path) -> dict[str, float]:
    """Logs to transitions, then the domain, in a store that is empty."""
    from demoplan.pipeline.crews import Processes
    from demoplan.pipeline.datasets import open_dataset, remember
    from demoplan.pipeline.domains.learning import learn_domain
    from demoplan.pipeline.episodes.activities import segment_episodes
    from demoplan.pipeline.episodes.ingest import ingest, jobs_of
    from demoplan.pipeline.episodes.segmenters import rules
    from demoplan.store import Store

    store, crew = Store(folder / "store"), MeasuringCrew(N_CORES)
    start = time.perf_counter()
    opened = open_dataset(folder)
    remember(opened, store, segmenter="rules")
    opened_s = time.perf_counter() - start
    start, own = time.perf_counter(), time.process_time()
    jobs = jobs_of(opened, store, opened.dataset.episodes)
    states = ingest(jobs, crew=crew, on_done=lambda _: None)
    chosen = {state.episode_id: rules() for state in states}
    states = segment_episodes(opened, store, states, chosen, crew=crew)
    wall_s, own_s = time.perf_counter() - start, time.process_time() - own
    assert all(state.status == "complete" and "transitions" in state.tables for state in states)
    start, own = time.perf_counter(), cpu_of_all_s()
    learned = learn_domain(
        store,
        states,
        opened.vocabulary,
        name="synthetic",
        dataset="synthetic",
        crew=Processes(N_CORES),
    )
    store.snapshots.take(store.manifest.episodes(), "learn synthetic")
    learn_s, learn_cpu_s = time.perf_counter() - start, cpu_of_all_s() - own
    n = len(states)
    quarter = max(1, len(crew.orders) // 4)
    work_s = sum(order[0] for order in crew.orders)
    return {
        "episodes": n,
        "open_s": opened_s,
        "wall_s": wall_s,
        "per_episode_ms": 1e3 * wall_s / n,
        "worker_cpu_ms": 1e3 * sum(order[1] for order in crew.orders) / n,
        "parent_cpu_ms": 1e3 * own_s / n,
        "work_ms": 1e3 * work_s / n,
        "elsewhere": max(0.0, 1.0 - work_s / N_CORES / wall_s),
        "real_time": synthetic.LENGTH_S * n / wall_s,
        "peak_first_mib": max(order[2] for order in crew.orders[:quarter]),
        "peak_mib": max(order[2] for order in crew.orders),
        "parent_mib": peak_mib(),
        "learn_s": learn_s,
        "learn_cpu_s": learn_cpu_s,
        "operators": len(learned.domain.operators),
        "activities": int(learned.evidence.height),
    }


def command(*arguments: str) -> tuple[float, float, dict[str, Any]]:
    """Seconds that a command of ``demoplan`` takes, of wall and CPU, and its JSON."""
    own, start = cpu_of_all_s(), time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "demoplan", *arguments, "--json"],
        env=os.environ | _ONE_THREAD,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        check=True,
        text=True,
    )
    return time.perf_counter() - start, cpu_of_all_s() - own, json.loads(done.stdout)


def child(*arguments: str) -> dict[str, float]:
    """What a process of its own measured."""
    done = subprocess.run(
        [sys.executable, __file__, *arguments],
        env=os.environ | _ONE_THREAD,
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return dict(json.loads(done.stdout.splitlines()[-1]))


def one_size(folder: Path, n_episodes: int) -> dict[str, float]:
    """All measurements of one number of episodes."""
    generate(folder, n_episodes)
    logs = [folder / synthetic.file_of(k) for k in range(n_episodes)]
    found = child("--first", str(folder))
    found["log_mb"] = statistics.mean(path.stat().st_size for path in logs[:100]) / 1e6
    store = str(folder / "store")
    dry = "reprocess", "--dry-run", "--store", store
    found["dry_run_s"], found["dry_run_cpu_s"], nothing = command(*dry)
    assert not nothing["stale"], nothing["stale"][:3]
    write_logs(folder, n_episodes, n_episodes + 1)
    (folder / synthetic.file_of(n_episodes)).replace(logs[n_episodes // 2])
    found["one_dry_run_s"], found["one_dry_run_cpu_s"], stale = command(
        "reprocess", "--dry-run", "--store", store
    )
    assert {row["episode_id"] for row in stale["stale"]} == {synthetic.episode_id(n_episodes // 2), None}
    found["one_changed_s"], found["one_changed_cpu_s"], again = command(
        "reprocess", "--store", store, "--workers", "1"
    )
    assert again["episodes"] == [synthetic.episode_id(n_episodes // 2)]
    return found


def count_all(n_activities: int, way: str) -> dict[str, float]:
    """Time and memory of aggregating operator counts over so many activities, or of learning at once."""
    import polars as pl

    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes.activities import segment_episodes
    from demoplan.pipeline.episodes.episode_tables import tables_of
    from demoplan.pipeline.episodes.ingest import ingest, jobs_of
    from demoplan.pipeline.episodes.segmenters import rules
    from demoplan.stages.learn import counting, learn
    from demoplan.store import Store
    from demoplan.tables import Patterns, Sightings, Transitions

    opened = open_dataset(synthetic.RECORDED)
    call = opened.vocabulary.types, [rule.signature for rule in opened.vocabulary.predicates]
    with tempfile.TemporaryDirectory(prefix="demoplan-scale-") as folder:
        store = Store(Path(folder))
        states = ingest(jobs_of(opened, store, opened.dataset.episodes), on_done=lambda _: None)
        states = segment_episodes(opened, store, states, {state.episode_id: rules() for state in states})
        shown = tables_of(store, states, "transitions", Transitions)
        n_copies = -(-n_activities // shown.height)

        def named(table: Any, numbers: Sequence[int]) -> Any:
            return pl.concat([table.with_columns(pl.col("episode_id") + f"-{k:06d}") for k in numbers])

        if way == "at once":
            table = Transitions.cast(named(shown, range(n_copies)))
            start, own = time.perf_counter(), time.process_time()
            operators = learn(table, *call).operators.height
            return _taken(table.height, start, own) | {"operators": operators}
        grip = counting.ranks([counting.grip_votes(shown, *call)])
        support = counting.ranks([counting.support_votes(shown, *call, grip)])
        found = counting.sight(shown, *call, grip, support)
        # Sixty-four episodes in a bucket, as the store keeps them.
        per_bucket = max(1, 64 // len(states))
        contents = [
            store.objects.put(
                Sightings.cast(named(found.sightings, range(k, min(k + per_bucket, n_copies)))), Sightings
            )
            for k in range(0, n_copies, per_bucket)
        ]
        kept = store.objects.put(found.patterns, Patterns)
        start, own = time.perf_counter(), time.process_time()
        rows = pl.concat([store.get(content, Sightings) for content in contents])
        if way == "counts":
            n_rows = int(counting.count(rows)["n_transitions"].sum())
            return _taken(n_rows, start, own) | {"operators": 0}
        operators = counting.learn_from_sightings(rows, store.get(kept, Patterns), *call).operators.height
        return _taken(rows.height, start, own) | {"operators": operators}


def _taken(n_rows: int, start: float, own: float) -> dict[str, float]:
    taken = time.perf_counter() - start, time.process_time() - own
    return {"activities": n_rows, "wall_s": taken[0], "cpu_s": taken[1], "peak_mib": peak_mib()}


def counts_table(n_activities: int) -> None:
    print("| way | activities | wall [s] | CPU [s] | peak [MiB] | operators |")
    print("| --- " * 6 + "|", flush=True)
    ways = {
        "counts": "counts of each pattern, from buckets",
        "operators": "operators and evidence, from buckets",
        "at once": "learning from all transitions",
    }
    for way, words in ways.items():
        n = n_activities if way != "at once" else n_activities // 5
        found = child("--count", way, "--counts", str(n))
        print(
            f"| {words} | {found['activities']} | {found['wall_s']:.1f} | {found['cpu_s']:.1f} "
            f"| {found['peak_mib']:.0f} | {found['operators'] or ''} |",
            flush=True,
        )


_COLUMNS = {
    "episodes": "episodes",
    "wall_s": "first run [s]",
    "per_episode_ms": "per episode [ms]",
    "work_ms": "work [ms]",
    "worker_cpu_ms": "CPU workers [ms]",
    "parent_cpu_ms": "CPU parent [ms]",
    "elsewhere": "elsewhere",
    "real_time": "× real time",
    "peak_first_mib": "worker, first quarter [MiB]",
    "peak_mib": "worker, all [MiB]",
    "parent_mib": "parent [MiB]",
    "activities": "activities",
    "learn_s": "learn [s]",
    "learn_cpu_s": "its CPU",
    "dry_run_s": "dry run [s]",
    "dry_run_cpu_s": "its CPU",
    "one_dry_run_s": "one changed, dry run [s]",
    "one_dry_run_cpu_s": "its CPU",
    "one_changed_s": "one changed [s]",
    "one_changed_cpu_s": "its CPU",
}


def table(sizes: Sequence[int], root: Path | None) -> None:
    print("| " + " | ".join(_COLUMNS.values()) + " |")
    print("| --- " * len(_COLUMNS) + "|", flush=True)
    for n_episodes in sizes:
        folder = Path(tempfile.mkdtemp(prefix="demoplan-scale-", dir=root))
        try:
            found = one_size(folder, n_episodes)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        shown = [
            f"{found[name]:.{0 if found[name] >= 100 else 1 if found[name] >= 10 else 2}f}"
            for name in _COLUMNS
        ]
        print("| " + " | ".join(shown) + " |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 1000], help="episodes [100 1000]")
    parser.add_argument("--folder", type=Path, help="where logs and stores are kept meanwhile")
    parser.add_argument("--counts", type=int, metavar="N", help="aggregate counts of N activities instead")
    parser.add_argument("--count", help=argparse.SUPPRESS)
    parser.add_argument("--first", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.first:
        print(json.dumps(first_run(options.first)))
        return
    if options.count:
        print(json.dumps(count_all(options.counts, options.count)))
        return
    if options.counts:
        counts_table(options.counts)
        return
    table(options.sizes, options.folder)


if __name__ == "__main__":
    main()
