"""Logs to tables: what the manifest names, and what has arrived beside it."""

import asyncio
import os
from pathlib import Path

from prefect import flow, task
from prefect.logging import get_run_logger

from demoplan.pipeline.arrivals import ArrivalParams, enrol, find_arrivals
from demoplan.pipeline.datasets import OpenDataset, open_dataset, remember
from demoplan.pipeline.ingest import ingest as ingest_jobs
from demoplan.pipeline.ingest import jobs_of
from demoplan.store import EpisodeState, Store
from flows.edges import EDGE
from flows.inputs import QuietSeconds, Workers
from flows.progress import ArtifactProgress
from flows.showing import show_episodes


@task(name="enrol", tags=["disk"], **EDGE)
async def enrol_arrivals(dataset: Path, root: Path | None, pattern: str, quiet_s: float) -> int:
    """Write logs that have arrived into the manifest; how many these were."""
    opened = open_dataset(dataset, root=root, environment=os.environ)
    arrivals = await asyncio.to_thread(find_arrivals, opened, ArrivalParams(pattern=pattern, quiet_s=quiet_s))
    for arrival in arrivals:
        if arrival.refusal:
            get_run_logger().warning("%s is left alone: %s", arrival.file, arrival.refusal)
    return await asyncio.to_thread(enrol, dataset, arrivals)


@task(name="read, align, perceive", tags=["disk", "cpu"], **EDGE)
async def ingest_dataset(dataset: Path, store: Path, root: Path | None, workers: int) -> list[EpisodeState]:
    """Ingest every episode; processes of its own, since Prefect's would each start a server."""
    opened = open_dataset(dataset, root=root, environment=os.environ)
    return await asyncio.to_thread(_ingest, opened, Store(store), workers, ArtifactProgress())


def _ingest(
    opened: OpenDataset, store: Store, workers: int, progress: ArtifactProgress
) -> list[EpisodeState]:
    remember(opened, store)
    jobs = jobs_of(opened, store, opened.dataset.episodes)
    with progress(f"ingest {opened.dataset.name}", len(jobs)) as done:
        states = ingest_jobs(jobs, n_workers=workers, on_done=lambda s: done(f"{s.episode_id} {s.status}"))
    store.snapshots.take(store.manifest.episodes(), f"ingest {opened.dataset.name}")
    return states


@flow(name="ingest", persist_result=False, log_prints=False)
async def ingest(
    dataset: Path,
    store: Path = Path(".demoplan"),
    root: Path | None = None,
    pattern: str | None = None,
    quiet_s: QuietSeconds = 30.0,
    workers: Workers = 2,
) -> list[EpisodeState]:
    """Read, align and perceive every episode of a dataset, after taking up what has arrived.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Folder of the store.
        root: Where the logs are, if the manifest does not say.
        pattern: Takes up logs that arrived: a regular expression over their names with the groups participant
            and task. Without it, only what the manifest names is ingested.
        quiet_s: Logs that changed less than this ago are left alone [s].
        workers: Processes for ingesting, and planners at once.
    """
    if pattern:
        await enrol_arrivals(dataset, root, pattern, quiet_s)
    states = await ingest_dataset(dataset, store, root, workers)
    await show_episodes(states[0].dataset if states else "none", states)
    return states
