"""What is stale, and why: every stage is looked up under the key that it would have now, and none is run."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.errors import DemoplanError, LogError, ManifestError, StoreError, UsageError
from demoplan.ids import ContentHash
from demoplan.pipeline.datasets import OpenDataset, recall, remembered, reopen, segmenter_of
from demoplan.pipeline.domains.learning import learn_call, params_of
from demoplan.pipeline.episodes.activities import recipe_of
from demoplan.pipeline.episodes.episode_stages import IngestJob, jobs_of, log_hash, run_stages
from demoplan.pipeline.episodes.episode_tables import EpisodeTables
from demoplan.pipeline.episodes.ingest import stands
from demoplan.pipeline.episodes.seen import SeenLogs
from demoplan.pipeline.episodes.segment_stages import ChosenSegmenter, contrast_stage, segment_stage
from demoplan.pipeline.episodes.segmenters import (
    read_segmenter,
    stored_segmenter,
    training_key,
    training_of,
    usable,
)
from demoplan.pipeline.upkeep.reasons import PENDING, reason_of
from demoplan.store import EpisodeState, Store, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.timings import Estimates

OUTPUTS = {
    "read": ("samples", "topics"),
    "align": ("frames",),
    "perceive": ("facts",),
    "labels": ("labels",),
    "segment": ("activities",),
    "contrast": ("transitions",),
}
"""Stages of an episode, in order, and the tables that they give."""

REASONS = ("new", "schema", "code", "parameters", "input", "upstream", "output", "blocked")

_DESCRIPTION = ("file", "participant", "task", "is_goal_reached")
"""What a dataset's manifest says of an episode and its table ``episodes`` repeats."""


class Staleness(dy.Schema):
    """One row per stage run whose output is not in the store, or is not what the manifest names."""

    dataset = dy.String(description="Dataset that it belongs to")
    episode_id = dy.String(nullable=True, description="The demonstration; null for domains and training")
    domain = dy.String(nullable=True, description="Name of the domain; null for episodes and training")
    participant = dy.String(nullable=True, description="Who demonstrates")
    task = dy.String(nullable=True, description="What was to be done")
    status = dy.String(nullable=True, description="What became of the episode when it last ran")
    stage = dy.String(
        description="read, align, perceive, labels, segment, contrast, episodes, train or learn"
    )
    reason = dy.Enum(
        REASONS,
        description="What differs from its last run: schema of its output, code, parameters, input; new: it "
        "never ran; upstream: a stage before it is stale, and it runs if that gives something else; output: "
        "its output is gone; blocked: it cannot run",
    )
    detail = dy.String(description="The reason in words")
    cost_s = dy.Float64(
        nullable=True,
        description="Time that its last run took, or such a stage takes",
        metadata={"unit": "s"},
    )


@dataclass(frozen=True, kw_only=True)
class DatasetPlan:
    """What is known of one dataset before anything is run."""

    opened: OpenDataset
    jobs: Mapping[str, IngestJob]
    """Episode → how it would be ingested."""
    segmenter: str | None
    """What its activities are found with; None if they were never found, or not by what the store knows."""
    domains: Mapping[str, tuple[str, ...]]
    """Name of each of its domains → episodes to learn it from."""


@dataclass(frozen=True, kw_only=True)
class StalePlan:
    """Everything that is stale, and what is needed to run it."""

    rows: dy.DataFrame[Staleness]
    datasets: Mapping[str, DatasetPlan]


def find_stale(
    store: Store,
    environment: Mapping[str, str] | None = None,
    on_done: Callable[[str], None] = lambda _: None,
) -> StalePlan:
    """Say what is stale in a store; nothing is run, and nothing is written.

    Datasets are taken as their manifests are now. A log that is not there any more counts as unchanged.

    Args:
        store: The store.
        environment: Variables that may name where logs are.
        on_done: Called with the name of each dataset.
    """
    rows: list[dict[str, object]] = []
    datasets = {}
    for name in remembered(store):
        try:
            opened = reopen(store, name, environment)
        except (ManifestError, UsageError) as error:
            rows.append(_row(name, "read", ("blocked", str(error)), None))
            continue
        plan, found = _DatasetWalk(store, opened, recall(store, name)).walk()
        datasets[name] = plan
        rows += found
        on_done(name)
    frame = pl.DataFrame(rows, schema=Staleness.create_empty().schema)
    return StalePlan(rows=Staleness.validate(frame), datasets=datasets)


class _PlannedTables(EpisodeTables):
    """Looks every stage up and runs none; the output of a stale one is pending."""

    def __init__(self, store: Store, state: EpisodeState | None, estimates: Estimates) -> None:
        super().__init__(store)
        self._state = state
        self._estimates = estimates
        self.found: list[tuple[str, tuple[str, str], float | None]] = []
        """Stage, reason and detail, cost of each stale stage."""

    def run(
        self,
        stage: str,
        *,
        modules: Sequence[str],
        inputs: dict[str, str],
        params: str,
        make: Callable[[], object],
    ) -> bool:
        version, text = code_version(*modules), params
        record = self.store.find(stage, inputs, text, version)
        if record is not None:
            self.contents |= record.outputs
            self.keys[stage] = str(record.key)
            self.notes |= record.notes
            if self._known(stage) != record.key:
                # It ran so once, as before a change that was taken back: only the manifest must follow.
                reason = reason_of(self.store, stage, self._known(stage), inputs, text, version)
                self.found.append((stage, reason, 0.0))
            return False
        if self._state is not None and stage_key(stage, inputs, text, version) == self._state.attempt:
            raise _SettledError
        key = self._known(stage)
        reason = reason_of(self.store, stage, key, inputs, text, version)
        self.found.append((stage, reason, self._estimates.of(stage, key)))
        self.contents |= dict.fromkeys(OUTPUTS[stage], PENDING)
        return False

    def _known(self, stage: str) -> str | None:
        """Key of the stage's last run, if the manifest names one."""
        return self._state.keys.get(stage) if self._state is not None else None


class _SettledError(Exception):
    """The very same run failed before, and would fail again."""


@dataclass
class _DatasetWalk:
    """One walk over one dataset."""

    store: Store
    opened: OpenDataset
    known: OpenDataset
    """The dataset as the store last saw it."""

    def __post_init__(self) -> None:
        self.name = self.opened.dataset.name
        self.estimates = Estimates(self.store.timings)
        self.rows: list[dict[str, object]] = []
        self.index = self.store.index()
        self.seen = SeenLogs(self.store)
        everything = self.store.manifest.episodes()
        self.states = {s.episode_id: s for s in everything if s.dataset == self.name}
        self.described = {e.id: e for e in self.known.dataset.episodes}

    def walk(self) -> tuple[DatasetPlan, list[dict[str, object]]]:
        segmenter = segmenter_of(self.store, self.name)
        jobs, assumed = {}, []
        for job in jobs_of(self.opened, self.store, self.opened.dataset.episodes):
            jobs[job.episode.id], state = self._episode(job)
            if state is not None:
                assumed.append(state)
        if segmenter is not None:
            assumed = self._activities(assumed, segmenter)
        domains = dict(self._domains(assumed))
        plan = DatasetPlan(opened=self.opened, jobs=jobs, segmenter=segmenter, domains=domains)
        return plan, self.rows

    def _add(self, state: EpisodeState | None, job: IngestJob, tables: _PlannedTables) -> None:
        for stage, reason, cost_s in tables.found:
            self.rows.append(_row(self.name, stage, reason, cost_s, job=job, state=state))

    def _episode(self, job: IngestJob) -> tuple[IngestJob, EpisodeState | None]:
        """How an episode would be ingested, and what would be known of it then; None if nothing would."""
        old = self.states.get(job.episode.id)
        if old is not None and stands(job, old, self.seen, self.index):
            return job, old
        job = _without_log(self.store, job, old)
        tables = _PlannedTables(self.store, old, self.estimates)
        try:
            if not job.log.exists() and job.known_sha256 is None:
                raise LogError(job.log, "is not there, and was never read")
            run_stages(job, tables, log_hash(job))
        except _SettledError:
            return job, old
        except StoreError:
            raise
        except DemoplanError as error:
            if old is None or old.status != "quarantined":
                self.rows.append(_row(self.name, "read", ("blocked", str(error)), None, job=job, state=old))
            return job, old
        if job.known_sha256 is not None and any(stage == "read" for stage, _, _ in tables.found):
            reason = ("blocked", f"{job.log} is not there any more, and would have to be read again")
            self.rows.append(_row(self.name, "read", reason, None, job=job, state=old))
            return job, old
        self._add(old, job, tables)
        known = self.described.get(job.episode.id)
        if old is not None and known is not None and not tables.found:
            changed = [
                f"{field}: {getattr(known, field)!r} → {getattr(job.episode, field)!r}"
                for field in _DESCRIPTION
                if getattr(known, field) != getattr(job.episode, field)
            ]
            if changed:
                reason = ("parameters", "; ".join(changed))
                self.rows.append(_row(self.name, "episodes", reason, 0.0, job=job, state=old))
        return job, EpisodeState(
            dataset=self.name,
            episode_id=job.episode.id,
            tables=(_later(old, tables) if old is not None else {}) | tables.contents,
            keys=(old.keys if old is not None else {}) | tables.keys,
        )

    def _activities(self, assumed: list[EpisodeState], segmenter: str) -> list[EpisodeState]:
        """What would be known after segmenting, with the rows of training and of stages from facts on."""
        chosen: dict[str, ChosenSegmenter]
        pending: dict[str, str] = {}
        try:
            if Path(segmenter).is_absolute():
                chosen = {s.episode_id: read_segmenter(Path(segmenter)) for s in usable(assumed)}
            else:
                chosen, pending = self._trained(assumed, segmenter)
        except (UsageError, DemoplanError) as error:
            self.rows.append(_row(self.name, "segment", ("blocked", str(error)), None))
            return assumed
        results = []
        jobs = {e.id: e for e in self.opened.dataset.episodes}
        recipe = recipe_of(self.opened)
        for state in assumed:
            by = chosen.get(state.episode_id)
            if by is None or recipe.standing(state, by, self.index) == state:
                results.append(state)
                continue
            old = self.states.get(state.episode_id)
            tables = _PlannedTables(self.store, old, self.estimates)
            segment_stage(state, by, tables, recipe)
            contrast_stage(tables, recipe)
            for stage, reason, cost_s in tables.found:
                told = reason
                if stage == "segment" and state.episode_id in pending and reason[0] == "input":
                    told = ("upstream", pending[state.episode_id])
                episode = jobs[state.episode_id]
                self.rows.append(
                    _row(self.name, stage, told, cost_s, state=old)
                    | {"episode_id": episode.id, "participant": episode.participant, "task": episode.task}
                )
            results.append(replace(state, tables=tables.contents, keys=state.keys | tables.keys))
        return results

    def _trained(
        self, assumed: list[EpisodeState], method: str
    ) -> tuple[dict[str, ChosenSegmenter], dict[str, str]]:
        """The segmenter of each episode, and of which of them it has yet to be trained, in words."""
        training = training_of(self.opened, assumed, method)
        good = usable(assumed)
        if isinstance(training, ChosenSegmenter):
            return {state.episode_id: training for state in good}, {}
        by_group: dict[str, ChosenSegmenter] = {}
        waiting: dict[str, str] = {}
        for group, others in training.sets.items():
            found = stored_segmenter(self.store, training_key(self.opened, others, training.params))
            if found is not None:
                by_group[group] = found
                continue
            # Whatever is pending has no segmenter yet; one that is not found must be trained.
            by_group[group] = replace(_ABSENT, method=training.params.method)
            waiting[group] = f"its segmenter, trained without {group}, is stale"
            detail = f"without {group}: {len(others)} episodes, their labels, code or parameters changed"
            self.rows.append(_row(self.name, "train", ("input", detail), self.estimates.of("train")))
        chosen = {s.episode_id: by_group[training.groups[s.episode_id]] for s in good}
        return chosen, {
            s.episode_id: waiting[training.groups[s.episode_id]]
            for s in good
            if training.groups[s.episode_id] in waiting
        }

    def _domains(self, assumed: list[EpisodeState]) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Domains that were learned from this dataset, and the episodes to learn them from now."""
        with_transitions = {s.episode_id: s for s in assumed if "transitions" in s.tables}
        latest = {v.name: v for v in self.store.domains.versions() if v.dataset == self.name}
        for name, version in sorted(latest.items()):
            wanted = with_transitions if name == self.name else version.episodes
            chosen = [with_transitions[each] for each in sorted(wanted) if each in with_transitions]
            if not chosen:
                continue
            yield name, tuple(state.episode_id for state in chosen)
            inputs, params, version_now = learn_call(chosen, self.opened.vocabulary, params_of(version))
            if self.store.find("learn", inputs, params, version_now) is not None:
                continue
            n_pending = sum(state.tables["transitions"] == PENDING for state in chosen)
            if version.code_version != version_now:
                reason = ("code", "the code of learning changed")
            elif n_pending:
                reason = (
                    "upstream",
                    f"{n_pending} of {len(chosen)} episodes that it is learned from are stale",
                )
            elif version.snapshot != inputs["transitions"]:
                reason = ("input", "the transitions that it is learned from changed")
            else:
                reason = ("parameters", "the parameters of learning, its types or its predicates changed")
            row = _row(self.name, "learn", reason, self.estimates.of("learn"))
            self.rows.append(row | {"domain": name})


_ABSENT = ChosenSegmenter(segmenter=None, method="", content=PENDING, source="")  # type: ignore[arg-type]
"""A segmenter that is yet to be trained; it is only ever looked at for its hash."""


def _without_log(store: Store, job: IngestJob, old: EpisodeState | None) -> IngestJob:
    """The job as it can be done if the log is away: by its hash, and without labels that are away with it."""
    if job.log.exists() or old is None or "read" not in old.keys:
        return job
    record = store.records.get("read", ContentHash(old.keys["read"]))
    if record is None:
        return job
    labels = job.labels if job.labels is not None and job.labels.is_file() else None
    return replace(job, known_sha256=record.inputs["log"], labels=labels)


def _later(old: EpisodeState, tables: EpisodeTables) -> dict[str, str]:
    """What of an episode's tables does not come from ingesting it, or could not be looked up."""
    return {name: content for name, content in old.tables.items() if name not in tables.contents}


def _row(
    dataset: str,
    stage: str,
    reason: tuple[str, str],
    cost_s: float | None,
    *,
    job: IngestJob | None = None,
    state: EpisodeState | None = None,
) -> dict[str, object]:
    return {
        "dataset": dataset,
        "episode_id": job.episode.id if job is not None else None,
        "domain": None,
        "participant": job.episode.participant if job is not None else None,
        "task": job.episode.task if job is not None else None,
        "status": state.status if state is not None else None,
        "stage": stage,
        "reason": reason[0],
        "detail": reason[1],
        "cost_s": cost_s,
    }


def selected(plan: StalePlan, where: str | None) -> dy.DataFrame[Staleness]:
    """The rows that a condition chooses, with all that must run with them.

    A condition chooses episodes and domains by any of their rows: a stage cannot run without those before
    it. Training goes with the episodes of its dataset; a domain goes with any episode of its own.

    Args:
        plan: What is stale.
        where: SQL condition over the columns of ``Staleness``; None chooses everything.

    Raises:
        UsageError: If the condition cannot be used.
    """
    if where is None:
        return plan.rows
    try:
        # Polars' own SQL, over one table in memory: there is nothing to inject into.
        query = f"SELECT * FROM stale WHERE {where}"  # noqa: S608
        hits = pl.SQLContext({"stale": plan.rows.with_columns(pl.col("reason").cast(pl.String))}).execute(
            query, eager=True
        )
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise UsageError(f"--where {where!r}: {error}; columns: {', '.join(plan.rows.columns)}") from None
    episodes = set(hits.drop_nulls("episode_id").select("dataset", "episode_id").iter_rows())
    domains = set(hits.drop_nulls("domain").select("dataset", "domain").iter_rows())
    for dataset, each in plan.datasets.items():
        for name, members in each.domains.items():
            if any((dataset, member) in episodes for member in members):
                domains.add((dataset, name))
    with_segment = {
        row["dataset"]
        for row in plan.rows.iter_rows(named=True)
        if row["stage"] == "segment" and (row["dataset"], row["episode_id"]) in episodes
    }
    keep = [
        (row["dataset"], row["episode_id"]) in episodes
        or (row["dataset"], row["domain"]) in domains
        or (row["stage"] == "train" and row["dataset"] in with_segment)
        for row in plan.rows.iter_rows(named=True)
    ]
    return Staleness.validate(plan.rows.filter(pl.Series(keep, dtype=pl.Boolean)))


def total_cost_s(rows: pl.DataFrame) -> tuple[float, int]:
    """Seconds that these rows take by what they took before, and of how many of them that is not known."""
    running = rows.filter(pl.col("reason") != "blocked")
    return float(running["cost_s"].sum()), int(running["cost_s"].null_count())
