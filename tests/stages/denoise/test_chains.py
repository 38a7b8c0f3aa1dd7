"""Messages along timelines say what looking at every possible course of the atom says."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.stages.denoise.chains import Evidence, FlipRates, estimate_flips, evidence, smooth
from demoplan.stages.denoise.touches import Touches


def touches_of(sizes, counts):
    """Timelines with so many touches each; counts are (true, false) of each segment, in order."""
    timeline = np.repeat(np.arange(len(sizes)), sizes)
    n = len(timeline)
    starts = np.cumsum(sizes) - sizes
    rank = np.arange(n) - np.repeat(starts, sizes)
    before, after = np.array(counts[: len(sizes)], dtype=float), np.array(counts[len(sizes) :], dtype=float)
    return Touches(
        entry_touch=np.arange(n),
        entry_candidate=np.zeros(n, dtype=np.int64),
        touch_timeline=timeline,
        touch_state=np.arange(n),
        timeline_code=np.arange(len(sizes)),
        timeline_span=np.zeros(len(sizes), dtype=np.int64),
        timeline_predicate=np.zeros(len(sizes), dtype=np.int64),
        before_true=before[:, 0],
        before_false=before[:, 1],
        after_true=after[:, 0],
        after_false=after[:, 1],
        ranks=tuple(np.flatnonzero(rank == k) for k in range(int(rank.max()) + 1)),
    )


@given(st.lists(st.integers(1, 4), min_size=1, max_size=3), st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_smoothing_agrees_with_enumeration_of_all_courses(sizes, seed):
    draw = np.random.default_rng(seed)
    sizes = np.array(sizes)
    n = int(sizes.sum())
    touches = touches_of(sizes, [(0, 0)] * (len(sizes) + n))
    seen = Evidence(draw.uniform(0.05, 1, (len(sizes), 2)), draw.uniform(0.05, 1, (n, 2)))
    steps = draw.uniform(0.01, 1, (n, 2, 2))
    messages = smooth(touches, seen, steps)
    for line, size in enumerate(sizes):
        first = int(sizes[:line].sum())
        weight_of = {}
        for course in itertools.product((0, 1), repeat=int(size) + 1):
            weight = seen.before[line, course[0]]
            for k in range(size):
                weight *= steps[first + k, course[k], course[k + 1]] * seen.after[first + k, course[k + 1]]
            weight_of[course] = weight
        total = sum(weight_of.values())
        for k in range(size + 1):
            true = sum(weight for course, weight in weight_of.items() if course[k]) / total
            found = messages.true_before[line] if k == 0 else messages.true_after[first + k - 1]
            assert found == pytest.approx(true)


def test_evidence_is_the_product_of_the_observations():
    touches = touches_of(np.array([1]), [(3, 1), (0, 2)])
    seen = evidence(touches, FlipRates(missed=np.array([0.2]), imagined=np.array([0.1])))
    false, true = 0.1**3 * 0.9, 0.8**3 * 0.2
    assert seen.before[0, 0] / seen.before[0, 1] == pytest.approx(false / true)
    assert seen.after[0, 1] / seen.after[0, 0] == pytest.approx(0.2**2 / 0.9**2)


def test_flip_rates_are_expected_flips_over_expected_values():
    touches = touches_of(np.array([1]), [(90, 10), (5, 95)])
    messages = smooth(
        touches,
        Evidence(np.array([[0.0 + 1e-20, 1.0]]), np.array([[1.0, 1e-20]])),
        np.array([[[1.0, 1e-9], [1.0, 1e-9]]]),
    )
    rates, overall = estimate_flips(touches, messages, 1, n_prior=0.0)
    assert rates.missed[0] == pytest.approx(0.10)
    assert rates.imagined[0] == pytest.approx(0.05)
    assert overall == pytest.approx(15.5 / 250)
