"""Logs to facts, by episode: what is up to date is skipped, what is bad is set aside with its reason."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.errors import DataError, DemoplanError, LogError, StoreError
from demoplan.ids import ContentHash
from demoplan.language.vocabulary import Vocabulary
from demoplan.logs import fingerprint, open_log
from demoplan.manifests.dataset import Episode
from demoplan.manifests.labels import activities_of_labels
from demoplan.manifests.mapping import Mapping
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.memory import keep_memory
from demoplan.pipeline.orders import IngestOrder, Setting, keep_setting, setting_of
from demoplan.pipeline.plausibility import refuse_implausible
from demoplan.stages.align import AlignParams, align
from demoplan.stages.perceive import PerceiveParams, perceive
from demoplan.store import EpisodeState, Store, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.objects import Table
from demoplan.store.store import StageOutput, canonical_json
from demoplan.tables import Activities, Episodes, Facts, Frames, Samples, Topics

LATER_STAGES = ("segment", "contrast")
LATER_TABLES = ("activities", "transitions")
"""What comes of an episode after ingesting, and stays when it is ingested again with the same result."""


@dataclass(frozen=True, kw_only=True)
class IngestJob:
    """All that a process needs to ingest one episode."""

    store_root: Path
    dataset: str
    episode: Episode
    log: Path
    labels: Path | None
    label_format: str
    mapping: Mapping
    vocabulary: Vocabulary
    definitions_root: Path
    tick_rate_hz: float
    known_sha256: str | None = None
    """Hash of the log's bytes where it is not there to be read any more, but was read before."""


def jobs_of(opened: OpenDataset, store: Store, episodes: Sequence[Episode]) -> list[IngestJob]:
    """One job for each of these episodes."""
    return [
        IngestJob(
            store_root=store.root,
            dataset=opened.dataset.name,
            episode=episode,
            log=opened.log_of(episode),
            labels=opened.labels_of(episode),
            label_format=opened.dataset.label_format,
            mapping=opened.dataset.mapping,
            vocabulary=opened.vocabulary,
            definitions_root=opened.folder,
            tick_rate_hz=opened.dataset.tick_rate_hz,
        )
        for episode in episodes
    ]


class StaleError(Exception):
    """A stage would have to run, and may not."""


class EpisodeTables:
    """The tables of one episode while its stages run: kept in memory, stored as they come."""

    def __init__(self, store: Store, *, may_work: bool = True) -> None:
        """Run stages over ``store``; without ``may_work``, only find what is there already."""
        self.store = store
        self.may_work = may_work
        self._memory: dict[str, pl.DataFrame] = {}
        self.contents: dict[str, str] = {}
        self.keys: dict[str, str] = {}
        self.notes: dict[str, str] = {}
        self.attempt: str | None = None
        """Key of the stage that runs now; it stays if the stage fails."""

    def run(
        self,
        stage: str,
        *,
        modules: Sequence[str],
        inputs: dict[str, str],
        params: object,
        make: Callable[[], dict[str, tuple[pl.DataFrame, type[dy.Schema]]]],
    ) -> bool:
        """Run a stage if its output is not there; say whether it was made anew."""
        made: dict[str, pl.DataFrame] = {}

        def work() -> StageOutput:
            if not self.may_work:
                raise StaleError
            tables = make()
            made.update({name: table for name, (table, _) in tables.items()})
            return StageOutput(tables=tables, notes=dict(self.notes))

        version = code_version(*modules)
        self.attempt = str(stage_key(stage, inputs, canonical_json(params), version))
        record = self.store.run(stage, inputs, canonical_json(params), version, work)
        self.attempt = None
        self.contents |= record.outputs
        self.keys[stage] = str(record.key)
        self.notes |= record.notes
        for name, table in made.items():
            self._memory[record.outputs[name]] = table
        return bool(made)

    def get(self, name: str, schema: type[Table]) -> dy.DataFrame[Table]:
        """A table of this episode, from memory if it was made just now."""
        content = self.contents[name]
        if content in self._memory:
            return self._memory[content]  # type: ignore[return-value]
        return self.store.get(content, schema)


def _found(job: IngestJob) -> EpisodeState | None:
    """What the store holds of an episode, if nothing of it is stale."""
    try:
        return ingest_episode(job, may_work=False)
    except StaleError:
        return None


def ingest_episode(job: IngestJob, *, may_work: bool = True) -> EpisodeState:
    """Read, align and perceive one episode; a log that cannot be used is quarantined with its reason.

    Args:
        job: What to ingest.
        may_work: Whether stages may run whose output is not there.

    Returns:
        What the store now holds of the episode. Nothing of the manifest is changed here.
    """
    keep_memory()
    store = Store(job.store_root)
    tables = EpisodeTables(store, may_work=may_work)
    sha256: str | None = None
    try:
        sha256 = log_hash(job)
        run_stages(job, tables, sha256)
        status, reason = tables.notes.get("status", "complete"), tables.notes.get("reason") or None
    except StoreError:
        raise
    except (DemoplanError, pl.exceptions.PolarsError, dy.exc.ValidationError) as error:
        status, reason = "quarantined", str(error)
    return _settled(job, tables, sha256, status, reason)


def _settled(
    job: IngestJob, tables: EpisodeTables, sha256: str | None, status: str, reason: str | None
) -> EpisodeState:
    """What the store now holds of an episode, with its row in the table of episodes."""
    store, episode = tables.store, job.episode
    extent = _extent(tables)
    row = pl.DataFrame(
        {
            "episode_id": [episode.id],
            "dataset": [job.dataset],
            "file": [episode.file],
            "sha256": [sha256],
            "participant": [episode.participant],
            "task": [episode.task],
            "is_goal_reached": [episode.is_goal_reached],
            "status": [status],
            "reason": [reason],
            "start_ns": [extent[0]],
            "end_ns": [extent[1]],
        },
        schema_overrides={
            "sha256": pl.String,
            "is_goal_reached": pl.Boolean,
            "reason": pl.String,
            "start_ns": pl.Int64,
            "end_ns": pl.Int64,
        },
    )
    contents = tables.contents | {"episodes": str(store.objects.put(row, Episodes))}
    attempt = tables.attempt if status == "quarantined" else None
    return EpisodeState(
        dataset=job.dataset,
        episode_id=episode.id,
        tables=contents,
        keys=tables.keys,
        status=status,
        reason=reason,
        attempt=attempt,
    )


def log_hash(job: IngestJob) -> str:
    """The hash of the bytes of a job's log.

    Raises:
        LogError: If the log cannot be read, or is not the one that the dataset's manifest names.
    """
    sha256 = job.known_sha256 or str(fingerprint(job.log))
    if job.episode.sha256 is not None and job.episode.sha256 != sha256:
        raise LogError(
            job.log,
            f"its content is not what the manifest names: sha256 {sha256}, expected {job.episode.sha256}; "
            "it was changed or damaged on the way",
        )
    return sha256


def run_stages(job: IngestJob, tables: EpisodeTables, sha256: str) -> None:
    """Run every stage of ingesting an episode whose output is not there."""
    _read(job, tables, sha256)
    _align(job, tables)
    _perceive(job, tables)
    if job.labels is not None:
        _labels(job, tables)


def _read(job: IngestJob, tables: EpisodeTables, sha256: str) -> None:
    def make() -> dict[str, tuple[pl.DataFrame, type[dy.Schema]]]:
        stream = open_log(job.log, job.mapping, job.episode.id, definitions_root=job.definitions_root)
        batches = [*stream.batches()]
        samples = pl.concat(batches) if batches else Samples.create_empty()
        refuse_implausible(Samples.cast(samples), stream.topics, job.mapping)
        tables.notes |= {"status": stream.status, "reason": stream.reason or ""}
        return {"samples": (samples, Samples), "topics": (stream.topics, Topics)}

    tables.run(
        "read",
        modules=["demoplan.logs", "demoplan.pipeline.plausibility"],
        inputs={"log": sha256},
        params={"episode_id": job.episode.id, "mapping": job.mapping.model_dump(mode="json")},
        make=make,
    )


def _align(job: IngestJob, tables: EpisodeTables) -> None:
    params = AlignParams(tick_rate_hz=job.tick_rate_hz)
    tables.run(
        "align",
        modules=["demoplan.stages.align"],
        inputs={"samples": tables.contents["samples"]},
        params={"params": asdict(params), "mapping": job.mapping.model_dump(mode="json")},
        make=lambda: {"frames": (align(tables.get("samples", Samples), job.mapping, params), Frames)},
    )


def _perceive(job: IngestJob, tables: EpisodeTables) -> None:
    params = PerceiveParams()
    tables.run(
        "perceive",
        modules=["demoplan.stages.perceive"],
        inputs={"frames": tables.contents["frames"]},
        params={
            "params": asdict(params),
            "entities": {name: e.model_dump(mode="json") for name, e in job.mapping.entities.items()},
            "vocabulary": asdict(job.vocabulary),
        },
        make=lambda: {
            "facts": (
                perceive(tables.get("frames", Frames), job.mapping.entities, job.vocabulary, params),
                Facts,
            )
        },
    )


def _labels(job: IngestJob, tables: EpisodeTables) -> None:
    """True activities: stored apart, for training and scoring only."""
    assert job.labels is not None
    try:
        text = job.labels.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{job.labels}: labels cannot be read: {error}") from None
    tables.run(
        "labels",
        modules=["demoplan.manifests.labels"],
        inputs={"labels": text, "samples": tables.contents["samples"]},
        params={"format": job.label_format, "episode_id": job.episode.id},
        make=lambda: {
            "labels": (
                activities_of_labels(
                    json.loads(text), job.label_format, job.episode.id, tables.get("samples", Samples)
                ),
                Activities,
            )
        },
    )


def _extent(tables: EpisodeTables) -> tuple[int | None, int | None]:
    if "frames" not in tables.contents:
        return None, None
    ticks = tables.get("frames", Frames)["tick_ns"]
    return (int(ticks.min()), int(ticks.max())) if len(ticks) else (None, None)  # type: ignore[arg-type]


def ingest(
    jobs: Sequence[IngestJob],
    *,
    n_workers: int = 1,
    crew: Crew | None = None,
    on_done: Callable[[EpisodeState], None],
) -> list[EpisodeState]:
    """Ingest episodes, and write what became of each into the manifest as it ends.

    A process that dies takes only its own episode with it: that one is quarantined, the others go on.

    Args:
        jobs: What to ingest.
        n_workers: Processes of this machine.
        crew: Who works in place of these processes.
        on_done: Called with each episode as it ends.
    """
    states: list[EpisodeState] = []
    if not jobs:
        return states
    manifest = Store(jobs[0].store_root).manifest
    before = {(state.dataset, state.episode_id): state for state in manifest.episodes()}
    for found in _run(jobs, crew or Processes(n_workers)):
        state = _with_what_still_holds(found, before.get((found.dataset, found.episode_id)))
        manifest.update([state])
        states.append(state)
        on_done(state)
    return sorted(states, key=lambda state: state.episode_id)


def _with_what_still_holds(new: EpisodeState, old: EpisodeState | None) -> EpisodeState:
    """Activities and what was made of them stay, as long as they were made from the same frames and facts."""
    if old is None or new.status == "quarantined":
        return new
    if any(new.tables.get(name) != old.tables.get(name) for name in ("frames", "facts")):
        return new
    later = {name: old.tables[name] for name in LATER_TABLES if name in old.tables}
    keys = {stage: old.keys[stage] for stage in LATER_STAGES if stage in old.keys}
    return replace(new, tables=later | new.tables, keys=keys | new.keys)


def _run(jobs: Sequence[IngestJob], crew: Crew) -> Iterator[EpisodeState]:
    # Finding that nothing is stale is quicker than giving it to another process.
    waiting: dict[IngestOrder, IngestJob] = {}
    settings: dict[tuple[int, int], ContentHash] = {}
    for job in jobs:
        state = _found(job)
        if state is not None:
            yield state
            continue
        shared = id(job.mapping), id(job.vocabulary)
        if shared not in settings:
            settings[shared] = _keep_setting(job)
        waiting[_order_of(job, settings[shared])] = job
    for order, done in crew(ingest_order, list(waiting)):
        yield done if done is not None else _died(waiting[order])


def _keep_setting(job: IngestJob) -> ContentHash:
    setting = Setting(
        dataset=job.dataset,
        label_format=job.label_format,
        mapping=job.mapping,
        vocabulary=job.vocabulary,
        definitions_root=job.definitions_root,
        tick_rate_hz=job.tick_rate_hz,
    )
    return keep_setting(job.store_root, setting)


def _order_of(job: IngestJob, setting: ContentHash) -> IngestOrder:
    return IngestOrder(
        store_root=job.store_root,
        setting=setting,
        episode=job.episode.model_dump_json(),
        log=job.log,
        labels=job.labels,
        known_sha256=job.known_sha256,
    )


def ingest_order(order: IngestOrder) -> EpisodeState:
    """Ingest the episode of an order; this is what a crew's workers run.

    Raises:
        StoreError: If the store cannot be read or written there.
    """
    setting = setting_of(order.store_root, order.setting)
    return ingest_episode(
        IngestJob(
            store_root=order.store_root,
            dataset=setting.dataset,
            episode=Episode.model_validate_json(order.episode),
            log=order.log,
            labels=order.labels,
            label_format=setting.label_format,
            mapping=setting.mapping,
            vocabulary=setting.vocabulary,
            definitions_root=setting.definitions_root,
            tick_rate_hz=setting.tick_rate_hz,
            known_sha256=order.known_sha256,
        )
    )


def _died(job: IngestJob) -> EpisodeState:
    """What is known of an episode whose worker died each time it was tried."""
    reason = f"{job.log}: every process that read it died (out of memory?)"
    return _settled(job, EpisodeTables(Store(job.store_root)), None, "quarantined", reason)
