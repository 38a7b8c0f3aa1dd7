"""Every error that demoplan raises on purpose.

An error keeps its facts as attributes; its message says what was asked, what was found and what was
available. Expected failures (a log that cannot be read, a goal without a plan) become rows in tables at
the edges; these exceptions carry the reason there.
"""

from collections.abc import Iterable
from pathlib import Path


def _listing(names: Iterable[str], limit: int = 20) -> str:
    """A short, sorted listing of names for a message."""
    ordered = sorted(set(names))
    if not ordered:
        return "none"
    shown = ", ".join(ordered[:limit])
    return shown if len(ordered) <= limit else f"{shown} … ({len(ordered)} in all)"


class DemoplanError(Exception):
    """Base of every error raised on purpose."""


class UsageError(DemoplanError):
    """The caller's arguments cannot be used: the command line ends with exit code 2."""


class UnknownNameError(UsageError):
    """A name was asked for that is not there."""

    def __init__(self, kind: str, asked: str, available: Iterable[str], where: str = "") -> None:
        """Keep what was asked, and what was available.

        Args:
            kind: What the name stands for, as a noun: ``topic``, ``predicate``, ``object``.
            asked: The name that was asked for.
            available: The names that exist.
            where: Optional place that was searched, for the message.
        """
        self.kind = kind
        self.asked = asked
        self.available = tuple(sorted(set(available)))
        self.where = where
        place = f" in {where}" if where else ""
        super().__init__(f"unknown {kind} {asked!r}{place}; available: {_listing(self.available)}")


class ManifestError(UsageError):
    """A dataset, mapping or vocabulary file breaks its contract."""

    def __init__(self, path: Path | str, line: int | None, problem: str) -> None:
        """Keep the file, the line (1-based, where known) and the problem."""
        self.path = str(path)
        self.line = line
        self.problem = problem
        place = f"{path}:{line}" if line is not None else str(path)
        super().__init__(f"{place}: {problem}")


class LogError(DemoplanError):
    """A log cannot be read at all; what could be salvaged is not an error but a note."""

    def __init__(self, path: Path | str, problem: str) -> None:
        """Keep the log's path and the problem."""
        self.path = str(path)
        self.problem = problem
        super().__init__(f"{path}: {problem}")


class DataError(DemoplanError):
    """Data arrived that a stage cannot use (NaN, wrong units, an object without a type)."""


class PddlError(UsageError):
    """PDDL or goal text does not parse, or does not fit its domain."""


class PlannerError(DemoplanError):
    """The planner is missing, or ended in a way that its exit code does not explain."""


class StoreError(DemoplanError):
    """The store cannot be read or written."""


class SimulationError(DemoplanError):
    """A scene or robot cannot be simulated: objects stand in each other, or a description is missing."""
