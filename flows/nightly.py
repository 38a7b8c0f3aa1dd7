"""The whole night: what changed is done again, what arrived is ingested, then learn and evaluate."""

from pathlib import Path

from prefect import flow

from flows.evaluate import evaluate
from flows.ingest import ingest
from flows.inputs import QuietSeconds, Workers
from flows.learn import learn
from flows.reprocess import reprocess


@flow(name="nightly", persist_result=False)
async def nightly(
    dataset: Path,
    store: Path = Path(".demoplan"),
    root: Path | None = None,
    pattern: str | None = None,
    quiet_s: QuietSeconds = 30.0,
    segmenter: str = "auto",
    workers: Workers = 2,
) -> str:
    """Reprocess, ingest, learn, evaluate; the id of the domain that stands in the morning.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Folder of the store.
        root: Where the logs are, if the manifest does not say.
        pattern: Takes up logs that arrived: a regular expression over their names with the groups participant
            and task. Without it, only what the manifest names is ingested.
        quiet_s: Logs that changed less than this ago are left alone [s].
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Processes for ingesting, and planners at once.
    """
    await reprocess(store, workers=workers)
    await ingest(dataset, store, root, pattern, quiet_s, workers)
    version = await learn(dataset, store, root, segmenter, workers)
    await evaluate(dataset, store, root, segmenter, workers)
    return version.learned.version.domain_id
