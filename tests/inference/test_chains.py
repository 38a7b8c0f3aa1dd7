"""Messages along timelines say what looking at every possible course of the atom says."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.inference.chains import Evidence, FlipRates, Steps, estimate_flips, evidence, smooth


@given(st.lists(st.integers(1, 4), min_size=1, max_size=3), st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_smoothing_agrees_with_enumeration_of_all_courses(timelines_of, sizes, seed):
    draw = np.random.default_rng(seed)
    sizes = sorted(sizes, reverse=True)
    n = sum(sizes)
    timelines = timelines_of(sizes, [(0, 0)] * (len(sizes) + n))
    seen = Evidence(draw.uniform(0.05, 20, len(sizes)), draw.uniform(0.05, 20, n))
    steps = Steps(draw.uniform(0.05, 20, n), draw.uniform(0.01, 0.99, n), draw.uniform(0.01, 0.99, n))
    messages = smooth(timelines, seen, steps)
    for line, size in enumerate(sizes):
        touch = np.flatnonzero(timelines.touch_timeline == line)
        weight_of = {}
        for course in itertools.product((False, True), repeat=size + 1):
            weight = seen.before[line] ** course[0]
            for k, row in enumerate(touch):
                true = steps.true_if_true[row] if course[k] else steps.true_if_false[row]
                weight *= steps.fit[row] ** course[k] * (true if course[k + 1] else 1 - true)
                weight *= seen.after[row] ** course[k + 1]
            weight_of[course] = weight
        total = sum(weight_of.values())
        for k in range(size + 1):
            true = sum(weight for course, weight in weight_of.items() if course[k]) / total
            found = messages.true_before[line] if k == 0 else messages.true_after[touch[k - 1]]
            assert found == pytest.approx(true)


def test_evidence_is_the_product_of_the_observations(timelines_of):
    timelines = timelines_of([1], [(3, 1), (0, 2)])
    seen = evidence(timelines, FlipRates(missed=np.array([0.2]), imagined=np.array([0.1])))
    assert seen.before[0] == pytest.approx((0.8**3 * 0.2) / (0.1**3 * 0.9))
    assert seen.after[0] == pytest.approx(0.2**2 / 0.9**2)


def test_flip_rates_are_expected_flips_over_expected_values(timelines_of):
    timelines = timelines_of([1], [(90, 10), (5, 95)])
    steps = Steps(fit=np.array([1.0]), true_if_false=np.array([1e-9]), true_if_true=np.array([1e-9]))
    messages = smooth(timelines, Evidence(np.array([1e20]), np.array([1e-20])), steps)
    rates, overall = estimate_flips(timelines, messages, 1, n_prior=0.0)
    assert rates.missed[0] == pytest.approx(0.10)
    assert rates.imagined[0] == pytest.approx(0.05)
    assert overall == pytest.approx(15.5 / 250)


def test_where_a_timeline_ends_is_known(timelines_of):
    timelines = timelines_of([3, 1], [(0, 0)] * 6)
    assert timelines.touch_timeline.tolist() == [0, 1, 0, 0]
    assert timelines.is_last.tolist() == [False, True, False, True]
