"""A stored episode, or a stored execution, to a recording that a person can look at."""

import json
from dataclasses import dataclass
from pathlib import Path

import dataframely as dy

from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.errors import StoreError, UnknownNameError, UsageError
from demoplan.ids import content_hash
from demoplan.language.vocabulary import Vocabulary
from demoplan.pipeline.datasets import OpenDataset, recall
from demoplan.pipeline.domains.learning import stored_domain
from demoplan.pipeline.episodes.segment_stages import ChosenSegmenter
from demoplan.pipeline.episodes.segmenters import RULE_TREES, entity_types, read_segmenter, rules
from demoplan.pipeline.execution.run_views import record_run
from demoplan.stages.segment.explaining import explain
from demoplan.store import EpisodeState, Store
from demoplan.store.objects import Table
from demoplan.store.store import canonical_json
from demoplan.tables import Activities, Episodes, Evidence, Executions, Facts, Frames, Runs
from demoplan.viewers import colours
from demoplan.viewers.describe import activity_text
from demoplan.viewers.episode import save_episode
from demoplan.viewers.episode_view import Note
from demoplan.viewers.sources import EpisodeTables, EpisodeViewParams, entities_of, thresholds_of

RUN_STAGE = "execute"
"""Stage under which the store keeps executions."""


def record_view(
    store: Store,
    opened: OpenDataset,
    state: EpisodeState,
    output: Path,
    evidence: dy.DataFrame[Evidence] | None = None,
    params: EpisodeViewParams | None = None,
) -> Path:
    """Write the recording of a stored episode: scene, trails, activities, predicates, operators, reasons.

    Args:
        store: Where the episode's tables are.
        opened: The episode's dataset: its mapping and vocabulary give shapes and thresholds.
        state: The episode.
        output: Where the recording goes, ``….rrd``.
        evidence: Which operator each activity matched, if a domain was learned from the episode.
        params: Choices of the view.

    Raises:
        UsageError: If the episode has no frames.
        UnknownNameError: If a layer is unknown.
    """
    params = params or EpisodeViewParams()
    if "frames" not in state.tables:
        raise UsageError(
            f"episode {state.episode_id!r} has nothing to show: {state.reason or 'not ingested'}"
        )

    def table(name: str, schema: type[Table]) -> dy.DataFrame[Table] | None:
        return store.get(state.tables[name], schema) if name in state.tables else None

    frames = store.get(state.tables["frames"], Frames)
    facts, activities = table("facts", Facts), table("activities", Activities)
    reasons: tuple[Note, ...] = ()
    if "explanation" in params.layers:
        reasons = (
            *_activity_reasons(store, opened, state, frames, facts, activities),
            *_fact_reasons(facts, opened.vocabulary),
        )
    goals = {episode.id: episode.goal for episode in opened.dataset.episodes}
    return save_episode(
        output,
        EpisodeTables(
            episode_id=state.episode_id,
            frames=frames,
            entities=entities_of(opened.dataset.mapping, opened.vocabulary),
            episodes=table("episodes", Episodes),
            facts=facts,
            activities=activities,
            truth=table("labels", Activities),
            evidence=evidence,
            thresholds=thresholds_of(opened.vocabulary),
            reasons=reasons,
            goal=goals.get(state.episode_id),
        ),
        params,
    )


def _activity_reasons(
    store: Store,
    opened: OpenDataset,
    state: EpisodeState,
    frames: dy.DataFrame[Frames],
    facts: dy.DataFrame[Facts] | None,
    activities: dy.DataFrame[Activities] | None,
) -> list[Note]:
    """Why each activity has its name, by the segmenter that gave it; nothing if that is gone."""
    chosen = segmenter_of_episode(store, state)
    if chosen is None or facts is None or activities is None:
        return []
    reasons = explain(
        frames, facts, activities, entity_types(opened), opened.vocabulary.types, chosen.segmenter
    )
    objects = {(row["hand"], row["start_ns"]): row for row in activities.iter_rows(named=True)}
    notes = []
    for reason in reasons:
        row = objects[reason.hand, reason.start_ns]
        what = activity_text(row["activity"], row["acted_on"], row["in_hand"])
        notes.append(
            Note(
                tick_ns=reason.start_ns,
                text=f"{reason.hand}: {what}, since {reason.text} ({chosen.method})",
                colour=colours.activity_colour(reason.activity),
            )
        )
    return notes


def segmenter_of_episode(store: Store, state: EpisodeState) -> ChosenSegmenter | None:
    """What the episode's activities were found with, by its hash; None if it is not there any more."""
    key = state.keys.get("segment")
    record = None if key is None else store.records.get("segment", key)
    if record is None:
        return None
    content = record.inputs.get("segmenter")
    for name in RULE_TREES:
        if rules(name).content == content:
            return rules(name)
    folder = store.place.path("segmenters")
    for path in sorted(folder.glob("*.json")) if folder is not None else ():
        if content_hash(path.read_text(encoding="utf-8")) == content:
            chosen = read_segmenter(path)
            return ChosenSegmenter(
                segmenter=chosen.segmenter,
                method=getattr(chosen.segmenter, "method", chosen.method),
                content=chosen.content,
                source=chosen.source,
            )
    return None


def _fact_reasons(facts: dy.DataFrame[Facts] | None, vocabulary: Vocabulary) -> list[Note]:
    """What each atom that begins to hold means: its definition, with the vocabulary's numbers."""
    if facts is None:
        return []
    rules_by_name = {rule.signature.name: rule for rule in vocabulary.predicates}
    notes = []
    for row in facts.sort("start_ns").iter_rows(named=True):
        rule = rules_by_name.get(row["predicate"])
        if rule is None:
            continue
        atom = f"{row['predicate']}({', '.join(row['arguments'])})"
        numbers = ", ".join(f"{name} {value:g}" for name, value in rule.numbers)
        if row["value"] == "true":
            text = f"{atom} holds by {rule.definition}" + (f": {numbers}" if numbers else "")
        else:
            text = f"{atom} is unknown: what {rule.definition} needs was not observed"
        colour = colours.colour_of(row["predicate"]) if row["value"] == "true" else colours.UNKNOWN
        notes.append(Note(tick_ns=row["start_ns"], text=text, colour=colour))
    return notes


@dataclass(frozen=True, kw_only=True)
class StoredRun:
    """An execution that the store keeps."""

    run_id: str
    dataset: str
    goal: str | None
    """Text of its goal."""
    run: dy.DataFrame[Runs]
    steps: dy.DataFrame[Executions]
    frames: dy.DataFrame[Frames] | None
    """What sensors saw; null if it was not kept."""
    scene: SceneSpec | None
    vocabulary: Vocabulary


def stored_run(store: Store, asked: str) -> StoredRun:
    """An execution by its id, or the start of it (4 digits or more).

    Raises:
        UnknownNameError: If none fits, or more than one does.
        StoreError: If its scene cannot be read.
    """
    records = {}
    for stage, key in sorted(store.records.keys()):
        record = store.records.get(stage, key) if stage == RUN_STAGE else None
        if record is not None:
            run_id = content_hash(canonical_json(record.inputs), record.params)[:32]
            records[run_id] = record
    fitting = [name for name in records if len(asked) >= 4 and name.startswith(asked)]
    if len(fitting) != 1:
        raise UnknownNameError("execution", asked, fitting or records, where=f"store {store.location}")
    record = records[fitting[0]]
    run = store.get(record.outputs["runs"], Runs)
    dataset = stored_domain(store, str(run["domain_id"][0])).version.dataset
    try:
        scene = SceneSpec.model_validate_json(record.notes["scene"]) if "scene" in record.notes else None
    except (ValueError, json.JSONDecodeError) as error:
        raise StoreError(f"execution {fitting[0]}: its scene cannot be read: {error}") from None
    return StoredRun(
        run_id=fitting[0],
        dataset=dataset,
        goal=record.inputs.get("goal"),
        run=run,
        steps=store.get(record.outputs["executions"], Executions),
        frames=store.get(record.outputs["frames"], Frames) if "frames" in record.outputs else None,
        scene=scene,
        vocabulary=recall(store, dataset).vocabulary,
    )


def record_stored_run(found: StoredRun, output: Path, params: EpisodeViewParams | None = None) -> Path:
    """Write the recording of a stored execution; without kept poses, its plans, steps and diagnoses only."""
    return record_run(
        found.run, found.steps, found.frames, found.scene, found.vocabulary, output, params, goal=found.goal
    )
