"""Goals against the domains that they were tried with."""

from collections.abc import Sequence
from dataclasses import dataclass

import polars as pl

from demoplan.viewers.report.content import DomainText, RefutedPlan


@dataclass(frozen=True, kw_only=True)
class PlanCell:
    """How a goal fared with a domain: its best attempt."""

    outcome: str
    is_solved: bool
    n_steps: int | None
    cost: int | None
    n_attempts: int
    steps: tuple[str, ...]
    message: str


@dataclass(frozen=True, kw_only=True)
class PlanMatrix:
    """Goals against domains; a cell is null where nothing was tried."""

    domains: tuple[str, ...]
    rows: tuple[tuple[str, tuple[PlanCell | None, ...], int, int], ...]
    """(goal, cells, solved, tried)."""
    totals: tuple[tuple[int, int], ...]
    """(solved, tried) per domain."""


def plan_matrix(
    plans: pl.DataFrame | None,
    domains: Sequence[DomainText],
    goals: Sequence[tuple[str, str]],
    refuted: Sequence[RefutedPlan] = (),
) -> PlanMatrix | None:
    """The success matrix.

    Solved means: an attempt gave a plan, the plan was validated independently, and nobody has refuted it.
    """
    if plans is None or plans.is_empty():
        return None
    names = {d.domain_id: d.name for d in domains}
    columns = [d.domain_id for d in domains if d.domain_id in set(plans["domain_id"])]
    columns += sorted(set(plans["domain_id"]) - set(columns))
    calls = dict(goals)
    rows_in_order = [goal for goal, _ in goals if goal in set(plans["goal"])]
    rows_in_order += sorted(set(plans["goal"]) - set(rows_in_order))
    attempts: dict[tuple[str, str], list[dict[str, object]]] = {}
    for row in plans.sort("domain_id", "goal", "problem_id", "attempt").iter_rows(named=True):
        attempts.setdefault((row["goal"], row["domain_id"]), []).append(row)
    against = {(plan.goal, plan.domain_id): plan.cause for plan in refuted}
    rows = []
    for goal in rows_in_order:
        cells = tuple(_plan_cell(attempts.get((goal, d), []), against.get((goal, d))) for d in columns)
        tried = [cell for cell in cells if cell is not None]
        rows.append((calls.get(goal, goal), cells, sum(c.is_solved for c in tried), len(tried)))
    totals = []
    for k in range(len(columns)):
        tried = [cell for _, cells, _, _ in rows if (cell := cells[k]) is not None]
        totals.append((sum(c.is_solved for c in tried), len(tried)))
    return PlanMatrix(domains=tuple(names.get(d, d) for d in columns), rows=tuple(rows), totals=tuple(totals))


def _plan_cell(attempts: Sequence[dict[str, object]], refuted: str | None) -> PlanCell | None:
    """The cheapest validated plan, else the last attempt."""
    if not attempts:
        return None
    good = [row for row in attempts if row["outcome"] == "solved" and row["is_validated"]]
    best = min(good, key=lambda row: (row["cost"] is None, row["cost"])) if good else attempts[-1]
    outcome = str(best["outcome"])
    if outcome == "solved" and not good:
        outcome = "not validated"
    if good and refuted is not None:
        outcome = "impossible"
    steps, n_steps, cost = best["steps"], best["n_steps"], best["cost"]
    return PlanCell(
        outcome=outcome.replace("_", " "),
        is_solved=bool(good) and refuted is None,
        n_steps=n_steps if isinstance(n_steps, int) else None,
        cost=cost if isinstance(cost, int) else None,
        n_attempts=len(attempts),
        steps=tuple(steps) if isinstance(steps, list) else (),
        message=str(best["message"] or "") if not good or refuted is None else refuted,
    )
