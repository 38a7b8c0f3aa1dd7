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
    subject: str
    """What was scored; empty for everything."""
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

    A suite without a score for ``all`` shows what it has. Where it knows some of ``methods``, the others are
    left to the comparison, as are the figures without an interval where others have one. A metric whose name
    says ``of what: which`` breaks another one down, and is left to the tables of its own section.
    """
    if scores is None:
        return ()
    known = {(r.suite, r.metric): r for r in references}
    is_whole, is_used = pl.col("subject") == "all", pl.col("method").is_in(list(methods))
    chosen = scores.filter(is_whole | ~is_whole.any().over("suite"))
    chosen = chosen.filter(is_used | ~is_used.any().over("suite"))
    chosen = chosen.filter(~pl.col("metric").str.contains(": ", literal=True))
    has_low = pl.col("low").is_not_null()
    chosen = chosen.filter(has_low | ~has_low.any().over("suite"))
    rows = []
    for row in chosen.sort("suite", "subject", "metric", "method").iter_rows(named=True):
        reference = known.get((row["suite"], row["metric"]))
        has_interval = row["low"] is not None and row["high"] is not None
        rows.append(
            ScoreRow(
                suite=row["suite"],
                subject="" if row["subject"] == "all" else row["subject"],
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
    """Metrics against methods, with the best method of each metric marked."""

    methods: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[str, bool], ...]], ...]
    """(metric, ((figure, is best), …)) in the order of ``methods``."""


def score_grid(scores: pl.DataFrame | None, suite: str) -> ScoreGrid | None:
    """The methods of a suite side by side over everything; null where no two have a metric in common."""
    if scores is None:
        return None
    chosen = scores.filter((pl.col("suite") == suite) & (pl.col("subject") == "all"))
    if chosen["metric"].n_unique() == chosen.height:
        return None
    methods = tuple(sorted(chosen["method"].unique()))
    figures = {(m, k): v for m, k, v in chosen.select("method", "metric", "value").iter_rows()}
    rows = []
    for metric in sorted(chosen["metric"].unique()):
        values = [figures.get((method, metric)) for method in methods]
        known = [value for value in values if value is not None]
        # An error or a duration is better when it is smaller; a name does not tell which, so ratios only.
        is_ratio = len(set(known)) > 1 and all(0.0 <= value <= 1.0 for value in known)
        best = max(known) if is_ratio else None
        rows.append((metric, tuple((number(v), v is not None and v == best) for v in values)))
    return ScoreGrid(methods=methods, rows=tuple(rows))


@dataclass(frozen=True, kw_only=True)
class ConfusionGrid:
    """Counts with the share of their row, for shading."""

    method: str
    labels: tuple[str, ...]
    unit: str
    rows: tuple[tuple[str, tuple[tuple[int, float], ...], int], ...]
    """(true label, ((count, share of the row), …), count of the row)."""
    accuracy: float | None


def confusion_grid(confusion: Confusion) -> ConfusionGrid:
    """A confusion with shares."""
    rows = []
    hits = 0
    for k, (label, counts) in enumerate(zip(confusion.labels, confusion.counts, strict=True)):
        total = sum(counts)
        hits += counts[k]
        shares = tuple((count, count / total if total else 0.0) for count in counts)
        rows.append((label, shares, total))
    everything = sum(sum(counts) for counts in confusion.counts)
    return ConfusionGrid(
        method=confusion.method,
        labels=confusion.labels,
        unit=confusion.unit,
        rows=tuple(rows),
        accuracy=hits / everything if everything else None,
    )
