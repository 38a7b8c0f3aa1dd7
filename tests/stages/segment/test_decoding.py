"""Sequences from probabilities: exact, and the same as the textbook says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.stages.segment.decoding import (
    Grammar,
    decoded,
    grammar_of,
    runs_of,
    viterbi,
    without_short_runs,
)


def textbook_viterbi(log_probability, initial, change):
    n, k = log_probability.shape
    score = initial + log_probability[0]
    back = np.zeros((n, k), dtype=int)
    for tick in range(1, n):
        ways = score[:, None] + change
        back[tick] = ways.argmax(axis=0)
        score = ways.max(axis=0) + log_probability[tick]
    path = [int(score.argmax())]
    for tick in range(n - 1, 0, -1):
        path.append(int(back[tick, path[-1]]))
    return np.asarray(path[::-1])


def worth(path, log_probability, initial, change):
    return (
        initial[path[0]]
        + log_probability[np.arange(len(path)), path].sum()
        + change[path[:-1], path[1:]].sum()
    )


def random_grammar(rng, k):
    sequences = [rng.integers(0, k, size=6) for _ in range(3)]
    sequences = [s[np.append(True, s[1:] != s[:-1])] for s in (*sequences, np.arange(k))]
    grammar = grammar_of(sequences, [np.ones(len(s)) for s in sequences], k, prior=0.5)
    return grammar.initial, grammar.costs(0.1)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 17, 99, 100, 101, 1000])
@pytest.mark.parametrize("k", [1, 2, 8])
def test_decoding_in_blocks_finds_the_course_that_the_textbook_finds(n, k):
    rng = np.random.default_rng(n * 10 + k)
    evidence = np.log(rng.dirichlet(np.ones(k), size=n)) * 0.3
    grammar = random_grammar(rng, k)
    fast, slow = viterbi(evidence, *grammar), textbook_viterbi(evidence, *grammar)
    np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("seed", range(8))
def test_deciding_stretches_as_a_whole_loses_nothing(seed):
    # Evidence as a single tree gives it: constant for a while, then another leaf.
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 40, size=30)
    evidence = np.repeat(np.log(rng.dirichlet(np.ones(5), size=30)), lengths, axis=0) * 0.2
    evidence += np.linspace(0, 1e-3, len(evidence))[:, None]
    grammar = random_grammar(rng, 5)
    whole, by_tick = decoded(evidence, *grammar), viterbi(evidence, *grammar)
    assert len(whole) == len(evidence)
    assert worth(whole, evidence, *grammar) == pytest.approx(worth(by_tick, evidence, *grammar))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 60))
def test_no_single_change_makes_the_decoded_course_better(seed, n):
    rng = np.random.default_rng(seed)
    evidence = np.log(rng.dirichlet(np.ones(4), size=n))
    grammar = random_grammar(rng, 4)
    path = viterbi(evidence, *grammar)
    best = worth(path, evidence, *grammar)
    for tick in range(n):
        for other in range(4):
            changed = path.copy()
            changed[tick] = other
            assert worth(changed, evidence, *grammar) <= best + 1e-9


def test_decoding_nothing_gives_nothing():
    assert viterbi(np.zeros((0, 2)), np.zeros(2), np.zeros((2, 2))).tolist() == []


def test_a_flicker_without_much_evidence_is_smoothed_away():
    evidence = np.log(np.tile([0.9, 0.1], (50, 1)))
    evidence[25] = np.log([0.4, 0.6])
    grammar = grammar_of([np.array([0, 1, 0])], [np.ones(3)], 2, prior=0.5)
    assert set(viterbi(evidence, grammar.initial, grammar.costs(0.1)).tolist()) == {0}


def test_changes_that_were_never_shown_cost_more_but_stay_possible():
    grammar = grammar_of([np.array([0, 1, 2])] * 5, [np.ones(3)] * 5, 3, prior=0.5)
    assert np.isfinite(grammar.change).all()
    assert grammar.change[0, 1] > grammar.change[0, 2]
    assert np.diag(grammar.change).tolist() == [0, 0, 0]


def test_an_activity_that_lasts_long_is_left_reluctantly():
    grammar = grammar_of([np.array([0, 1, 0])], [np.array([10.0, 0.5, 10.0])], 2, prior=0.5)
    costs = grammar.costs(0.1)
    assert costs[0, 1] == pytest.approx(np.log(0.01))
    assert costs[1, 0] == pytest.approx(np.log(0.2))


def test_runs_are_named_by_their_first_tick():
    starts, values = runs_of(np.array([3, 3, 1, 1, 1, 3]))
    assert starts.tolist() == [0, 2, 5]
    assert values.tolist() == [3, 1, 3]


def test_a_short_run_joins_the_neighbour_that_its_ticks_speak_for():
    classes = np.array([0] * 10 + [1] * 2 + [2] * 10)
    evidence = np.zeros((22, 3))
    evidence[10:12, 2] = 1.0
    assert without_short_runs(classes, evidence, 5).tolist() == [0] * 10 + [2] * 12


def test_equal_neighbours_of_a_short_run_become_one():
    classes = np.array([0] * 4 + [1] + [0] * 4)
    assert without_short_runs(classes, None, 3).tolist() == [0] * 9


def test_a_single_run_stays_however_short():
    assert without_short_runs(np.array([2, 2]), None, 50).tolist() == [2, 2]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 3), min_size=1, max_size=80), st.integers(1, 12))
def test_no_run_that_is_left_is_short_unless_it_is_the_only_one(classes, least):
    calm = without_short_runs(np.asarray(classes), None, least)
    assert len(calm) == len(classes)
    starts, _ = runs_of(calm)
    lengths = np.diff([*starts, len(calm)])
    assert len(starts) == 1 or lengths.min() >= least


def test_a_grammar_is_two_arrays_of_logarithms():
    grammar = grammar_of([np.array([1, 0])], [np.ones(2)], 2, prior=1.0)
    assert isinstance(grammar, Grammar)
    assert np.exp(grammar.initial).sum() == pytest.approx(1.0)
