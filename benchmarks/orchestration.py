# ruff: noqa: PLC0415 (Prefect and the clusters take seconds to import)
"""What orchestration costs beside the work: each way of running episodes, with and without something to do.

One command prints the table, in some minutes::

    python benchmarks/orchestration.py

Measured is processor time (user and system) of everything that takes part, once it is warm: this process,
Prefect's server with its database, the cluster's scheduler and its two workers. *Nothing* are tasks that take
the orders of real episodes and do no work; *work* is ingesting and segmenting the same episodes in one
process without any of it, into an empty store. The share is nothing ÷ (nothing + work).
"""

import argparse
import asyncio
import dataclasses
import os
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "src")]
DATASET = ROOT / "datasets" / "cube-stacking"
RUNNERS = ("processes", "threads", "dask", "ray")
IN_ORDER = 16
"""Episodes of one order; as many as `demoplan.pipeline.episodes.ingest` puts into one of a large dataset."""


def cpu_s() -> float:
    """Processor time of this process and all that it started, dead or alive."""
    import psutil

    spent = sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    for process in psutil.Process().children(recursive=True):
        try:
            times = process.cpu_times()
            spent += times.user + times.system + times.children_user + times.children_system
        except psutil.Error:
            continue
    return spent


@contextmanager
def timed(into: dict[str, float]) -> Iterator[None]:
    start, wall = cpu_s(), time.perf_counter()
    yield
    into |= {"cpu_s": cpu_s() - start, "wall_s": time.perf_counter() - wall}


def orders_of(store: Path, n: int) -> list[tuple[Any, ...]]:
    """Orders of sixteen episodes each, the shipped ones again and again."""
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes import ingest
    from demoplan.store import Store

    given: list[Any] = []

    def crew(_: object, groups: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        given.extend(order for group in groups for order in group)
        yield from (
            (group, [ingest._died(job, Store(store)) for job in jobs[: len(group)]]) for group in groups
        )

    opened = open_dataset(DATASET)
    jobs = ingest.jobs_of(opened, Store(store), opened.dataset.episodes)
    ingest.ingest(jobs, crew=crew, on_done=lambda _: None)
    return [tuple(given[(at + i) % len(given)] for i in range(IN_ORDER)) for at in range(n)]


def work_s(n: int) -> list[float]:
    """Processor seconds of doing an order, with segmentation, without anybody to orchestrate it."""
    from demoplan.pipeline.datasets import open_dataset
    from demoplan.pipeline.episodes import activities, ingest, segmenters
    from demoplan.store import Store

    opened = open_dataset(DATASET)
    spent = []
    for at in range(n + 1):
        with tempfile.TemporaryDirectory() as folder:
            # Equal logs in one store would be found done: each episode has a store of its own.
            jobs = [
                job
                for i in range(IN_ORDER)
                for job in ingest.jobs_of(
                    opened,
                    Store(Path(folder) / str(i)),
                    [opened.dataset.episodes[(at + i) % len(opened.dataset.episodes)]],
                )
            ]
            start = time.process_time()
            for job in jobs:
                state = ingest.ingest_episode(job)
                chosen = {state.episode_id: segmenters.rules()}
                activities.segment_episodes(opened, Store(job.store), [state], chosen, is_kept=False)
            spent.append(time.process_time() - start)
    return spent[1:]  # the first warms up


async def nothing(runner: str, orders: list[tuple[Any, ...]], in_task: int) -> dict[str, float]:
    """What it costs to give these orders to workers that do nothing about them."""
    from prefect import flow

    from flows import crews

    spent: dict[str, float] = {}

    def give() -> None:
        place = crews.workplace(runner, None, 2)
        with crews.crew_of(place) as found:
            crew = found
            if isinstance(crew, crews.TaskCrew):
                crew = dataclasses.replace(crew, most_orders=in_task)
            list(crew(len, orders[: 4 * in_task]))  # starts the workers, and what they import
            with timed(spent):
                list(crew(len, orders))

    @flow(name="orchestration", persist_result=False)
    async def measured() -> None:
        await asyncio.to_thread(give)

    await measured()
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=200, help="tasks of each kind [200]")
    parser.add_argument("--work", type=int, default=5, help="orders that are really done [5]")
    parser.add_argument("--runner", choices=RUNNERS, action="append", help="only this one")
    parser.add_argument("--in-task", type=int, action="append", help="orders in a task [1 and the default]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="demoplan-", ignore_cleanup_errors=True) as folder:
        os.environ |= {
            "PREFECT_HOME": folder,
            "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "300",
            "PREFECT_LOGGING_LEVEL": "ERROR",
            "PREFECT_LOGGING_SERVER_LEVEL": "CRITICAL",
        }
        from flows import crews

        runs = work_s(options.work)
        work = statistics.median(runs)
        print(f"work: {work:.2f} s of processor time for an order of {IN_ORDER} episodes ", end="")
        print(f"({min(runs):.2f}–{max(runs):.2f}, n = {len(runs)})\n")
        print(
            "| runner | orders in a task | tasks | nothing, CPU per task [ms] | wall per task [ms] | share |"
        )
        print("| --- | --- | --- | --- | --- | --- |", flush=True)
        for runner in options.runner or RUNNERS:
            sizes = [1] if runner == "processes" else options.in_task or [1, crews.MOST_ORDERS]
            for in_task in sizes:
                orders = orders_of(Path(folder) / "store", options.tasks * in_task)
                spent = asyncio.run(nothing(runner, orders, in_task))
                per_task = spent["cpu_s"] / options.tasks
                print(
                    f"| {runner} | {in_task} | {options.tasks} | {1e3 * per_task:.0f} "
                    f"| {1e3 * spent['wall_s'] / options.tasks:.0f} "
                    f"| {per_task / (per_task + in_task * work):.1%} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
