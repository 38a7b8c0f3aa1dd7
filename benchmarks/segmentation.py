"""How well activities are found: rules, one tree, ensembles and the naive answer, side by side.

    python benchmarks/segmentation.py                      both datasets, where their recordings are present
    python benchmarks/segmentation.py --also FOLDER …      train on cube-stacking, try on other people's data
    python benchmarks/segmentation.py --speed              time of segmenting the cube-stacking episodes

Every row is held out: a participant's episodes (or, with one participant, an episode) are segmented by what
was trained on the others. Intervals are 95 %, by resampling episodes.
"""

import argparse
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import dataframely as dy
import numpy as np
import polars as pl
from rich.console import Console
from rich.table import Table

from demoplan.language.types import TypeHierarchy
from demoplan.logs import read
from demoplan.manifests.labels import activities_of_labels
from demoplan.pipeline.datasets import OpenDataset, open_dataset
from demoplan.stages.align import AlignParams, align
from demoplan.stages.perceive import perceive
from demoplan.stages.score import majority_activities, score_segmentation
from demoplan.stages.segment import (
    PUBLISHED_RULES,
    RULES,
    Segmenter,
    TrainParams,
    segment,
    segment_held_out,
    train,
)
from demoplan.tables import Activities, Facts, Frames, Scores

HERE = Path(__file__).resolve().parent.parent
Method: TypeAlias = Literal["decision_tree", "distilled_tree", "random_forest", "extra_trees"]
METHODS: tuple[Method, ...] = get_args(Method)
METRICS = ("frame accuracy", "macro F1", "F1@10", "F1@25", "F1@50", "edit score")


@dataclass(frozen=True, kw_only=True, eq=False)
class Labelled:
    """The labelled episodes of a dataset, as tables."""

    frames: dy.DataFrame[Frames]
    facts: dy.DataFrame[Facts]
    truth: dy.DataFrame[Activities]
    entities: dict[str, str]
    types: TypeHierarchy
    groups: dict[str, str]


def labelled(opened: OpenDataset, prefix: str = "") -> Labelled:
    """Read, align and perceive every labelled episode; ``prefix`` sets episode names of datasets apart."""
    mapping = opened.dataset.mapping
    frames, facts, truth, groups = [], [], [], {}
    for episode in opened.dataset.episodes:
        labels = opened.labels_of(episode)
        if labels is None:
            continue
        samples = read(opened.log_of(episode), mapping, episode.id).samples
        frames.append(align(samples, mapping, AlignParams(tick_rate_hz=opened.dataset.tick_rate_hz)))
        facts.append(perceive(frames[-1], mapping.entities, opened.vocabulary))
        document = json.loads(labels.read_text(encoding="utf-8"))
        truth.append(activities_of_labels(document, opened.dataset.label_format, episode.id, samples))
        groups[prefix + episode.id] = prefix + episode.participant
    if len(set(groups.values())) == 1:
        groups = {name: name for name in groups}
    apart = pl.format("{}{}", pl.lit(prefix), "episode_id").alias("episode_id")
    return Labelled(
        frames=Frames.cast(pl.concat(frames).with_columns(apart)),
        facts=Facts.cast(pl.concat(facts).with_columns(apart)),
        truth=Activities.cast(pl.concat(truth).with_columns(apart)),
        entities={name: entity.type for name, entity in mapping.entities.items()},
        types=opened.vocabulary.types,
        groups=groups,
    )


def rule_rows(data: Labelled) -> list[tuple[str, dy.DataFrame[Scores]]]:
    """Scores of what needs no labels, where the labels speak the rules' language."""
    found = [("majority", majority_activities(data.truth))]
    if set(data.truth["activity"]) <= {"Idle", "Reach", "Take", "Put", "Release"}:
        for name, tree in (("rules as published", PUBLISHED_RULES), ("rules with memory", RULES)):
            found.append((name, segment(data.frames, data.facts, data.entities, data.types, tree)))
    return [(name, score_segmentation(activities, data.truth, name)) for name, activities in found]


def report(title: str, rows: list[tuple[str, dy.DataFrame[Scores]]], console: Console) -> None:
    """Print one table: a method per row, a metric per column."""
    table = Table(title=title)
    table.add_column("method")
    for metric in METRICS:
        table.add_column(metric, justify="right")
    for name, scores in rows:
        whole = scores.filter(pl.col("subject") == "all")
        of = {row["metric"]: row for row in whole.iter_rows(named=True)}
        cells = []
        for metric in METRICS:
            row = of[metric]
            interval = "" if row["low"] is None else f" [{row['low']:.3f}, {row['high']:.3f}]"
            cells.append(f"{row['value']:.3f}{interval}")
        table.add_row(name, *cells)
    console.print(table)
    per_class = {
        name: {
            row["metric"][3:]: round(row["value"], 2)
            for row in scores.filter(
                (pl.col("subject") == "all") & pl.col("metric").str.starts_with("f1 ")
            ).iter_rows(named=True)
        }
        for name, scores in rows
    }
    for name, values in per_class.items():
        console.print(f"  {name}: F1 of each activity {values}")


def trained(data: Labelled, method: Method) -> Segmenter:
    """A segmenter of everything that a dataset has."""
    params = TrainParams(method=method)
    return train(data.frames, data.facts, data.truth, data.entities, data.types, params=params)


def held_out(title: str, data: Labelled, methods: list[Method], console: Console) -> None:
    """Everything on one dataset, each group left out in turn."""
    rows = rule_rows(data)
    for method in methods:
        params = TrainParams(method=method)
        activities = segment_held_out(
            data.frames, data.facts, data.truth, data.entities, data.types, groups=data.groups, params=params
        )
        rows.append((method, score_segmentation(activities, data.truth, method, groups=data.groups)))
    n_groups = len(set(data.groups.values()))
    report(f"{title}: {len(data.groups)} episodes, {n_groups} groups left out in turn", rows, console)


def transferred(title: str, known: Labelled, new: Labelled, methods: list[Method], console: Console) -> None:
    """Trained on one dataset, tried on people of others."""
    rows = rule_rows(new)
    for method in methods:
        segmenter = train(
            known.frames,
            known.facts,
            known.truth,
            known.entities,
            known.types,
            params=TrainParams(method=method),
        )
        activities = segment(new.frames, new.facts, new.entities, new.types, segmenter)
        rows.append((method, score_segmentation(activities, new.truth, method)))
    report(f"{title}: trained on {len(known.groups)} episodes, tried on {len(new.groups)}", rows, console)


def speed(data: Labelled, console: Console) -> None:
    """CPU time of segmenting, per minute of recording: median of 5, on the dataset's own episodes."""
    span = data.frames.group_by("episode_id").agg(
        (pl.col("tick_ns").max() - pl.col("tick_ns").min()).alias("ns")
    )
    minutes = float(span["ns"].sum()) / 60e9
    table = Table(title=f"segmenting {minutes:.1f} minutes, {len(data.entities)} entities, CPU time")
    for column in ("segmenter", "ms per minute", "times real time"):
        table.add_column(column, justify="right" if column != "segmenter" else "left")
    segmenters = [("rules with memory", RULES)] + [
        (
            method,
            train(
                data.frames,
                data.facts,
                data.truth,
                data.entities,
                data.types,
                params=TrainParams(method=method),
            ),
        )
        for method in ("decision_tree", "distilled_tree", "extra_trees")
    ]
    for name, segmenter in segmenters:
        times = []
        for _ in range(5):
            begin = time.process_time()
            segment(data.frames, data.facts, data.entities, data.types, segmenter)
            times.append(time.process_time() - begin)
        median = float(np.median(times))
        table.add_row(name, f"{1e3 * median / minutes:.1f}", f"{60 * minutes / median:.0f}")
    console.print(table)


def main() -> None:
    """Parse what is asked, and print tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--also", nargs="*", type=Path, default=[], help="datasets of other people")
    parser.add_argument("--only", choices=("cube-stacking", "bimanual-cooking"))
    parser.add_argument("--speed", action="store_true")
    arguments = parser.parse_args()
    console = Console(width=170)

    cubes = HERE / "datasets" / "cube-stacking"
    if arguments.only != "bimanual-cooking" and (cubes / "dataset.yaml").is_file():
        known = labelled(open_dataset(cubes))
        if arguments.speed:
            speed(known, console)
        else:
            held_out("cube-stacking", known, arguments.methods, console)
        if arguments.also:
            parts = [labelled(open_dataset(path), f"{path.name}-") for path in arguments.also]
            new = Labelled(
                frames=Frames.cast(pl.concat([part.frames for part in parts])),
                facts=Facts.cast(pl.concat([part.facts for part in parts])),
                truth=Activities.cast(pl.concat([part.truth for part in parts])),
                entities=parts[0].entities,
                types=parts[0].types,
                groups={name: group for part in parts for name, group in part.groups.items()},
            )
            transferred("cube-stacking, fresh people", known, new, arguments.methods, console)
    default = HERE.parent / "shared" / "data" / "bimanual-cooking"
    root = Path(os.environ.get("DEMOPLAN_BIMANUAL_ROOT", default))
    if arguments.only == "cube-stacking" or arguments.speed:
        return
    if root.is_dir():
        data = labelled(open_dataset(HERE / "datasets" / "bimanual-cooking", root=root))
        held_out("bimanual-cooking", data, arguments.methods, console)
    else:
        console.print(f"bimanual-cooking: not here; set DEMOPLAN_BIMANUAL_ROOT, or put it into {default}")


if __name__ == "__main__":
    main()
