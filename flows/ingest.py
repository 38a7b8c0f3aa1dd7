"""Logs to tables: what the manifest names, and what has arrived beside it."""

import asyncio
from pathlib import Path

from prefect import flow, task
from prefect.logging import get_run_logger

from demoplan.pipeline.crews import Crew
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.episodes.arrivals import ArrivalParams, enrol, find_arrivals
from demoplan.pipeline.episodes.fetching import fetch_logs
from demoplan.pipeline.episodes.ingest import ingest_dataset
from demoplan.pipeline.reporting import Progress
from demoplan.store import EpisodeState, Store
from demoplan.store.opening import open_place
from flows.crews import Workplace, in_crew, workplace
from flows.edges import EDGE
from flows.inputs import Address, Bucket, QuietSeconds, Runner, Workers, opened, store_at
from flows.showing import show_episodes


@task(name="fetch", tags=["network", "disk"], **EDGE)
async def fetch_arrivals(dataset: Path, root: Path | None, bucket: str, quiet_s: float) -> int:
    """Bring logs that are in a bucket and not here beside the dataset; how many files these were."""
    place, folder = open_place(bucket), opened(dataset, root).root
    fetched = await asyncio.to_thread(fetch_logs, place, folder, quiet_s=quiet_s)
    for each in fetched:
        if each.refusal:
            get_run_logger().warning("%s/%s is left alone: %s", bucket, each.file, each.refusal)
    return sum(not each.refusal for each in fetched)


@task(name="enrol", tags=["disk"], **EDGE)
async def enrol_arrivals(dataset: Path, root: Path | None, pattern: str, quiet_s: float) -> int:
    """Write logs that have arrived into the manifest; how many these were."""
    data = opened(dataset, root)
    arrivals = await asyncio.to_thread(find_arrivals, data, ArrivalParams(pattern=pattern, quiet_s=quiet_s))
    for arrival in arrivals:
        if arrival.refusal:
            get_run_logger().warning("%s is left alone: %s", arrival.file, arrival.refusal)
    return await asyncio.to_thread(enrol, dataset, arrivals)


@task(name="read, align, perceive", tags=["disk", "cpu"], **EDGE)
async def ingest_all(dataset: Path, store: str, root: Path | None, place: Workplace) -> list[EpisodeState]:
    """Ingest every episode."""
    data, kept = opened(dataset, root), store_at(store)
    return await in_crew(place, lambda crew, progress: _ingest(data, kept, crew, progress))


def _ingest(data: OpenDataset, store: Store, crew: Crew, progress: Progress) -> list[EpisodeState]:
    states = ingest_dataset(data, store, crew=crew, progress=progress)
    store.snapshots.take(store.manifest.episodes(), f"ingest {data.dataset.name}")
    return states


@flow(name="ingest", persist_result=False, log_prints=False)
async def ingest(
    dataset: Path,
    store: str = ".demoplan",
    root: Path | None = None,
    pattern: str | None = None,
    quiet_s: QuietSeconds = 30.0,
    workers: Workers = 2,
    runner: Runner = None,
    address: Address = None,
    bucket: Bucket = None,
) -> list[EpisodeState]:
    """Read, align and perceive every episode of a dataset, after taking up what has arrived.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Where the store is: a folder, or s3://BUCKET/PREFIX.
        root: Where the logs are, if the manifest does not say.
        pattern: Takes up logs that arrived: a regular expression over their names with the groups participant
            and task. Without it, only what the manifest names is ingested.
        quiet_s: Logs that changed less than this ago are left alone [s].
        workers: Workers at once: processes for episodes, and planners.
        runner: Who works on episodes: processes, threads, dask or ray; by default DEMOPLAN_RUNNER says.
        address: Of a Dask or Ray cluster that is there already; without it, one is started on this machine.
        bucket: Logs in s3://BUCKET/PREFIX that are not here yet are fetched first; with a pattern, taken up.
    """
    if bucket:
        await fetch_arrivals(dataset, root, bucket, quiet_s)
    if pattern:
        await enrol_arrivals(dataset, root, pattern, quiet_s)
    states = await ingest_all(dataset, store, root, workplace(runner, address, workers))
    await show_episodes(states[0].dataset if states else "none", states)
    return states
