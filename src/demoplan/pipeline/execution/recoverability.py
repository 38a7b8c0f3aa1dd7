"""Whether a goal could still be reached after a fault: decided once for a case, without any monitor.

The plan is carried out open loop until the fault has happened, and no further. Hands come to rest, and what
the fault does is given time to end. Then the world as it truly is is planned from, with the operators as they
truly are, and with the robot's own ways out. If that gives a plan, whoever monitors could have found it too.
"""

from dataclasses import dataclass, replace

import polars as pl

from demoplan.engines.mujoco.session import Session
from demoplan.language.domains import Domain
from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.faults import AnyFault, WrongLiteralFault
from demoplan.pipeline.execution.executing import ExecuteParams, Executor
from demoplan.pipeline.execution.replanning import Planned, plan_from

_SETTLE_S = 1.5
"""What falls has come to rest after this long [s]."""


@dataclass(frozen=True)
class Recoverability:
    """What was decided about a case."""

    has_happened: bool
    """Whether the fault happened at all."""
    is_recoverable: bool | None
    """None if it did not happen."""
    reason: str


def recoverability(
    domain: Domain,
    goal: str,
    session: Session,
    vocabulary: Vocabulary,
    fault: AnyFault,
    *,
    seed: int,
    params: ExecuteParams = ExecuteParams(),
) -> Recoverability:
    """Whether anybody could reach the goal after the fault.

    Args:
        domain: Operators, as they are without the fault.
        goal: Goal text.
        session: Robot and scene, at rest; it is used up.
        vocabulary: What perception looks for.
        fault: What goes wrong.
        seed: Of what the fault draws.
        params: Choices; the monitor's do not count.
    """
    executor = Executor(
        domain,
        goal,
        session,
        vocabulary,
        run_id="",
        seed=seed,
        fault=fault,
        params=replace(params, monitor="none"),
    )
    injector = executor.injector
    ended = executor.run(until=lambda: injector.has_shown)
    if not injector.has_shown:
        if isinstance(fault, WrongLiteralFault):
            return Recoverability(True, False, f"no step of a wrong operator is ever taken: {ended.reason}")
        return Recoverability(False, None, f"it did not happen: {ended.outcome}: {ended.reason}".strip(": "))
    session.advance(getattr(fault, "duration_s", 0.0) + _SETTLE_S)
    planned = _planned(executor, domain)
    if not _is_plan(planned) and executor.free_a_hand(executor.senses.truth()):
        session.advance(_SETTLE_S)
        planned = _planned(executor, domain)
    if _is_plan(planned):
        assert planned.plan is not None
        n_steps = len(planned.plan.steps)
        return Recoverability(True, True, f"a plan of {n_steps} steps leads on from what is true")
    return Recoverability(True, False, f"no plan leads on from what is true: {planned.reason}")


def _is_plan(planned: Planned) -> bool:
    return planned.plan is not None and planned.n_possible is None


def _planned(executor: Executor, domain: Domain) -> Planned:
    session, params = executor.session, executor.params
    seen = session.true_frames(session.time_ns - 500_000_000)
    present = set(seen.filter(pl.col("position_xyz_m").is_not_null())["entity"])
    return plan_from(
        domain,
        executor.full_goal,
        executor.senses.truth(),
        executor.senses,
        params.momentary,
        params.solving,
        params.skills,
        is_first=False,
        gone=frozenset(executor.senses.objects) - present,
    )
