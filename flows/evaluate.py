"""Domains to success: every domain of a dataset is tried on every goal, on paper and by robots in physics."""

import asyncio
from pathlib import Path
from typing import Annotated, Literal

from prefect import flow, task
from pydantic import Field

from demoplan.pipeline.execution.simulate import Batch, Simulated, keep_report, simulate
from demoplan.pipeline.run import RunResult, run
from flows.crews import Workplace, in_crew, workplace
from flows.edges import EDGE
from flows.inputs import Address, Runner, Workers, opened, store_at
from flows.progress import ArtifactProgress
from flows.showing import show_links, show_success
from flows.showing_runs import show_runs

Seeds = Annotated[int, Field(ge=1, le=10_000)]
Robot = Literal["gripper", "gripper_dual", "tiago", "tiago_dual"]


@task(name="plan and score", tags=["cpu", "planner"], **EDGE)
async def run_study(
    dataset: Path, store: str, root: Path | None, segmenter: str, place: Workplace
) -> RunResult:
    """The planning study of a dataset; attempts that were made before are not made again."""
    data, kept, n_workers = opened(dataset, root), store_at(store), place.n_workers
    return await in_crew(
        place,
        lambda crew, progress: run(
            data, kept, segmenter=segmenter, n_workers=n_workers, crew=crew, progress=progress
        ),
    )


@task(name="simulate", tags=["cpu", "simulation"], **EDGE)
async def run_robots(store: str, batch: Batch, workers: int) -> Simulated:
    """Robots carry the plans out; runs that were made before are not made again."""
    progress = ArtifactProgress()
    return await asyncio.to_thread(simulate, store_at(store), batch, n_workers=workers, progress=progress)


@flow(name="evaluate", persist_result=False)
async def evaluate(
    dataset: Path,
    store: str = ".demoplan",
    root: Path | None = None,
    segmenter: str = "auto",
    workers: Workers = 2,
    runner: Runner = None,
    address: Address = None,
    goals: Path | None = None,
    robot: Robot = "gripper",
    seeds: Seeds = 3,
    faults: Path | None = None,
) -> RunResult:
    """Plan for every goal with every domain, score, and write the report; with a goals file, simulate too.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Where the store is: a folder, or s3://BUCKET/PREFIX.
        root: Where the logs are, if the manifest does not say.
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Workers at once: processes for episodes, and planners.
        runner: Who works on episodes: processes, threads, dask or ray; by default DEMOPLAN_RUNNER says.
        address: Of a Dask or Ray cluster that is there already; without it, one is started on this machine.
        goals: Goals file: robots carry out every domain's plans for them, in scenes drawn from seeds.
        robot: Which robot.
        seeds: How many scenes for each domain and goal.
        faults: Faults file: what goes wrong in further runs, one fault at a time.
    """
    result = await run_study(dataset, store, root, segmenter, workplace(runner, address, workers))
    name = result.states[0].dataset
    await show_success(name, result.tried)
    await show_links(store_at(store), name, result.report)
    if goals is not None:
        batch = Batch(
            domains=(name, f"{name}--*"),
            goals=goals.absolute(),
            seeds=range(seeds),
            robot=robot,
            faults=faults and faults.absolute(),
        )
        simulated = await run_robots(store, batch, workers)
        report = keep_report(store_at(store), f"{name}-{robot}", simulated, title=f"{name}: {robot}")
        await show_runs(name, robot, simulated.evaluation, report)
    return result
