"""What is made of misread states and misnamed activities: estimated rates, mended states, and a domain all the same."""

import random

import numpy as np
import polars as pl
import pytest

from demoplan.engines.fast_downward import solve
from demoplan.language.execution import ground
from demoplan.stages.learn.encode import encode
from demoplan.stages.learn.mend import mend
from demoplan.tables import Transitions


@pytest.fixture(scope="module")
def study(table_world):
    return table_world.transitions_of(*table_world.study("mending").values())


def encoded(table_world, transitions):
    return encode(transitions, table_world.TYPES, table_world.PREDICATES)


def atoms_of(data):
    """(state, atom text) pairs that are true."""
    owner, atom = data.true.gather(np.arange(2 * data.n))
    texts = [
        f"{data.predicates[code].name}({','.join(data.names[name] for name in names if name >= 0)})"
        for code, names in zip(data.atom_predicate, data.atom_arguments, strict=True)
    ]
    return {(int(state), texts[code]) for state, code in zip(owner, atom, strict=True)}


@pytest.mark.parametrize("flips", [0.02, 0.05, 0.1])
def test_rates_of_misreading_are_estimated_and_most_misreadings_put_right(table_world, study, flips):
    data = encoded(table_world, table_world.corrupted(study, flips, flips=flips))
    mended = mend(data, table_world.TYPES)
    assert mended.is_needed
    assert mended.rates.imagined == pytest.approx(np.full(len(data.predicates), flips), abs=0.02)
    assert mended.rates.overall == pytest.approx(flips, abs=0.015)
    truth = atoms_of(encoded(table_world, study))
    wrong_before, wrong_after = (len(truth ^ atoms_of(each)) for each in (data, mended.data))
    assert wrong_after < 0.5 * wrong_before


def test_what_was_read_well_is_left_as_it_is(table_world, study):
    data = encoded(table_world, study)
    mended = mend(data, table_world.TYPES)
    assert not mended.is_needed
    assert mended.data is data


def test_groups_that_exclude_each_other_are_found_in_clean_and_in_noisy_readings(table_world, study):
    found = []
    for transitions in (study, table_world.corrupted(study, 1)):
        data = encoded(table_world, transitions)
        found.append(
            {
                tuple((data.predicates[code].name, position) for code, position in group.members)
                for group in mend(data, table_world.TYPES).exclusions
            }
        )
    assert all((("onTop", 0),) in groups for groups in found)
    assert (("handOpen", 0), ("inHand", 0)) in found[0]
    assert not any((("inTouch", 0),) in groups for groups in found)


def test_mending_does_not_depend_on_the_order_of_rows(table_world, study):
    noisy = table_world.corrupted(study, 2)
    shuffled = Transitions.validate(noisy.sample(fraction=1.0, shuffle=True, seed=3))
    first, second = (mend(encoded(table_world, each), table_world.TYPES) for each in (noisy, shuffled))
    assert atoms_of(first.data) == atoms_of(second.data)


def test_what_was_not_observed_stays_so(table_world, study):
    noisy = table_world.corrupted(study, 4)
    unknown = Transitions.validate(
        noisy.with_columns(
            pl.col("before", "after").list.filter(~pl.element().str.starts_with("clear")),
            unknown_before=pl.col("before").list.filter(pl.element().str.starts_with("clear")),
            unknown_after=pl.col("after").list.filter(pl.element().str.starts_with("clear")),
        )
    )
    data = encoded(table_world, unknown)
    mended = mend(data, table_world.TYPES).data

    def pairs(states):
        return set(zip(*(each.tolist() for each in states.gather(np.arange(2 * data.n))), strict=True))

    hidden = pairs(data.unknown)
    assert hidden <= pairs(mended.unknown)
    assert not hidden & pairs(mended.true)


def test_what_neither_reading_nor_course_decides_counts_for_no_literal(table_world, study):
    data = encoded(table_world, table_world.corrupted(study, 5, flips=0.1))
    mended = mend(data, table_world.TYPES).data
    assert len(mended.unknown.atoms) > len(data.unknown.atoms)


@pytest.mark.parametrize("seed", range(3))
def test_a_tenth_misnamed_and_a_twentieth_misread_still_give_a_domain_for_every_goal(
    table_world, study, seed
):
    domain = table_world.domain_of(table_world.corrupted(study, seed))
    assert len(domain.operators) <= 9
    for kind in table_world.GOALS:
        problem = table_world.problem_of(domain, kind, random.Random(f"{seed}{kind}"), ("Right_hand",))
        attempt = solve(domain, problem)
        assert attempt.plan is not None, (kind, attempt.outcome, attempt.message)
        world, operators = table_world.Tabletop(problem), {each.name: each for each in domain.operators}
        for step in attempt.plan.steps:
            grounded = ground(operators[step.operator], step)
            assert not world.wrong(grounded.adds, grounded.deletes)
        assert world.reaches(problem.goal)
