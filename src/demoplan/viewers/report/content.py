"""What a report is made from. Only the episodes are needed; a section without its table is left out."""

from dataclasses import dataclass

import dataframely as dy

from demoplan.tables import (
    Activities,
    Episodes,
    Evidence,
    Findings,
    Literals,
    Operators,
    Plans,
    Scores,
    Topics,
)


@dataclass(frozen=True, kw_only=True)
class Confusion:
    """How often which true activity was taken for which; rows are true, columns inferred."""

    method: str
    labels: tuple[str, ...]
    counts: tuple[tuple[int, ...], ...]
    """``len(labels)`` rows of as many counts."""
    unit: str = "frames"
    """What is counted, as a plural noun."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A published or measured figure that a score is held against."""

    suite: str
    metric: str
    value: float
    source: str


@dataclass(frozen=True, kw_only=True)
class DomainText:
    """A domain with the name that the report calls it by: the demonstration behind it, or ``combined``."""

    domain_id: str
    name: str
    text: str = ""
    """PDDL; shown where it is not empty."""
    n_operators: int | None = None
    is_main: bool = False
    """Shown open, and the one that the operators' section speaks of."""


@dataclass(frozen=True, kw_only=True)
class Failure:
    """Something that went wrong, and why."""

    kind: str
    subject: str
    cause: str


@dataclass(frozen=True, kw_only=True)
class RefutedPlan:
    """A plan that is valid in its domain and impossible in the world, as taking a covered cube is."""

    domain_id: str
    goal: str
    """As the plans state it."""
    cause: str


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A PNG with its caption, embedded into the page."""

    caption: str
    png: bytes


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """Everything that a report may show.

    Nothing in it is a wall-clock time, so that the same tables give the same bytes.
    """

    dataset: str
    episodes: dy.DataFrame[Episodes]
    description: str = ""
    versions: tuple[tuple[str, str], ...] = ()
    """(what, version or hash) pairs, in the order shown: code version, dataset snapshot, parameters."""
    topics: dy.DataFrame[Topics] | None = None
    activities: dy.DataFrame[Activities] | None = None
    truth: dy.DataFrame[Activities] | None = None
    scores: dy.DataFrame[Scores] | None = None
    methods: tuple[str, ...] = ()
    """Methods that made these tables: where a suite compares several, key results show these only."""
    references: tuple[Reference, ...] = ()
    confusions: tuple[Confusion, ...] = ()
    operators: dy.DataFrame[Operators] | None = None
    literals: dy.DataFrame[Literals] | None = None
    evidence: dy.DataFrame[Evidence] | None = None
    findings: dy.DataFrame[Findings] | None = None
    """What learning found on the way, of the same domain as the operators."""
    domains: tuple[DomainText, ...] = ()
    """In the order of the matrix's columns."""
    plans: dy.DataFrame[Plans] | None = None
    goals: tuple[tuple[str, str], ...] = ()
    """(goal as the plans state it, name to call it by) pairs, in the order of the matrix's rows."""
    refuted: tuple[RefutedPlan, ...] = ()
    """Plans that the planner's tables call solved, and that could not happen."""
    failures: tuple[Failure, ...] = ()
    """Beyond those that the tables themselves tell. If any is of the kind ``plan``, these are all of them."""
    pictures: tuple[Picture, ...] = ()
