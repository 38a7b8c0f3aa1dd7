"""Counts of (before, after) say the same as the transitions that they count."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.inference import (
    ADD,
    DELETE,
    FALSE,
    KEEP,
    TRUE,
    UNSEEN,
    BeliefParams,
    believe,
    believe_pairs,
    timelines_of_pairs,
)


def counts_of(*cells):
    """Counts of one literal, from {(before, after): n}."""
    counts = np.zeros((len(cells), 3, 3), dtype=np.int64)
    for row, each in enumerate(cells):
        for (before, after), n in each.items():
            counts[row, before, after] = n
    return counts


ROLES = {
    "required": ({(TRUE, TRUE): 40, (FALSE, TRUE): 2, (TRUE, FALSE): 2}, 1, KEEP),
    "consumed": ({(TRUE, FALSE): 40, (FALSE, FALSE): 2, (TRUE, TRUE): 2}, 1, DELETE),
    "produced": ({(FALSE, TRUE): 40, (TRUE, TRUE): 2, (FALSE, FALSE): 2}, -1, ADD),
    "added": ({(FALSE, TRUE): 22, (TRUE, TRUE): 18, (TRUE, FALSE): 2}, 0, ADD),
    "unrelated": ({(TRUE, TRUE): 19, (FALSE, FALSE): 20, (TRUE, FALSE): 2}, 0, KEEP),
}


@pytest.mark.parametrize("name", ROLES)
def test_counts_with_five_percent_misread_say_what_the_literal_is(name):
    cells, condition, effect = ROLES[name]
    beliefs = believe_pairs(counts_of(cells), np.zeros(1, dtype=np.int64), 1, BeliefParams())
    likeliest = int(beliefs.probabilities[0].argmax())
    assert (beliefs.roles.condition[likeliest], beliefs.roles.effect[likeliest]) == (condition, effect)
    assert beliefs.is_settled


@given(st.lists(st.lists(st.integers(0, 3), min_size=9, max_size=9), min_size=1, max_size=4))
@settings(max_examples=20, deadline=None)
def test_a_count_of_n_is_the_same_as_n_transitions(rows):
    counts = np.array(rows).reshape(-1, 3, 3)
    predicate = np.arange(len(counts)) % 2
    together = believe_pairs(counts, predicate, 2, BeliefParams())
    timelines = timelines_of_pairs(counts, predicate)
    each = np.repeat(np.arange(len(timelines.entry_literal)), timelines.n_alike.astype(np.int64))
    apart = replace(
        timelines,
        n_by_rank=(len(each),) if len(each) else (),
        n_alike=None,
        entry_literal=timelines.entry_literal[each],
        entry_touch=np.arange(len(each)),
        **{
            name: getattr(timelines, name)[each]
            for name in ("timeline_predicate", "before_true", "before_false", "after_true", "after_false")
        },
    )
    one_by_one = believe(apart, predicate, 2, BeliefParams())
    assert together.probabilities == pytest.approx(one_by_one.probabilities)
    assert together.flip_rate == pytest.approx(one_by_one.flip_rate)


def test_more_evidence_makes_surer_and_one_exception_in_many_does_not_rule_out():
    few, many, spoiled = (
        believe_pairs(
            counts_of({(TRUE, TRUE): n, (FALSE, TRUE): k}), np.zeros(1, dtype=np.int64), 1, BeliefParams()
        )
        for n, k in ((3, 0), (40, 0), (39, 1))
    )
    assert few.required[0] < many.required[0]
    assert spoiled.required[0] > 0.9


def test_without_observations_the_prior_is_what_is_left():
    unseen = counts_of({(UNSEEN, UNSEEN): 7})
    beliefs = believe_pairs(unseen, np.zeros(1, dtype=np.int64), 1, BeliefParams())
    assert beliefs.probabilities[0] == pytest.approx(beliefs.roles.weight, abs=1e-3)
    nothing = believe_pairs(counts_of({}), np.zeros(1, dtype=np.int64), 1, BeliefParams())
    assert nothing.probabilities[0] == pytest.approx(nothing.roles.weight)
    assert believe_pairs(counts_of(), np.zeros(0, dtype=np.int64), 1, BeliefParams()).effects.shape == (0, 3)


@given(st.permutations(range(5)))
@settings(max_examples=10, deadline=None)
def test_the_order_of_literals_does_not_matter(order):
    counts = counts_of(*(cells for cells, _, _ in ROLES.values()))
    predicate = np.array([0, 1, 0, 1, 2])
    one = believe_pairs(counts, predicate, 3, BeliefParams())
    other = believe_pairs(counts[order], predicate[order], 3, BeliefParams())
    assert other.probabilities == pytest.approx(one.probabilities[order])
