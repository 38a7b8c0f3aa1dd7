"""The study: a domain from every single demonstration and one from all, each tried on every goal."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass

import dataframely as dy
import polars as pl

from demoplan.engines.fast_downward import SolveParams, plan_rows, solve
from demoplan.errors import DataError
from demoplan.language.atoms import Atom
from demoplan.language.domains import Domain, Plan, Problem, Step
from demoplan.language.pddl import domain_id, problem_id
from demoplan.language.possibility import impossibility
from demoplan.manifests.dataset import Goal
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.datasets import OpenDataset
from demoplan.pipeline.domains.learning import Learned, exclusive_groups_of, learn_domain
from demoplan.pipeline.domains.planning import missing_demonstrations, problem_of, start_of, start_of_episode
from demoplan.stages.learn import LearnParams
from demoplan.stages.missing import MissingDemonstration
from demoplan.stages.score_plans import Trial
from demoplan.store import EpisodeState, Store
from demoplan.store.code_version import code_version
from demoplan.store.store import StageOutput, canonical_json
from demoplan.tables import Plans

COMBINED = "combined"


@dataclass(frozen=True, kw_only=True)
class Tried:
    """One domain tried on one goal, with the attempt behind it."""

    trial: Trial
    learned: Learned
    goal: Goal
    plans: dy.DataFrame[Plans]
    missing: tuple[MissingDemonstration, ...] = ()
    """Demonstrations that would give a plan, for the combined domain where it has none."""


def learn_all(
    opened: OpenDataset,
    store: Store,
    states: Sequence[EpisodeState],
    *,
    params: LearnParams = LearnParams(),
    crew: Crew = Processes(1),
    on_done: Callable[[str], None] = lambda _: None,
) -> dict[str, Learned]:
    """A domain from each episode, by the episode's id, and one from all, under ``combined``.

    Args:
        opened: The dataset.
        store: Where everything is kept.
        states: The episodes; those without activities are left out.
        params: How operators are learned.
        crew: Who counts, where there are thousands of episodes.
        on_done: Called with the name of each domain when it is there.

    Raises:
        DataError: If no episode has activities; it says why for each.
    """
    usable = [state for state in states if "transitions" in state.tables]
    if not usable:
        reasons = "".join(f"\n  {state.episode_id}: {state.reason or 'no activities'}" for state in states)
        raise DataError(f"{opened.dataset.name}: none of {len(states)} episodes could be used:{reasons}")
    name = opened.dataset.name
    learned = {}
    for state in usable:
        learned[state.episode_id] = learn_domain(
            store,
            [state],
            opened.vocabulary,
            name=f"{name}--{state.episode_id}"[:128],
            dataset=name,
            params=params,
        )
        on_done(state.episode_id)
    learned[COMBINED] = learn_domain(
        store, usable, opened.vocabulary, name=name, dataset=name, params=params, crew=crew
    )
    on_done(COMBINED)
    return learned


def try_goals(
    opened: OpenDataset,
    store: Store,
    learned: dict[str, Learned],
    *,
    prefix: str = "",
    n_workers: int = 1,
    params: SolveParams = SolveParams(),
    on_done: Callable[[str], None] = lambda _: None,
) -> list[Tried]:
    """Plan for every goal with every domain; single domains start from their own episode's first state.

    Args:
        opened: The dataset; its ``goals`` are tried.
        store: Where attempts are kept, so that none is made twice.
        learned: Domains by the episode that they come from, or ``combined``.
        prefix: Put before the names of groups, to tell several datasets apart.
        n_workers: Planners to run at once.
        params: Limits.
        on_done: Called with the name of each attempt when it has ended.
    """
    first = next(name for name in sorted(learned) if name != COMBINED)
    work = [(name, domain, goal) for name, domain in learned.items() for goal in opened.dataset.goals]

    def attempt(job: tuple[str, Learned, Goal]) -> Tried:
        name, domain, goal = job
        if goal.start is not None:
            start = start_of(goal.start, store, domain.domain)
        else:
            episode = first if name == COMBINED else name
            start = start_of_episode(store, f"{opened.dataset.name}/{episode}")
        problem = problem_of(domain.domain, start, goal.goal)
        plans = _plans(store, domain.domain, problem, params)
        cause = cause_of_failure(domain.domain, problem, plans)
        group = f"{prefix}combined domain" if name == COMBINED else f"{prefix}single domains"
        on_done(f"{name}: {goal.name}")
        trial = Trial(group=group, domain=name, goal=goal.name, is_solved=cause is None, cause=cause)
        missing: tuple[MissingDemonstration, ...] = ()
        if name == COMBINED and plans.item(plans.height - 1, "outcome") == "unsolvable":
            missing = missing_demonstrations(domain.domain, problem, params, exclusive_groups_of(domain))
        return Tried(trial=trial, learned=domain, goal=goal, plans=plans, missing=missing)

    # Threads are enough: the planner is a program of its own.
    with ThreadPoolExecutor(max(1, n_workers)) as pool:
        return list(pool.map(attempt, work))


def _plans(store: Store, domain: Domain, problem: Problem, params: SolveParams) -> dy.DataFrame[Plans]:
    """The attempt at a problem, from the store if it was made before."""
    record = store.run(
        "plan",
        {"domain": domain_id(domain), "problem": problem_id(problem, domain)},
        canonical_json(asdict(params)),
        code_version("demoplan.engines.fast_downward"),
        lambda: StageOutput(tables={"plans": (plan_rows([solve(domain, problem, params)]), Plans)}),
    )
    return store.get(record.outputs["plans"], Plans)


def cause_of_failure(domain: Domain, problem: Problem, plans: dy.DataFrame[Plans]) -> str | None:
    """Why a problem is not solved: the planner's outcome, or a step that could not happen; None if it is."""
    solved = plans.filter((pl.col("outcome") == "solved") & pl.col("is_validated"))
    if solved.is_empty():
        row = plans.row(plans.height - 1, named=True)
        return f"{row['outcome']}: {row['message'] or ''}".strip()
    return impossibility(problem, domain, plan_of(solved.item(0, "steps"), solved.item(0, "cost")))


def plan_of(steps: Sequence[str], cost: int) -> Plan:
    """A plan from the text of its steps."""
    atoms = [Atom.parse(step) for step in steps]
    return Plan(tuple(Step(atom.predicate, atom.arguments) for atom in atoms), cost)
