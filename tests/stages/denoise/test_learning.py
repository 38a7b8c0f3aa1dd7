"""Rules come back from noisy walks, whatever the order, in one go or in pieces; counts are exact."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.inference import believe
from demoplan.language.atoms import Atom
from demoplan.stages.denoise import DenoiseParams, conclude, denoise, forget, gather
from demoplan.stages.denoise.counts import count
from demoplan.stages.denoise.opportunities import Occasions, Opportunity, forbidden, occasions
from demoplan.stages.denoise.touches import Candidate, GroundCodes, candidates, spans, touch


@pytest.mark.parametrize("rate", [0.0, 0.01, 0.05, 0.1, 0.2])
def test_rules_come_back_from_twelve_noisy_walks(courier, rules, learned, rate):
    found = learned(denoise(courier(12, rate=rate)))
    symmetric = {"go": ({"at(?c,?a)", "door(?b,?a)"}, rules["go"][1])}
    assert found in (rules, rules | symmetric)


@pytest.mark.parametrize("rate", [0.0, 0.05, 0.2])
def test_the_flip_rate_is_estimated_and_not_told(courier, rate):
    denoised = denoise(courier(12, rate=rate))
    assert denoised.flip_rate == pytest.approx(rate, abs=0.01)
    assert denoised.is_settled


def test_flips_that_go_one_way_are_estimated_per_direction(courier):
    traces = courier(12)
    kept = [n for n in range(len(traces.true_atom)) if n * 7919 % 10 != 0]
    thinned = replace(traces, true_state=traces.true_state[kept], true_atom=traces.true_atom[kept])
    missed, imagined = denoise(thinned).flip_rates["at"]
    assert missed > 0.05
    assert imagined < 0.02


def test_rules_come_back_where_half_of_the_atoms_are_not_said(courier, rules, learned):
    found = learned(denoise(courier(12, rate=0.05, hidden=0.5)))
    assert {name: effects for name, (_, effects) in found.items()} == {n: e for n, (_, e) in rules.items()}


def test_an_action_without_an_instance_gives_no_operator(courier):
    operators = denoise(courier(3)).operators
    assert "vanish" not in set(operators["operator"])
    assert set(operators["operator"]) == {"go", "pick", "drop", "stamp"}


def test_no_negative_condition_is_stated_without_evidence(courier):
    literals = denoise(courier(12, rate=0.1)).literals
    assert literals.filter((pl.col("role") == "precondition") & ~pl.col("is_positive")).is_empty()


@pytest.mark.parametrize("rate", [0.0, 0.1])
def test_a_negative_condition_is_stated_where_chances_were_avoided(courier, rules, learned, rate):
    denoised = denoise(courier(16, barred="heavy", rate=rate))
    pre, effects = learned(denoised)["pick"]
    assert pre == rules["pick"][0] | {"not heavy(?p)"}
    assert effects == rules["pick"][1]
    row = denoised.literals.filter(~pl.col("is_positive") & (pl.col("role") == "precondition")).row(
        0, named=True
    )
    assert row["n_support"] + row["n_against"] == row["n_transitions"]
    assert re.fullmatch(r"avoided on \d+ occasions where it held in \d+% of the chances", row["note"])


def test_a_literal_left_out_says_what_implies_it(courier):
    # Doors go both ways here: one of the two directions says it all.
    rows = denoise(courier(12)).literals.filter(
        (pl.col("operator") == "go") & (pl.col("predicate") == "door") & pl.col("note").is_not_null()
    )
    assert rows["note"].to_list() == ["implied by door(?a,?b)"]
    assert not rows["is_kept"].any()
    whole = denoise(courier(12), DenoiseParams(is_minimal=False)).actions()
    assert {"door(?a,?b)", "door(?b,?a)"} <= {str(each) for each in whole["go"][0]}


@given(st.permutations(range(8)))
@settings(max_examples=5, deadline=None)
def test_the_order_of_traces_does_not_matter(courier, learned, order):
    assert learned(denoise(courier(order, rate=0.1))) == learned(denoise(courier(8, rate=0.1)))


def test_learning_twice_gives_the_same_tables(courier):
    one, two = denoise(courier(6, rate=0.1)), denoise(courier(6, rate=0.1))
    assert one.literals.equals(two.literals)
    assert one.operators.equals(two.operators)


def test_gathered_piece_by_piece_is_learned_the_same_as_at_once(courier):
    traces = courier(9, rate=0.1)
    starts = [
        n for n in range(traces.n_states) if n == 0 or traces.state_trace[n] != traces.state_trace[n - 1]
    ]
    bounds = [0, starts[2], starts[5], traces.n_states]
    gathered = None
    for low, high in pairwise(bounds):
        first = np.array([n for n in starts if low <= n < high])
        last = np.array([*(n - 1 for n in starts if low < n < high), high - 1])
        gathered = gather(traces.select(first, last), so_far=gathered)
    assert conclude(gathered).literals.equals(denoise(traces).literals)


def test_what_is_kept_of_many_traces_is_bounded_and_what_is_counted_is_all(courier, rules, learned):
    params = DenoiseParams(max_instances=40)
    few, many = gather(courier(20, rate=0.05), params), gather(courier(60, rate=0.05), params)
    assert many.sample.n_states < 1.3 * few.sample.n_states
    assert many.counts.n_transitions.sum() == 60 * 25
    assert learned(conclude(many, params)) == rules


def test_counts_of_two_sets_add_up_and_forgetting_one_is_exact(courier):
    def counted(numbers):
        traces = courier(numbers, rate=0.1)
        return count(traces, candidates(traces.signatures), GroundCodes(traces))

    all_of_them, first, second = counted(range(6)), counted(range(4)), counted(range(4, 6))
    for column in ("true_before", "false_before", "true_after", "false_after", "n_transitions"):
        assert getattr(first + second, column).tolist() == getattr(all_of_them, column).tolist()
        assert getattr(all_of_them - second, column).tolist() == getattr(first, column).tolist()


@pytest.mark.parametrize(
    ("number", "order"), [(0, range(7)), (3, (6, 3, 1, 0, 5, 2, 4)), (6, range(6, -1, -1))]
)
def test_a_forgotten_trace_leaves_nothing_behind(courier_one_by_one, number, order):
    pieces = courier_one_by_one
    gathered, without = None, None
    for n in order:
        gathered = gather(pieces[n], so_far=gathered)
        without = without if n == number else gather(pieces[n], so_far=without)
    forgotten = forget(gathered, pieces[number])
    assert forgotten.counts.n_transitions.tolist() == without.counts.n_transitions.tolist()
    assert forgotten.n_episodes.tolist() == without.n_episodes.tolist()
    assert conclude(forgotten).literals.equals(conclude(without).literals)


def test_counts_are_those_of_looking_at_one_transition_after_the_other(courier):
    traces = courier(4, rate=0.1, hidden=0.3)
    over = candidates(traces.signatures)
    counts = count(traces, over, GroundCodes(traces))
    atoms = {
        (p, *(a for a in row if a >= 0)): n
        for n, (p, row) in enumerate(
            zip(traces.atom_predicate.tolist(), traces.atom_arguments.tolist(), strict=True)
        )
    }
    true = set(zip(traces.true_state.tolist(), traces.true_atom.tolist(), strict=True))
    false = set(zip(traces.false_state.tolist(), traces.false_atom.tolist(), strict=True))
    for index, each in enumerate(over):
        expected = [0, 0, 0, 0]
        for state, action, arguments in zip(
            traces.action_state, traces.action_signature, traces.action_arguments, strict=True
        ):
            if action == each.action:
                atom = atoms.get((each.predicate, *(int(arguments[term]) for term in each.terms)), -1)
                for place, at in ((0, state), (2, state + 1)):
                    expected[place] += (at, atom) in true
                    expected[place + 1] += (at, atom) in false
        found = [
            counts.true_before[index],
            counts.false_before[index],
            counts.true_after[index],
            counts.false_after[index],
        ]
        assert found == expected, each.atom


def test_one_transition_is_enough_to_learn_something(courier):
    denoised = denoise(courier(1, length=1))
    assert len(denoised.operators) == 1
    assert denoised.literals["probability"].is_between(0, 1).all()


def test_occasions_are_counted_once_while_nothing_changes(timelines_of_courier):
    timelines, messages = timelines_of_courier
    n, n_true = 0, 0.0
    for line in range(len(messages.true_before)):
        touches = np.flatnonzero(timelines.touch_timeline == line)
        values = [messages.true_before[line] > 1 / 2, *(messages.true_after[touches] > 1 / 2)]
        met: dict[int, list[bool]] = {}
        n_changes = 0
        for before, after in pairwise(values):
            met.setdefault(n_changes, []).append(bool(before))
            n_changes += before != after
        n += len(met)
        n_true += sum(sum(each) / len(each) for each in met.values())
    (found,) = occasions(timelines, messages, 1)
    assert found.n == n
    assert found.n_true == pytest.approx(n_true, abs=0.2)


@pytest.fixture
def timelines_of_courier(courier):
    """Timelines of a noisy walk as if every touch were of one literal, and what is believed of them."""
    traces = courier(4, rate=0.05)
    over = candidates(traces.signatures)
    touches = touch(traces, spans(traces, DenoiseParams()), over, GroundCodes(traces))
    predicate = np.array([each.predicate for each in over])
    beliefs = believe(touches.timelines, predicate, len(traces.signatures.predicates), DenoiseParams())
    n_touches = len(touches.touch_state)
    one = replace(
        touches.timelines, entry_literal=np.zeros(n_touches, dtype=np.int64), entry_touch=np.arange(n_touches)
    )
    return one, beliefs.messages


def test_what_is_avoided_by_habit_is_not_forbidden():
    def chances(n_true, n=26, share=0.18):
        return [
            Opportunity(Candidate(0, k, Atom(f"p{k}", ()), ()), Occasions(n, met), share)
            for k, met in enumerate(n_true)
        ]

    at_random = chances([0, 11, 9, 12, 10, 8, 11], n=60)
    of_habit = chances([0, 25, 2, 0, 1, 30, 1], n=60)
    assert {each.predicate for each in forbidden(at_random, {}, DenoiseParams())} == {0}
    assert not forbidden(of_habit, {}, DenoiseParams())
