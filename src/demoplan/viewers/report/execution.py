"""Runs as one page: goals against domains, scores with intervals, faults, and what ended badly."""

from dataclasses import dataclass

import dataframely as dy
import polars as pl
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from demoplan.tables import Executions, Runs, Scores
from demoplan.viewers.report.markup import interval_bar, number, visible


@dataclass(frozen=True, kw_only=True)
class RunMatrix:
    """How often each goal was reached with each domain, for one monitor, without faults."""

    monitor: str
    domains: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[int, int, str] | None, ...]], ...]
    """(goal, ((reached, tried, most common reason of failure), …))."""


def run_matrices(runs: pl.DataFrame) -> tuple[RunMatrix, ...]:
    """One matrix per monitor; a cell is null where nothing was tried."""
    matrices = []
    clean = runs.filter(pl.col("fault").is_null())
    for monitor in sorted(clean["monitor"].cast(pl.String).unique()):
        own = clean.filter(pl.col("monitor") == monitor)
        domains, goals = sorted(own["domain_name"].unique()), sorted(own["goal"].unique())
        rows = []
        for goal in goals:
            cells: list[tuple[int, int, str] | None] = []
            for domain in domains:
                part = own.filter((pl.col("goal") == goal) & (pl.col("domain_name") == domain))
                bad = part.filter(~pl.col("is_goal_reached"))
                reasons = bad.group_by("outcome").len().sort("len", "outcome", descending=[True, False])
                why = str(reasons.item(0, "outcome")).replace("_", " ") if reasons.height else ""
                cells.append((part.height - bad.height, part.height, why) if part.height else None)
            rows.append((goal, tuple(cells)))
        matrices.append(RunMatrix(monitor=monitor, domains=tuple(domains), rows=tuple(rows)))
    return tuple(matrices)


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
    environment = Environment(
        loader=PackageLoader("demoplan.viewers.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    stylesheet, _, _ = environment.loader.get_source(environment, "report.css")  # type: ignore[union-attr]
    named = sorted(set(confusion["named"]))
    counts = {(t, k): n for t, k, n in confusion.select("truth", "named", "n").iter_rows()}
    troubled = runs.filter(~pl.col("is_goal_reached")).sort("domain_name", "goal", "fault", "monitor", "seed")
    causes = {
        row["run_id"]: f"{row['operator']}: {row['cause']}"
        for row in steps.filter(pl.col("failure").is_not_null()).iter_rows(named=True)
    }
    return environment.get_template("execution.html").render(
        title=title,
        stylesheet=Markup(stylesheet),  # noqa: S704 - ours, from beside the template
        tiles=_tiles(runs),
        matrices=run_matrices(runs),
        scores=[
            {**row, "drawn": interval_bar(row["value"], row["low"], row["high"], None)}
            for row in scores.iter_rows(named=True)
        ],
        named=named,
        confusion=[
            (truth, [counts.get((truth, name), 0) for name in named])
            for truth in sorted(set(confusion["truth"]))
        ],
        troubled=[
            {**row, "cause": causes.get(row["run_id"], "")}
            for row in troubled.head(300).iter_rows(named=True)
        ],
        n_troubled=troubled.height,
    )


def _tiles(runs: pl.DataFrame) -> list[tuple[str, str, str]]:
    clean = runs.filter(pl.col("fault").is_null())
    faulty = runs.filter(pl.col("is_fault_injected"))
    simulated_s = float(runs["simulated_s"].sum())
    tiles = [
        (str(runs.height), "runs", f"{simulated_s / 3600:.1f} simulated hours"),
        (f"{int(clean['is_goal_reached'].sum())}/{clean.height}", "goals reached", "without faults"),
    ]
    if faulty.height:
        tiles.append((str(faulty.height), "faults injected", f"{faulty['fault'].n_unique()} different ones"))
    tiles.append((str(int(clean["n_unsound"].sum())), "unsound dispatches", "conditions physically false"))
    return tiles
