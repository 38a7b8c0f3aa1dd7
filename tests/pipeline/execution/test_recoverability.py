"""Whether anybody could recover is decided by the world after a fault, and by nothing that monitors do."""

import weakref

import pytest

from demoplan.manifests.faults import parse_faults
from demoplan.pipeline.execution.recoverability import recoverability

TOWER = "onTop(cube_red, cube_blue) & onTop(cube_green, cube_red)"


@pytest.fixture
def decide(learned_domain, tabletop, four_cubes, new_session):
    def of(text, goal=TOWER):
        (fault,) = parse_faults(f"faults:\n  - {text}\n", "faults.yaml")
        return recoverability(learned_domain, goal, new_session(four_cubes), tabletop, fault, seed=1)

    return of


@pytest.mark.parametrize(
    "text",
    [
        "{name: f, kind: drop, at: {activity: Put, delay_s: 0.6}}",
        "{name: f, kind: object_moved, which: thing, at: {activity: Take, delay_s: 0.1}}",
        "{name: f, kind: flipped_predicate, predicate: onTop, duration_s: 1.0}",
        "{name: f, kind: wrong_effect, activity: Take, literal: 'clear(?object)'}",
    ],
)
def test_a_world_from_which_a_plan_leads_on_can_be_recovered_from(decide, text):
    found = decide(text)
    assert (found.has_happened, found.is_recoverable) == (True, True)
    assert "a plan of" in found.reason


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("{name: f, kind: object_removed, which: thing, at: {activity: Take, delay_s: 0.1}}", "gone"),
        ("{name: f, kind: wrong_effect, activity: Release, literal: 'inHand(?hand,?object)'}", "ever taken"),
    ],
)
def test_a_world_from_which_none_does_cannot_and_it_says_why(decide, text, why):
    found = decide(text)
    assert (found.has_happened, found.is_recoverable) == (True, False)
    assert why in found.reason


def test_a_fault_that_does_not_happen_is_no_case(decide):
    found = decide("{name: f, kind: drop, at: {activity: Put, occurrence: 9}}")
    assert (found.has_happened, found.is_recoverable) == (False, None)
    assert "did not happen" in found.reason


def test_a_case_that_is_decided_keeps_nothing_of_its_session(
    new_session, learned_domain, tabletop, four_cubes, no_collector
):
    (fault,) = parse_faults(
        "faults:\n  - {name: f, kind: drop, at: {activity: Put, delay_s: 0.6}}\n", "faults.yaml"
    )
    session = new_session(four_cubes)
    seen = weakref.ref(session)
    assert recoverability(learned_domain, TOWER, session, tabletop, fault, seed=1).has_happened
    del session
    assert seen() is None
