"""Domains to success: every domain of a dataset is tried on every goal."""

import asyncio
import os
from pathlib import Path

from prefect import flow, task

from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.run import RunResult, run
from demoplan.store import Store
from flows.edges import EDGE
from flows.inputs import Workers
from flows.progress import ArtifactProgress
from flows.showing import show_links, show_success


@task(name="plan and score", tags=["cpu", "planner"], **EDGE)
async def run_study(dataset: Path, store: Path, root: Path | None, segmenter: str, workers: int) -> RunResult:
    """The planning study of a dataset; attempts that were made before are not made again."""
    opened = open_dataset(dataset, root=root, environment=os.environ)
    return await asyncio.to_thread(
        run, opened, Store(store), segmenter=segmenter, n_workers=workers, progress=ArtifactProgress()
    )


@flow(name="evaluate", persist_result=False)
async def evaluate(
    dataset: Path,
    store: Path = Path(".demoplan"),
    root: Path | None = None,
    segmenter: str = "auto",
    workers: Workers = 2,
) -> RunResult:
    """Plan for every goal with every domain, score, and write the report.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Folder of the store.
        root: Where the logs are, if the manifest does not say.
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Processes for ingesting, and planners at once.
    """
    result = await run_study(dataset, store, root, segmenter, workers)
    name = result.states[0].dataset
    await show_success(name, result.tried)
    await show_links(Store(store), name, result.report)
    return result
