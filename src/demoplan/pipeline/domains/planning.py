"""A start, a goal and a domain version to plans."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import dataframely as dy
import polars as pl

from demoplan.engines.fast_downward import SolveParams, diagnose, plan_rows, solve, solve_widening
from demoplan.errors import DataError, PddlError, UnknownNameError, UsageError
from demoplan.language.atoms import Atom
from demoplan.language.domains import Domain, Plan, Problem
from demoplan.language.goals import parse_goal
from demoplan.language.invariants import ExclusiveGroup
from demoplan.language.pddl import parse_problem
from demoplan.language.possibility import impossibility
from demoplan.manifests.loading import read_text
from demoplan.stages.ask import ask, state_at
from demoplan.stages.missing import MissingDemonstration, imagine, read_missing
from demoplan.stages.repair import describe
from demoplan.store import Store
from demoplan.tables import Facts, Plans, Transitions

_AT_TIME = re.compile(r"(?P<episode>.+)@(?P<instant>start|end|[0-9]+(?:\.[0-9]+)?)")


@dataclass(frozen=True, kw_only=True)
class Start:
    """A world state to plan from."""

    objects: Mapping[str, str]
    """Instance → type."""
    atoms: frozenset[Atom]
    origin: str
    """Where it comes from, for messages."""


def start_of(text: str, store: Store, domain: Domain) -> Start:
    """The state that a text names.

    Args:
        text: ``EPISODE@start``, ``EPISODE@end`` or ``EPISODE@12.5`` (seconds from the first tick), or a file:
            a PDDL problem (``.pddl``), or JSON with ``objects`` (instance → type) and ``atoms``.
        store: Where the episodes are.
        domain: What a PDDL problem's names refer to.

    Raises:
        UsageError: If the text names neither, or an instant outside the episode.
    """
    path = Path(text)
    if path.suffix in {".pddl", ".json"} or path.is_file():
        return _start_of_file(path, domain)
    match = _AT_TIME.fullmatch(text)
    if match is None:
        raise UsageError(
            f"{text!r} is not a state; expected EPISODE@start, EPISODE@end, EPISODE@SECONDS, "
            "or a .json or .pddl file"
        )
    return start_of_episode(store, match["episode"], match["instant"])


def start_of_episode(store: Store, name: str, instant: str = "start") -> Start:
    """The state of a stored episode at ``start``, ``end``, or seconds from its first tick."""
    state = store.manifest.episode(name)
    if "transitions" not in state.tables:
        raise UsageError(f"episode {name!r} has no activities yet: {state.reason or 'run `demoplan run`'}")
    facts = store.get(state.tables["facts"], Facts)
    transitions = store.get(state.tables["transitions"], Transitions)
    first_ns, end_ns = transitions.select(pl.col("start_ns").min(), pl.col("end_ns").max()).row(0)
    instants = {"start": first_ns, "end": end_ns - 1}
    instant_ns = instants[instant] if instant in instants else first_ns + round(float(instant) * 1e9)
    if not first_ns <= instant_ns < end_ns:
        raise UsageError(f"{name}@{instant}: the episode lasts {(end_ns - first_ns) / 1e9:.2f} s")
    return Start(
        objects={entry["name"]: entry["type"] for entry in transitions.item(0, "objects")},
        atoms=state_at(facts, state.episode_id, instant_ns),
        origin=f"{name}@{instant}",
    )


def _start_of_file(path: Path, domain: Domain) -> Start:
    text = read_text(path)
    if path.suffix == ".pddl":
        problem = parse_problem(text, domain)
        return Start(objects=dict(problem.objects), atoms=problem.initial, origin=str(path))
    try:
        content = json.loads(text)
        objects = {str(name): str(kind) for name, kind in content["objects"].items()}
        atoms = frozenset(Atom.parse(atom) for atom in content["atoms"])
    except (ValueError, KeyError, AttributeError, TypeError, PddlError) as error:
        raise UsageError(
            f'{path}: not a state: {error}; expected {{"objects": {{"cube_red": "Cube"}}, "atoms": '
            f'["onTop(cube_red,table)"]}}'
        ) from None
    return Start(objects=objects, atoms=atoms, origin=str(path))


def problem_of(domain: Domain, start: Start, goal: str, name: str = "problem") -> Problem:
    """The problem of reaching a goal text from a start.

    Raises:
        UsageError: If the goal names what is not there, or contradicts itself, or the start does not fit.
    """
    literals = parse_goal(goal, domain.predicates, start.objects, domain.types)
    try:
        return ask(domain, start.atoms, start.objects, literals, name)
    except UnknownNameError:
        raise
    except DataError as error:
        raise UsageError(f"{start.origin}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What came of a planning problem."""

    rows: dy.DataFrame[Plans]
    """One row per attempt."""
    plan: Plan | None
    """A plan that was simulated and reaches the goal."""
    impossibility: str | None
    """Why the plan could not happen, if the laws of a tabletop forbid a step."""
    missing: str | None
    """Without a plan: what is missing, and what to demonstrate next."""


def missing_demonstrations(
    domain: Domain,
    problem: Problem,
    params: SolveParams,
    groups: Sequence[tuple[ExclusiveGroup, str]] = (),
) -> tuple[MissingDemonstration, ...]:
    """The fewest demonstrations, of what is near to what was shown, that would give a plan; maybe none.

    Args:
        domain: What the problem could not be solved with.
        problem: Start and goal.
        params: Limits.
        groups: Atoms that demonstrations showed to exclude each other.
    """
    attempt = solve(imagine(domain, problem, groups), problem, params)
    if attempt.plan is None or not attempt.is_validated:
        return ()
    return read_missing(attempt.plan, domain)


def make_plan(
    domain: Domain,
    problem: Problem,
    params: SolveParams,
    *,
    is_widening: bool,
    groups: Sequence[tuple[ExclusiveGroup, str]] = (),
) -> Answer:
    """Plan; without a plan, say which demonstration, or which change of the start, would give one.

    Args:
        domain: What may be done.
        problem: Start and goal.
        params: Limits of each planning attempt.
        is_widening: Begin with the operators that were shown most often.
        groups: Atoms that demonstrations showed to exclude each other, to imagine what was not shown.
    """
    attempts = solve_widening(domain, problem, params) if is_widening else (solve(domain, problem, params),)
    last = attempts[-1]
    missing = None
    if last.outcome == "unsolvable":
        lacking = missing_demonstrations(domain, problem, params, groups)
        lines = [f"needed is {each}" for each in lacking]
        missing = "\n".join([*lines, describe(diagnose(domain, problem, params), domain)])
    return Answer(
        rows=plan_rows(attempts),
        plan=last.plan if last.is_validated else None,
        impossibility=impossibility(problem, domain, last.plan) if last.plan and last.is_validated else None,
        missing=missing,
    )
