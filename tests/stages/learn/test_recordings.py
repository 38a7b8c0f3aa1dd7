"""The paper's study, from the shipped logs alone: what each demonstration, and all of them, let a planner do."""

import json
import random
from pathlib import Path

import polars as pl
import pytest

from demoplan.engines.fast_downward import solve
from demoplan.language.execution import ground
from demoplan.logs import read
from demoplan.manifests.labels import activities_of_labels
from demoplan.pipeline.datasets import open_dataset
from demoplan.stages.align import AlignParams, align
from demoplan.stages.compose import compose
from demoplan.stages.contrast import contrast
from demoplan.stages.learn import learn
from demoplan.stages.perceive import perceive
from demoplan.stages.segment import segment
from demoplan.tables import Transitions

DATASET = Path(__file__).resolve().parents[3] / "datasets" / "cube-stacking"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def dataset():
    return open_dataset(DATASET)


@pytest.fixture(scope="module")
def transitions(dataset):
    """Transitions of each episode, with inferred and with true activities."""
    mapping, vocabulary = dataset.dataset.mapping, dataset.vocabulary
    entities = {name: entity.type for name, entity in mapping.entities.items()}
    result = {"inferred": {}, "true": {}}
    for episode in dataset.dataset.episodes:
        reading = read(dataset.log_of(episode), mapping, episode.id, definitions_root=dataset.folder)
        frames = align(reading.samples, mapping, AlignParams(tick_rate_hz=dataset.dataset.tick_rate_hz))
        facts = perceive(frames, mapping.entities, vocabulary)
        labels = json.loads(dataset.labels_of(episode).read_text(encoding="utf-8"))
        activities = {
            "inferred": segment(frames, facts, entities, vocabulary.types),
            "true": activities_of_labels(labels, dataset.dataset.label_format, episode.id, reading.samples),
        }
        for source, each in activities.items():
            result[source][episode.id] = contrast(each, facts, entities)
    return result


def domain_of(dataset, tables):
    vocabulary = dataset.vocabulary
    predicates = [rule.signature for rule in vocabulary.predicates]
    together = Transitions.validate(pl.concat(list(tables)))
    learned = learn(together, vocabulary.types, predicates)
    return compose(learned.operators, learned.literals, vocabulary.types, predicates, "stacking")


def result_of(table_world, domain, kind, seed):
    problem = table_world.problem_of(domain, kind, random.Random(seed), ("Right_hand",))
    attempt = solve(domain, problem)
    if attempt.plan is None:
        return attempt.outcome
    world, operators = table_world.Tabletop(problem), {each.name: each for each in domain.operators}
    for step in attempt.plan.steps:
        grounded = ground(operators[step.operator], step)
        wrong = world.wrong(grounded.adds, grounded.deletes)
        assert not wrong, f"{step}: {wrong}"
    return "solved" if world.reaches(problem.goal) else "the goal is not reached in the world"


@pytest.mark.parametrize("source", ["inferred", "true"])
def test_eleven_of_twelve_single_demonstrations_reach_every_kind_of_goal(
    table_world, dataset, transitions, source
):
    n_solved = 0
    for name, table in transitions[source].items():
        domain = domain_of(dataset, [table])
        n_solved += all(
            result_of(table_world, domain, kind, f"{name}/{kind}") == "solved" for kind in table_world.GOALS
        )
    assert n_solved >= 11


@pytest.mark.parametrize("source", ["inferred", "true"])
def test_all_twelve_together_reach_every_goal_with_at_most_fifteen_operators(
    table_world, dataset, transitions, source
):
    domain = domain_of(dataset, transitions[source].values())
    assert len(domain.operators) <= 15
    for kind in table_world.GOALS:
        assert result_of(table_world, domain, kind, kind) == "solved"
