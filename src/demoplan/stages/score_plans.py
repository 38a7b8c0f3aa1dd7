"""Planning attempts to scores: how many problems were solved, with intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import dataframely as dy
import polars as pl
from scipy.stats import binomtest

from demoplan.tables import Scores

SUITE = "planning"


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One domain tried on one goal."""

    group: str
    """What the trial counts for: ``single domains``, ``combined domain``, ``fresh single domains``."""
    domain: str
    """What the domain was learned from."""
    goal: str
    """The goal's name."""
    is_solved: bool
    """A plan was found, is valid, and could happen."""
    cause: str | None
    """Why it is not solved."""


def proportion_interval(n_hits: int, n: int) -> tuple[float, float] | tuple[None, None]:
    """95 % interval of a proportion; none without observations.

    Source: E. B. Wilson, "Probable inference, the law of succession, and statistical inference", JASA 22
    (1927), doi:10.1080/01621459.1927.10502953.
    """
    if n == 0:
        return None, None
    interval = binomtest(n_hits, n).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def score_plans(trials: Sequence[Trial], method: str) -> dy.DataFrame[Scores]:
    """Share of solved goals, and of domains that solve every goal, for each group of domains.

    Args:
        trials: Every domain × goal that was tried.
        method: What made the domains, for the table.
    """
    rows = []
    for group in sorted({trial.group for trial in trials}):
        own = [trial for trial in trials if trial.group == group]
        domains = sorted({trial.domain for trial in own})
        whole = [all(trial.is_solved for trial in own if trial.domain == name) for name in domains]
        rows += [
            _row(method, group, "goals solved", [trial.is_solved for trial in own]),
            _row(method, group, "domains that solve every goal", whole),
        ]
        for goal in sorted({trial.goal for trial in own}):
            solved = [trial.is_solved for trial in own if trial.goal == goal]
            rows.append(_row(method, group, f"solved: {goal}", solved))
    schema = {name: column.dtype for name, column in Scores.columns().items()}
    return Scores.validate(pl.DataFrame(rows, schema=schema))


def _row(method: str, subject: str, metric: str, hits: Sequence[bool]) -> dict[str, object]:
    low, high = proportion_interval(sum(hits), len(hits))
    return {
        "suite": SUITE,
        "method": method,
        "subject": subject,
        "metric": metric,
        "value": sum(hits) / len(hits) if hits else None,
        "n": len(hits),
        "low": low,
        "high": high,
        "detail": f"{sum(hits)} of {len(hits)}",
    }
