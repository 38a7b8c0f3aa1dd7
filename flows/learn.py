"""Tables to the next version of a dataset's domain."""

from pathlib import Path

from prefect import flow, task

from demoplan.pipeline.upkeep.versions import NewVersion, learn_version
from flows.crews import Workplace, in_crew, workplace
from flows.edges import EDGE
from flows.inputs import Address, Runner, Workers, opened, store_at
from flows.showing import show_episodes, show_version


@task(name="learn", tags=["cpu"], **EDGE)
async def learn_dataset(
    dataset: Path, store: str, root: Path | None, segmenter: str, place: Workplace
) -> NewVersion:
    """Segment what is stale, and learn; a version is added if it says something new."""
    data, kept = opened(dataset, root), store_at(store)
    return await in_crew(
        place,
        lambda crew, progress: learn_version(data, kept, segmenter=segmenter, crew=crew, progress=progress),
    )


@flow(name="learn", persist_result=False)
async def learn(
    dataset: Path,
    store: str = ".demoplan",
    root: Path | None = None,
    segmenter: str = "auto",
    workers: Workers = 2,
    runner: Runner = None,
    address: Address = None,
) -> NewVersion:
    """Learn a dataset's domain; a new version, with its difference, if the evidence changed it.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Where the store is: a folder, or s3://BUCKET/PREFIX.
        root: Where the logs are, if the manifest does not say.
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Workers at once: processes for episodes, and planners.
        runner: Who works on episodes: processes, threads, dask or ray; by default DEMOPLAN_RUNNER says.
        address: Of a Dask or Ray cluster that is there already; without it, one is started on this machine.
    """
    version = await learn_dataset(dataset, store, root, segmenter, workplace(runner, address, workers))
    await show_episodes(version.learned.version.dataset, version.states)
    await show_version(version.learned.version.dataset, version)
    return version
