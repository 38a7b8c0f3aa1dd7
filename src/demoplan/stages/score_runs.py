"""Runs to scores: successes, recoveries, false alarms and classes of faults, with 95 % intervals."""

from collections.abc import Iterable

import dataframely as dy
import polars as pl
from scipy.stats import binomtest

from demoplan.tables import Runs, Scores

SUITE = "execution"


def score_runs(runs: dy.DataFrame[Runs]) -> dy.DataFrame[Scores]:
    """Shares with Wilson intervals, per monitor.

    Recovered means: the goal was physically reached though a fault happened from which one could recover.
    That is decided for the case, so that all monitors are held against the same ones. A false alarm is a
    discrepancy that was acted upon and was not true, in a run without a fault. The class is right if the
    first one named after the fault is the true one; a run in which none was named counts as missed, unless
    the goal was reached all the same: then the fault had no effect that could have been named.

    Args:
        runs: Any number of runs.

    Returns:
        ``subject`` is the domain, the goal, the kind of fault, or ``all``; ``method`` is the monitor. Without
        runs to count there is no row.
    """
    rows = []
    for (monitor,), own in runs.group_by("monitor", maintain_order=True):
        clean, faulty = own.filter(pl.col("fault").is_null()), own.filter(pl.col("is_fault_injected"))
        method = f"monitor: {monitor}"
        rows += _shares(clean, method, "goals reached", pl.col("is_goal_reached"), ("domain_name", "goal"))
        rows += _shares(clean, method, "runs with a false alarm", pl.col("n_false_alarms") > 0, ())
        rows += _shares(clean, method, "runs with an unsound dispatch", pl.col("n_unsound") > 0, ())
        believed = (pl.col("outcome") == "reached") == pl.col("is_goal_reached")
        rows += _shares(own, method, "ends as it believes", believed, ())
        able = own.filter(pl.col("is_recoverable"))
        rows += _shares(
            able, method, "recovered", pl.col("is_goal_reached"), ("fault_class", "fault", "severity")
        )
        told = faulty.filter(pl.col("diagnosed").is_not_null() | ~pl.col("is_goal_reached"))
        is_right = (pl.col("diagnosed").cast(pl.String) == pl.col("fault_class").cast(pl.String)).fill_null(
            value=False
        )
        if monitor == "full":
            rows += _shares(told, method, "class named rightly", is_right, ("fault_class", "fault"))
    schema = {name: column.dtype for name, column in Scores.columns().items()}
    table = pl.DataFrame(rows, schema=schema).sort("suite", "method", "metric", "subject")
    return Scores.validate(table)


def _shares(
    runs: pl.DataFrame, method: str, metric: str, hit: pl.Expr, by: Iterable[str]
) -> list[dict[str, object]]:
    rows = []
    marked = runs.with_columns(hit.alias("hit"))
    if marked.height:
        rows.append(_row(method, "all", metric, marked["hit"]))
    for column in by:
        for (name,), part in marked.group_by(column, maintain_order=True):
            rows.append(_row(method, f"{column}: {name}", metric, part["hit"]))
    return rows


def _row(method: str, subject: str, metric: str, hits: pl.Series) -> dict[str, object]:
    n_hits, n = int(hits.sum()), len(hits)
    interval = binomtest(n_hits, n).proportion_ci(method="wilson")
    return {
        "suite": SUITE,
        "method": method,
        "subject": subject,
        "metric": metric,
        "value": n_hits / n,
        "n": n,
        "low": float(interval.low),
        "high": float(interval.high),
        "detail": f"{n_hits} of {n}",
    }


def fault_confusion(runs: dy.DataFrame[Runs]) -> pl.DataFrame:
    """How often which true class was given which name: ``truth``, ``named``, ``n``; sorted."""
    return (
        runs.filter(pl.col("is_fault_injected") & (pl.col("monitor") == "full"))
        .select(
            truth=pl.col("fault_class").cast(pl.String),
            named=pl.col("diagnosed").cast(pl.String).fill_null("nothing"),
        )
        .group_by("truth", "named")
        .agg(n=pl.len())
        .sort("truth", "named")
    )
