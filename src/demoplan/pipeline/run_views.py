"""Runs to look at: recordings for rerun, and one page for all of them."""

from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.engines.mujoco.scene_spec import SceneSpec
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.mapping import Mapping
from demoplan.pipeline.evaluate import Evaluation
from demoplan.pipeline.senses import entities_of_scene, with_fixed
from demoplan.stages.perceive import perceive
from demoplan.stages.score_runs import fault_confusion, score_runs
from demoplan.store import Store
from demoplan.tables import Activities, Evidence, Executions, Frames
from demoplan.viewers.episode import save_episode
from demoplan.viewers.report.execution import render_execution_report
from demoplan.viewers.sources import EpisodeTables, entities_of, thresholds_of


def record_run(
    frames: pl.DataFrame,
    steps: dy.DataFrame[Executions],
    scene: SceneSpec,
    vocabulary: Vocabulary,
    output: Path,
) -> Path:
    """Write the recording of a run: scene, trails, predicates, and the steps of the plans per hand.

    Args:
        frames: What sensors saw, as rows of ``Frames`` of one run.
        steps: The run's steps. What went wrong with one stands beside it.
        scene: Shapes of what is there.
        vocabulary: What perception looks for.
        output: Where the recording goes, ``….rrd``.
    """
    hands = tuple(sorted(set(steps["hand"].drop_nulls())))
    entities = entities_of_scene(scene, hands)
    known = frames.filter(pl.col("entity").is_in(list(entities)))
    whole = Frames.validate(with_fixed(known, entities), cast=True)
    episode = str(whole["episode_id"][0])
    return save_episode(
        output,
        EpisodeTables(
            episode_id=episode,
            frames=whole,
            entities=entities_of(Mapping(entities=entities, topics={}), vocabulary),
            facts=perceive(whole, entities, vocabulary),
            activities=_activities(steps, episode),
            evidence=_evidence(steps, episode),
            thresholds=thresholds_of(vocabulary),
        ),
    )


def record_runs(store: Store, evaluation: Evaluation, vocabulary: Vocabulary, folder: Path) -> list[Path]:
    """Write the recordings of all runs whose poses were kept: ``RUN_ID.rrd`` each."""
    written = []
    for record in evaluation.records:
        if record.frames is not None:
            frames = store.get(record.frames, Frames)
            path = folder / f"{record.job.run_id}.rrd"
            written.append(record_run(frames, record.steps, record.job.scene, vocabulary, path))
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


def _run(steps: pl.DataFrame) -> pl.DataFrame:
    return steps.filter(
        pl.col("hand").is_not_null()
        & pl.col("start_ns").is_not_null()
        & (pl.col("end_ns") > pl.col("start_ns"))
    ).sort("start_ns")


def _activities(steps: pl.DataFrame, episode: str) -> dy.DataFrame[Activities]:
    """What each hand was told to do, and when."""
    thing = pl.col("arguments").list.get(1, null_on_oob=True)
    table = _run(steps).select(
        pl.lit(episode).alias("episode_id"),
        "hand",
        "start_ns",
        "end_ns",
        "activity",
        thing.alias("acted_on"),
        pl.lit(None, dtype=pl.String).alias("in_hand"),
    )
    return Activities.validate(table.unique(Activities.primary_key()).sort("hand", "start_ns"))


def _evidence(steps: pl.DataFrame, episode: str) -> dy.DataFrame[Evidence]:
    """Steps in the form in which a view shows operators; what was not as expected is said beside them."""
    cause = pl.when(pl.col("failure").is_not_null()).then(
        pl.concat_list(pl.format("{}: {}", pl.col("failure").cast(pl.String), pl.col("cause")))
    )
    table = _run(steps).select(
        "operator",
        pl.lit(episode).alias("episode_id"),
        "hand",
        "start_ns",
        "end_ns",
        pl.col("arguments").alias("binding"),
        cause.otherwise(pl.col("missing")).alias("contradicts"),
    )
    return Evidence.validate(table.unique(Evidence.primary_key()).sort("operator", "start_ns"))
