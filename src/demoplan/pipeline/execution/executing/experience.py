"""What a run has shown so far: which effects came about, which failed, and how often in the same way."""

from collections import Counter
from collections.abc import Iterable


class Experience:
    """Counts over one run. Literals are text in an operator's own variables, so that cases add up."""

    def __init__(self) -> None:
        """Nothing has been seen."""
        self._good: Counter[tuple[str, str]] = Counter()
        self._bad: Counter[tuple[str, tuple[str, ...]]] = Counter()
        self._equal: Counter[tuple[str, str, tuple[str, ...]]] = Counter()

    def came_about(self, operator: str, literals: Iterable[str]) -> None:
        """A step of the operator did what it should."""
        for literal in literals:
            self._good[operator, literal] += 1

    def failed_though_moved(self, operator: str, literals: tuple[str, ...]) -> None:
        """A step's motion was well, and the literals were not so after it."""
        self._bad[operator, literals] += 1

    def failed(self, operator: str, failure: str, literals: tuple[str, ...]) -> int:
        """Note a failure; how often there has been one like it, this one included."""
        self._equal[operator, failure, literals] += 1
        return self._equal[operator, failure, literals]

    def n_alike(self, operator: str, literals: tuple[str, ...]) -> int:
        """Times that the same literals failed though the motion was well."""
        return self._bad[operator, literals]

    def n_good(self, operator: str, literals: tuple[str, ...]) -> int:
        """Times that every one of the literals came about."""
        return min((self._good[operator, literal] for literal in literals), default=0)
