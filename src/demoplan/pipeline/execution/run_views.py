"""Runs to look at: recordings for rerun, and one page for all of them."""

from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.ids import content_hash
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.mapping import Mapping
from demoplan.pipeline.execution.evaluate import Evaluation
from demoplan.pipeline.execution.senses import entities_of_scene, with_fixed
from demoplan.stages.perceive import perceive
from demoplan.stages.score_runs import fault_confusion, score_runs
from demoplan.store import Store
from demoplan.store.store import canonical_json
from demoplan.tables import Executions, Frames, Runs
from demoplan.viewers.episode import save_episode
from demoplan.viewers.report.execution import render_execution_report
from demoplan.viewers.sources import EpisodeTables, EpisodeViewParams, entities_of, thresholds_of

UNNAMED = "run"
"""Key of a run that was not made as part of a batch."""


def record_run(
    run: dy.DataFrame[Runs],
    steps: dy.DataFrame[Executions],
    frames: pl.DataFrame | None,
    scene: SceneSpec | None,
    vocabulary: Vocabulary,
    output: Path,
    params: EpisodeViewParams | None = None,
    *,
    goal: str | None = None,
) -> Path:
    """Write the recording of a run: scene, trails, predicates, plans, the steps of each hand, and diagnoses.

    Args:
        run: Its row.
        steps: Its steps. What went wrong with one stands beside it.
        frames: What sensors saw, as rows of ``Frames`` of one run; null if that was not kept.
        scene: Shapes of what is there; without it, nothing is drawn but lanes.
        vocabulary: What perception looks for.
        output: Where the recording goes, ``….rrd``.
        params: Choices of the view.
        goal: Text of the goal, of which the run states the name.

    Raises:
        UnknownNameError: If nothing was dispatched and no frames were kept.
    """
    name = _name_of(run, steps)
    tables = EpisodeTables(
        episode_id=name,
        frames=Frames.create_empty(),
        entities=(),
        run=_named(run, name),
        steps=steps,
        goal=goal,
    )
    if frames is not None and scene is not None and not frames.is_empty():
        hands = tuple(sorted(set(steps["hand"].drop_nulls())))
        entities = entities_of_scene(scene, hands)
        known = frames.filter(pl.col("entity").is_in(list(entities)))
        whole = Frames.validate(
            with_fixed(known.with_columns(pl.lit(name).alias("episode_id")), entities), cast=True
        )
        tables = EpisodeTables(
            episode_id=name,
            frames=whole,
            entities=entities_of(Mapping(entities=entities, topics={}), vocabulary),
            facts=perceive(whole, entities, vocabulary),
            thresholds=thresholds_of(vocabulary),
            run=tables.run,
            steps=steps,
            goal=goal,
        )
    return save_episode(output, tables, params)


def _name_of(run: dy.DataFrame[Runs], steps: dy.DataFrame[Executions]) -> str:
    """The run's id; one made of what it did if it has none, so that no two recordings share one."""
    row = run.row(0, named=True)
    if row["run_id"] != UNNAMED:
        return str(row["run_id"])
    return content_hash(canonical_json(row), canonical_json(steps.to_dicts()))[:32]


def _named(run: dy.DataFrame[Runs], name: str) -> dy.DataFrame[Runs]:
    return Runs.validate(run.with_columns(pl.lit(name).alias("run_id")))


def record_runs(store: Store, evaluation: Evaluation, vocabulary: Vocabulary, folder: Path) -> list[Path]:
    """Write the recordings of all runs whose poses were kept: ``RUN_ID.rrd`` each."""
    written = []
    for record in evaluation.records:
        if record.frames is not None:
            frames = store.get(record.frames, Frames)
            path = folder / f"{record.job.run_id}.rrd"
            job = record.job
            written.append(
                record_run(record.run, record.steps, frames, job.scene, vocabulary, path, goal=job.goal.goal)
            )
    return written


def execution_report(evaluation: Evaluation, *, title: str) -> str:
    """The page about a batch of runs."""
    return render_execution_report(
        title,
        evaluation.runs,
        evaluation.steps,
        score_runs(evaluation.runs),
        fault_confusion(evaluation.runs),
    )
