"""Plan with the operators shown most often, and widen when there is no plan."""

import time
from dataclasses import replace

from demoplan.engines.fast_downward.installation import Installation
from demoplan.engines.fast_downward.solve import Attempt, SolveParams, solve
from demoplan.language.domains import Domain, Problem
from demoplan.stages.widen import WidenParams, is_worth_trying, widen


def solve_widening(
    domain: Domain,
    problem: Problem,
    params: SolveParams = SolveParams(),
    widen_params: WidenParams = WidenParams(),
    *,
    installation: Installation | None = None,
) -> tuple[Attempt, ...]:
    """Planning attempts with more and more operators, up to the first plan.

    Args:
        domain: All operators, with their counts.
        problem: Start and goal.
        params: Limits; the time is for all attempts together.
        widen_params: Size of the ladder.
        installation: The planner; by default where its wheel put it.

    Returns:
        At least one attempt; the last one decides. Sets of operators that cannot reach the goal at a glance
        are skipped. A plan costs the least among the operators that its attempt could use.
    """
    ladder = widen(domain, widen_params)
    rungs = [rung for rung in ladder[:-1] if is_worth_trying(rung, problem)] + [ladder[-1]]
    end = time.monotonic() + params.wall_s
    attempts: list[Attempt] = []
    for number, rung in enumerate(rungs):
        # What earlier attempts left over is shared by those to come, so that the full domain gets its turn.
        share_s = max(end - time.monotonic(), 0.0) / (len(rungs) - number)
        attempts.append(solve(rung, problem, replace(params, wall_s=share_s), installation=installation))
        if attempts[-1].outcome in {"solved", "planner_missing", "bad_input"}:
            break
    return tuple(attempts)
