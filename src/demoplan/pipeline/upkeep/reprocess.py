"""Run again what is stale, and nothing else."""

from dataclasses import dataclass, replace
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.language.diff import Change
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import remember
from demoplan.pipeline.domains.learning import (
    Learned,
    changes_between,
    learn_domain,
    params_of,
    stored_domain,
)
from demoplan.pipeline.episodes.activities import segment_episodes
from demoplan.pipeline.episodes.ingest import ingest
from demoplan.pipeline.episodes.segment_stages import ChosenSegmenter
from demoplan.pipeline.episodes.segmenters import read_segmenter, trained, training_of
from demoplan.pipeline.reporting import Progress, silent
from demoplan.pipeline.upkeep.staleness import DatasetPlan, Staleness, StalePlan
from demoplan.store import EpisodeState, Store

_OF_FACTS = ("segment", "contrast")
_OF_LOGS = ("read", "align", "perceive", "labels", "episodes")


@dataclass(frozen=True, kw_only=True)
class Reprocessed:
    """What was run again."""

    states: tuple[EpisodeState, ...]
    """Episodes of which a stage ran, as they stand now."""
    learned: tuple[Learned, ...]
    """Domains that were learned again."""
    changes: dict[str, tuple[Change, ...]]
    """Name of each of these domains → what differs from the version before, if that is another one."""
    snapshot_id: str


def reprocess(
    store: Store,
    plan: StalePlan,
    rows: dy.DataFrame[Staleness],
    *,
    n_workers: int = 1,
    crew: Crew | None = None,
    progress: Progress = silent,
) -> Reprocessed:
    """Run what some rows of a plan say.

    Killed at any moment, it loses nothing: what was finished is not stale any more.

    Args:
        store: The store.
        plan: What is stale.
        rows: What to run; see ``selected``. Rows that are blocked are left out.
        n_workers: Processes of this machine.
        crew: Who works on episodes in place of these processes.
        progress: How to say how far it is.
    """
    crew = crew or Processes(n_workers)
    states: dict[tuple[str, str], EpisodeState] = {}
    learned: list[Learned] = []
    changes: dict[str, tuple[Change, ...]] = {}
    running = rows.filter(pl.col("reason") != "blocked")
    for name, part in sorted(plan.datasets.items()):
        mine = running.filter(pl.col("dataset") == name)
        if mine.is_empty():
            continue
        for state in _episodes(store, part, mine, crew, progress):
            states[name, state.episode_id] = state
        domains = sorted(mine.drop_nulls("domain")["domain"])
        if domains:
            standing = {s.episode_id: s for s in store.manifest.episodes(name)}
            with progress(f"{name}: learn", len(domains)) as done:
                for domain in domains:
                    members = [standing[each] for each in part.domains[domain] if each in standing]
                    if not any("transitions" in state.tables for state in members):
                        continue  # every episode of it was set aside: the domain stays as it is
                    before = stored_domain(store, domain)
                    now = learn_domain(
                        store,
                        members,
                        part.opened.vocabulary,
                        name=domain,
                        dataset=name,
                        params=params_of(before.version),
                        crew=crew,
                    )
                    learned.append(now)
                    if now.version.domain_id != before.version.domain_id:
                        changes[domain] = changes_between(before, now)
                    done(domain)
        whole = plan.rows.filter((pl.col("dataset") == name) & (pl.col("reason") != "blocked"))
        if mine.height == whole.height:
            # Kept only now: until everything follows the new manifest, the next look must see the old one.
            remember(part.opened, store)
    return Reprocessed(
        states=tuple(state for _, state in sorted(states.items())),
        learned=tuple(learned),
        changes=changes,
        snapshot_id=store.snapshots.take(store.manifest.episodes(), "reprocess"),
    )


def _episodes(
    store: Store, part: DatasetPlan, rows: pl.DataFrame, crew: Crew, progress: Progress
) -> list[EpisodeState]:
    """Run the stale stages of one dataset's episodes."""
    name = part.opened.dataset.name
    from_logs = set(rows.filter(pl.col("stage").is_in(_OF_LOGS)).drop_nulls("episode_id")["episode_id"])
    from_facts = set(rows.filter(pl.col("stage").is_in(_OF_FACTS)).drop_nulls("episode_id")["episode_id"])
    before = {s.episode_id: s for s in store.manifest.episodes() if s.dataset == name}
    ran: dict[str, EpisodeState] = {}
    jobs = [part.jobs[each] for each in sorted(from_logs)]
    if jobs:
        with progress(f"{name}: read, align, perceive", len(jobs)) as done:
            for state in ingest(jobs, crew=crew, on_done=lambda s: done(f"{s.episode_id} {s.status}")):
                old = before.get(state.episode_id)
                ran[state.episode_id] = _with_labels(part, state, old)
        store.manifest.update(ran.values())
    if from_facts and part.segmenter is not None:
        standing = store.manifest.episodes(name)
        listed = {episode.id for episode in part.opened.dataset.episodes}
        standing = [state for state in standing if state.episode_id in listed]
        segmenters = _segmenters(store, part, standing, from_facts)
        chosen = [state for state in standing if state.episode_id in segmenters]
        with progress(f"{name}: segment", len(chosen)) as done:
            for state in segment_episodes(
                part.opened, store, chosen, segmenters, crew=crew, on_done=lambda s: done(s.episode_id)
            ):
                ran[state.episode_id] = state
    return list(ran.values())


def _with_labels(part: DatasetPlan, state: EpisodeState, old: EpisodeState | None) -> EpisodeState:
    """True labels stay what they were where their file is away with its log."""
    job = part.jobs[state.episode_id]
    is_away = job.known_sha256 is not None and job.labels is None and job.episode.labels is not None
    if not is_away or old is None or "labels" not in old.tables:
        return state
    return replace(
        state,
        tables=state.tables | {"labels": old.tables["labels"]},
        keys=state.keys | {"labels": old.keys["labels"]},
    )


def _segmenters(
    store: Store, part: DatasetPlan, states: list[EpisodeState], wanted: set[str]
) -> dict[str, ChosenSegmenter]:
    """The segmenters of some episodes; only those are trained that are needed."""
    assert part.segmenter is not None
    here = [state.episode_id for state in states if state.episode_id in wanted and "facts" in state.tables]
    if Path(part.segmenter).is_absolute():
        return dict.fromkeys(here, read_segmenter(Path(part.segmenter)))
    training = training_of(part.opened, states, part.segmenter)
    if isinstance(training, ChosenSegmenter):
        return dict.fromkeys(here, training)
    by_group = {
        group: trained(part.opened, store, others, training.params)
        for group, others in training.sets.items()
        if any(training.groups[each] == group for each in here)
    }
    return {each: by_group[training.groups[each]] for each in here if training.groups[each] in by_group}
