"""Which segmenter finds an episode's activities, and the training of those that are trained."""

import functools
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from demoplan.errors import StoreError, UsageError
from demoplan.ids import ContentHash, content_hash
from demoplan.manifests.loading import read_text
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.episodes.episode_tables import tables_of
from demoplan.pipeline.episodes.orders import types_of_entities
from demoplan.pipeline.episodes.segment_stages import ChosenSegmenter
from demoplan.stages.segment import (
    PUBLISHED_RULES,
    RULES,
    TrainParams,
    parse_segmenter,
    render_segmenter,
    train,
)
from demoplan.store import EpisodeState, Store, stage_key
from demoplan.store.code_version import code_version
from demoplan.store.opening import open_place
from demoplan.store.places import AbsentError
from demoplan.store.store import canonical_json
from demoplan.tables import Activities, Facts, Frames

RULE_TREES = {"rules": RULES, "published_rules": PUBLISHED_RULES}
"""What needs no labels: the published rule tree with memory for its thresholds, and as it was published."""

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


@functools.lru_cache(maxsize=32)
def segmenter_at(store: str, source: str, content: str) -> ChosenSegmenter:
    """The segmenter that an order names, read once by a process.

    Args:
        store: What opens the store.
        source: Name of a rule tree, absolute path of a file, or name in the store.
        content: Hash that it had when it was chosen.

    Raises:
        StoreError: If it has another one now.
    """
    if source in RULE_TREES:
        chosen = rules(source)
    elif Path(source).is_absolute():
        chosen = read_segmenter(Path(source))
    else:
        chosen = _parsed(open_place(store).read(source).decode(), source, source)
    if chosen.content != content:
        raise StoreError(f"{source}: is not the segmenter that was chosen; it has changed: run again")
    return chosen
