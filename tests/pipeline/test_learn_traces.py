"""A case folder becomes a domain file; what is wrong in it is told, and the rest is learned from."""

import json
import random

import pytest
from typer.testing import CliRunner

from demoplan.cli.main import app
from demoplan.errors import PddlError, UsageError
from demoplan.language.pddl import parse_domain
from demoplan.pipeline.domains.learn_traces import learn_traces

DOMAIN = """(define (domain Switches) (:requirements :strips :typing) (:types Switch room - object)
(:predicates (On ?s - Switch) (off ?s - Switch) (in ?s - Switch ?r - room))
(:action turnOn :parameters (?s - Switch ?r - room) :precondition (and ) :effect (and ))
(:action turnOff :parameters (?s - Switch ?r - room) :precondition (and ) :effect (and ))
(:action explode :parameters (?r - room) :precondition (and ) :effect (and )))
"""
PROBLEM = (
    "(define (problem p) (:domain Switches) (:objects a b c - Switch hall - room) (:init) (:goal (and )))"
)


def trace(seed, length=20):
    draw = random.Random(seed)
    on = set()
    parts = ["(:trajectory"]
    for step in range(length + 1):
        facts = [f"(On {s})" if s in on else f"(off {s})" for s in "abc"] + [f"(in {s} hall)" for s in "abc"]
        parts.append(f"(:state {' '.join(facts)})")
        if step < length:
            chosen = draw.choice("abc")
            parts.append(f"(:action ({'turnOff' if chosen in on else 'turnOn'} {chosen} hall))")
            on ^= {chosen}
    return "\n".join(parts) + "\n)\n"


@pytest.fixture
def case(tmp_path):
    folder = tmp_path / "case"
    (folder / "trajectories").mkdir(parents=True)
    (folder / "problems").mkdir()
    (folder / "domain.pddl").write_text(DOMAIN)
    for number in range(4):
        (folder / "trajectories" / f"{number}_traj").write_text(trace(number))
        (folder / "problems" / f"{number}_prob.pddl").write_text(PROBLEM)
    return folder


def test_a_case_becomes_a_domain_with_the_names_of_the_case(case, tmp_path):
    report = learn_traces(case, tmp_path / "out.pddl")
    assert (report.exit_code, report.faults) == (0, ())
    assert (report.n_traces, report.n_transitions) == (4, 80)
    assert report.unseen_actions == ("explode",)
    text = (tmp_path / "out.pddl").read_text()
    assert "(:action turnOn\n    :parameters (?s - Switch ?r - room)" in text
    assert "(off ?s)" in text.split(":precondition")[1].split(":effect")[0]
    domain = parse_domain(text)
    assert {each.name: len(each.effects) for each in domain.operators} == {"turnon": 2, "turnoff": 2}


def test_the_same_case_gives_the_same_bytes(case, tmp_path):
    learn_traces(case, tmp_path / "one.pddl")
    learn_traces(case, tmp_path / "two.pddl")
    assert (tmp_path / "one.pddl").read_bytes() == (tmp_path / "two.pddl").read_bytes()


def test_what_is_wrong_is_told_by_file_and_line_and_the_rest_is_learned_from(case, tmp_path):
    (case / "trajectories/1_traj").write_text(trace(1).replace("(On a)", "(on a b)", 1))
    (case / "trajectories/2_traj").write_text("")
    (case / "trajectories/3_traj").write_bytes(b"\xff\xfe\x00")
    report = learn_traces(case, tmp_path / "out.pddl")
    assert report.exit_code == 3
    line = next(n for n, text in enumerate(trace(1).splitlines(), start=1) if "(On a)" in text)
    told = [str(fault) for fault in report.faults]
    assert told[0] == f"trajectories/1_traj:{line}: (on a b) has 2 arguments; 'On' takes 1"
    assert told[1] == "trajectories/2_traj:1: empty trace: no state in it"
    assert told[2].startswith("trajectories/3_traj:1: not readable as text: ")
    assert report.n_transitions == 40
    assert {each.name for each in parse_domain((tmp_path / "out.pddl").read_text()).operators} == {
        "turnon",
        "turnoff",
    }


def test_contradicting_signatures_are_told(case, tmp_path):
    (case / "domain.pddl").write_text(DOMAIN.replace("(off ?s - Switch)", "(off ?s - Switch) (off)"))
    report = learn_traces(case, tmp_path / "out.pddl")
    assert report.exit_code == 3
    assert str(report.faults[0]) == (
        "domain.pddl:2: predicate 'off' is declared twice, differently; the first declaration is used"
    )


def test_without_a_domain_signatures_are_inferred(case, tmp_path):
    (case / "domain.pddl").unlink()
    learn_traces(case, tmp_path / "out.pddl")
    domain = parse_domain((tmp_path / "out.pddl").read_text())
    assert {each.name: len(each.parameters) for each in domain.operators} == {"turnon": 2, "turnoff": 2}
    assert {each.name: len(each.effects) for each in domain.operators} == {"turnon": 2, "turnoff": 2}


def test_one_trajectory_file_will_do(case, tmp_path):
    alone = tmp_path / "alone_traj"
    alone.write_text(trace(0))
    assert learn_traces(alone, tmp_path / "out.pddl").n_transitions == 20


def test_a_problem_that_cannot_be_read_is_told_and_its_trace_is_used(case, tmp_path):
    (case / "problems/0_prob.pddl").write_text("(define (problem p)")
    report = learn_traces(case, tmp_path / "out.pddl")
    assert report.faults[0].file == "problems/0_prob.pddl"
    assert report.n_transitions == 80


@pytest.mark.parametrize("broken", ["no folder", "no trajectory", "nothing in them"])
def test_nothing_to_learn_from_is_refused_and_nothing_is_written(case, tmp_path, broken):
    for path in (case / "trajectories").iterdir():
        path.write_text("") if broken == "nothing in them" else path.unlink()
    if broken == "no folder":
        (case / "trajectories").rmdir()
    with pytest.raises(UsageError, match="traject"):
        learn_traces(case, tmp_path / "out.pddl")
    assert not (tmp_path / "out.pddl").exists()


def test_a_domain_that_is_none_is_refused(case, tmp_path):
    (case / "domain.pddl").write_text("hello")
    with pytest.raises(PddlError, match=r"domain\.pddl: line 1, column 1: expected"):
        learn_traces(case, tmp_path / "out.pddl")


def test_the_command_tells_how_sure_each_literal_is_and_how_noisy_the_traces_are(case, tmp_path):
    told = CliRunner().invoke(app, ["learn-traces", "--json", str(case), str(tmp_path / "out.pddl")])
    assert told.exit_code == 0
    said = json.loads(told.stdout)
    assert 0 < said["flip_rate"] < 0.01
    assert set(said["flip_rates"]) == {"On", "off", "in"}
    effects = {
        (row["operator"], row["predicate"], row["is_positive"]): row["probability"]
        for row in said["literals"]
        if row["role"] == "effect"
    }
    assert effects.keys() == {
        (name, predicate, is_positive)
        for name, on in (("turnOn", True), ("turnOff", False))
        for predicate, is_positive in (("On", on), ("off", not on))
    }
    assert min(effects.values()) > 0.99


def test_the_command_says_with_its_code_that_something_was_left_out(case, tmp_path):
    (case / "trajectories" / "9_traj").write_text("(:trajectory (:action (turnOn a hall)) (:state (On a)))")
    told = CliRunner().invoke(app, ["learn-traces", str(case), str(tmp_path / "out.pddl")])
    assert told.exit_code == 3
    assert "trajectories/9_traj:1: action without a state before it" in told.stderr.replace("\n", " ")
