"""Many jobs in processes of their own: one that dies costs its own job only."""

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

Job = TypeVar("Job")


def run_batch(
    function: Callable[[Job], object], jobs: Sequence[Job], *, n_workers: int
) -> Iterator[tuple[Job, str | None]]:
    """Each job when it has ended, with what killed it if something did.

    Args:
        function: What to do with each; it keeps its result by itself, and can be sent to a process.
        jobs: One at a time to each process.
        n_workers: Processes; with one, everything runs here.
    """
    if n_workers <= 1 or len(jobs) <= 1:
        for job in jobs:
            function(job)
            yield job, None
        return
    remaining = list(jobs)
    while remaining:
        done: set[int] = set()
        # Spawned, not forked: polars hangs in a forked process that used it before.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(n_workers, len(remaining)), mp_context=context) as pool:
            futures = {pool.submit(function, job): k for k, job in enumerate(remaining)}
            for future in as_completed(futures):
                k = futures[future]
                try:
                    future.result()
                except BrokenProcessPool:
                    continue
                done.add(k)
                yield remaining[k], None
        left = [job for k, job in enumerate(remaining) if k not in done]
        if len(left) == len(remaining):
            # Nobody came back: try them alone, so that only the one at fault is lost.
            for job in left:
                yield job, _alone(function, job)
            return
        remaining = left


def _alone(function: Callable[[Job], object], job: Job) -> str | None:
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        try:
            pool.submit(function, job).result()
        except BrokenProcessPool:
            return "the process that ran it died"
    return None
