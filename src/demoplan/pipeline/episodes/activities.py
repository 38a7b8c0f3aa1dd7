"""Facts to activities to transitions, for many episodes, over the store."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import dataframely as dy
import polars as pl

from demoplan.errors import UnknownNameError, UsageError
from demoplan.ids import ContentHash
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.episodes.episode_tables import EpisodeTables, tables_of
from demoplan.pipeline.episodes.ingest import MOST_IN_GROUP, Ledger, ingest_dataset
from demoplan.pipeline.episodes.memory import keep_memory
from demoplan.pipeline.episodes.orders import keep_setting, setting_of, setting_of_dataset
from demoplan.pipeline.episodes.segment_stages import (
    ChosenSegmenter,
    Contrasted,
    SegmentRecipe,
    contrast_stage,
    is_contrasted,
    segment_stage,
)
from demoplan.pipeline.episodes.segmenters import (
    METHODS,
    entity_types,
    groups_of,
    segmenter_at,
    segmenters_for,
    trained,
    usable,
)
from demoplan.pipeline.reporting import Progress, silent
from demoplan.stages.score import confusion, majority_activities, score_segmentation
from demoplan.stages.segment import (
    Segmenter,
    SegmentParams,
    TrainParams,
    render_segmenter,
)
from demoplan.store import EpisodeState, Store
from demoplan.tables import Activities, Confusions, Scores

MAJORITY = "most frequent activity"
"""Name of the naive alternative to a segmenter."""

MANY = 64
"""Fewer episodes than this are segmented here: each takes some 20 ms, and starting a process two seconds."""


def segment_episodes(
    opened: OpenDataset,
    store: Store,
    states: Sequence[EpisodeState],
    segmenters: Mapping[str, ChosenSegmenter],
    *,
    params: SegmentParams = SegmentParams(),
    is_kept: bool = True,
    crew: Crew = Processes(1),
    on_done: Callable[[EpisodeState], None] = lambda _: None,
) -> list[EpisodeState]:
    """Activities and transitions of every usable episode; the others come back as they are.

    Args:
        opened: The dataset.
        store: Where the episodes' tables are.
        states: The episodes.
        segmenters: The segmenter of each episode.
        params: Segmentation choices.
        is_kept: Whether the manifest names the results as what now stands for the episodes.
        crew: Who does it, if it is many.
        on_done: Called with each episode when it is done.
    """
    results = {state.episode_id: state for state in states}
    changed: list[EpisodeState] = []
    waiting: dict[str, list[EpisodeState]] = {}
    recipe, index = recipe_of(opened, params), store.index()
    for state in states:
        by = segmenters.get(state.episode_id)
        found = state if by is None else recipe.standing(state, by, index)
        if found is not None:
            results[state.episode_id] = found
            changed += [found] if found != state else []
            on_done(found)
        elif by is not None:
            waiting.setdefault(by.content, []).append(state)
    orders = _orders_of(opened, store, waiting, segmenters, params)
    n_waiting = sum(len(order.states) for order in orders)
    with Ledger(store) as ledger:
        for state in changed if is_kept else ():
            ledger.note(state)
        for result in _segmented(crew if n_waiting >= MANY else Processes(1), orders):
            results[result.episode_id] = result
            if is_kept:
                ledger.note(result)
            on_done(result)
    return list(results.values())


def segment_dataset(
    opened: OpenDataset,
    store: Store,
    states: Sequence[EpisodeState],
    choose: Callable[[Sequence[EpisodeState]], dict[str, ChosenSegmenter]],
    *,
    crew: Crew = Processes(1),
    progress: Progress = silent,
) -> tuple[list[EpisodeState], dict[str, ChosenSegmenter]]:
    """Choose segmenters, training them where they are trained, and segment every usable episode with its own.

    Args:
        opened: The dataset.
        store: Where the episodes' tables are.
        states: The episodes, ingested.
        choose: From episodes to the segmenter of each; see ``segmenters_for``.
        crew: Who does it, if it is many.
        progress: How to say how far it is.
    """
    with progress(f"{opened.dataset.name}: segment", len(states)) as done:
        chosen = choose(states)
        segmented = segment_episodes(
            opened, store, states, chosen, crew=crew, on_done=lambda state: done(state.episode_id)
        )
    return segmented, chosen


def recipe_of(opened: OpenDataset, params: SegmentParams = SegmentParams()) -> SegmentRecipe:
    """What a dataset's episodes are segmented with, besides a segmenter."""
    return SegmentRecipe(entities=entity_types(opened), types=opened.vocabulary.types, params=params)


@dataclass(frozen=True, kw_only=True)
class SegmentOrder:
    """Some episodes to segment: hashes of their tables, and where their segmenter is."""

    store: str
    setting: ContentHash
    states: tuple[EpisodeState, ...]
    segmenter: str
    content: str
    params: SegmentParams


def _orders_of(
    opened: OpenDataset,
    store: Store,
    waiting: Mapping[str, Sequence[EpisodeState]],
    segmenters: Mapping[str, ChosenSegmenter],
    params: SegmentParams,
) -> list[SegmentOrder]:
    """Groups of episodes that have one segmenter."""
    if not waiting:
        return []
    setting = keep_setting(store.location, setting_of_dataset(opened))
    return [
        SegmentOrder(
            store=store.location,
            setting=setting,
            states=tuple(members[start : start + MOST_IN_GROUP]),
            segmenter=segmenters[members[0].episode_id].source,
            content=content,
            params=params,
        )
        for content, members in waiting.items()
        for start in range(0, len(members), MOST_IN_GROUP)
    ]


def _segmented(crew: Crew, orders: Sequence[SegmentOrder]) -> Iterator[EpisodeState]:
    """Have every order done; of a group whose worker died, each episode is tried alone."""
    suspects: list[SegmentOrder] = []
    for order, done in crew(segment_group, orders):
        if done is not None:
            yield from done
        else:
            suspects += [replace(order, states=(state,)) for state in order.states]
    for order, done in crew(segment_group, suspects) if suspects else ():
        reason = "every process that segmented it died (out of memory?)"
        yield from done or [replace(order.states[0], status="quarantined", reason=reason)]


def segment_group(order: SegmentOrder) -> list[EpisodeState]:
    """Segment the episodes of an order; this is what a crew's workers run.

    Raises:
        StoreError: If the store cannot be read or written there, or the segmenter has changed meanwhile.
    """
    keep_memory()
    store = Store(order.store)
    chosen = segmenter_at(order.store, order.segmenter, order.content)
    setting = setting_of(order.store, order.setting)
    recipe = SegmentRecipe(entities=setting.entities, types=setting.vocabulary.types, params=order.params)
    with store.together():
        found = []
        for state in order.states:
            tables = EpisodeTables(store)
            segment_stage(state, chosen, tables, recipe)
            found.append(tables)
        changed = Contrasted(recipe, [tables for tables in found if not is_contrasted(tables, recipe)])
        for tables in found:
            contrast_stage(tables, recipe, changed)
    return [
        replace(state, tables=tables.contents, keys=state.keys | tables.keys)
        for state, tables in zip(order.states, found, strict=True)
    ]


def train_on(
    opened: OpenDataset,
    store: Store,
    *,
    method: str,
    split: str | None,
    n_workers: int,
    progress: Progress = silent,
) -> tuple[ChosenSegmenter, str]:
    """A segmenter fitted to every labelled episode of a dataset, or of one of its splits, and its text.

    Raises:
        UsageError: If the method is unknown, or there are no labels.
        UnknownNameError: If the split is unknown.
    """
    if method not in METHODS:
        raise UnknownNameError("method", method, METHODS)
    if split is not None and split not in opened.dataset.splits:
        raise UnknownNameError("split", split, opened.dataset.splits, opened.dataset.name)
    members = opened.dataset.splits[split] if split else [e.id for e in opened.dataset.episodes]
    ingested = ingest_dataset(opened, store, crew=Processes(n_workers), progress=progress)
    states = [state for state in ingested if state.episode_id in members]
    chosen = trained(opened, store, states, TrainParams(method=method))  # type: ignore[arg-type]
    assert isinstance(chosen.segmenter, Segmenter)
    return chosen, render_segmenter(chosen.segmenter)


def score_methods(
    opened: OpenDataset,
    store: Store,
    *,
    methods: Sequence[str],
    n_workers: int,
    progress: Progress = silent,
) -> tuple[dy.DataFrame[Scores], dy.DataFrame[Confusions]]:
    """How good segmenters are on a dataset's labels, beside the naive alternative.

    A training method is fitted anew for every participant (for every take, if there is one participant)
    without that participant's episodes. A segmenter's file is taken as it is: whether it has seen the
    episodes is for the caller to know.

    Raises:
        UsageError: If no episode has labels, or a method is unknown.
    """
    ingested = ingest_dataset(opened, store, crew=Processes(n_workers), progress=progress)
    states = [state for state in usable(ingested) if "labels" in state.tables]
    if not states:
        raise UsageError(f"{opened.dataset.name}: no episode has true labels to score against")
    truth = tables_of(store, states, "labels", Activities)
    groups = groups_of(opened)
    scores, confusions = [], []
    naive = majority_activities(truth)
    scores.append(score_segmentation(naive, truth, MAJORITY, groups=groups))
    with progress(f"{opened.dataset.name}: segment", len(methods)) as done:
        for method in methods:
            segmenters = segmenters_for(opened, store, states, method)
            found = segment_episodes(opened, store, states, segmenters, is_kept=False)
            activities = tables_of(store, found, "activities", Activities)
            scores.append(score_segmentation(activities, truth, method, groups=groups))
            confusions.append(confusion(activities, truth, method))
            done(method)
    return Scores.validate(pl.concat(scores)), Confusions.validate(pl.concat(confusions))
