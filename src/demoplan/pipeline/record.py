"""Record demonstrations: from physics and participants to logs, true labels and a manifest."""

import io
import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dataframely as dy
import numpy as np
import polars as pl
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap

from demoplan.engines.mujoco.acting import demonstrate
from demoplan.engines.mujoco.demonstration import Demonstration
from demoplan.engines.mujoco.labels import LabelParams, label
from demoplan.engines.mujoco.participants import Participant, draw_participant
from demoplan.engines.mujoco.scene import TABLE, SceneParams, cube_names, draw_layout
from demoplan.engines.mujoco.sensing import Clocks, Rig, RigParams, Sensed, SensedBodies, draw_rig, sense
from demoplan.engines.mujoco.tasks import STUDY_TASKS, Task, parse_task
from demoplan.errors import UnknownNameError, UsageError
from demoplan.ids import is_safe_name
from demoplan.logs import fingerprint
from demoplan.logs.writing import (
    LOG_FORMATS,
    JoyStream,
    LogFormat,
    PoseStream,
    Stamped,
    Stream,
    TransformStream,
    write_log,
)
from demoplan.manifests.dataset import parse_dataset
from demoplan.store.atomic import write_bytes

_EPOCH_NS = 1_760_000_000_000_000_000
"""Rig clocks begin here (October 2025), so that a recording does not depend on the day it is made."""

_USUAL_EDGE_M = 0.05
"""Edge of a ``WoodenCube`` in the tabletop vocabulary; the mapping speaks of other sizes only."""

_SIDES = {"Left_hand": "left", "Right_hand": "right"}

STUDY_GOALS = (
    ("one-on-one", "onTop(cube_red, cube_blue)"),
    ("three-tower", "onTop(cube_red, cube_blue) & onTop(cube_green, cube_red)"),
    ("reordered-tower", "onTop(cube_blue, cube_green) & onTop(cube_yellow, cube_blue)"),
    ("two-towers", "onTop(cube_red, cube_blue) & onTop(cube_green, cube_yellow)"),
)
"""The study's four kinds of goal, on which learned domains are tried."""


class Recordings(dy.Schema):
    """What was recorded: one row per episode."""

    episode_id = dy.String(primary_key=True, description="The demonstration")
    participant = dy.String(description="Who demonstrates")
    task = dy.String(description="What was to be done")
    file = dy.String(description="Log, relative to the dataset's folder")
    sha256 = dy.String(description="Hash of the log's bytes; of a folder's data files, in name order")
    n_bytes = dy.Int64(min=0, description="Size of the log", metadata={"unit": "byte"})
    is_goal_reached = dy.Bool(description="Whether every cube rests where it was to be, by physics")
    n_attempts = dy.Int64(min=1, description="How often the demonstration was begun until it was kept")
    n_misses = dy.Int64(min=0, description="Grasps that closed on nothing, or lost the cube")
    duration_s = dy.Float64(min=0.0, description="Length of the demonstration", metadata={"unit": "s"})


@dataclass(frozen=True, kw_only=True)
class RecordParams:
    """What can be chosen about recording, besides who and what."""

    scene: SceneParams = SceneParams()
    rig: RigParams = RigParams()
    labels: LabelParams = LabelParams()
    most_attempts: int = 3
    """A demonstration that misses its goal is repeated, as in the study; at most this many are made."""


def record(
    out_dir: Path,
    *,
    participants: int | Sequence[str] = 3,
    tasks: Sequence[str | Task] = STUDY_TASKS,
    seed: int = 0,
    formats: Sequence[LogFormat] = ("mcap", "rosbag2", "rosbag1"),
    name: str | None = None,
    vocabulary: Path | None = None,
    is_vocabulary_linked: bool | None = None,
    params: RecordParams = RecordParams(),
    is_overwriting: bool = False,
    on_episode: Callable[[str], None] | None = None,
) -> dy.DataFrame[Recordings]:
    """Record every task once with every participant, and write a dataset that can be run as it is.

    Args:
        out_dir: Folder for ``dataset.yaml``, ``logs/`` and ``labels/``.
        participants: How many (they are called p1, p2, …), or their names.
        tasks: Tasks, or texts that ``parse_task`` reads.
        seed: Seed of everything random. Participant k of a seed is the same person whatever the tasks are.
        formats: Log formats; participant k has format k, beginning anew when they are used up.
        name: Name of the dataset; by default the folder's.
        vocabulary: Vocabulary file; by default the checkout's ``schemas/vocabularies/tabletop.yaml``.
        is_vocabulary_linked: Name the vocabulary by its relative path instead of copying it; by default only
            where the folder is in the checkout that the vocabulary is part of.
        params: Physics, rig and label definitions.
        is_overwriting: Replace the dataset that the folder holds; otherwise a folder with one is refused.
        on_episode: Called with each episode's id when it is written.

    Returns:
        One row per episode, in order of participants and tasks.

    Raises:
        UnknownNameError: If a format, task or cube is unknown.
        UsageError: If names repeat or are not safe as file names, there is no vocabulary, or the folder
            already holds a dataset.
    """
    people = [f"p{k + 1}" for k in range(participants)] if isinstance(participants, int) else [*participants]
    parsed = [parse_task(task) if isinstance(task, str) else task for task in tasks]
    dataset_name = name or out_dir.resolve().name
    _refuse_bad_names(people, parsed, formats, dataset_name)
    held = [name for name in ("dataset.yaml", "logs", "labels") if (out_dir / name).exists()]
    if held and not is_overwriting:
        raise UsageError(
            f"{out_dir} already holds {', '.join(held)}: recorded data is never replaced unless that is "
            "asked for; name another folder, or give --overwrite"
        )
    vocabulary_name = _place_vocabulary(out_dir, vocabulary, is_linked=is_vocabulary_linked)
    for folder in ("logs", "labels"):
        shutil.rmtree(out_dir / folder, ignore_errors=True)
    rows: list[dict[str, Any]] = []
    episodes: list[dict[str, Any]] = []
    for k, person in enumerate(people):
        participant = draw_participant(person, _rng(seed, k, 0))
        rig = draw_rig(_rng(seed, k, 1))
        for number, task in enumerate(parsed):
            episode_id = f"{person}-{task.name}"
            log_format = formats[k % len(formats)]
            demonstration, sensed, n_attempts = _perform(participant, rig, task, seed, (k, number), params)
            file = f"logs/{episode_id}{LOG_FORMATS[log_format]}"
            labels = f"labels/{episode_id}.json"
            write_log(out_dir / file, streams_of(sensed), log_format)
            start_ns = _start_ns(k, number, n_attempts)
            notes = {"n_attempts": n_attempts, "n_misses": demonstration.n_misses, "seed": seed}
            write_bytes(
                out_dir / labels, _labels_json(demonstration, episode_id, start_ns, params.labels, notes)
            )
            digest = str(fingerprint(out_dir / file))
            parts = [out_dir / file] if (out_dir / file).is_file() else [*(out_dir / file).iterdir()]
            n_bytes = sum(part.stat().st_size for part in parts)
            rows.append(
                {
                    "episode_id": episode_id,
                    "participant": person,
                    "task": task.name,
                    "file": file,
                    "sha256": digest,
                    "n_bytes": n_bytes,
                    "is_goal_reached": demonstration.is_goal_reached,
                    "n_attempts": n_attempts,
                    "n_misses": demonstration.n_misses,
                    "duration_s": float(demonstration.time_s[-1]),
                }
            )
            episodes.append(
                {
                    "id": episode_id,
                    "file": file,
                    "sha256": digest,
                    "labels": labels,
                    "participant": person,
                    "task": task.name,
                    **({"hand": task.hand} if task.hand else {}),
                    "is_goal_reached": demonstration.is_goal_reached,
                    "goal": task.goal_text,
                }
            )
            if on_episode is not None:
                on_episode(episode_id)
    cubes = cube_names(max(task.n_cubes for task in parsed))
    manifest = _manifest_yaml(
        {
            "name": dataset_name,
            "description": _description(people, parsed),
            "licence": "Apache-2.0",
            "source": f"recorded by demoplan record, seed {seed}",
            "root": ".",
            "vocabulary": vocabulary_name,
            "tick_rate_hz": 100.0,
            "mapping": _mapping(cubes, params.scene),
            "episodes": episodes,
            "goals": [
                _line(name=goal, goal=text)
                for goal, text in STUDY_GOALS
                if all(
                    word.strip("(), ") in cubes
                    for word in text.replace("onTop", " ").replace("&", " ").split()
                )
            ],
            "splits": {
                f"without-{person}": [e["id"] for e in episodes if e["participant"] != person]
                for person in people
                if len(people) > 1
            },
        }
    )
    parse_dataset(manifest, out_dir / "dataset.yaml")
    write_bytes(out_dir / "dataset.yaml", manifest.encode())
    return Recordings.validate(pl.DataFrame(rows), cast=True)


def _refuse_bad_names(people: list[str], tasks: list[Task], formats: Sequence[str], dataset: str) -> None:
    names = [f"{person}-{task.name}" for person in people for task in tasks]
    if not names:
        raise UsageError(f"nothing to record: {len(people)} participants, {len(tasks)} tasks")
    for text in (dataset, *people, *names):
        if not is_safe_name(text):
            raise UsageError(f"{text!r} cannot be a file name; use letters, digits, '.', '-' and '_'")
    if len(set(names)) < len(names):
        raise UsageError(f"participants or tasks repeat: {', '.join(names)}")
    if not formats:
        raise UsageError(f"no log format given; available: {', '.join(LOG_FORMATS)}")
    for log_format in formats:
        if log_format not in LOG_FORMATS:
            raise UnknownNameError("log format", log_format, LOG_FORMATS)


def _rng(seed: int, *key: int) -> np.random.Generator:
    """A source of randomness of its own for each key, so that nothing depends on what else is recorded."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def _start_ns(person: int, number: int, attempt: int) -> int:
    """When a demonstration begins on the rig's clock: participants on different days, tasks minutes apart."""
    return _EPOCH_NS + (person * 86_400 + number * 240 + attempt * 40) * 1_000_000_000


def _perform(
    participant: Participant,
    rig: Rig,
    task: Task,
    seed: int,
    which: tuple[int, int],
    params: RecordParams,
) -> tuple[Demonstration, Sensed, int]:
    """A demonstration, what the rig saw of it, and how many were made until it was kept."""
    person, number = which
    for attempt in range(1, max(1, params.most_attempts) + 1):
        rng = _rng(seed, person, 2, number, attempt)
        layout = draw_layout(cube_names(task.n_cubes), task.start, rng, params.scene)
        demonstration = demonstrate(participant, task, layout, rng, scene=params.scene)
        if demonstration.is_goal_reached:
            break
    start_ns = _start_ns(person, number, attempt)
    noise = _rng(seed, person, 3, number, attempt)
    return demonstration, sense(demonstration, participant, rig, start_ns, noise, params.rig), attempt


def streams_of(sensed: Sensed) -> list[Stream]:
    """What a rig saw, as the topics that it publishes."""

    def stamped(clocks: Clocks) -> Stamped:
        return Stamped(clocks.captured_ns, clocks.published_ns, clocks.received_ns)

    def transforms(topic: str, bodies: SensedBodies, *, is_static: bool) -> TransformStream:
        return TransformStream(
            topic,
            stamped(bodies.clocks),
            bodies.frame,
            bodies.names,
            bodies.position_xyz_m,
            bodies.orientation_wxyz,
            bodies.is_present,
            is_static,
        )

    streams: list[Stream] = [
        transforms("/tf_static", sensed.static, is_static=True),
        transforms("/tf", sensed.cubes, is_static=False),
    ]
    for hand, side in _SIDES.items():
        poses, trigger = sensed.hands[hand], sensed.triggers[hand]
        streams.append(
            PoseStream(
                f"/hand/{side}/pose",
                stamped(poses.clocks),
                poses.frame,
                poses.position_xyz_m[:, 0],
                poses.orientation_wxyz[:, 0],
            )
        )
        streams.append(
            JoyStream(f"/hand/{side}/joy", stamped(trigger.clocks), f"hand_{side}", trigger.trigger[:, None])
        )
    return streams


def _labels_json(
    demonstration: Demonstration, episode_id: str, start_ns: int, params: LabelParams, notes: dict[str, int]
) -> bytes:
    def ns(time_s: float) -> str:
        return str(start_ns + round(time_s * 1e9))

    content = {
        "format": "activities",
        "clock": "header",
        "episode_id": episode_id,
        "hands": {
            hand: [
                {
                    "start_ns": ns(stretch.start_s),
                    "end_ns": ns(stretch.end_s),
                    "activity": stretch.activity,
                    "acted_on": stretch.acted_on,
                    "in_hand": stretch.in_hand,
                }
                for stretch in label(demonstration, hand, params)
            ]
            for hand in sorted(demonstration.hands)
        },
        "goal": demonstration.task.goal_text,
        "is_goal_reached": demonstration.is_goal_reached,
        "recorded": {**notes, "physics": demonstration.physics},
    }
    return (json.dumps(content, indent=1) + "\n").encode()


def _place_vocabulary(out_dir: Path, vocabulary: Path | None, *, is_linked: bool | None) -> str:
    checkout = Path(__file__).resolve().parents[3]
    source = vocabulary or checkout / "schemas" / "vocabularies" / "tabletop.yaml"
    if is_linked is None:
        is_linked = vocabulary is None and out_dir.resolve().is_relative_to(checkout)
    if not source.is_file():
        raise UsageError(f"{source}: no vocabulary here; give one")
    if is_linked:
        return Path(os.path.relpath(source.resolve(), out_dir.resolve())).as_posix()
    write_bytes(out_dir / "vocabulary.yaml", source.read_bytes())
    return "vocabulary.yaml"


def _mapping(cubes: Sequence[str], scene: SceneParams) -> dict[str, Any]:
    depth, width, thickness = scene.table_size_xyz_m
    entities: dict[str, Any] = {hand: _line(type="Hand") for hand in _SIDES}
    for cube in cubes:
        entities[cube] = _line(type="WoodenCube")
        if scene.cube_edge_m != _USUAL_EDGE_M:
            entities[cube]["shape"] = _line(kind="box", size_xyz_m=[scene.cube_edge_m] * 3)
    centre = [0.0, 0.0, -thickness / 2]
    table_shape = _line(kind="box", size_xyz_m=[depth, width, thickness], centre_xyz_m=centre)
    entities[TABLE] = {"type": "Table", "shape": table_shape}
    topics: dict[str, Any] = {
        "/tf_static": _line(kind="transforms", static=True, entities={TABLE: TABLE}),
        "/tf": _line(kind="transforms", entities={cube: cube for cube in cubes}),
    }
    for hand, side in _SIDES.items():
        topics[f"/hand/{side}/pose"] = _line(kind="pose", entity=hand)
        topics[f"/hand/{side}/joy"] = _line(
            kind="grip", entity=hand, field="axes[0]", open_at=0.0, closed_at=1.0
        )
    return {"world": "world", "clock": "header", "entities": entities, "topics": topics}


def _line(**values: Any) -> CommentedMap:
    """A mapping that is written on one line."""
    line = CommentedMap(values)
    line.fa.set_flow_style()
    return line


def _description(people: Sequence[str], tasks: Sequence[Task]) -> str:
    return (
        f"Cubes on a table, moved by hand in virtual reality: {len(people)} participant(s), "
        f"{', '.join(task.name for task in tasks)}."
    )


def _manifest_yaml(content: dict[str, Any]) -> str:
    yaml = YAML(typ="rt", pure=True)
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.width = 110
    stream = io.StringIO()
    yaml.dump({key: value for key, value in content.items() if value not in ({}, [])}, stream)
    return stream.getvalue()
