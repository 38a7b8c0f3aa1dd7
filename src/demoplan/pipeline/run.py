"""The main job: logs to activities, domains, plans, scores and a report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import dataframely as dy
import polars as pl

import demoplan
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset, remember
from demoplan.pipeline.domains.learning import Learned
from demoplan.pipeline.domains.study import COMBINED, Tried, learn_all, try_goals
from demoplan.pipeline.episodes.activities import MAJORITY, segment_dataset, segment_episodes
from demoplan.pipeline.episodes.episode_tables import tables_of
from demoplan.pipeline.episodes.ingest import ingest_dataset
from demoplan.pipeline.episodes.segment_stages import ChosenSegmenter
from demoplan.pipeline.episodes.segmenters import (
    METHODS,
    RULE_TREES,
    groups_of,
    rules,
    segmenters_for,
    trained,
    usable,
)
from demoplan.pipeline.reporting import Progress, silent
from demoplan.stages.learn import LearnParams
from demoplan.stages.missing import rank_missing
from demoplan.stages.score import confusion, majority_activities, score_segmentation
from demoplan.stages.score_plans import score_plans
from demoplan.stages.segment import RULE_ACTIVITIES, Segmenter, TrainParams
from demoplan.store import EpisodeState, Store
from demoplan.tables import Activities, Confusions, Episodes, Plans, Scores, Topics
from demoplan.viewers.report import (
    Confusion,
    DomainText,
    Failure,
    Reference,
    RefutedPlan,
    ReportContent,
    render_report,
)

FRESH = "fresh "
"""Put before the groups of trials of people who are not part of the dataset."""

FRESH_SUITE = ", fresh participants"
"""Put behind the suites of scores of people who are not part of the dataset."""

REFERENCES = (
    Reference(
        suite="segmentation",
        metric="frame accuracy",
        value=0.874,
        source="Ramirez-Amaro, Beetz, Cheng, AIJ 2017",
    ),
    Reference(
        suite="planning",
        metric="domains that solve every goal",
        value=11 / 12,
        source="Diehl & Ramirez-Amaro, work-in-progress paper: 11 of 12",
    ),
)


@dataclass(frozen=True, kw_only=True)
class RunResult:
    """What the main job made."""

    states: tuple[EpisodeState, ...]
    learned: dict[str, Learned]
    tried: tuple[Tried, ...]
    scores: dy.DataFrame[Scores]
    confusions: dy.DataFrame[Confusions]
    method: str
    report: str
    """Where the report is: a path, or a URL below that of the store."""


@dataclass(frozen=True, kw_only=True)
class _Part:
    """What was made of one dataset."""

    opened: OpenDataset
    states: tuple[EpisodeState, ...]
    segmenters: dict[str, ChosenSegmenter]
    learned: dict[str, Learned]
    tried: tuple[Tried, ...]

    @property
    def method(self) -> str:
        return next(iter(self.segmenters.values())).method


def run(
    opened: OpenDataset,
    store: Store,
    *,
    segmenter: str = "auto",
    n_workers: int = 1,
    crew: Crew | None = None,
    progress: Progress = silent,
    fresh: OpenDataset | None = None,
    learning: LearnParams = LearnParams(),
) -> RunResult:
    """Do everything for a dataset; what is up to date is not done again.

    Args:
        opened: The dataset.
        store: Where everything is kept.
        segmenter: ``auto``, ``rules``, a training method, or a segmenter's file. An episode is never
            segmented by what was trained on its own participant.
        n_workers: Processes of this machine, and planners at once.
        crew: Who works on episodes in place of these processes.
        progress: How to say how far it is.
        fresh: A dataset of other people, in no way part of the first, to try the same on. Their activities
            are found by a segmenter trained on the first dataset only.
        learning: How operators are learned.

    Raises:
        UsageError: If nothing of the dataset can be used.
    """

    def choose(states: Sequence[EpisodeState]) -> dict[str, ChosenSegmenter]:
        return segmenters_for(opened, store, states, segmenter)

    crew = crew or Processes(n_workers)
    remember(opened, store, segmenter=segmenter)
    main = _work(opened, store, choose, crew, n_workers, progress, learning)
    scores, confusions = _score_activities(main, store)
    parts = [main]
    if fresh is not None:
        outside = _for_others(opened, store, main)
        part = _work(
            fresh,
            store,
            lambda states: {s.episode_id: outside for s in usable(states)},
            crew,
            n_workers,
            progress,
            learning,
        )
        fresh_scores, _ = _score_activities(part, store)
        scores = _joined(scores, fresh_scores.with_columns(pl.col("suite") + FRESH_SUITE))
        parts.append(part)
    trials = [
        replace(tried.trial, group=(FRESH if part is not main else "") + tried.trial.group)
        for part in parts
        for tried in part.tried
    ]
    scores = _joined(scores, score_plans(trials, main.method))
    store.snapshots.take(store.manifest.episodes(), f"run {opened.dataset.name}")
    report = f"reports/{opened.dataset.name}.html"
    store.place.write(report, _report(main, parts, store, scores, confusions).encode())
    return RunResult(
        states=tuple(state for part in parts for state in part.states),
        learned=main.learned,
        tried=tuple(tried for part in parts for tried in part.tried),
        scores=scores,
        confusions=confusions,
        method=main.method,
        report=f"{store.location}/{report}",
    )


def _work(
    opened: OpenDataset,
    store: Store,
    choose: Callable[[Sequence[EpisodeState]], dict[str, ChosenSegmenter]],
    crew: Crew,
    n_workers: int,
    progress: Progress,
    learning: LearnParams,
) -> _Part:
    """Ingest, segment, learn and plan, for one dataset."""
    name = opened.dataset.name
    states = ingest_dataset(opened, store, crew=crew, progress=progress)
    states, segmenters = segment_dataset(opened, store, states, choose, crew=crew, progress=progress)
    with progress(f"{name}: learn", len(usable(states)) + 1) as done:
        learned = learn_all(opened, store, states, params=learning, crew=crew, on_done=done)
    with progress(f"{name}: plan", len(learned) * len(opened.dataset.goals)) as done:
        tried = try_goals(opened, store, learned, n_workers=n_workers, on_done=done)
    return _Part(
        opened=opened,
        states=tuple(states),
        segmenters=segmenters,
        learned=learned,
        tried=tuple(tried),
    )


def _for_others(opened: OpenDataset, store: Store, main: _Part) -> ChosenSegmenter:
    """The segmenter for people who are not part of a dataset: trained on all of it, by the same method."""
    one = next(iter(main.segmenters.values()))
    if not isinstance(one.segmenter, Segmenter) or one.method not in METHODS:
        return one
    params = TrainParams(method=one.method)  # type: ignore[arg-type]
    return trained(opened, store, main.states, params)


def _joined(*scores: pl.DataFrame) -> dy.DataFrame[Scores]:
    return Scores.validate(pl.concat(scores))


def _score_activities(part: _Part, store: Store) -> tuple[dy.DataFrame[Scores], dy.DataFrame[Confusions]]:
    """What was inferred against what is true, beside the published rules and the naive alternative."""
    labelled = [s for s in part.states if "labels" in s.tables and "activities" in s.tables]
    if not labelled:
        return Scores.create_empty(), Confusions.create_empty()
    truth = tables_of(store, labelled, "labels", Activities)
    found = {part.method: tables_of(store, labelled, "activities", Activities)}
    names = set(truth["activity"])
    # Rules that speak of other activities than the labels do would only be scored for their words.
    comparable = set(RULE_TREES) if set(RULE_ACTIVITIES) <= names else set()
    for name in sorted(comparable - {part.method}):
        chosen = {state.episode_id: rules(name) for state in labelled}
        by_rules = segment_episodes(part.opened, store, labelled, chosen, is_kept=False)
        found[name] = tables_of(store, by_rules, "activities", Activities)
    found[MAJORITY] = majority_activities(truth)
    groups = groups_of(part.opened)
    return (
        _joined(*(score_segmentation(found[m], truth, m, groups=groups) for m in sorted(found))),
        confusion(found[part.method], truth, part.method),
    )


def _report(
    main: _Part,
    parts: Sequence[_Part],
    store: Store,
    scores: dy.DataFrame[Scores],
    confusions: dy.DataFrame[Confusions],
) -> str:
    """The page that a person reads, from the tables."""
    states = main.states
    combined = main.learned[COMBINED]
    plans = [tried.plans for tried in main.tried]
    goals = {tried.plans.item(0, "goal"): tried.goal.name for tried in main.tried if tried.plans.height}
    # The combined domain first: it is the one that people come for.
    ordered = sorted(main.learned.items(), key=lambda item: (item[0] != COMBINED, item[0]))
    names = {learned.version.domain_id: name for name, learned in ordered}
    failures = [
        Failure(kind="plan", subject=f"{t.trial.domain}: {t.trial.goal}", cause=t.trial.cause)
        for part in parts
        for t in part.tried
        if t.trial.cause is not None
    ]
    lacking = rank_missing({tried.goal.name: tried.missing for tried in main.tried if tried.missing})
    failures += [
        Failure(
            kind="missing knowledge", subject=str(each), cause=f"would give a plan for {', '.join(opened)}"
        )
        for each, opened in lacking
    ]
    return render_report(
        ReportContent(
            dataset=main.opened.dataset.name,
            description=main.opened.dataset.description,
            episodes=tables_of(store, states, "episodes", Episodes),
            versions=(
                ("demoplan", demoplan.__version__),
                ("dataset snapshot", combined.version.snapshot[:16]),
                ("domain", combined.version.domain_id),
                ("code of learning", combined.version.code_version),
            ),
            topics=tables_of(store, states, "topics", Topics),
            activities=tables_of(store, states, "activities", Activities),
            truth=tables_of(store, states, "labels", Activities),
            scores=scores,
            methods=(main.method,),
            references=REFERENCES,
            confusions=_matrices(confusions),
            operators=combined.operators,
            literals=combined.literals,
            evidence=combined.evidence,
            findings=combined.findings,
            domains=tuple(
                DomainText(
                    domain_id=domain_id,
                    name=name,
                    text=main.learned[name].text if name == COMBINED else "",
                    n_operators=len(main.learned[name].domain.operators),
                    is_main=name == COMBINED,
                )
                for domain_id, name in names.items()
            ),
            plans=Plans.validate(
                pl.concat(plans).unique(Plans.primary_key(), keep="first", maintain_order=True)
            )
            if plans
            else None,
            goals=tuple(goals.items()),
            refuted=tuple(
                RefutedPlan(
                    domain_id=tried.learned.version.domain_id,
                    goal=tried.plans.item(0, "goal"),
                    cause=tried.trial.cause,
                )
                for tried in main.tried
                if tried.trial.cause is not None and tried.plans.item(0, "is_validated")
            ),
            failures=tuple(failures),
        )
    )


def _matrices(confusions: dy.DataFrame[Confusions]) -> tuple[Confusion, ...]:
    """The overall confusion of each method, in seconds."""
    matrices = []
    for (method,), rows in confusions.filter(pl.col("subject") == "all").group_by(
        "method", maintain_order=True
    ):
        labels = tuple(sorted(set(rows["truth"]) | set(rows["predicted"])))
        spent = {(t, p): d for t, p, d in rows.select("truth", "predicted", "duration_ns").iter_rows()}
        matrices.append(
            Confusion(
                method=str(method),
                labels=labels,
                counts=tuple(tuple(round(spent.get((t, p), 0) / 1e9) for p in labels) for t in labels),
                unit="seconds",
            )
        )
    return tuple(matrices)
