"""Runs as one page: goals against domains, faults against monitors, scores, and what ended badly."""

from dataclasses import dataclass
from typing import Any

import dataframely as dy
import polars as pl

from demoplan.tables import Executions, Runs, Scores
from demoplan.viewers.report.markup import counted, interval_bar
from demoplan.viewers.report.page import page_of

_SHOWN_TROUBLES = 300


@dataclass(frozen=True, kw_only=True)
class RunMatrix:
    """How often the goal was reached, for each of some rows and columns."""

    monitor: str
    """Which monitor all runs had; empty if these are the columns."""
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[int, int], tuple[tuple[int, int, str] | None, ...]], ...]
    """(name, (reached, tried) in all, ((reached, tried, most common reason of failure) per column, …))."""
    totals: tuple[tuple[int, int], ...]
    """(reached, tried) per column."""
    total: tuple[int, int]


def run_matrices(runs: pl.DataFrame) -> tuple[RunMatrix, ...]:
    """Goals against domains in runs without faults, one matrix per monitor."""
    clean = runs.filter(pl.col("fault").is_null())
    monitors = sorted(clean["monitor"].cast(pl.String).unique())
    return tuple(
        _matrix(clean.filter(pl.col("monitor") == monitor), "goal", "domain_name", monitor)
        for monitor in monitors
    )


def fault_matrix(runs: pl.DataFrame) -> RunMatrix | None:
    """Faults against monitors, in runs in which the fault happened; null if it did in none."""
    faulty = runs.filter(pl.col("is_fault_injected"))
    return None if faulty.is_empty() else _matrix(faulty, "fault", "monitor", "")


def _matrix(runs: pl.DataFrame, row: str, column: str, monitor: str) -> RunMatrix:
    """Runs counted by two of their columns; a cell is null where nothing was tried."""
    named = runs.with_columns(pl.col(row, column).cast(pl.String))
    names, columns = sorted(named[row].unique()), sorted(named[column].unique())
    cells = {(str(key[0]), str(key[1])): part for key, part in named.group_by(row, column)}
    rows = []
    for name in names:
        own = [cells.get((name, each)) for each in columns]
        rows.append(
            (
                name,
                _reached(named.filter(pl.col(row) == name)),
                tuple(None if part is None else (*_reached(part), _usual_end(part)) for part in own),
            )
        )
    return RunMatrix(
        monitor=monitor,
        columns=tuple(columns),
        rows=tuple(rows),
        totals=tuple(_reached(named.filter(pl.col(column) == each)) for each in columns),
        total=_reached(named),
    )


def _reached(runs: pl.DataFrame) -> tuple[int, int]:
    return int(runs["is_goal_reached"].sum()), runs.height


def _usual_end(runs: pl.DataFrame) -> str:
    """How most of the runs ended that missed the goal; empty if none did."""
    bad = runs.filter(~pl.col("is_goal_reached"))
    ends = bad.group_by("outcome").len().sort("len", "outcome", descending=[True, False])
    if ends.is_empty():
        return ""
    # A run may believe that it reached a goal which by physics it has not.
    end = str(ends.item(0, "outcome")).replace("_", " ")
    return "believed reached" if end == "reached" else end


def render_execution_report(
    title: str,
    runs: dy.DataFrame[Runs],
    steps: dy.DataFrame[Executions],
    scores: dy.DataFrame[Scores],
    confusion: pl.DataFrame,
) -> str:
    """The page; it needs no other file, no network and no script.

    Args:
        title: Its heading.
        runs: One row per run.
        steps: Their steps.
        scores: Shares over them.
        confusion: ``truth``, ``named``, ``n`` of faults.
    """
    named = sorted(set(confusion["named"]))
    counts = {(t, k): n for t, k, n in confusion.select("truth", "named", "n").iter_rows()}
    troubled = runs.filter(~pl.col("is_goal_reached")).sort("domain_name", "goal", "fault", "monitor", "seed")
    causes = {
        row["run_id"]: f"{row['operator']}: {row['cause']}"
        for row in steps.filter(pl.col("failure").is_not_null()).iter_rows(named=True)
    }
    return page_of(
        "execution.html",
        title=title,
        tiles=_tiles(runs),
        matrices=run_matrices(runs),
        fault_matrix=fault_matrix(runs),
        scores=_score_rows(scores),
        named=named,
        confusion=[
            (truth, [counts.get((truth, name), 0) for name in named])
            for truth in sorted(set(confusion["truth"]))
        ],
        troubled=[
            {**row, "cause": causes.get(row["run_id"], "")}
            for row in troubled.head(_SHOWN_TROUBLES).iter_rows(named=True)
        ],
        n_troubled=troubled.height,
    )


def _score_rows(scores: pl.DataFrame) -> list[dict[str, Any]]:
    """Scores by metric, each over everything before its parts."""
    rows = [
        {
            **row,
            "monitor": row["method"].removeprefix("monitor: "),
            "is_all": row["subject"] == "all",
            "subject": _subject(row["subject"]),
            "drawn": interval_bar(row["value"], row["low"], row["high"], None),
        }
        for row in scores.iter_rows(named=True)
    ]
    return sorted(rows, key=lambda row: (row["metric"], row["monitor"], not row["is_all"], row["subject"]))


def _subject(subject: str) -> str:
    """What a score is of, without the column's name.

    >>> _subject("domain_name: p1_one"), _subject("fault_class: motion"), _subject("all")
    ('domain: p1_one', 'fault class: motion', 'all')
    """
    kind, colon, name = subject.partition(": ")
    return kind.replace("_name", "").replace("_", " ") + colon + name


def _duration(seconds: float) -> str:
    """A stretch of time in the unit that fits.

    >>> _duration(38.2), _duration(600.0), _duration(9000.0)
    ('38 s', '10.0 minutes', '2.5 hours')
    """
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} minutes" if seconds < 7200 else f"{seconds / 3600:.1f} hours"


def _tiles(runs: pl.DataFrame) -> list[tuple[str, str, str]]:
    clean = runs.filter(pl.col("fault").is_null())
    faulty = runs.filter(pl.col("is_fault_injected"))
    simulated_s = float(runs["simulated_s"].sum())
    tiles = [
        (str(runs.height), "runs", f"{_duration(simulated_s)} of simulated time"),
        (f"{int(clean['is_goal_reached'].sum())}/{clean.height}", "goals reached", "without faults"),
    ]
    if faulty.height:
        tiles.append(
            (str(faulty.height), "faults injected", f"{counted(faulty['fault'].n_unique(), 'kind')} of them")
        )
    tiles.append((str(int(clean["n_unsound"].sum())), "unsound dispatches", "conditions physically false"))
    return tiles
