"""Logs to facts, by the thousand: what is up to date is skipped, what is bad is set aside with its reason."""

import random
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import dataframely as dy
import polars as pl

from demoplan.errors import DemoplanError, StoreError
from demoplan.ids import ContentHash, content_hash
from demoplan.manifests.dataset import Episode
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset, remember
from demoplan.pipeline.episodes.episode_stages import (
    ChangedLogError,
    IngestJob,
    is_standing,
    jobs_of,
    log_hash,
    run_stages,
)
from demoplan.pipeline.episodes.episode_tables import EpisodeTables
from demoplan.pipeline.episodes.memory import keep_memory
from demoplan.pipeline.episodes.orders import IngestOrder, Setting, keep_setting, setting_of
from demoplan.pipeline.episodes.seen import Seen, SeenLogs, settled_signature, signature_of
from demoplan.pipeline.reporting import Progress, silent
from demoplan.store import EpisodeState, Store
from demoplan.store.index import Index
from demoplan.store.store import canonical_json
from demoplan.tables import Episodes, Frames

__all__ = ["IngestJob", "ingest", "ingest_dataset", "ingest_episode", "ingest_group", "jobs_of"]

LATER_STAGES = ("segment", "contrast")
LATER_TABLES = ("activities", "transitions")
"""What comes of an episode after ingesting, and stays when it is ingested again with the same result."""

MOST_IN_GROUP = 16
"""Episodes that one worker takes at once: they become durable together, which is most of the waiting."""
MOST_BYTES_IN_GROUP = 64 << 20
"""Logs of a group, so that little is done again if its worker dies."""
LEAST_GROUPS = 8
"""Of few episodes, groups are smaller: nobody is to be idle while another has many."""


@dataclass(frozen=True, kw_only=True)
class Ingested:
    """What a worker gives back of one episode."""

    state: EpisodeState
    seen: Seen | None
    """Its log, as it was read; None if it could not be."""
    row: Mapping[str, object]
    """Its row in the table of episodes, which is stored already."""


def ingest_dataset(
    opened: OpenDataset, store: Store, *, crew: Crew = Processes(1), progress: Progress = silent
) -> list[EpisodeState]:
    """Read, align and perceive every episode of a dataset, and keep the dataset's manifest with it.

    Args:
        opened: The dataset.
        store: Where everything is kept.
        crew: Who does it.
        progress: How to say how far it is.
    """
    remember(opened, store)
    jobs = jobs_of(opened, store, opened.dataset.episodes)
    with progress(f"{opened.dataset.name}: read, align, perceive", len(jobs)) as done:
        return ingest(jobs, crew=crew, on_done=lambda s: done(f"{s.episode_id} {s.status}"))


def ingest_episode(job: IngestJob, store: Store | None = None) -> EpisodeState:
    """Read, align and perceive one episode; a log that cannot be used is quarantined with its reason.

    A log that changes while it is read is read once more, and quarantined if it changes again.

    Args:
        job: What to ingest.
        store: The job's store, if it is open already.

    Returns:
        What the store now holds of the episode. Nothing of the manifest is changed here.
    """
    return _ingested(job, store or Store(job.store)).state


def _ingested(job: IngestJob, store: Store) -> Ingested:
    keep_memory()
    try:
        return _tried(job, store)
    except ChangedLogError:
        pass
    try:
        return _tried(job, store)
    except ChangedLogError as error:
        return _settled(job, EpisodeTables(store), None, "quarantined", str(error))


def _tried(job: IngestJob, store: Store) -> Ingested:
    tables = EpisodeTables(store)
    sha256, signature = None, ""
    try:
        if job.known_sha256 is None:
            signature = settled_signature(signature_of(job.log))
        sha256 = log_hash(job)
        run_stages(job, tables, sha256)
        status, reason = tables.notes.get("status", "complete"), tables.notes.get("reason") or None
    except (StoreError, ChangedLogError):
        raise
    except (DemoplanError, pl.exceptions.PolarsError, dy.exc.ValidationError) as error:
        status, reason = "quarantined", str(error)
    done = _settled(job, tables, sha256, status, reason)
    if sha256 is None:
        return done
    return replace(done, seen=Seen(signature=signature, sha256=sha256, row=_row_of(job, done.state, sha256)))


def _settled(
    job: IngestJob, tables: EpisodeTables, sha256: str | None, status: str, reason: str | None
) -> Ingested:
    """What the store now holds of an episode, with its row in the table of episodes."""
    store, episode = tables.store, job.episode
    extent = _extent(tables)
    row = {
        "episode_id": episode.id,
        "dataset": job.dataset,
        "file": episode.file,
        "sha256": sha256,
        "participant": episode.participant,
        "task": episode.task,
        "is_goal_reached": episode.is_goal_reached,
        "status": status,
        "reason": reason,
        "start_ns": extent[0],
        "end_ns": extent[1],
    }
    contents = tables.contents | {"episodes": _stored_row(store, row)}
    attempt = tables.attempt if status == "quarantined" else None
    state = EpisodeState(
        dataset=job.dataset,
        episode_id=episode.id,
        tables=contents,
        keys=tables.keys,
        status=status,
        reason=reason,
        attempt=attempt,
    )
    return Ingested(state=state, seen=None, row=row)


def _stored_row(store: Store, row: Mapping[str, object]) -> str:
    """The content hash of a table of episodes that has just this row."""
    table = pl.DataFrame(
        {name: [value] for name, value in row.items()},
        schema_overrides={
            "sha256": pl.String,
            "is_goal_reached": pl.Boolean,
            "reason": pl.String,
            "start_ns": pl.Int64,
            "end_ns": pl.Int64,
        },
    )
    return str(store.objects.put(table, Episodes))


def _extent(tables: EpisodeTables) -> tuple[int | None, int | None]:
    if "frames" not in tables.contents:
        return None, None
    if tables.is_long("frames"):
        stated = tables.store.objects.extent(ContentHash(tables.contents["frames"]), "tick_ns")
        if stated is not None:
            return stated
    ticks = tables.get("frames", Frames)["tick_ns"]
    return (int(ticks.min()), int(ticks.max())) if len(ticks) else (None, None)  # type: ignore[arg-type]


def _row_of(job: IngestJob, state: EpisodeState, sha256: str) -> str:
    """Hash of all that an episode's row in the table ``episodes`` is made of."""
    episode = job.episode
    said = [job.dataset, episode.id, episode.file, episode.participant, episode.task, episode.is_goal_reached]
    return content_hash(
        canonical_json([*said, sha256, state.status, state.reason, state.tables.get("frames")])
    )


def ingest(
    jobs: Sequence[IngestJob],
    *,
    n_workers: int = 1,
    crew: Crew | None = None,
    on_done: Callable[[EpisodeState], None],
) -> list[EpisodeState]:
    """Ingest episodes, and write what became of each into the manifest.

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
    store = Store(jobs[0].store)
    before = {(state.dataset, state.episode_id): state for state in store.manifest.episodes()}
    waiting = []
    with Ledger(store) as ledger:
        index = store.index()
        for job in jobs:
            old = before.get((job.dataset, job.episode.id))
            if old is None or not stands(job, old, ledger.seen, index):
                waiting.append(job)
                continue
            states.append(old)
            on_done(old)
        for done in _run(store, waiting, crew or Processes(n_workers)):
            old = before.get((done.state.dataset, done.state.episode_id))
            state = _with_what_still_holds(done.state, old)
            ledger.note(state, done.seen, done.row)
            states.append(state)
            on_done(state)
    return sorted(states, key=lambda state: state.episode_id)


def stands(job: IngestJob, state: EpisodeState, seen: SeenLogs, index: Index) -> bool:
    """Whether nothing of an episode is to be done again: its log, what it is read with, what is said of it.

    No file is read but those with true labels. Where the log was changed lately, or was never seen, the
    answer is no, and its content decides later.
    """
    last = seen.of(job.dataset, job.episode.id)
    try:
        if last is None or seen.sha256_of(job.dataset, job.episode.id, job.log) is None:
            return False
        if job.episode.sha256 not in (None, last.sha256):
            return False
        return last.row == _row_of(job, state, last.sha256) and is_standing(job, state, last.sha256, index)
    except DemoplanError:
        return False


class Ledger:
    """Writes what became of episodes into the manifest, many at a time, and all that is left at the end.

    What a killed run has not written is found again by its records.
    """

    def __init__(self, store: Store, least_s: float = 1.0, most_share: float = 0.05) -> None:
        """Write at most so often, and for at most that share of the time."""
        self.seen = SeenLogs(store)
        self._store = store
        self._least_s, self._most_share = least_s, most_share
        self._states: list[EpisodeState] = []
        self._rows: dict[str, Mapping[str, object]] = {}
        """By content hash."""
        self._due_s = time.monotonic() + least_s

    def __enter__(self) -> "Ledger":
        return self

    def __exit__(self, *_: object) -> None:
        self._write()

    def note(
        self, state: EpisodeState, seen: Seen | None = None, row: Mapping[str, object] | None = None
    ) -> None:
        """Take up an episode."""
        self._states.append(state)
        if row is not None:
            self._rows[state.tables["episodes"]] = row
        if seen is not None:
            self.seen.note(state.dataset, state.episode_id, seen)
        if time.monotonic() >= self._due_s:
            self._write()

    def _write(self) -> None:
        start_s = time.monotonic()
        if self._states:
            with self._store.naming():
                # No record names these rows, so they may have been swept before the manifest could.
                for content, row in self._rows.items():
                    if not self._store.objects.has(ContentHash(content)):
                        _stored_row(self._store, row)
                self._store.manifest.update(self._states)
            self._states, self._rows = [], {}
        self.seen.keep()
        now_s = time.monotonic()
        self._due_s = now_s + max(self._least_s, (now_s - start_s) / self._most_share)


def _with_what_still_holds(new: EpisodeState, old: EpisodeState | None) -> EpisodeState:
    """Activities and what was made of them stay, as long as they were made from the same frames and facts."""
    if old is None or new.status == "quarantined":
        return new
    if any(new.tables.get(name) != old.tables.get(name) for name in ("frames", "facts")):
        return new
    later = {name: old.tables[name] for name in LATER_TABLES if name in old.tables}
    keys = {stage: old.keys[stage] for stage in LATER_STAGES if stage in old.keys}
    return replace(new, tables=later | new.tables, keys=keys | new.keys)


def _run(store: Store, jobs: Sequence[IngestJob], crew: Crew) -> Iterator[Ingested]:
    """Have every job done; of a group whose worker died, each is tried alone."""
    settings: dict[tuple[int, int], ContentHash] = {}
    by_order: dict[IngestOrder, IngestJob] = {}
    for job in jobs:
        shared = id(job.mapping), id(job.vocabulary)
        if shared not in settings:
            settings[shared] = _keep_setting(job)
        by_order[_order_of(job, settings[shared])] = job
    suspects: list[tuple[IngestOrder, ...]] = []
    groups = grouped(list(by_order), size_of=_n_bytes)
    # Of several runs on one store, each takes another order, and finds done what the others did meanwhile.
    random.SystemRandom().shuffle(groups)
    for group, done in crew(ingest_group, groups):
        if done is not None:
            yield from done
        elif len(group) == 1:
            yield _died(by_order[group[0]], store)
        else:
            suspects += [(order,) for order in group]
    for (order,), done in crew(ingest_group, suspects) if suspects else ():
        yield from done if done is not None else [_died(by_order[order], store)]


def _n_bytes(order: IngestOrder) -> int:
    try:
        return order.log.stat().st_size
    except OSError:
        return 0


def grouped(
    orders: Sequence[IngestOrder], size_of: Callable[[IngestOrder], int]
) -> list[tuple[IngestOrder, ...]]:
    """Orders in groups for one worker each: not too many, not too large, and not too few groups."""
    most = max(1, min(MOST_IN_GROUP, len(orders) // LEAST_GROUPS))
    groups: list[list[IngestOrder]] = []
    n_bytes = 0
    for order in orders:
        size = size_of(order)
        if not groups or len(groups[-1]) >= most or n_bytes + size > MOST_BYTES_IN_GROUP:
            groups.append([])
            n_bytes = 0
        groups[-1].append(order)
        n_bytes += size
    return [tuple(group) for group in groups]


def _keep_setting(job: IngestJob) -> ContentHash:
    setting = Setting(
        dataset=job.dataset,
        label_format=job.label_format,
        mapping=job.mapping,
        vocabulary=job.vocabulary,
        definitions_root=job.definitions_root,
        tick_rate_hz=job.tick_rate_hz,
    )
    return keep_setting(job.store, setting)


def _order_of(job: IngestJob, setting: ContentHash) -> IngestOrder:
    return IngestOrder(
        store=job.store,
        setting=setting,
        episode=job.episode.model_dump_json(),
        log=job.log,
        labels=job.labels,
        known_sha256=job.known_sha256,
    )


def ingest_group(orders: tuple[IngestOrder, ...]) -> list[Ingested]:
    """Ingest the episodes of some orders; this is what a crew's workers run.

    Raises:
        StoreError: If the store cannot be read or written there.
    """
    store = Store(orders[0].store)
    with store.together():
        return [_ingested(_job_of(order), store) for order in orders]


def _job_of(order: IngestOrder) -> IngestJob:
    setting = setting_of(order.store, order.setting)
    return IngestJob(
        store=order.store,
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


def _died(job: IngestJob, store: Store) -> Ingested:
    """What is known of an episode whose worker died each time it was tried."""
    reason = f"{job.log}: every process that read it died (out of memory?)"
    return _settled(job, EpisodeTables(store), None, "quarantined", reason)
