"""What is written down of a run: a row for each step, begun or not, and each motion of the robot's own."""

from collections.abc import Sequence

Row = dict[str, object]
"""A row of ``Executions`` in the making; it is changed as the step goes on."""


class StepRows:
    """The rows of one run."""

    def __init__(self, run_id: str) -> None:
        """Begin without any."""
        self.run_id = run_id
        self.rows: list[Row] = []

    def of_plan(self, plan_index: int) -> list[Row]:
        """Those of one plan."""
        return [row for row in self.rows if row["plan_index"] == plan_index]

    def of_step(
        self,
        plan_index: int,
        step_index: int,
        operator: str,
        arguments: Sequence[str],
        *,
        hand: str,
        activity: str,
    ) -> Row:
        """The new row of a step of a plan; it is yet to be begun."""
        return self._new(plan_index, step_index, operator, list(arguments), hand, activity)

    def beside(self, plan_index: int, n_steps: int) -> Row:
        """A new row for something that is no step of the plan: it is numbered after all ``n_steps`` of it."""
        taken = [int(str(row["step_index"])) for row in self.of_plan(plan_index)]
        return self._new(plan_index, max([n_steps - 1, *taken]) + 1, "goal", [], None, "Check")

    def _new(
        self,
        plan_index: int,
        step_index: int,
        operator: str,
        arguments: list[str],
        hand: str | None,
        activity: str,
    ) -> Row:
        row: Row = {
            "run_id": self.run_id,
            "plan_index": plan_index,
            "step_index": step_index,
            "operator": operator,
            "arguments": arguments,
            "hand": hand,
            "activity": activity,
            "state": "not_executed",
            "start_ns": None,
            "end_ns": None,
            "unmet": [],
            "missing": [],
            "extra": [],
            "failure": None,
            "cause": None,
            "tracking_error_m": None,
            "peak_force_n": None,
            "n_collisions": None,
        }
        self.rows.append(row)
        return row


def end_of(row: Row) -> str:
    """The state of a step that did not succeed."""
    return "timeout" if row["state"] == "timeout" else "failed"
