"""Plans from Fast Downward: valid, cheapest where it is said, and every failure an outcome."""

import heapq
import itertools
import stat
from dataclasses import replace

import pytest

from demoplan.engines.fast_downward import (
    FIRST,
    OPTIMAL,
    Installation,
    SolveParams,
    plan_rows,
    solve,
    solve_text,
    solve_widening,
)
from demoplan.engines.fast_downward import solve as solve_function
from demoplan.engines.fast_downward.outcomes import verdict_of_translator
from demoplan.engines.fast_downward.processes import Ended
from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Parameter, Problem, Signature, Step
from demoplan.language.execution import execute, ground, unmet
from demoplan.language.pddl import render_domain, render_problem
from demoplan.language.types import TypeHierarchy


def cheapest_cost(domain, problem):
    """The least cost of any plan, by uniform-cost search over every ground step; None without a plan."""
    objects = dict(problem.objects)
    actions = []
    for operator in domain.operators:
        choices = [
            [name for name, kind in objects.items() if domain.types.is_subtype(kind, each.type_name)]
            for each in operator.parameters
        ]
        actions += [
            ground(operator, Step(operator.name, arguments)) for arguments in itertools.product(*choices)
        ]
    queue, best, tie = [(0, 0, problem.initial)], {problem.initial: 0}, itertools.count(1)
    while queue:
        cost, _, state = heapq.heappop(queue)
        if cost > best[state]:
            continue
        if not unmet(problem.goal, state):
            return cost
        for action in actions:
            if not action.unmet(state):
                after, total = action.apply(state), cost + action.cost
                if total < best.get(after, float("inf")):
                    best[after] = total
                    heapq.heappush(queue, (total, next(tie), after))
    return None


GOALS = {
    "one on one": "onTop(cube_red, cube_blue)",
    "a tower of three": "onTop(cube_red, cube_blue) & onTop(cube_blue, cube_green)",
    "the tower turned round": "onTop(a, b) & onTop(b, c)",
    "two towers of two": "onTop(cube_red, cube_blue) & onTop(cube_green, cube_yellow)",
    "a negative wish": "onTop(cube_red, cube_blue) & !inHand(Right_hand, cube_red) & handOpen(Left_hand)",
}


@pytest.mark.parametrize("name", sorted(GOALS))
def test_plans_for_the_kinds_of_goals_of_the_paper_hold(planner, stacking, towers, name):
    start = (
        [["c", "b", "a"]]
        if "round" in name
        else [["cube_red"], ["cube_blue"], ["cube_green"], ["cube_yellow"]]
    )
    goal = "onTop(c, b) & onTop(b, a)" if "round" in name else GOALS[name]
    problem = towers(*start, goal=goal)
    attempt = solve(stacking, problem)
    assert (attempt.outcome, attempt.is_validated, attempt.is_optimal) == ("solved", True, True)
    assert execute(stacking, problem, attempt.plan).is_valid


def test_the_cheapest_plan_is_as_cheap_as_exhaustive_search_finds(planner, stacking, towers):
    for piles, goal in [
        ([["a"], ["b"]], "onTop(a, b)"),
        ([["a", "b"]], "onTop(b, a) & onTop(a, table) & !inHand(Right_hand, b) & clear(b)"),
        ([["a", "b"], ["c"]], "onTop(a, b)"),
    ]:
        problem = towers(*piles, goal=goal, hands=("Right_hand",))
        attempt = solve(stacking, problem)
        assert attempt.is_optimal
        assert attempt.plan.cost == cheapest_cost(stacking, problem)


def test_no_plan_is_proved_where_exhaustive_search_finds_none(planner, stacking, towers):
    problem = towers(["a"], ["b"], goal="onTop(a, b) & onTop(b, a)", hands=("Right_hand",))
    assert cheapest_cost(stacking, problem) is None
    for searches in (None, (FIRST,), (OPTIMAL,)):
        attempt = solve(stacking, problem, searches=searches)
        assert (attempt.outcome, attempt.is_explained, attempt.plan) == ("unsolvable", True, None)


def test_plans_hold_for_an_independent_validator(planner, stacking, towers, tmp_path):
    engines = pytest.importorskip("unified_planning.engines", reason="unified-planning is not installed")
    from unified_planning.io import PDDLReader

    problem = towers(["cube_c", "cube_a"], ["cube_b"], goal="onTop(cube_a, cube_b) & onTop(cube_b, cube_c)")
    domain_text, problem_text = render_domain(stacking), render_problem(problem, stacking)
    answer = solve_text(domain_text, problem_text)
    (tmp_path / "domain.pddl").write_text(domain_text)
    (tmp_path / "problem.pddl").write_text(problem_text)
    (tmp_path / "plan").write_text(
        "".join(f"({' '.join([s.operator, *s.arguments])})\n" for s in answer.plan.steps)
    )
    reader = PDDLReader()
    task = reader.parse_problem(str(tmp_path / "domain.pddl"), str(tmp_path / "problem.pddl"))
    plan = reader.parse_plan(task, str(tmp_path / "plan"))
    result = engines.SequentialPlanValidator().validate(task, plan)
    assert result.status.name == "VALID"
    shorter = type(plan)(plan.actions[:-1])
    assert engines.SequentialPlanValidator().validate(task, shorter).status.name == "INVALID"


def test_a_goal_that_holds_already_needs_no_planner(stacking, towers, tmp_path):
    nowhere = Installation(tmp_path / "nothing", tmp_path, "0")
    for goal in ("onTop(a, b)", "(and)", "!onTop(b, a)"):
        attempt = solve(stacking, towers(["b", "a"], goal=goal), installation=nowhere)
        assert (attempt.outcome, attempt.plan.steps, attempt.plan.cost) == ("solved", (), 0)
        assert attempt.message == "the goal holds already"


def test_a_domain_without_operators_has_no_plan(planner, stacking, towers):
    attempt = solve(replace(stacking, operators=()), towers(["a"], ["b"], goal="onTop(a, b)"))
    assert (attempt.outcome, attempt.n_operators) == ("unsolvable", 0)


def test_equal_input_gives_equal_plans(planner, stacking, towers):
    piles = [["a", "b", "c", "d"], ["e", "f"], ["g", "h"]]
    problem = towers(*piles, goal="onTop(h, a) & onTop(a, e) & onTop(d, g)")
    first, second = (solve(stacking, problem) for _ in range(2))
    assert first.plan == second.plan
    assert first.plan.steps


def test_hostile_names_are_planned_with(planner):
    types = TypeHierarchy.of({"A) (and": "object"})
    parameter = Parameter("?x y", "A) (and")
    domain = Domain(
        "; evil",
        types,
        (Signature("and", ("A) (and",)),),
        (
            Operator(
                "not\n", (parameter,), frozenset(), frozenset({Literal(Atom("and", ("?x y",)))}), "", 1, 1
            ),
        ),
    )
    names = ("'; rm -rf /", "手", "x" * 1000)
    problem = Problem(
        "(", "; evil", tuple((name, "A) (and") for name in names), frozenset(),
        frozenset(Literal(Atom("and", (name,))) for name in names),
    )  # fmt: skip
    attempt = solve(domain, problem)
    assert attempt.is_validated
    assert {step.arguments[0] for step in attempt.plan.steps} == set(names)


def test_a_value_that_is_not_pddl_is_an_outcome(stacking, towers):
    problem = replace(towers(["a"], ["b"], goal="onTop(a, b)"), initial=frozenset({Atom("flies", ("a",))}))
    attempt = solve(stacking, problem)
    assert (attempt.outcome, attempt.is_explained) == ("bad_input", True)
    assert "unknown predicate 'flies'" in attempt.message


def test_text_that_the_translator_refuses_is_an_outcome(planner, stacking, towers):
    text = render_problem(towers(["a"], ["b"], goal="onTop(a, b)"), stacking)
    for broken in (text.replace("(on_top a b)", "(on_top a"), text.replace("(:goal", "(:gaol")):
        verdict = solve_text(render_domain(stacking), broken).verdict
        assert (verdict.outcome, verdict.is_explained) == ("bad_input", True)
        assert "the translator refused the PDDL text: " in verdict.meaning
    verdict = solve_text(render_domain(stacking), "").verdict
    assert (verdict.outcome, verdict.is_explained) == ("failed", False), "it ends with a traceback of its own"


def test_a_missing_planner_is_an_outcome_with_a_hint(stacking, towers, monkeypatch):
    module = __import__("sys").modules[solve_function.__module__]
    monkeypatch.setattr(module, "find_installation", lambda: None)
    attempt = solve(stacking, towers(["a"], ["b"], goal="onTop(a, b)"))
    assert attempt.outcome == "planner_missing"
    assert "pip install 'demoplan[planner]'" in attempt.message


def fake_search(planner, tmp_path, script):
    """An installation whose search is a shell script; the translator stays the real one."""
    search = tmp_path / "search"
    search.write_text(f"#!/bin/sh\nfor last; do :; done\n{script}\n")
    search.chmod(search.stat().st_mode | stat.S_IXUSR)
    return replace(planner, search=search)


@pytest.mark.parametrize(
    ("script", "outcome", "is_explained", "message"),
    [
        ("echo '(reach_1 right_hand a)' > $last; echo '; cost = 1 (general cost)' >> $last", "invalid_plan", True, "the goal lacks onTop(a,b)"),
        ("echo '(take_1 right_hand a)' > $last; echo '; cost = 1 (general cost)' >> $last", "invalid_plan", True, "step 1, Take_1(Right_hand,a): its condition fails"),
        ("exit 0", "failed", False, "wrote none"),
        ("exit 10", "unsolvable", True, ""),
        ("exit 11", "unsolvable", True, ""),
        ("exit 12", "gave_up", True, ""),
        ("exit 22", "out_of_memory", True, ""),
        ("exit 23", "out_of_time", True, ""),
        ("exit 32", "failed", True, "critical error"),
        ("echo no such heuristic; exit 33", "bad_input", True, "no such heuristic"),
        ("echo bang; exit 99", "failed", False, "exit code 99, which says nothing: bang"),
        ("kill -SEGV $$", "failed", False, "signal 11"),
        ("kill -KILL $$", "failed", False, "signal 9"),
    ],
)  # fmt: skip
def test_every_exit_is_an_outcome_and_unknown_ones_never_mean_no_plan(
    planner, stacking, towers, tmp_path, script, outcome, is_explained, message
):
    problem = towers(["a"], ["b"], goal="onTop(a, b)", hands=("Right_hand",))
    attempt = solve(stacking, problem, installation=fake_search(planner, tmp_path, script))
    assert (attempt.outcome, attempt.is_explained) == (outcome, is_explained)
    assert message in attempt.message
    assert not attempt.is_validated


def test_when_the_cheapest_plan_takes_too_long_any_plan_will_do(planner, stacking, towers, tmp_path):
    problem = towers(["a"], ["b"], goal="onTop(a, b)", hands=("Right_hand",))
    script = f'case "$*" in *astar*) sleep 60;; *) exec "{planner.search}" "$@";; esac'
    slow = fake_search(planner, tmp_path, script)
    attempt = solve(stacking, problem, SolveParams(wall_s=6.0), installation=slow)
    assert (attempt.outcome, attempt.is_validated, attempt.is_optimal) == ("solved", True, False)
    assert attempt.search_s < 6


def test_too_little_memory_is_an_outcome(planner, stacking, towers):
    problem = towers(*([f"cube_{n}"] for n in range(4)), goal="onTop(cube_0, cube_1)")
    attempt = solve(stacking, problem, SolveParams(memory_bytes=20 * 1024**2))
    # Whether Python itself still starts with so little depends on its version.
    assert attempt.outcome in {"out_of_memory", "failed"}
    assert attempt.plan is None


@pytest.mark.parametrize(
    ("exit_code", "output", "outcome", "is_explained"),
    [
        (1, "Traceback …\nMemoryError\nNameError: …", "out_of_memory", True),
        (1, "Traceback …\nStopIteration", "failed", False),
        (2, "", "failed", False),
        (10, "", "unsolvable", True),
        (20, "", "out_of_memory", True),
        (21, "", "out_of_time", True),
        (31, "Missing ')'", "bad_input", True),
        (-9, "", "failed", False),
    ],
)
def test_exits_of_the_translator_mean_what_they_say(exit_code, output, outcome, is_explained):
    verdict = verdict_of_translator(Ended(exit_code, False, 0.1, output))
    assert (verdict.outcome, verdict.is_explained) == (outcome, is_explained)


def test_a_translator_that_succeeds_has_no_verdict_yet_and_one_out_of_time_has():
    assert verdict_of_translator(Ended(0, False, 0.1, "")) is None
    assert verdict_of_translator(Ended(-9, True, 3.0, "")).outcome == "out_of_time"


def test_attempts_are_rows_of_the_table_of_plans(planner, stacking, towers):
    solved = solve(stacking, towers(["a"], ["b"], goal="onTop(a, b)"))
    unsolvable = solve(replace(stacking, operators=()), towers(["a"], ["b"], goal="onTop(a, b)"))
    bad = solve(stacking, replace(towers(["a"], goal="(and)"), initial=frozenset({Atom("flies", ())})))
    rows = plan_rows([unsolvable, solved, bad, bad])
    assert rows["outcome"].to_list() == ["unsolvable", "solved", "bad_input", "bad_input"]
    assert rows["attempt"].to_list() == [0, 1, 0, 1]
    assert rows["steps"].to_list()[0] is None
    assert rows["steps"].to_list()[1] == [str(step) for step in solved.plan.steps]
    assert rows["cost"].to_list()[:2] == [None, solved.plan.cost]
    assert plan_rows([]).height == 0


def test_the_ladder_starts_with_frequent_operators_and_widens(planner, stacking, towers):
    easy = solve_widening(stacking, towers(["a"], ["b"], goal="onTop(a, b)"))
    assert [(each.n_operators, each.outcome) for each in easy] == [(5, "solved")]
    assert "Put_3" not in {step.operator for step in easy[-1].plan.steps}
    hard = solve_widening(stacking, towers(["a", "b"], goal="onTop(b, table)"))
    assert [(each.n_operators, each.outcome) for each in hard] == [(5, "unsolvable"), (6, "solved")]
    rows = plan_rows(hard)
    assert rows["attempt"].to_list() == [0, 1]


def test_the_ladder_ends_with_all_operators_even_if_none_can_help(planner, stacking, towers):
    attempts = solve_widening(stacking, towers(["a"], ["b"], goal="onTop(a, b) & onTop(b, a)"))
    assert attempts[-1].n_operators == len(stacking.operators)
    assert {each.outcome for each in attempts} == {"unsolvable"}
