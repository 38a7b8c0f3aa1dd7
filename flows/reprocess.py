"""What is stale in a store, again."""

import asyncio
import os

from prefect import flow, task
from prefect.artifacts import acreate_markdown_artifact

from demoplan.pipeline.crews import Crew
from demoplan.pipeline.reporting import Progress
from demoplan.pipeline.upkeep.reprocess import Reprocessed
from demoplan.pipeline.upkeep.reprocess import reprocess as run_again
from demoplan.pipeline.upkeep.staleness import StalePlan, find_stale, selected, total_cost_s
from demoplan.store import Store
from flows.crews import Workplace, in_crew, workplace
from flows.edges import EDGE
from flows.inputs import Address, Runner, Workers, store_at
from flows.showing import changes_text, key_of, show_stale


@task(name="find what is stale", tags=["disk"], **EDGE)
async def look(store: str) -> StalePlan:
    """What is stale, and why; nothing is run."""
    return await asyncio.to_thread(find_stale, store_at(store), dict(os.environ))


@task(name="run what is stale", tags=["disk", "cpu"], **EDGE)
async def work(store: str, where: str | None, place: Workplace) -> Reprocessed:
    """Run what is stale now: looked up again, so that a second try does not repeat what the first did."""
    kept = store_at(store)
    return await in_crew(place, lambda crew, progress: _again(kept, where, crew, progress))


def _again(store: Store, where: str | None, crew: Crew, progress: Progress) -> Reprocessed:
    plan = find_stale(store, dict(os.environ))
    return run_again(store, plan, selected(plan, where), crew=crew, progress=progress)


@flow(name="reprocess", persist_result=False)
async def reprocess(
    store: str = ".demoplan",
    where: str | None = None,
    dry_run: bool = False,
    workers: Workers = 2,
    runner: Runner = None,
    address: Address = None,
) -> Reprocessed | None:
    """Say what is stale and why, then run exactly that.

    Args:
        store: Where the store is: a folder, or s3://BUCKET/PREFIX.
        where: Only what fits, as SQL: ``participant = 'p1' AND reason = 'code'``.
        dry_run: Only say what is stale.
        workers: Workers at once: processes for episodes, and planners.
        runner: Who works on episodes: processes, threads, dask or ray; by default DEMOPLAN_RUNNER says.
        address: Of a Dask or Ray cluster that is there already; without it, one is started on this machine.
    """
    rows = selected(await look(store), where)
    await show_stale(rows, total_cost_s(rows)[0])
    if dry_run or (rows["reason"] == "blocked").all():
        return None
    result = await work(store, where, workplace(runner, address, workers))
    for name, changes in sorted(result.changes.items()):
        text = changes_text("the version before", changes)
        await acreate_markdown_artifact(key=key_of("domain-diff", name), markdown=f"# {name}\n\n{text}")
    return result
