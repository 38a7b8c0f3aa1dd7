"""From two logs to a plan, stage by stage, without a store: what `demoplan run` does, in thirty lines.

Run it from the checkout: ``python examples/learn_and_plan.py``. Two people stack one cube on another; the
plan is for a tower of three, which neither of them built.
"""

from pathlib import Path

import polars as pl

from demoplan.engines.fast_downward import solve
from demoplan.language.goals import parse_goal
from demoplan.language.possibility import impossibility
from demoplan.logs import read
from demoplan.pipeline.datasets import open_dataset
from demoplan.stages.align import align
from demoplan.stages.ask import ask, state_at
from demoplan.stages.compose import compose
from demoplan.stages.contrast import contrast
from demoplan.stages.learn import learn
from demoplan.stages.perceive import perceive
from demoplan.stages.segment import segment

opened = open_dataset(Path(__file__).resolve().parent.parent / "datasets/cube-stacking")
mapping, vocabulary = opened.dataset.mapping, opened.vocabulary
predicates = [rule.signature for rule in vocabulary.predicates]
types = {name: entity.type for name, entity in mapping.entities.items()}

parts = []
for name in ("p1-one-left", "p3-one-right"):
    episode = opened.episode(name)
    samples = read(opened.log_of(episode), mapping, episode.id).samples
    frames = align(samples, mapping)
    facts = perceive(frames, mapping.entities, vocabulary)
    activities = segment(frames, facts, types, vocabulary.types)  # rules: no labels needed
    parts.append(contrast(activities, facts, types))
    print(f"{name}: {' → '.join(activities.filter(pl.col('activity') != 'Idle')['activity'])}")

learned = learn(pl.concat(parts), vocabulary.types, predicates)
domain = compose(learned.operators, learned.literals, vocabulary.types, predicates, "stacking")
goal = parse_goal(
    "onTop(cube_yellow, cube_green) & onTop(cube_green, cube_red)", predicates, types, vocabulary.types
)
start = state_at(facts, "p3-one-right", int(facts["start_ns"].min()))  # type: ignore[arg-type]
problem = ask(domain, start, types, goal, "tower")
attempt = solve(domain, problem)
if attempt.plan is None:
    raise SystemExit(f"no plan: {attempt.message}")
for step in attempt.plan.steps:
    print(step)
print("impossible:", impossibility(problem, domain, attempt.plan))
