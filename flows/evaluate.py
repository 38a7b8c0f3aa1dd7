"""Domains to success: every domain of a dataset is tried on every goal."""

import asyncio
from pathlib import Path

from prefect import flow, task

from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.run import RunResult, run
from demoplan.store import Store
from flows.crews import Workplace, crew_of, workplace
from flows.edges import EDGE
from flows.inputs import Address, Runner, Workers, opened, store_at
from flows.progress import ArtifactProgress
from flows.showing import show_links, show_success


@task(name="plan and score", tags=["cpu", "planner"], **EDGE)
async def run_study(
    dataset: Path, store: str, root: Path | None, segmenter: str, place: Workplace
) -> RunResult:
    """The planning study of a dataset; attempts that were made before are not made again."""
    data = opened(dataset, root)
    return await asyncio.to_thread(_study, data, store_at(store), segmenter, place, ArtifactProgress())


def _study(
    data: OpenDataset, store: Store, segmenter: str, place: Workplace, progress: ArtifactProgress
) -> RunResult:
    with crew_of(place) as crew:
        return run(data, store, segmenter=segmenter, n_workers=place.n_workers, crew=crew, progress=progress)


@flow(name="evaluate", persist_result=False)
async def evaluate(
    dataset: Path,
    store: str = ".demoplan",
    root: Path | None = None,
    segmenter: str = "auto",
    workers: Workers = 2,
    runner: Runner = None,
    address: Address = None,
) -> RunResult:
    """Plan for every goal with every domain, score, and write the report.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Where the store is: a folder, or s3://BUCKET/PREFIX.
        root: Where the logs are, if the manifest does not say.
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Workers at once: processes for episodes, and planners.
        runner: Who works on episodes: processes, threads, dask or ray; by default DEMOPLAN_RUNNER says.
        address: Of a Dask or Ray cluster that is there already; without it, one is started on this machine.
    """
    result = await run_study(dataset, store, root, segmenter, workplace(runner, address, workers))
    name = result.states[0].dataset
    await show_success(name, result.tried)
    await show_links(store_at(store), name, result.report)
    return result
