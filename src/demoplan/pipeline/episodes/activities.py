"""Facts to activities to transitions, over the store; and the training of segmenters."""

import functools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.errors import StoreError, UnknownNameError, UsageError
from demoplan.ids import ContentHash, content_hash
from demoplan.manifests.loading import read_text
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.episodes.episode_tables import EpisodeTables
from demoplan.pipeline.episodes.ingest import MOST_IN_GROUP, Ledger, ingest_dataset
from demoplan.pipeline.episodes.memory import keep_memory
from demoplan.pipeline.episodes.orders import keep_setting, setting_of, setting_of_dataset, types_of_entities
from demoplan.pipeline.episodes.segment_stages import (
    ChosenSegmenter,
    Contrasted,
    SegmentRecipe,
    contrast_stage,
    is_contrasted,
    segment_stage,
)
from demoplan.pipeline.reporting import Progress, silent
from demoplan.stages.score import confusion, majority_activities, score_segmentation
from demoplan.stages.segment import (
    PUBLISHED_RULES,
    RULES,
    Segmenter,
    SegmentParams,
    TrainParams,
    parse_segmenter,
    render_segmenter,
    train,
)
from demoplan.store import EpisodeState, Store, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.objects import Table
from demoplan.store.opening import open_place
from demoplan.store.places import AbsentError
from demoplan.store.store import canonical_json
from demoplan.tables import Activities, Confusions, Facts, Frames, Scores

MAJORITY = "most frequent activity"
"""Name of the naive alternative to a segmenter."""

RULE_TREES = {"rules": RULES, "published_rules": PUBLISHED_RULES}
"""What needs no labels: the published rule tree with memory for its thresholds, and as it was published."""

MANY = 64
"""Fewer episodes than this are segmented here: each takes some 20 ms, and starting a process two seconds."""

METHODS = ("decision_tree", "distilled_tree", "random_forest", "extra_trees", "gradient_boosting")


def usable(states: Iterable[EpisodeState]) -> list[EpisodeState]:
    """The episodes whose facts are there: quarantined ones are left out."""
    return [state for state in states if state.status != "quarantined" and "facts" in state.tables]


def rules(name: str = "rules") -> ChosenSegmenter:
    """A rule tree by its name; it needs no labels."""
    tree = RULE_TREES[name]
    content = content_hash(canonical_json(asdict(tree)))
    return ChosenSegmenter(segmenter=tree, method=name, content=content, source=name)


def read_segmenter(path: Path) -> ChosenSegmenter:
    """A segmenter that ``demoplan segmenter train`` wrote.

    Raises:
        UsageError: If the file cannot be read.
        DataError: If it is not a segmenter.
    """
    return _parsed(read_text(path), path.name, str(path.absolute()))


def stored_segmenter(store: Store, key: ContentHash) -> ChosenSegmenter | None:
    """The segmenter that training under that key gave; None if there is none.

    Raises:
        DataError: If it is not a segmenter.
    """
    name = f"segmenters/{key}.json"
    try:
        return _parsed(store.place.read(name).decode(), name, name)
    except AbsentError:
        return None


def _parsed(text: str, method: str, source: str) -> ChosenSegmenter:
    return ChosenSegmenter(
        segmenter=parse_segmenter(text), method=method, content=content_hash(text), source=source
    )


def tables_of(
    store: Store, states: Sequence[EpisodeState], name: str, schema: type[Table]
) -> dy.DataFrame[Table]:
    """One table of several episodes, joined in order of episode."""
    return schema.cast(store.joined([s.tables[name] for s in states if name in s.tables], schema))


def trained(
    opened: OpenDataset, store: Store, states: Sequence[EpisodeState], params: TrainParams
) -> ChosenSegmenter:
    """A segmenter fitted to the labelled ones of these episodes; found in the store if it was fitted before.

    Raises:
        UsageError: If none of the episodes has labels.
    """
    labelled = [state for state in usable(states) if "labels" in state.tables]
    if not labelled:
        raise UsageError(
            f"{opened.dataset.name}: none of {len(states)} episodes has true labels to train from; "
            f"`--segmenter rules` needs none"
        )
    key = training_key(opened, labelled, params)
    found = stored_segmenter(store, key)
    if found is None:
        start = time.perf_counter()
        segmenter = train(
            tables_of(store, labelled, "frames", Frames),
            tables_of(store, labelled, "facts", Facts),
            tables_of(store, labelled, "labels", Activities),
            entity_types(opened),
            opened.vocabulary.types,
            params=params,
        )
        store.place.write(f"segmenters/{key}.json", render_segmenter(segmenter).encode())
        store.timings.note("train", key, time.perf_counter() - start)
        found = stored_segmenter(store, key)
        assert found is not None
    return replace(found, method=params.method)


def training_key(opened: OpenDataset, states: Iterable[EpisodeState], params: TrainParams) -> ContentHash:
    """What names the segmenter that training on the labelled ones of these episodes gives."""
    inputs = {
        f"{state.episode_id}/{name}": state.tables[name]
        for state in states
        if "labels" in state.tables
        for name in ("frames", "facts", "labels")
    }
    version = code_version("demoplan.stages.segment")
    settings = canonical_json(
        {
            "params": asdict(params),
            "entities": entity_types(opened),
            "types": opened.vocabulary.types.parents,
        }
    )
    return stage_key("train", inputs, settings, version)


def entity_types(opened: OpenDataset) -> dict[str, str]:
    """Instance → type, as the dataset's mapping says."""
    return types_of_entities(opened.dataset.mapping)


def groups_of(opened: OpenDataset) -> dict[str, str]:
    """Episode → what is left out together with it: its participant, or itself where there is only one."""
    participants = {episode.id: episode.participant for episode in opened.dataset.episodes}
    if len(set(participants.values())) > 1:
        return participants
    return {name: name for name in participants}


@dataclass(frozen=True, kw_only=True)
class Training:
    """Which segmenters a dataset needs, so that none has seen an episode that it is used on."""

    params: TrainParams
    groups: Mapping[str, str]
    """Episode → group."""
    sets: Mapping[str, tuple[EpisodeState, ...]]
    """Group → the usable episodes of all other groups."""


def segmenters_for(
    opened: OpenDataset, store: Store, states: Sequence[EpisodeState], method: str
) -> dict[str, ChosenSegmenter]:
    """The segmenter of each episode: never one that has seen the episode's own group.

    Args:
        opened: The dataset.
        store: Where the episodes' tables are.
        states: The episodes.
        method: ``rules``, ``published_rules``, a training method, ``auto``: a decision tree if labels
            allow it, else the rules; or a segmenter's file: whether that has seen the episodes is for the
            caller to know.

    Raises:
        UsageError: If the method is unknown, or there are labels of one group only.
        DataError: If the file is not a segmenter.
    """
    good = usable(states)
    if Path(method).is_file():
        return dict.fromkeys((state.episode_id for state in good), read_segmenter(Path(method)))
    training = training_of(opened, states, method)
    if isinstance(training, ChosenSegmenter):
        return {state.episode_id: training for state in good}
    by_group = {
        group: trained(opened, store, others, training.params) for group, others in training.sets.items()
    }
    return {state.episode_id: by_group[training.groups[state.episode_id]] for state in good}


def training_of(
    opened: OpenDataset, states: Sequence[EpisodeState], method: str
) -> Training | ChosenSegmenter:
    """What must be trained for ``segmenters_for``, or the rule tree that serves every episode.

    Raises:
        UsageError: If the method is unknown, or there are labels of one group only.
    """
    if method not in ("auto", *RULE_TREES, *METHODS):
        raise UsageError(
            f"unknown segmenter {method!r}; known: auto, {', '.join((*RULE_TREES, *METHODS))}, or a file"
        )
    groups = groups_of(opened)
    good = usable(states)
    labelled = {groups[state.episode_id] for state in good if "labels" in state.tables}
    if method in RULE_TREES or (method == "auto" and len(labelled) < 2):
        return rules(method if method in RULE_TREES else "rules")
    if len(labelled) < 2:
        raise UsageError(
            f"{opened.dataset.name}: an episode may not be segmented by what was trained on it, and labels "
            f"are there for {len(labelled)} group(s) only; use `--segmenter rules` or a file"
        )
    return Training(
        params=TrainParams(method="decision_tree" if method == "auto" else method),  # type: ignore[arg-type]
        groups=groups,
        sets={
            group: tuple(s for s in good if groups[s.episode_id] != group)
            for group in sorted({groups[state.episode_id] for state in good})
        },
    )


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
    chosen = _segmenter_of(order.store, order.segmenter, order.content)
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


@functools.lru_cache(maxsize=32)
def _segmenter_of(store: str, source: str, content: str) -> ChosenSegmenter:
    if source in RULE_TREES:
        chosen = rules(source)
    elif Path(source).is_absolute():
        chosen = read_segmenter(Path(source))
    else:
        chosen = _parsed(open_place(store).read(source).decode(), source, source)
    if chosen.content != content:
        raise StoreError(f"{source}: is not the segmenter that was chosen; it has changed: run again")
    return chosen


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
