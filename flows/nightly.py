"""The whole night: what changed is done again, what arrived is ingested, then learn and evaluate."""

from pathlib import Path

from prefect import flow

from flows.evaluate import evaluate
from flows.ingest import ingest
from flows.inputs import Address, Bucket, QuietSeconds, Runner, Workers
from flows.learn import learn
from flows.reprocess import reprocess
from flows.showing import show_run


@flow(name="nightly", persist_result=False)
async def nightly(
    dataset: Path,
    store: str = ".demoplan",
    root: Path | None = None,
    pattern: str | None = None,
    quiet_s: QuietSeconds = 30.0,
    segmenter: str = "auto",
    workers: Workers = 2,
    runner: Runner = None,
    address: Address = None,
    bucket: Bucket = None,
) -> str:
    """Reprocess, ingest, learn, evaluate; the id of the domain that stands in the morning.

    Args:
        dataset: Folder with dataset.yaml, or the file.
        store: Where the store is: a folder, or s3://BUCKET/PREFIX.
        root: Where the logs are, if the manifest does not say.
        pattern: Takes up logs that arrived: a regular expression over their names with the groups participant
            and task. Without it, only what the manifest names is ingested.
        quiet_s: Logs that changed less than this ago are left alone [s].
        segmenter: auto, rules, a training method, or a segmenter's file, as ``demoplan run`` takes it.
        workers: Workers at once: processes for episodes, and planners.
        runner: Who works on episodes: processes, threads, dask or ray; by default DEMOPLAN_RUNNER says.
        address: Of a Dask or Ray cluster that is there already; without it, one is started on this machine.
        bucket: Logs in s3://BUCKET/PREFIX that are not here yet are fetched first; with a pattern, taken up.
    """
    await reprocess(store, workers=workers, runner=runner, address=address)
    await ingest(dataset, store, root, pattern, quiet_s, workers, runner, address, bucket)
    version = await learn(dataset, store, root, segmenter, workers, runner, address)
    result = await evaluate(dataset, store, root, segmenter, workers, runner, address)
    await show_run(version.learned.version.dataset, version, result)
    return version.learned.version.domain_id
