"""Episodes with what their logs held, and everything that went wrong, as rows."""

from dataclasses import dataclass

import polars as pl

from demoplan.viewers.report.content import Failure, ReportContent
from demoplan.viewers.report.plan_matrix import PlanMatrix

_STATUS_ORDER = {"quarantined": 0, "truncated": 1, "complete": 2}


@dataclass(frozen=True, kw_only=True)
class EpisodeRow:
    """An episode, and what its log held."""

    episode_id: str
    participant: str
    task: str
    goal: str
    status: str
    reason: str
    duration: str
    n_messages: str
    n_rejected: int | None
    file: str
    sha256: str


def episode_rows(content: ReportContent) -> tuple[EpisodeRow, ...]:
    """Every episode, those in trouble first."""
    counts: dict[str, tuple[int, int]] = {}
    if content.topics is not None:
        mapped = content.topics.filter(pl.col("is_mapped"))
        sums = mapped.group_by("episode_id").agg(pl.col("n_messages").sum(), pl.col("n_rejected").sum())
        counts = {episode: (n, rejected) for episode, n, rejected in sums.iter_rows()}
    rows = sorted(content.episodes.to_dicts(), key=lambda r: (_STATUS_ORDER[r["status"]], r["episode_id"]))
    return tuple(
        EpisodeRow(
            episode_id=row["episode_id"],
            participant=row["participant"],
            task=row["task"],
            goal={True: "reached", False: "missed", None: "–"}[row["is_goal_reached"]],
            status=row["status"],
            reason=row["reason"] or "",
            duration=(
                "–"
                if row["start_ns"] is None or row["end_ns"] is None
                else f"{(row['end_ns'] - row['start_ns']) * 1e-9:.1f} s"
            ),
            n_messages=f"{counts[row['episode_id']][0]:,}".replace(",", " ")
            if row["episode_id"] in counts
            else "–",
            n_rejected=counts[row["episode_id"]][1] if row["episode_id"] in counts else None,
            file=row["file"],
            sha256=row["sha256"] or "",
        )
        for row in rows
    )


def failure_rows(content: ReportContent, matrix: PlanMatrix | None) -> tuple[Failure, ...]:
    """Everything that went wrong: episodes, topics, plans, scored subjects, and what the caller adds."""
    rows = [
        Failure(kind="episode", subject=row.episode_id, cause=f"{row.status}: {row.reason}")
        for row in episode_rows(content)
        if row.status != "complete"
    ]
    if content.topics is not None:
        for row in (
            content.topics.filter(pl.col("n_rejected") > 0).sort("episode_id", "topic").iter_rows(named=True)
        ):
            cause = f"{row['n_rejected']} of {row['n_messages']} messages rejected"
            cause += f": {row['note']}" if row["note"] else ""
            rows.append(Failure(kind="topic", subject=f"{row['episode_id']} {row['topic']}", cause=cause))
    if matrix is not None and not any(failure.kind == "plan" for failure in content.failures):
        for goal, cells, _, _ in matrix.rows:
            for domain, cell in zip(matrix.domains, cells, strict=True):
                if cell is not None and not cell.is_solved:
                    cause = cell.outcome + (f": {cell.message}" if cell.message else "")
                    rows.append(Failure(kind="plan", subject=f"{goal} with {domain}", cause=cause))
    return (*rows, *content.failures)
