"""Trace files in every form become the same tables; what is wrong is named by line, and the rest is kept."""

from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from demoplan.language.traces import TraceReader, read_signatures
from demoplan.language.traces.tokens import Pieces

DOMAIN = """(define (domain Lamps) (:types lamp room - object)
(:predicates (lit ?l - lamp) (in ?l - lamp ?r - room) (dark))
(:action switchOn :parameters (?l - lamp ?r - room))
(:action wait :parameters ()))
"""
OBJECTS = {"L1": "lamp", "L2": "lamp", "hall": "room"}


def read(*texts, objects=OBJECTS):
    signatures, faults = read_signatures(DOMAIN, "domain.pddl")
    assert not faults
    reader = TraceReader(signatures)
    for number, text in enumerate(texts):
        reader.add(text, f"trajectories/{number}_traj", objects)
    return reader.take(), [str(fault) for fault in reader.faults]


def states_of(traces):
    """Per state, its atoms as text: an oracle that looks at one state after the other."""
    names = traces.object_names
    text = [
        f"{traces.signatures.predicates[p].name} {' '.join(names[a] for a in row if a >= 0)}".strip()
        for p, row in zip(traces.atom_predicate, traces.atom_arguments, strict=True)
    ]
    states = [set() for _ in range(traces.n_states)]
    for state, atom in zip(traces.true_state, traces.true_atom, strict=True):
        states[state].add(text[atom])
    for state, atom in zip(traces.false_state, traces.false_atom, strict=True):
        states[state].add(f"not {text[atom]}")
    return states


AMLGYM = """(:trajectory

(:state (dark) (in L1 hall))

(:action (switchOn L1 hall))

(:state (lit L1) (in L1 hall))

)"""
FORMS = {
    "AMLGym": AMLGYM,
    "with comments and letters of another case": AMLGYM.replace("(dark)", "(DARK) ; it is night\n").replace(
        "L1", "l1"
    ),
    "with a conjunction": AMLGYM.replace(
        "(:state (lit L1) (in L1 hall))", "(:state (and (lit L1) (in L1 hall)))"
    ),
    "OffLAM's observation": AMLGYM.replace("(:trajectory", "(:observation"),
    "NOLAM's observation": AMLGYM.replace("(:trajectory", "(observation"),
    "SAM": AMLGYM.replace("(:trajectory", "(")
    .replace("(:state", "(:init", 1)
    .replace("(:action", "(operator:"),
    "one line": " ".join(AMLGYM.split()),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_states_and_actions(form):
    traces, faults = read(FORMS[form])
    assert faults == []
    assert states_of(traces) == [{"dark", "in l1 hall"}, {"lit l1", "in l1 hall"}]
    assert traces.action_state.tolist() == [0]
    assert [traces.object_names[code] for code in traces.action_arguments[0]] == ["l1", "hall"]
    assert not traces.is_partial.any()


def test_a_state_that_states_what_is_false_is_partial():
    traces, faults = read(AMLGYM.replace("(dark)", "(not (lit L1)) (not (dark))"))
    assert faults == []
    assert states_of(traces)[0] == {"not lit l1", "not dark", "in l1 hall"}
    assert traces.is_partial.tolist() == [True, False]


def test_a_trace_may_say_that_all_its_states_are_partial():
    traces, faults = read(AMLGYM.replace("(:trajectory", "(:trajectory (:partial)"))
    assert faults == []
    assert traces.is_partial.tolist() == [True, True]


def test_the_quick_way_and_the_careful_way_read_the_same():
    careful = AMLGYM.replace("(:state (lit L1)", "(:state (and (lit L1)").replace(
        "(in L1 hall))\n\n)", "(in L1 hall)))\n\n)"
    )
    one, two = read(AMLGYM)[0], read(careful)[0]
    for column in ("true_state", "true_atom", "action_arguments", "state_trace", "declared_object"):
        assert np.array_equal(getattr(one, column), getattr(two, column)), column


def test_an_atom_listed_twice_in_a_state_counts_once():
    assert len(read(AMLGYM.replace("(dark)", "(dark) (dark)"))[0].true_atom) == len(read(AMLGYM)[0].true_atom)


BAD = {
    "unknown predicate": (
        AMLGYM.replace("(dark)", "(gloomy)"),
        "trajectories/0_traj:3: unknown predicate in (gloomy); declared: dark, in, lit",
        2,
    ),
    "wrong arity of an atom": (
        AMLGYM.replace("(lit L1)", "(lit L1 hall)"),
        "trajectories/0_traj:7: (lit L1 hall) has 2 arguments; 'lit' takes 1",
        2,
    ),
    "undeclared object in an atom": (
        AMLGYM.replace("(lit L1)", "(lit L9)"),
        "trajectories/0_traj:7: undeclared object 'l9' in an atom of 'lit'",
        2,
    ),
    "ill-typed atom": (
        AMLGYM.replace("(lit L1)", "(lit hall)"),
        "trajectories/0_traj:7: object 'hall' is a room; 'lit' takes a lamp",
        2,
    ),
    "unknown action": (
        AMLGYM.replace("switchOn", "smash"),
        "trajectories/0_traj:5: unknown action 'smash'; declared: switchOn, wait",
        2,
    ),
    "wrong arity of an action": (
        AMLGYM.replace("switchOn L1 hall", "switchOn L1"),
        "trajectories/0_traj:5: action 'switchOn' has 1 arguments; it takes 2",
        2,
    ),
    "ill-typed action": (
        AMLGYM.replace("switchOn L1 hall", "switchOn hall L1"),
        "trajectories/0_traj:5: object 'hall' is a room; ?l of 'switchOn' takes a lamp",
        2,
    ),
    "undeclared object in an action": (
        AMLGYM.replace("switchOn L1 hall", "switchOn L9 hall"),
        "trajectories/0_traj:5: undeclared object 'l9' in action 'switchOn'",
        2,
    ),
    "action without a state after it": (
        AMLGYM.replace("\n\n)", "\n\n(:action (wait))\n\n)"),
        "trajectories/0_traj:11: action without a state after it",
        2,
    ),
    "state without an action before it": (
        AMLGYM.replace("(:action (switchOn L1 hall))", ""),
        "trajectories/0_traj:7: state without an action between it and the one before",
        2,
    ),
    "bracket that is never closed": (
        AMLGYM.replace("(:state (dark) (in L1 hall))", "(:state (dark) (in L1 hall)"),
        "trajectories/0_traj:3: '(' is never closed",
        2,
    ),
    "empty trace": ("(:trajectory\n)", "trajectories/0_traj:1: empty trace: no state in it", 0),
    "empty file": ("", "trajectories/0_traj:1: empty trace: no state in it", 0),
    "one state only": (
        "(:trajectory\n(:state (dark))\n)",
        "trajectories/0_traj:1: empty trace: no action between states in it",
        1,
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_used_is_named_by_file_and_line(case):
    text, message, n_states = BAD[case]
    traces, faults = read(text)
    assert faults == [message]
    assert traces.n_states == n_states


def test_an_action_right_after_another_has_an_unobserved_state_between():
    traces, faults = read(
        AMLGYM.replace("(:action (switchOn L1 hall))", "(:action (wait))\n(:action (switchOn L1 hall))")
    )
    assert faults == ["trajectories/0_traj:6: action without a state between it and the one before"]
    assert traces.is_partial.tolist() == [False, True, False]
    assert states_of(traces)[1] == set()
    assert traces.action_state.tolist() == [0, 1]


def test_an_action_before_the_first_state_is_left_out():
    traces, faults = read(AMLGYM.replace("(:trajectory", "(:trajectory (:action (wait))"))
    assert faults == ["trajectories/0_traj:1: action without a state before it"]
    assert traces.n_actions == 1


def test_nothing_is_learned_across_an_action_that_cannot_be_read():
    text = AMLGYM.replace(
        "\n\n)", "\n(:action (smash))\n(:state (dark))\n(:action (wait))\n(:state (dark))\n)"
    )
    traces, faults = read(text)
    assert len(faults) == 1
    assert traces.state_trace.tolist() == [0, 0, 1, 1]
    assert traces.action_state.tolist() == [0, 2]


def test_one_bad_trace_does_not_harm_the_others():
    traces, faults = read(AMLGYM, "(:trajectory (:state (((", AMLGYM)
    assert len(faults) == 1
    assert faults[0].startswith("trajectories/1_traj:1: ")
    assert traces.n_actions == 2


def test_the_same_fault_again_only_counts():
    _, faults = read(AMLGYM.replace("(in L1 hall)", "(gloomy)"))
    assert faults == [
        "trajectories/0_traj:3: unknown predicate in (gloomy); declared: dark, in, lit (2 times)"
    ]


def test_stretches_selected_and_joined_again_hold_what_they_held():
    traces, _ = read(AMLGYM, AMLGYM.replace("L1", "L2"), AMLGYM)
    first, last = np.array([0, 4]), np.array([1, 5])
    picked = traces.select(first, last)
    assert states_of(picked) == [states_of(traces)[n] for n in (0, 1, 4, 5)]
    assert picked.action_state.tolist() == [0, 2]
    rest = traces.select(np.array([2]), np.array([3]))
    both = picked.join(rest)
    assert states_of(both) == states_of(picked) + states_of(rest)
    assert both.state_trace.tolist() == [0, 0, 1, 1, 2, 2]
    assert both.action_arguments.tolist() == [
        *picked.action_arguments.tolist(),
        *rest.action_arguments.tolist(),
    ]


@pytest.mark.parametrize(
    "piece", ["(", " ", "(:state ", "(not (", "(and ", ")", "(:trajectory ", "; (", "(a "]
)
def test_a_hostile_file_takes_no_longer_than_a_friendly_one(piece):
    import time

    def seconds(n):
        start = time.process_time()
        read("(:trajectory " + piece * n)
        return time.process_time() - start

    seconds(100)
    # Four times the length may cost some more than four times as much, but not the square of it.
    assert seconds(20_000) < 12 * seconds(5_000) + 0.2


@given(st.text(alphabet="() aL1:-\n", max_size=30), st.integers(0, len(AMLGYM)))
@example(":state", 13)
@example(")(", 42)
@example("(dark)", 25)
@example(")", len(AMLGYM))
@settings(max_examples=300, deadline=None)
def test_what_is_read_in_one_go_is_what_is_read_item_by_item(inserted, place):
    text = AMLGYM[:place] + inserted + AMLGYM[place:]
    quick, quick_faults = read(text)
    with patch.object(Pieces, "regular", return_value=None):
        careful, careful_faults = read(text)
    assert quick_faults == careful_faults
    assert states_of(quick) == states_of(careful)
    assert quick.action_arguments.tolist() == careful.action_arguments.tolist()
