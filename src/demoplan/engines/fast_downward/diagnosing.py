"""No plan: find what is missing, by asking the planner for the smallest change of the start."""

from dataclasses import replace

from demoplan.engines.fast_downward.installation import Installation
from demoplan.engines.fast_downward.searches import FIRST, OPTIMAL
from demoplan.engines.fast_downward.solve import Attempt, SolveParams, solve
from demoplan.errors import DataError
from demoplan.language.atoms import Literal
from demoplan.language.domains import Domain, Problem
from demoplan.stages.repair import (
    Diagnosis,
    Repair,
    RepairParams,
    ask_for_repair,
    never_changed,
    read_repair,
)


def diagnose(
    domain: Domain,
    problem: Problem,
    params: SolveParams = SolveParams(),
    repair_params: RepairParams = RepairParams(),
    *,
    n_repairs: int = 3,
    installation: Installation | None = None,
) -> Diagnosis:
    """Why a problem has no plan: what no operator can bring about, and the smallest changes that would help.

    Args:
        domain: What the problem could not be solved with.
        problem: Start and goal. If it has a plan after all, the first repair changes nothing.
        params: Limits; the time is for everything together.
        repair_params: Prices and limits of changes.
        n_repairs: At most this many repairs; each takes nothing that an earlier one took.
        installation: The planner; by default where its wheel put it.

    Returns:
        Repairs that leave the goal itself alone first; the trivial answer, to assume the goal, only if there
        is no other.
    """
    each = replace(params, wall_s=params.wall_s / (n_repairs + 1))
    repairs: list[Repair] = []
    excluded = frozenset(problem.goal)
    notes: list[str] = []
    while len(repairs) < n_repairs:
        repair, note = _one_repair(domain, problem, each, repair_params, excluded, installation)
        if repair is None:
            notes += [note] if note else []
            break
        repairs.append(repair)
        if not repair.changes:
            break
        excluded |= repair.changes
    if not repairs:
        repair, note = _one_repair(domain, problem, each, repair_params, frozenset(), installation)
        repairs += [repair] if repair else []
        notes += [note] if note and note not in notes else []
    repairs.sort(key=lambda found: len(found.changes))
    return Diagnosis(
        never_changed=never_changed(domain, problem), repairs=tuple(repairs), note="; ".join(notes)
    )


def _one_repair(
    domain: Domain,
    problem: Problem,
    params: SolveParams,
    repair_params: RepairParams,
    excluded: frozenset[Literal],
    installation: Installation | None,
) -> tuple[Repair | None, str]:
    """The smallest repair without the excluded literals; or None, and why, unless there simply is none."""
    try:
        changed_domain, changed_problem = ask_for_repair(domain, problem, repair_params, excluded=excluded)
    except DataError as error:
        return None, str(error)
    attempt: Attempt = solve(
        changed_domain, changed_problem, params, searches=(OPTIMAL, FIRST), installation=installation
    )
    if attempt.outcome == "unsolvable":
        return None, ""
    if attempt.outcome != "solved" or attempt.plan is None:
        return None, f"the smallest change could not be found: {attempt.message}"
    return read_repair(domain, problem, attempt.plan, is_cheapest=attempt.is_optimal), ""
