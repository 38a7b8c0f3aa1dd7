"""Plan files as test cases: what they say, and what comes of them."""

import json
from pathlib import Path

import pytest

from demoplan.errors import UsageError
from demoplan.language.pddl import parse_domain
from demoplan.pipeline.domains.domain_quality import read_case, run_cases

DOMAIN = parse_domain(
    (Path(__file__).parents[1] / "golden" / "planning" / "stacking-domain.pddl").read_text()
)
STATE = {
    "objects": {
        "Left_hand": "Hand",
        "Right_hand": "Hand",
        "a": "WoodenCube",
        "b": "WoodenCube",
        "table": "Table",
    },
    "atoms": [
        "handOpen(Left_hand)",
        "handOpen(Right_hand)",
        "onTop(a,table)",
        "onTop(b,table)",
        "clear(a)",
        "clear(b)",
    ],
}


@pytest.fixture
def case(tmp_path):
    (tmp_path / "start.json").write_text(json.dumps(STATE))

    def write(text, name="case.plan"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


HEAD = "; start: start.json\n; goal: onTop(a, b)\n"


def result_of(path):
    return run_cases(DOMAIN, [read_case(path)], None)[0]


def solution(case):
    from demoplan.engines.fast_downward import solve
    from demoplan.pipeline.domains.planning import problem_of, start_of

    start = start_of(read_case(case(HEAD)).start, None, DOMAIN)
    return solve(DOMAIN, problem_of(DOMAIN, start, "onTop(a, b)")).plan.steps


def test_a_plan_that_reaches_its_goal_is_valid_in_names_of_logs_and_of_planners(case):
    steps = solution(case)
    as_logged = HEAD + "".join(f"{step}\n" for step in steps)
    as_planned = HEAD + "".join(f"({' '.join([s.operator, *s.arguments]).lower()})\n" for s in steps)
    assert result_of(case(as_logged)).is_passed
    assert result_of(case(as_planned)).is_passed


def test_a_plan_that_lacks_a_step_is_invalid_and_the_reason_is_said(case):
    steps = solution(case)
    text = HEAD + "".join(f"{step}\n" for step in steps[1:])
    result = result_of(case(text))
    assert (result.found, result.is_passed) == ("invalid", False)
    assert result.reason
    assert result_of(case(text + "; expect: invalid\n")).is_passed


def test_goals_may_be_expected_to_be_solvable_or_not(case):
    assert result_of(case(HEAD + "; expect: solvable\n")).is_passed
    assert result_of(
        case("; start: start.json\n; goal: onTop(a, b) & onTop(b, a)\n; expect: unsolvable\n")
    ).is_passed


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("; goal: onTop(a, b)\n", "says no start"),
        ("; start: start.json\n", "says no goal"),
        (HEAD + "; expect: fine\n", "expects 'fine'; available: valid, invalid, solvable, unsolvable"),
        (HEAD + "put a on b\n", r"case.plan:3: not a step: 'put a on b'"),
    ],
)
def test_what_a_case_does_not_say_is_named(case, text, words):
    with pytest.raises(UsageError, match=words):
        read_case(case(text))
