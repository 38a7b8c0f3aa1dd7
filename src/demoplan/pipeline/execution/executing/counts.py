"""What is counted over a run, for its row."""

from dataclasses import dataclass


@dataclass
class Counts:
    """Columns of ``Runs`` of the same names."""

    n_plans: int = 0
    n_steps: int = 0
    n_discrepancies: int = 0
    n_passed: int = 0
    n_false_alarms: int = 0
    n_unsound: int = 0

    @property
    def plan_index(self) -> int:
        """Number of the plan under way."""
        return max(0, self.n_plans - 1)
