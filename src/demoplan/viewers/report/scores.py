"""Scores beside what they are held against, methods side by side, and confusions with their shares."""

from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl
from markupsafe import Markup

from demoplan.viewers.report.content import Confusion, Reference
from demoplan.viewers.report.markup import interval_bar, number


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """A figure with its interval, drawn where it lies between 0 and 1."""

    suite: str
    method: str
    metric: str
    value: str
    n: int
    interval: str
    drawn: Markup
    reference: str
    source: str


def key_results(
    scores: pl.DataFrame | None, references: Sequence[Reference], methods: Sequence[str] = ()
) -> tuple[ScoreRow, ...]:
    """The scores over everything, beside the figures that they are held against.

    Where a suite knows some of ``methods``, the others are left to the comparison.
    """
    if scores is None:
        return ()
    used = scores.group_by("suite").agg(pl.col("method").is_in(list(methods)).any().alias("has_used"))
    scores = scores.join(used, on="suite").filter(~pl.col("has_used") | pl.col("method").is_in(list(methods)))
    known = {(r.suite, r.metric): r for r in references}
    rows = []
    for row in (
        scores.filter(pl.col("subject") == "all").sort("suite", "metric", "method").iter_rows(named=True)
    ):
        reference = known.get((row["suite"], row["metric"]))
        has_interval = row["low"] is not None and row["high"] is not None
        rows.append(
            ScoreRow(
                suite=row["suite"],
                method=row["method"],
                metric=row["metric"],
                value=number(row["value"]),
                n=row["n"],
                interval=f"{number(row['low'])} – {number(row['high'])}" if has_interval else "",
                drawn=interval_bar(
                    row["value"], row["low"], row["high"], None if reference is None else reference.value
                ),
                reference="" if reference is None else number(reference.value),
                source="" if reference is None else reference.source,
            )
        )
    return tuple(rows)


@dataclass(frozen=True, kw_only=True)
class ScoreGrid:
    """Methods against metrics for one subject, with the best of each metric marked."""

    metrics: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[str, bool], ...]], ...]
    """(method, ((figure, is best), …)) in the order of ``metrics``."""


def score_grid(scores: pl.DataFrame | None, suite: str) -> ScoreGrid | None:
    """The methods of a suite side by side; null where no two have a metric in common."""
    if scores is None:
        return None
    chosen = scores.filter((pl.col("suite") == suite) & (pl.col("subject") == "all"))
    methods = sorted(chosen["method"].unique())
    metrics = tuple(sorted(chosen["metric"].unique()))
    if chosen["metric"].n_unique() == chosen.height:
        return None
    figures = {(m, k): v for m, k, v in chosen.select("method", "metric", "value").iter_rows()}
    best: dict[str, float] = {}
    for metric in metrics:
        known = [v for m in methods if (v := figures.get((m, metric))) is not None]
        # A duration or an error is better when it is smaller; which, a name does not tell: mark ratios only.
        if known and all(0.0 <= v <= 1.0 for v in known):
            best[metric] = max(known)
    return ScoreGrid(
        metrics=metrics,
        rows=tuple(
            (
                method,
                tuple(
                    (number(v := figures.get((method, metric))), v is not None and best.get(metric) == v)
                    for metric in metrics
                ),
            )
            for method in methods
        ),
    )


@dataclass(frozen=True, kw_only=True)
class ConfusionGrid:
    """Counts with the share of their row, for shading."""

    method: str
    labels: tuple[str, ...]
    unit: str
    rows: tuple[tuple[str, tuple[tuple[int, float], ...], float | None], ...]
    """(true label, ((count, share of the row), …), recall)."""
    accuracy: float | None


def confusion_grid(confusion: Confusion) -> ConfusionGrid:
    """A confusion with shares."""
    rows = []
    hits = 0
    for k, (label, counts) in enumerate(zip(confusion.labels, confusion.counts, strict=True)):
        total = sum(counts)
        hits += counts[k]
        shares = tuple((count, count / total if total else 0.0) for count in counts)
        rows.append((label, shares, counts[k] / total if total else None))
    everything = sum(sum(counts) for counts in confusion.counts)
    return ConfusionGrid(
        method=confusion.method,
        labels=confusion.labels,
        unit=confusion.unit,
        rows=tuple(rows),
        accuracy=hits / everything if everything else None,
    )
