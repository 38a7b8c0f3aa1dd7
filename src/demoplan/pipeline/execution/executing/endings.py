"""The ways in which a plan, or a whole run, is given up before its last step."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Ended:
    """How a run ended."""

    outcome: str
    reason: str = ""


class Replanned(Exception):  # noqa: N818
    """A discrepancy was acted upon: what is left of the plan is given up."""

    def __init__(self, *, pause_s: float = 0.0, let_go: str | None = None) -> None:
        """Ask for another plan.

        Args:
            pause_s: After so long [s].
            let_go: A hand that opens before: it believes to hold what perception sees elsewhere.
        """
        super().__init__()
        self.pause_s, self.let_go = pause_s, let_go


class RunEnded(Exception):  # noqa: N818
    """The run ends here."""

    def __init__(self, outcome: str, reason: str) -> None:
        """Say how and why."""
        super().__init__(reason)
        self.ended = Ended(outcome, reason)
