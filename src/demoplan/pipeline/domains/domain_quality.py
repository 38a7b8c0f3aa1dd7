"""Whether a stored domain is good: what is suspicious about it, and whether plans behave as expected."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from demoplan.engines.fast_downward import SolveParams, solve
from demoplan.errors import UsageError
from demoplan.language.domains import Domain, Plan, Problem, Step
from demoplan.language.execution import execute
from demoplan.language.lint import LintFinding, lint
from demoplan.language.pddl.symbols import domain_symbols, problem_symbols
from demoplan.language.possibility import impossibility
from demoplan.manifests.loading import read_text
from demoplan.pipeline.domains.learning import Learned, exclusive_groups_of
from demoplan.pipeline.domains.planning import problem_of, start_of
from demoplan.store import Store

EXPECTATIONS = ("valid", "invalid", "solvable", "unsolvable")
_DIRECTIVE = re.compile(r";\s*(start|goal|expect)\s*:\s*(.+?)\s*")
_STEP = re.compile(r"\(\s*([^\s()]+)((?:\s+[^\s()]+)*)\s*\)|([^\s();]+)\(([^()]*)\)")


def lint_domain(learned: Learned, store: Store, start: str | None = None) -> tuple[LintFinding, ...]:
    """What is suspicious about a domain version, groups of its demonstrations considered.

    Args:
        learned: The version.
        store: Where its episodes are.
        start: A state from which operators should be reachable, as :func:`start_of` reads it, if any.
    """
    if start is None:
        return lint(learned.domain, groups=exclusive_groups_of(learned))
    state = start_of(start, store, learned.domain)
    return lint(
        learned.domain,
        groups=exclusive_groups_of(learned),
        start=state.atoms,
        objects=sorted(state.objects.items()),
    )


@dataclass(frozen=True, kw_only=True)
class PlanCase:
    """A plan file as a test case."""

    path: Path
    start: str
    goal: str
    expected: str
    steps: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """What came of a test case."""

    case: str
    expected: str
    found: str
    is_passed: bool
    reason: str
    """What is wrong with the plan, or why there is none; empty if nothing is."""


def read_case(path: Path) -> PlanCase:
    """A test case from a plan file: comments say where it starts, what it is for, and what is expected.

    ``; start: EPISODE@start`` (or a file beside it), ``; goal: onTop(a, b)``, and ``; expect:`` one of
    ``valid`` (the default), ``invalid``, ``solvable``, ``unsolvable``. Steps are ``put_1(hand,cube)`` or, as
    planners write them, ``(put_1 hand cube)``, one a line.

    Raises:
        UsageError: If the file cannot be read, or does not say so.
    """
    lines = read_text(path).splitlines()
    said: dict[str, str] = {}
    steps: list[tuple[str, tuple[str, ...]]] = []
    for number, line in enumerate(lines, 1):
        directive = _DIRECTIVE.fullmatch(line.strip())
        if directive is not None:
            said[directive[1]] = directive[2]
            continue
        content = line.partition(";")[0].strip()
        if not content:
            continue
        match = _STEP.fullmatch(content)
        if match is None:
            raise UsageError(f"{path}:{number}: not a step: {content!r}; expected put_1(hand,cube)")
        if match[1]:
            steps.append((match[1], tuple(match[2].split())))
        else:
            steps.append((match[3], tuple(name.strip() for name in match[4].split(",") if name.strip())))
    for name in ("start", "goal"):
        if name not in said:
            raise UsageError(f"{path}: says no {name}; write it as a comment: `; {name}: …`")
    expected = said.get("expect", "valid")
    if expected not in EXPECTATIONS:
        raise UsageError(f"{path}: expects {expected!r}; available: {', '.join(EXPECTATIONS)}")
    beside = path.parent / said["start"]
    start = str(beside) if beside.is_file() else said["start"]
    return PlanCase(path=path, start=start, goal=said["goal"], expected=expected, steps=tuple(steps))


def run_cases(
    domain: Domain, cases: Sequence[PlanCase], store: Store, params: SolveParams = SolveParams()
) -> tuple[CaseResult, ...]:
    """Try every case on a domain; a plan is run on paper and held against the laws of the tabletop."""
    return tuple(_run_case(domain, case, store, params) for case in cases)


def _run_case(domain: Domain, case: PlanCase, store: Store, params: SolveParams) -> CaseResult:
    problem = problem_of(domain, start_of(case.start, store, domain), case.goal)
    if case.expected in ("valid", "invalid"):
        reason = _fault(domain, problem, _plan_of(case, domain, problem))
        found = "invalid" if reason else "valid"
    else:
        attempt = solve(domain, problem, params)
        reason = "" if attempt.is_validated else f"{attempt.outcome}: {attempt.message}"
        found = "solvable" if attempt.is_validated else attempt.outcome
    return CaseResult(
        case=str(case.path),
        expected=case.expected,
        found=found,
        is_passed=found == case.expected,
        reason=reason,
    )


def _fault(domain: Domain, problem: Problem, plan: Plan) -> str:
    violation = execute(domain, problem, plan).violation
    if violation is not None:
        return str(violation)
    return impossibility(problem, domain, plan) or ""


def _plan_of(case: PlanCase, domain: Domain, problem: Problem) -> Plan:
    """The case's steps, in names of logs or of PDDL."""
    symbols = domain_symbols(domain)
    own = problem_symbols(problem, symbols)
    operators = {symbols.symbol("operator", each.name): each.name for each in domain.operators}
    names = [name for name, _ in (*problem.objects, *domain.constants)]
    objects = {own.symbol("object", name): name for name, _ in problem.objects}
    steps = []
    for operator, arguments in case.steps:
        chosen = tuple(name if name in names else objects.get(name, name) for name in arguments)
        steps.append(Step(operators.get(operator, operator), chosen))
    costs = {each.name: each.cost for each in domain.operators}
    return Plan(tuple(steps), sum(costs.get(step.operator, 0) for step in steps))
