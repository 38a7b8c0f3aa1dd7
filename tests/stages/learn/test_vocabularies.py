"""Predicates beyond the base set: a vocabulary that has them, and domains that are no larger for it."""

from pathlib import Path

import pytest

from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.stages.compose import compose, pruned
from demoplan.stages.learn import learn
from demoplan.stages.perceive.registry import check_definitions

VOCABULARIES = Path(__file__).resolve().parents[3] / "schemas" / "vocabularies"
BEYOND = {"inside", "above", "leftOf", "aligned", "near", "upright"}


@pytest.fixture(scope="module")
def household():
    return parse_vocabulary((VOCABULARIES / "household.yaml").read_text(), "household.yaml")


def test_the_household_vocabulary_relates_objects_to_each_other(household):
    names = {rule.signature.name for rule in household.predicates}
    base = parse_vocabulary((VOCABULARIES / "tabletop.yaml").read_text(), "tabletop.yaml")
    assert names == {rule.signature.name for rule in base.predicates} | BEYOND
    assert len(check_definitions(household)) == len(household.predicates)


def test_predicates_that_no_demonstration_needs_are_pruned_from_its_domain(table_world, household):
    transitions = table_world.transitions_of(*table_world.study("household", participants=1).values())
    predicates = [rule.signature for rule in household.predicates]
    learned = learn(transitions, household.types, predicates)
    domain = compose(learned.operators, learned.literals, household.types, predicates, "stacking")
    assert {each.name for each in domain.predicates} >= BEYOND
    assert not {each.name for each in pruned(domain).predicates} & BEYOND
    assert {each.activity for each in domain.operators} == {"Idle", "Reach", "Take", "Put", "Release"}
