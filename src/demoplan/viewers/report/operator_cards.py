"""Operators with their literals, what speaks for and against each, and where they were seen."""

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from demoplan.viewers.report.content import ReportContent
from demoplan.viewers.report.markup import support_bar


@dataclass(frozen=True, kw_only=True)
class LiteralRow:
    """A literal with what speaks for and against it."""

    literal: str
    is_positive: bool
    n_support: int
    n_against: int
    n_transitions: int
    probability: float
    note: str
    drawn: Markup


@dataclass(frozen=True, kw_only=True)
class EvidenceRow:
    """Where an operator was seen."""

    episode_id: str
    hand: str
    start: str
    end: str
    binding: str
    contradicts: str


@dataclass(frozen=True, kw_only=True)
class OperatorCard:
    """An operator with all that was considered for it."""

    operator: str
    activity: str
    parameters: tuple[tuple[str, str], ...]
    n_transitions: int
    n_episodes: int
    n_successes: int
    n_failures: int
    beta: float
    cost: int
    is_quarantined: bool
    note: str
    preconditions: tuple[LiteralRow, ...]
    effects: tuple[LiteralRow, ...]
    dropped: tuple[LiteralRow, ...]
    evidence: tuple[EvidenceRow, ...]


def operator_cards(content: ReportContent) -> tuple[OperatorCard, ...]:
    """Operators by count, then name; quarantined ones last."""
    if content.operators is None:
        return ()
    starts = {e: s for e, s in content.episodes.select("episode_id", "start_ns").iter_rows() if s is not None}
    literals = [] if content.literals is None else content.literals.to_dicts()
    evidence = [] if content.evidence is None else content.evidence.to_dicts()
    by_operator: dict[str, list[dict[str, object]]] = {}
    for row in sorted(literals, key=lambda r: (r["predicate"], r["variables"], not r["is_positive"])):
        by_operator.setdefault(row["operator"], []).append(row)
    seen: dict[str, list[EvidenceRow]] = {}
    for row in sorted(evidence, key=lambda r: (r["episode_id"], r["start_ns"], r["hand"])):
        since = starts.get(row["episode_id"], 0)
        seen.setdefault(row["operator"], []).append(
            EvidenceRow(
                episode_id=row["episode_id"],
                hand=row["hand"],
                start=f"{(row['start_ns'] - since) * 1e-9:.2f}",
                end=f"{(row['end_ns'] - since) * 1e-9:.2f}",
                binding=", ".join(row["binding"]),
                contradicts=", ".join(row["contradicts"]),
            )
        )
    ordered = sorted(
        content.operators.to_dicts(), key=lambda r: (r["is_quarantined"], -r["n_transitions"], r["operator"])
    )
    return tuple(
        OperatorCard(
            operator=row["operator"],
            activity=row["activity"],
            parameters=tuple((p["variable"], p["type"]) for p in row["parameters"]),
            n_transitions=row["n_transitions"],
            n_episodes=row["n_episodes"],
            n_successes=row["n_successes"],
            n_failures=row["n_failures"],
            beta=row["beta"],
            cost=row["cost"],
            is_quarantined=row["is_quarantined"],
            note=row["note"] or "",
            preconditions=_literal_rows(by_operator.get(row["operator"], []), "precondition", is_kept=True),
            effects=_literal_rows(by_operator.get(row["operator"], []), "effect", is_kept=True),
            dropped=_literal_rows(by_operator.get(row["operator"], []), None, is_kept=False),
            evidence=tuple(seen.get(row["operator"], ())),
        )
        for row in ordered
    )


def _literal_rows(
    rows: Sequence[dict[str, object]], role: str | None, *, is_kept: bool
) -> tuple[LiteralRow, ...]:
    result = []
    for row in rows:
        if row["is_kept"] is not is_kept or (role is not None and row["role"] != role):
            continue
        variables = row["variables"]
        assert isinstance(variables, list)
        n_support, n_against, n = (int(str(row[k])) for k in ("n_support", "n_against", "n_transitions"))
        note = str(row["note"] or "")
        result.append(
            LiteralRow(
                literal=f"{row['predicate']}({', '.join(variables)})",
                is_positive=bool(row["is_positive"]),
                n_support=n_support,
                n_against=n_against,
                n_transitions=n,
                probability=float(str(row["probability"])),
                note=note if role is not None else f"{row['role']}{': ' if note else ''}{note}",
                drawn=support_bar(n_support, n_against, n),
            )
        )
    return tuple(result)
