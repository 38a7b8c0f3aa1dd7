from itertools import pairwise

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan.errors import DataError, UnknownNameError
from demoplan.stages.contrast import contrast
from demoplan.tables import Activities, Facts

ENTITIES = {"hand": "Hand", "a": "Cube", "b": "Cube"}


def activities(*rows):
    return Activities.validate(
        pl.DataFrame(list(rows), schema=Activities.create_empty().schema, orient="row")
    )


def facts(*rows):
    return Facts.validate(pl.DataFrame(list(rows), schema=Facts.create_empty().schema, orient="row"))


SEEN = ("e", "seen", ["b"], 0, 200, "true")
TWO = (("e", "hand", 0, 100, "Reach", "a", None), ("e", "hand", 100, 200, "Take", "a", "a"))


def test_the_state_at_an_end_is_the_last_one_within_the_segment():
    table = contrast(
        activities(*TWO),
        facts(
            ("e", "ends", ["a"], 50, 100, "true"),
            ("e", "begins", ["a"], 100, 150, "true"),
            ("e", "stays", ["a"], 0, 200, "true"),
        ),
        ENTITIES,
    )
    assert table["after"].to_list() == [["ends(a)", "stays(a)"], ["stays(a)"]]
    assert table["before"].to_list() == [["stays(a)"], ["ends(a)", "stays(a)"]]


def test_the_first_activity_of_a_hand_has_no_previous_one_and_starts_at_its_first_tick():
    table = contrast(
        activities(*TWO), facts(("e", "p", ["a"], 0, 1, "true"), ("e", "q", ["a"], 1, 200, "true")), ENTITIES
    )
    first = table.row(0, named=True)
    assert first["previous_activity"] is None
    assert first["before"] == ["p(a)"]
    assert table.row(1, named=True)["previous_activity"] == "Reach"


def test_labels_that_begin_before_anything_was_seen_start_with_what_was_seen_first():
    table = contrast(activities(*TWO), facts(("e", "p", ["a"], 7, 200, "true")), ENTITIES)
    assert table["before"].to_list()[0] == ["p(a)"]


def test_what_was_not_observed_is_neither_true_nor_false():
    table = contrast(activities(*TWO), facts(SEEN, ("e", "p", ["a"], 90, 200, "unknown")), ENTITIES)
    assert table["unknown_after"].to_list() == [["p(a)"], ["p(a)"]]
    assert table["after"].to_list() == [["seen(b)"], ["seen(b)"]]
    assert table["unknown_before"].to_list() == [[], ["p(a)"]]


def test_how_a_hand_moves_is_read_over_the_whole_activity():
    moves = facts(
        SEEN, ("e", "handMove", ["hand"], 10, 98, "true"), ("e", "handMove", ["hand"], 195, 200, "true")
    )
    table = contrast(activities(*TWO), moves, ENTITIES)
    assert table["after"].to_list() == [["handMove(hand)", "seen(b)"], ["seen(b)"]]
    assert table["before"].to_list() == [["seen(b)"], ["handMove(hand)", "seen(b)"]]


def test_motion_that_was_mostly_unseen_is_unknown_and_unseen_time_counts_for_neither_side():
    moves = facts(
        ("e", "handMove", ["hand"], 0, 60, "unknown"),
        ("e", "handMove", ["hand"], 100, 140, "unknown"),
        ("e", "handMove", ["hand"], 140, 175, "true"),
    )
    table = contrast(activities(*TWO), moves, ENTITIES)
    assert table["unknown_after"].to_list() == [["handMove(hand)"], []]
    assert table["after"].to_list() == [[], ["handMove(hand)"]]


def test_episodes_and_hands_do_not_mix():
    entities = {**ENTITIES, "other": "Hand"}
    rows = (
        ("e", "hand", 0, 100, "Reach", None, None),
        ("e", "other", 0, 50, "Idle", None, None),
        ("e", "other", 50, 100, "Reach", None, None),
        ("f", "hand", 0, 100, "Take", None, None),
    )
    table = contrast(
        activities(*rows),
        facts(("e", "p", ["a"], 0, 60, "true"), ("f", "q", ["a"], 0, 100, "true")),
        entities,
    )
    assert table["previous_activity"].to_list() == [None, None, "Idle", None]
    assert table["after"].to_list() == [[], ["p(a)"], [], ["q(a)"]]


def test_an_unknown_instance_is_named_with_those_that_there_are():
    with pytest.raises(UnknownNameError, match=r"instance 'c'.*available: a, b, hand"):
        contrast(activities(*TWO), facts(("e", "p", ["c"], 0, 1, "true")), ENTITIES)


def test_activities_that_overlap_are_refused():
    with pytest.raises(DataError, match="do not tile"):
        contrast(
            activities(TWO[0], ("e", "hand", 90, 200, "Take", None, None)),
            facts(("e", "p", ["a"], 0, 1, "true")),
            ENTITIES,
        )


def test_no_activities_give_no_transitions():
    assert contrast(activities(), facts(), ENTITIES).is_empty()


@settings(max_examples=60, deadline=None)
@given(
    cuts=st.lists(st.integers(1, 39), min_size=0, max_size=6, unique=True),
    spans=st.lists(st.tuples(st.sampled_from("pqr"), st.integers(0, 39), st.integers(1, 15)), max_size=10),
    shuffled=st.randoms(use_true_random=False),
)
def test_it_agrees_with_asking_every_fact_at_every_end(cuts, spans, shuffled):
    ends = [0, *sorted(cuts), 40]
    rows = [("e", "hand", a, b, "X", None, None) for a, b in pairwise(ends)]
    taken: dict[str, int] = {}
    table = []
    for name, start, length in sorted(spans, key=lambda span: span[1]):
        if start >= taken.get(name, 0):
            taken[name] = start + length + 1
            table.append(("e", name, ["a"], start, start + length, "true"))
    table.append(("e", "always", ["a"], 0, 60, "true"))
    expected = [sorted(f"{n}(a)" for _, n, _, s, t, _ in table if s < end <= t) for end in ends[1:]]
    shuffled.shuffle(rows)
    shuffled.shuffle(table)
    result = contrast(activities(*rows), facts(*table), ENTITIES)
    assert result["after"].to_list() == expected
    assert result["before"].to_list()[1:] == expected[:-1]
