"""A dataset in the store to a folder that others read."""

from collections.abc import Callable, Sequence
from pathlib import Path

import demoplan
from demoplan.errors import UnknownNameError, UsageError
from demoplan.exports.lerobot import (
    DatasetFacts,
    EpisodeContent,
    LeRobotParams,
    Written,
    licence_id,
    write_dataset,
)
from demoplan.ids import content_hash
from demoplan.manifests.dataset import Dataset
from demoplan.manifests.mapping import BodiesTopic, GripTopic, Mapping, PoseTopic, TransformsTopic
from demoplan.pipeline.datasets import OpenDataset, recall
from demoplan.store import EpisodeState, Store
from demoplan.tables import Activities, Episodes, Frames

ACTIVITIES = {
    "inferred": ("activities", "as demoplan's segmentation inferred them"),
    "true": ("labels", "as people labelled them"),
}
"""Which activities become subtasks → table, and how the card says it."""

TRAIN, TEST, REST = "train", "test", "rest"


def export_lerobot(
    store: Store,
    name: str,
    output: Path,
    *,
    fps: int | None = None,
    held_out: Sequence[str] = (),
    trained_on: str | None = None,
    activities: str = "inferred",
    has_language: bool = False,
    is_unlicensed_allowed: bool = False,
    is_overwriting: bool = False,
    on_episode: Callable[[str], None] = lambda _: None,
) -> Written:
    """Write an ingested dataset as a LeRobot dataset.

    Args:
        store: Where its tables are.
        name: The dataset's name.
        output: Folder to write.
        fps: Frames per second; by default the dataset's tick rate [Hz].
        held_out: Participants of the split ``test``; see :func:`split_of_episodes`.
        trained_on: Split of the manifest that becomes ``train``.
        activities: ``inferred`` or ``true``.
        has_language: Whether subtasks are also written as LeRobot 0.6 writes language.
        is_unlicensed_allowed: Whether data may be written whose manifest names no licence to pass it on.
        is_overwriting: Whether a LeRobot dataset that is there may be replaced.
        on_episode: Called with each episode's id when it is written.

    Raises:
        UnknownNameError: If the store has no such dataset, or the dataset no such participant.
        UsageError: If the dataset names no licence, nothing can be exported, or ``fps`` does not fit.
    """
    opened = recall(store, name)
    dataset = opened.dataset
    if licence_id(dataset.licence) is None and not is_unlicensed_allowed:
        raise UsageError(
            f"dataset {name!r} names no licence that lets it be passed on; its manifest says: "
            f"{dataset.licence or 'nothing'!r}. Put an SPDX identifier into its manifest, or give "
            "--allow-unlicensed for an export that stays with you"
        )
    rate = dataset.tick_rate_hz
    if fps is None and rate != int(rate):
        raise UsageError(f"dataset {name!r} has {rate:g} ticks per second, not a whole number: give --fps")
    fps = int(rate) if fps is None else fps
    if fps > rate:
        raise UsageError(f"dataset {name!r} has {rate:g} ticks per second; --fps {fps} is more than that")
    states = [state for state in store.manifest.episodes(name) if "frames" in state.tables]
    splits = split_of_episodes(
        dataset, [state.episode_id for state in states], held_out=held_out, trained_on=trained_on
    )
    table, words = ACTIVITIES[activities]
    contents = [_content(store, opened, state, splits[state.episode_id], table) for state in states]
    order = list(dict.fromkeys([*dataset.splits, TRAIN, TEST, REST]))
    contents.sort(key=lambda content: (order.index(content.split), content.episode_id))
    return write_dataset(
        output,
        _facts(opened, words),
        contents,
        LeRobotParams(fps=fps, has_language=has_language),
        is_overwriting=is_overwriting,
        on_episode=on_episode,
    )


def left_out(store: Store, name: str) -> list[EpisodeState]:
    """Episodes of a dataset of which nothing can be exported: quarantined, or never ingested."""
    return [state for state in store.manifest.episodes(name) if "frames" not in state.tables]


def split_of_episodes(
    dataset: Dataset,
    episode_ids: Sequence[str],
    *,
    held_out: Sequence[str] = (),
    trained_on: str | None = None,
) -> dict[str, str]:
    """The split of each episode: ``train`` or ``test``, unless the manifest parts the episodes itself.

    Args:
        dataset: Participants, and the manifest's splits.
        episode_ids: What is exported.
        held_out: Participants whose episodes are ``test``.
        trained_on: A split of the manifest: its episodes are ``train``, all others ``test``.

    Returns:
        Episode → split. If neither is given: the manifest's splits, where no episode is in two of them (what
        is in none is ``rest``); else the last participant by name is held out; with one participant only,
        everything is ``train``.

    Raises:
        UnknownNameError: If there is no such participant or split.
        UsageError: If both are given, or nothing is left to train on.
    """
    if held_out and trained_on is not None:
        raise UsageError("participants are held out, or a split of the manifest is trained on: not both")
    people = {e.id: e.participant for e in dataset.episodes if e.id in set(episode_ids)}
    known = sorted(set(people.values()))
    for person in held_out:
        if person not in known:
            raise UnknownNameError("participant", person, known, f"dataset {dataset.name}")
    if trained_on is not None and trained_on not in dataset.splits:
        raise UnknownNameError("split", trained_on, dataset.splits, f"dataset {dataset.name}")
    members = [member for split in dataset.splits.values() for member in split]
    if not held_out and trained_on is None and members and len(set(members)) == len(members):
        found = {member: split for split, each in dataset.splits.items() for member in each}
        return {episode: found.get(episode, REST) for episode in episode_ids}
    if trained_on is not None:
        train = set(dataset.splits[trained_on])
    else:
        tested = held_out or (known[-1:] if len(known) > 1 else ())
        train = {episode for episode, person in people.items() if person not in tested}
    if train.isdisjoint(episode_ids):
        raise UsageError(f"nothing is left to train on; participants: {', '.join(known)}")
    return {episode: TRAIN if episode in train else TEST for episode in episode_ids}


def _content(
    store: Store, opened: OpenDataset, state: EpisodeState, split: str, activities: str
) -> EpisodeContent:
    row = store.get(state.tables["episodes"], Episodes).row(0, named=True)
    goals = {episode.id: episode.goal for episode in opened.dataset.episodes}
    frames, labels = state.tables["frames"], state.tables.get(activities)
    return EpisodeContent(
        episode_id=state.episode_id,
        participant=row["participant"],
        task=row["task"],
        goal=goals.get(state.episode_id),
        is_goal_reached=row["is_goal_reached"],
        status=row["status"],
        log_sha256=row["sha256"],
        split=split,
        manifest_splits=tuple(
            sorted(name for name, members in opened.dataset.splits.items() if state.episode_id in members)
        ),
        frames=lambda: store.get(frames, Frames),
        activities=None if labels is None else lambda: store.get(labels, Activities),
    )


def _facts(opened: OpenDataset, activities_from: str) -> DatasetFacts:
    dataset, mapping = opened.dataset, opened.dataset.mapping
    types = opened.vocabulary.types
    tracked = _tracked(mapping)
    hands = sorted(n for n, entity in mapping.entities.items() if "Hand" in types.ancestors(entity.type))
    gripping = {topic.entity for topic in mapping.topics.values() if isinstance(topic, GripTopic)}
    return DatasetFacts(
        name=dataset.name,
        description=dataset.description,
        licence=licence_id(dataset.licence),
        licence_words=dataset.licence,
        source=dataset.source,
        world=mapping.world,
        tick_rate_hz=dataset.tick_rate_hz,
        hands=tuple(hands),
        gripping=tuple(hand for hand in hands if hand in gripping),
        objects=tuple(sorted(tracked - set(hands))),
        activities_from=activities_from,
        version=demoplan.__version__,
        manifest_sha256=content_hash(opened.manifest_text),
    )


def _tracked(mapping: Mapping) -> set[str]:
    """Instances whose poses come from a topic."""
    names: set[str] = set()
    for topic in mapping.topics.values():
        if isinstance(topic, TransformsTopic | BodiesTopic):
            names |= set(topic.entities.values())
        elif isinstance(topic, PoseTopic):
            names.add(topic.entity)
    return names
