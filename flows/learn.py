"""Tables to the next version of a dataset's domain."""

import asyncio
import os
from pathlib import Path

from prefect import flow, task

from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.versions import NewVersion, learn_version
from demoplan.store import Store
from flows.edges import EDGE
from flows.inputs import Workers
from flows.progress import ArtifactProgress
from flows.showing import show_episodes, show_version


@task(name="learn", tags=["cpu"], **EDGE)
async def learn_dataset(
    dataset: Path, store: Path, root: Path | None, segmenter: str, workers: int
) -> NewVersion:
    """Segment what is stale, and learn; a version is added if it says something new."""
    opened = open_dataset(dataset, root=root, environment=os.environ)
    return await asyncio.to_thread(
        learn_version,
        opened,
        Store(store),
        segmenter=segmenter,
        n_workers=workers,
        progress=ArtifactProgress(),
    )


@flow(name="learn", persist_result=False)
async def learn(
    dataset: Path,
    store: Path = Path(".demoplan"),
    root: Path | None = None,
    segmenter: str = "auto",
    workers: Workers = 2,
) -> NewVersion:
    """Learn a dataset's domain; a new version, with its difference, if the evidence changed it.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Folder of the store.
        root: Where the logs are, if the manifest does not say.
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Processes for ingesting, and planners at once.
    """
    version = await learn_dataset(dataset, store, root, segmenter, workers)
    await show_episodes(version.learned.version.dataset, version.states)
    await show_version(version.learned.version.dataset, version)
    return version
