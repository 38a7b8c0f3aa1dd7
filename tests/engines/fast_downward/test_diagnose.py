"""No plan: what is missing, found and said."""

import itertools
from dataclasses import replace

import pytest

from demoplan.engines.fast_downward import SolveParams, diagnose, solve
from demoplan.language.atoms import Atom, Literal
from demoplan.language.execution import execute
from demoplan.language.invariants import exclusive_groups
from demoplan.stages.repair import RepairParams, ask_for_repair, describe, never_changed


def without(domain, *names):
    return replace(domain, operators=tuple(each for each in domain.operators if each.name not in names))


def repaired(problem, repair):
    return replace(problem, initial=(problem.initial - set(repair.removed)) | set(repair.added))


def test_repairs_lead_to_the_goal_and_undoing_any_part_of_them_does_not(planner, stacking, towers):
    domain = without(stacking, "Put_2", "Put_3")
    problem = towers(["a", "b"], ["c"], goal="onTop(a, c)", hands=("Right_hand",))
    assert solve(domain, problem).outcome == "unsolvable"
    diagnosis = diagnose(domain, problem)
    groups, n_tried = set(exclusive_groups(domain, problem.initial)), 0
    assert diagnosis.repairs
    for repair in diagnosis.repairs:
        assert execute(domain, repaired(problem, repair), repair.plan).is_valid
        assert not repair.is_trivial
        assert not repair.changes & problem.goal
        for kept in itertools.combinations(sorted(repair.changes), len(repair.changes) - 1):
            partly = replace(
                repair,
                added=tuple(each.atom for each in kept if each.is_positive),
                removed=tuple(each.atom for each in kept if not each.is_positive),
            )
            partial = repaired(problem, partly)
            if groups <= set(exclusive_groups(domain, partial.initial)):
                n_tried += 1
                assert solve(domain, partial).outcome == "unsolvable"
    assert n_tried
    assert [len(each.changes) for each in diagnosis.repairs] == sorted(
        len(each.changes) for each in diagnosis.repairs
    )


def test_the_smallest_repair_is_as_small_as_trying_every_change_finds(planner, stacking, towers):
    domain = without(stacking, "Put_2", "Put_3")
    problem = towers(["a", "b"], ["c"], goal="onTop(a, c)", hands=("Right_hand",))
    predicates = {each.name: each for each in domain.predicates}
    objects = [name for name, _ in problem.objects]
    single = []
    for name, signature in predicates.items():
        for arguments in itertools.permutations(objects, len(signature.argument_types)):
            types = dict(problem.objects)
            fits = all(
                domain.types.is_subtype(types[each], kind)
                for each, kind in zip(arguments, signature.argument_types, strict=True)
            )
            if fits and Literal(Atom(name, arguments)) not in problem.goal:
                single.append(Atom(name, arguments))
    works = {
        atom
        for atom in single
        if solve(domain, replace(problem, initial=problem.initial ^ {atom})).outcome == "solved"
    }
    diagnosis = diagnose(domain, problem)
    best = diagnosis.repairs[0]
    assert works, "one change is enough here"
    assert best.is_minimal
    assert len(best.changes) == 1
    assert {each.atom for each in best.changes} <= works


def test_a_hand_that_is_assumed_to_hold_something_is_not_open_as_well(planner, stacking, towers):
    domain = without(stacking, "Take_1")
    problem = towers(["a"], ["b"], goal="onTop(a, b)", hands=("Right_hand",))
    best = diagnose(domain, problem).repairs[0]
    assert best.added == (Atom("inHand", ("Right_hand", "a")),)
    assert best.removed == (Atom("handOpen", ("Right_hand",)),)


def test_a_goal_that_no_operator_brings_about_is_said_first(planner, stacking, towers):
    domain = without(stacking, "Put_1", "Put_2", "Put_3")
    problem = towers(["a"], ["b"], goal="onTop(a, b)")
    diagnosis = diagnose(domain, problem)
    assert diagnosis.never_changed == (Literal(Atom("onTop", ("a", "b"))),)
    assert [each.is_trivial for each in diagnosis.repairs] == [True]
    first, second = describe(diagnosis, domain).splitlines()
    assert first == (
        "no operator ever adds onTop, which the goal asks for in onTop(a,b): demonstrate an activity that adds it"
    )
    assert second.startswith("only if onTop(a,b) held")
    assert "the trivial answer" in second


def test_a_missing_operator_is_named_by_what_it_would_add(planner, stacking, towers):
    domain = without(stacking, "Take_1")
    diagnosis = diagnose(domain, towers(["a"], ["b"], goal="onTop(a, b)", hands=("Right_hand",)))
    assert diagnosis.never_changed == ()
    assert Literal(Atom("inHand", ("Right_hand", "a"))) in diagnosis.repairs[0].changes
    text = describe(diagnosis, domain)
    assert "no operator ever adds inHand: demonstrate an activity that adds it" in text
    assert "the smallest change" in text


def test_a_problem_with_a_plan_misses_nothing(planner, stacking, towers):
    diagnosis = diagnose(stacking, towers(["a"], ["b"], goal="onTop(a, b)"))
    assert [each.changes for each in diagnosis.repairs] == [frozenset()]
    assert describe(diagnosis, stacking) == "nothing is missing: there is a plan"


def test_what_could_not_be_found_in_time_is_said(stacking, towers, planner):
    diagnosis = diagnose(
        without(stacking, "Take_1"),
        towers(["a"], ["b"], goal="onTop(a, b)"),
        SolveParams(wall_s=0.001),
    )
    assert diagnosis.repairs == ()
    assert "could not be found" in diagnosis.note


def test_too_many_candidates_are_refused_with_the_number(stacking, towers):
    problem = towers(["a"], ["b"], goal="onTop(a, b)")
    diagnosis = diagnose(stacking, problem, repair_params=RepairParams(max_candidates=3))
    assert "more than 3 atoms could be missing (5 objects)" in diagnosis.note


def test_excluded_literals_are_not_assumed(stacking, towers):
    problem = towers(["a"], ["b"], goal="onTop(a, b)")
    clear = Literal(Atom("onTop", ("a", "b")))
    for excluded, is_there in ((frozenset(), True), (frozenset({clear}), False)):
        _, task = ask_for_repair(stacking, problem, excluded=excluded)
        assert (Atom("may assume onTop", ("a", "b")) in task.initial) is is_there


@pytest.mark.parametrize(
    ("goal", "expected"),
    [("onTop(a, b)", ()), ("!onTop(a, table)", ()), ("inHand(Right_hand, a)", ("inHand(Right_hand,a)",))],
)
def test_never_changed_looks_at_effects_of_either_sign(stacking, towers, goal, expected):
    domain = without(stacking, "Take_1")
    found = never_changed(domain, towers(["a"], ["b"], goal=goal))
    assert tuple(map(str, found)) == expected
