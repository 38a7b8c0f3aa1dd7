"""What is stale in a store, again."""

import asyncio
import os
from pathlib import Path

from prefect import flow, task
from prefect.artifacts import acreate_markdown_artifact

from demoplan.pipeline.reprocess import Reprocessed
from demoplan.pipeline.reprocess import reprocess as run_again
from demoplan.pipeline.staleness import StalePlan, find_stale, selected, total_cost_s
from demoplan.store import Store
from flows.edges import EDGE
from flows.inputs import Workers
from flows.progress import ArtifactProgress
from flows.showing import changes_text, key_of, show_stale


@task(name="find what is stale", tags=["disk"], **EDGE)
async def look(store: Path) -> StalePlan:
    """What is stale, and why; nothing is run."""
    return await asyncio.to_thread(find_stale, Store(store), dict(os.environ))


@task(name="run what is stale", tags=["disk", "cpu"], **EDGE)
async def work(store: Path, where: str | None, workers: int) -> Reprocessed:
    """Run what is stale now: looked up again, so that a second try does not repeat what the first did."""
    plan = await asyncio.to_thread(find_stale, Store(store), dict(os.environ))
    rows = selected(plan, where)
    return await asyncio.to_thread(
        run_again, Store(store), plan, rows, n_workers=workers, progress=ArtifactProgress()
    )


@flow(name="reprocess", persist_result=False)
async def reprocess(
    store: Path = Path(".demoplan"),
    where: str | None = None,
    dry_run: bool = False,
    workers: Workers = 2,
) -> Reprocessed | None:
    """Say what is stale and why, then run exactly that.

    Args:
        store: Folder of the store.
        where: Only what fits, as SQL: ``participant = 'p1' AND reason = 'code'``.
        dry_run: Only say what is stale.
        workers: Processes for ingesting, and planners at once.
    """
    rows = selected(await look(store), where)
    await show_stale(rows, total_cost_s(rows)[0])
    if dry_run or (rows["reason"] == "blocked").all():
        return None
    result = await work(store, where, workers)
    for name, changes in sorted(result.changes.items()):
        text = changes_text("the version before", changes)
        await acreate_markdown_artifact(key=key_of("domain-diff", name), markdown=f"# {name}\n\n{text}")
    return result
