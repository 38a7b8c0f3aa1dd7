"""A goal to an execution: plan, dispatch, monitor, diagnose, plan again, and say honestly how it ended."""

from dataclasses import asdict, dataclass

import dataframely as dy
import polars as pl

from demoplan.engines.mujoco.session import Session
from demoplan.language.domains import Domain
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.faults import AnyFault
from demoplan.pipeline.execution.executing import ExecuteParams, Executor
from demoplan.tables import Executions, Runs

MONITORS = ("full", "preconditions", "none")


@dataclass(frozen=True, kw_only=True)
class Executed:
    """One run."""

    run: dy.DataFrame[Runs]
    steps: dy.DataFrame[Executions]
    frames: pl.DataFrame
    """What sensors saw, as rows of ``Frames``."""


def execute(
    domain: Domain,
    goal: str,
    session: Session,
    vocabulary: Vocabulary,
    *,
    run_id: str = "run",
    seed: int = 0,
    domain_id: str = "",
    domain_name: str = "",
    goal_name: str | None = None,
    fault: AnyFault | None = None,
    params: ExecuteParams = ExecuteParams(),
) -> Executed:
    """Reach a goal in a session.

    Args:
        domain: Operators to plan with.
        goal: Goal text.
        session: Robot and scene, at rest.
        vocabulary: What perception looks for.
        run_id: Key of the rows.
        seed: Of what a fault draws.
        domain_id: For the rows.
        domain_name: For the rows.
        goal_name: For the rows; the goal's text by default.
        fault: What goes wrong, if anything.
        params: Choices.

    Returns:
        One row for the run and one for each step. Failures are rows; equal arguments give equal rows.

    Raises:
        UnknownNameError: If the goal names what is not there, or a skill is not mapped.
        PddlError: If the goal is not one.
        UsageError: If a fault does not fit the domain.
    """
    executor = Executor(
        domain, goal, session, vocabulary, run_id=run_id, seed=seed, fault=fault, params=params
    )
    ended = executor.run()
    fault_columns = {
        "fault": None if fault is None else fault.name,
        "fault_kind": None if fault is None else fault.kind,
        "fault_class": executor.injector.true_class,
        "severity": None if fault is None else fault.severity,
        "is_fault_injected": executor.injector.is_done,
        "fault_ns": executor.injector.happened_ns,
        "is_recoverable": None,
    }
    run: dict[str, object] = {
        "run_id": run_id,
        "domain_id": domain_id,
        "domain_name": domain_name or domain.name,
        "goal": goal_name or goal,
        "robot": session.robot,
        "monitor": params.monitor,
        "seed": seed,
        **fault_columns,
        "is_goal_reached": executor.is_goal_reached(),
        "is_goal_sensed": executor.is_goal_sensed(),
        "outcome": ended.outcome,
        "reason": ended.reason or None,
        **asdict(executor.counts),
        "diagnosed": executor.discrepancies.diagnosed,
        "simulated_s": session.time_ns / 1e9,
    }
    return Executed(
        run=run_rows([run]), steps=step_rows(executor.noted.rows), frames=executor.senses.frames(-1)
    )


def run_rows(rows: list[dict[str, object]]) -> dy.DataFrame[Runs]:
    """Rows as the table ``runs``."""
    schema = {name: column.dtype for name, column in Runs.columns().items()}
    return Runs.validate(pl.DataFrame(rows, schema=schema))


def step_rows(rows: list[dict[str, object]]) -> dy.DataFrame[Executions]:
    """Rows as the table ``executions``."""
    schema = {name: column.dtype for name, column in Executions.columns().items()}
    table = pl.DataFrame(rows, schema=schema)
    return Executions.validate(table.sort("run_id", "plan_index", "step_index"))


__all__ = ["MONITORS", "ExecuteParams", "Executed", "execute", "run_rows", "step_rows"]
