"""Domain and problem to a plan, by Fast Downward as two separate programs: translator, then search.

The driver is left out, as it only starts the two and costs another Python start-up; the translator is kept
warm (:mod:`demoplan.engines.fast_downward.translating`). Everything that can happen is an outcome, never an
exception; a plan is returned only if :mod:`demoplan.language.execution`, which knows nothing of the planner,
finds that it reaches the goal.
"""

import re
import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.engines.fast_downward.inequalities import state_inequalities
from demoplan.engines.fast_downward.installation import INSTALL_HINT, Installation, find_installation
from demoplan.engines.fast_downward.outcomes import (
    Outcome,
    Verdict,
    verdict_of_search,
    verdict_of_translator,
)
from demoplan.engines.fast_downward.processes import run_limited
from demoplan.engines.fast_downward.searches import FIRST, OPTIMAL, Search
from demoplan.engines.fast_downward.translating import translate
from demoplan.errors import DataError
from demoplan.ids import ContentHash, DomainId, content_hash
from demoplan.language.domains import Domain, Plan, Problem, Step
from demoplan.language.execution import execute, unmet
from demoplan.language.goals import goal_text
from demoplan.language.pddl import (
    domain_symbols,
    problem_symbols,
    render_domain,
    render_problem,
)
from demoplan.tables import Plans

_STEP = re.compile(r"\(\s*([^\s()]+)((?:\s+[^\s()]+)*)\s*\)")
_domain_text = lru_cache(maxsize=16)(render_domain)
"""Few domains are planned with again and again."""
_TASK_SIZE = re.compile(r"^Translator operators: (\d+)", re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class SolveParams:
    """Limits, and how hard to look for the cheapest plan."""

    wall_s: float = 30.0
    """Wall-clock time for everything [s]."""
    memory_bytes: int = 2 * 1024**3
    """Address space of each program."""
    max_operators_for_optimal: int = 400
    """Up to this many ground operators the cheapest plan is looked for first; beyond, any plan."""
    optimal_share: float = 0.3
    """Share of the time that looking for the cheapest plan may take before any plan will do."""


@dataclass(frozen=True, kw_only=True)
class TextAnswer:
    """What the planner said to a pair of texts; steps go by their PDDL names."""

    verdict: Verdict
    plan: Plan | None = None
    is_optimal: bool = False
    translate_s: float = 0.0
    search_s: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One planning attempt; what it was about, and how it ended."""

    domain_id: DomainId
    problem_id: ContentHash
    goal: str
    outcome: Outcome
    is_explained: bool
    message: str
    n_operators: int
    plan: Plan | None = None
    is_validated: bool = False
    is_optimal: bool = False
    """No plan costs less."""
    translate_s: float = 0.0
    search_s: float = 0.0


def solve(
    domain: Domain,
    problem: Problem,
    params: SolveParams = SolveParams(),
    *,
    searches: tuple[Search, ...] | None = None,
    installation: Installation | None = None,
) -> Attempt:
    """Find a plan.

    Args:
        domain: Operators to plan with.
        problem: Start and goal.
        params: Limits.
        searches: Configurations to run in turn until one answers; by default chosen by the task's size.
        installation: The planner; by default where its wheel put it.

    Returns:
        How it ended. The plan, if there is one, has been run on paper and reaches the goal; its steps go by
        the domain's and the problem's own names. Equal input gives an equal plan, unless time runs out.
    """
    n_operators = len(domain.operators)
    goal = goal_text(problem.goal)
    try:
        domain_text, problem_text = _domain_text(domain), render_problem(problem, domain)
    except DataError as error:
        return Attempt(
            domain_id=DomainId(""),
            problem_id=content_hash("not PDDL", goal, *sorted(map(str, problem.initial))),
            goal=goal,
            outcome="bad_input",
            is_explained=True,
            message=str(error),
            n_operators=n_operators,
        )
    domain_id, problem_id = DomainId(content_hash(domain_text)[:16]), content_hash(problem_text)
    stated_domain, stated_problem = state_inequalities(domain, problem)
    if not unmet(problem.goal, problem.initial):
        verdict = Verdict("solved", True, "the goal holds already")
        answer = TextAnswer(verdict=verdict, plan=Plan(), is_optimal=True)
    else:
        answer = solve_text(
            _domain_text(stated_domain),
            render_problem(stated_problem, stated_domain),
            params,
            searches=searches,
            installation=installation,
        )
    verdict, plan, is_validated = answer.verdict, None, False
    if answer.plan is not None:
        symbols = problem_symbols(stated_problem, domain_symbols(stated_domain))
        plan = Plan(
            tuple(
                Step(symbols.name(step.operator), tuple(symbols.name(name) for name in step.arguments))
                for step in answer.plan.steps
            ),
            answer.plan.cost,
        )
        execution = execute(domain, problem, plan)
        is_validated = execution.is_valid and execution.cost == plan.cost
        if not is_validated:
            fault = execution.violation or f"it costs {execution.cost}, and the planner says {plan.cost}"
            verdict = Verdict("invalid_plan", True, f"the planner's plan does not hold: {fault}")
    return Attempt(
        domain_id=domain_id,
        problem_id=problem_id,
        goal=goal,
        outcome=verdict.outcome,
        is_explained=verdict.is_explained,
        message=verdict.meaning,
        n_operators=n_operators,
        plan=plan,
        is_validated=is_validated,
        is_optimal=is_validated and answer.is_optimal,
        translate_s=answer.translate_s,
        search_s=answer.search_s,
    )


def solve_text(
    domain_text: str,
    problem_text: str,
    params: SolveParams = SolveParams(),
    *,
    searches: tuple[Search, ...] | None = None,
    installation: Installation | None = None,
) -> TextAnswer:
    """What Fast Downward answers to two PDDL texts, taken at its word.

    Args:
        domain_text: PDDL of a domain.
        problem_text: PDDL of a problem.
        params: Limits.
        searches: Configurations to run in turn until one answers; by default chosen by the task's size.
        installation: The planner; by default where its wheel put it.
    """
    installation = installation or find_installation()
    if installation is None:
        return TextAnswer(
            verdict=Verdict("planner_missing", True, f"Fast Downward is not installed; {INSTALL_HINT}")
        )
    with tempfile.TemporaryDirectory(prefix="demoplan-plan-") as name:
        folder = Path(name)
        (folder / "domain.pddl").write_text(domain_text, encoding="utf-8")
        (folder / "problem.pddl").write_text(problem_text, encoding="utf-8")
        return _run(folder, params, searches, installation)


def _run(
    folder: Path, params: SolveParams, searches: tuple[Search, ...] | None, installation: Installation
) -> TextAnswer:
    """Both programs in turn, on ``domain.pddl`` and ``problem.pddl`` of a folder that they may fill."""
    task = folder / "task.sas"
    translated = translate(
        ["--sas-file", task, "domain.pddl", "problem.pddl"],
        folder=folder,
        installation=installation,
        wall_s=params.wall_s,
        memory_bytes=params.memory_bytes,
    )
    verdict = verdict_of_translator(translated)
    if verdict is not None or not task.is_file():
        missing = Verdict("failed", False, "the translator wrote no task")
        return TextAnswer(verdict=verdict or missing, translate_s=translated.wall_s)
    chosen = searches or _searches_for(translated.output, params)
    left_s, search_s = params.wall_s - translated.wall_s, 0.0
    verdict = Verdict("out_of_time", True, "no time was left for the search")
    for number, search in enumerate(chosen, 1):
        if left_s <= 0:
            break
        is_last = number == len(chosen)
        plan_file = folder / f"plan-{number}"
        ended = run_limited(
            [installation.search, *search.options, "--internal-plan-file", plan_file],
            folder=folder,
            environment={},
            wall_s=left_s if is_last else min(left_s, params.wall_s * params.optimal_share),
            memory_bytes=params.memory_bytes,
            stdin=task,
        )
        left_s -= ended.wall_s
        search_s += ended.wall_s
        verdict = verdict_of_search(ended)
        plan = _best_plan(folder, plan_file.name) if verdict.outcome in {"solved", "out_of_time"} else None
        times = {"translate_s": translated.wall_s, "search_s": search_s}
        if plan is not None:
            is_optimal = search.is_optimal and ended.exit_code == 0
            solved = Verdict(
                "solved", True, "the cheapest plan" if is_optimal else "a plan; others may cost less"
            )
            return TextAnswer(verdict=solved, plan=plan, is_optimal=is_optimal, **times)
        if verdict.outcome == "solved":
            verdict = Verdict("failed", False, "the search says that it found a plan, but wrote none")
        if verdict.outcome not in {"out_of_time", "out_of_memory", "gave_up"}:
            break
    return TextAnswer(verdict=verdict, translate_s=translated.wall_s, search_s=search_s)


def _searches_for(translator_output: str, params: SolveParams) -> tuple[Search, ...]:
    size = _TASK_SIZE.search(translator_output)
    is_small = size is not None and int(size[1]) <= params.max_operators_for_optimal
    return (OPTIMAL, FIRST) if is_small else (FIRST,)


def _best_plan(folder: Path, name: str) -> Plan | None:
    """The cheapest plan that a search wrote; anytime searches number their plans."""
    plans = [_read_plan(path.read_text(encoding="utf-8")) for path in sorted(folder.glob(f"{name}*"))]
    return min(plans, key=lambda plan: plan.cost, default=None)


def _read_plan(text: str) -> Plan:
    steps = tuple(Step(match[1], tuple(match[2].split())) for match in _STEP.finditer(text.partition(";")[0]))
    cost = re.search(r"; cost = (\d+)", text)
    return Plan(steps, int(cost[1]) if cost else len(steps))


def plan_rows(attempts: Iterable[Attempt]) -> dy.DataFrame[Plans]:
    """Attempts as rows of the table ``plans``; those at one problem are numbered in the order given."""
    rows = []
    numbers: Counter[ContentHash] = Counter()
    for attempt in attempts:
        plan = attempt.plan
        rows.append(
            {
                "domain_id": attempt.domain_id,
                "problem_id": attempt.problem_id,
                "attempt": numbers[attempt.problem_id],
                "goal": attempt.goal,
                "outcome": attempt.outcome,
                "is_explained": attempt.is_explained,
                "is_validated": attempt.is_validated,
                "n_operators": attempt.n_operators,
                "n_steps": None if plan is None else len(plan.steps),
                "cost": None if plan is None else plan.cost,
                "steps": None if plan is None else [str(step) for step in plan.steps],
                "message": attempt.message,
            }
        )
        numbers[attempt.problem_id] += 1
    schema = {name: column.dtype for name, column in Plans.columns().items()}
    return Plans.validate(pl.DataFrame(rows, schema=schema), cast=True)
