"""Scores of segmentation: exact, bounded, and the same as naive counting says."""

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import accuracy_score, f1_score

from demoplan.errors import DataError
from demoplan.stages.score import ScoreParams, confusion, majority_activities, score_segmentation
from demoplan.tables import Activities

QUICK = ScoreParams(n_resamples=200)


def activities(*tracks):
    """Tracks as (episode, "A5 B3 C4"): letters are activities, numbers seconds."""
    rows = []
    for episode, text in tracks:
        start = 0
        for word in text.split():
            end = start + round(float(word[1:]) * 1e9)
            rows.append((episode, "hand", start, end, word[0], None, None))
            start = end
    schema = Activities.create_empty().schema
    return Activities.validate(pl.DataFrame(rows, schema=schema, orient="row"))


def values(scores, subject="all"):
    return {row["metric"]: row["value"] for row in scores.iter_rows(named=True) if row["subject"] == subject}


def scored(predicted, truth):
    return values(
        score_segmentation(activities(("e", predicted)), activities(("e", truth)), "m", params=QUICK)
    )


def test_the_truth_itself_scores_one_throughout():
    found = scored("A2 B3 A1", "A2 B3 A1")
    assert set(found.values()) == {1.0}


def test_accuracy_is_the_share_of_time_that_is_right():
    assert scored("A4 B6", "A5 B5")["frame accuracy"] == pytest.approx(0.9)


def test_splitting_one_segment_costs_segments_but_not_frames():
    found = scored("A4.9 B0.1 A5", "A10")
    assert found["frame accuracy"] == pytest.approx(0.99)
    assert found["edit score"] == pytest.approx(1 / 3)
    # A4.9 and A5 both overlap by about half: one is the match, the other and B are false.
    assert found["F1@10"] == pytest.approx(2 * 1 / (1 + 3))


def test_a_late_boundary_costs_frames_but_not_the_order():
    found = scored("A9 B1", "A5 B5")
    assert found["edit score"] == 1.0
    assert found["F1@10"] == 1.0
    assert found["F1@25"] == pytest.approx(0.5)
    assert found["frame accuracy"] == pytest.approx(0.6)


def test_neighbours_that_only_differ_in_object_are_one_segment():
    truth = activities(("e", "A5 B5"))
    predicted = activities(("e", "A2 A3 B5")).with_columns(
        acted_on=pl.when(pl.col("start_ns") == 0).then(pl.lit("cup"))
    )
    found = values(score_segmentation(Activities.validate(predicted), truth, "m", params=QUICK))
    assert found["edit score"] == 1.0


def test_macro_f1_is_the_mean_over_activities():
    found = scored("A8 B2", "A5 B5")
    f1_a, f1_b = 2 * 5 / 13, 2 * 2 / 7
    assert found["macro F1"] == pytest.approx((f1_a + f1_b) / 2)
    assert found["f1 A"] == pytest.approx(f1_a)


def test_only_time_with_a_label_counts():
    truth = activities(("e", "A5"))
    predicted = activities(("e", "A5 B500"))
    assert values(score_segmentation(predicted, truth, "m", params=QUICK))["frame accuracy"] == 1.0


def test_a_true_track_without_an_answer_is_an_error():
    with pytest.raises(DataError, match="e2/hand"):
        score_segmentation(activities(("e", "A5")), activities(("e", "A5"), ("e2", "A5")), "m")


def test_no_truth_gives_no_scores():
    nothing = Activities.create_empty()
    assert score_segmentation(nothing, nothing, "m").height == 0
    assert confusion(nothing, nothing, "m").height == 0
    assert majority_activities(nothing).height == 0


def test_intervals_hold_the_value_and_need_two_episodes():
    truth = activities(*((f"e{i}", "A5 B5") for i in range(8)))
    predicted = activities(*((f"e{i}", f"A{5 + i / 4} B{5 - i / 4}") for i in range(8)))
    rows = score_segmentation(predicted, truth, "m", groups={"e0": "ann"}, params=QUICK)
    whole = rows.filter((pl.col("subject") == "all") & (pl.col("metric") == "frame accuracy")).row(
        0, named=True
    )
    assert whole["low"] < whole["value"] < whole["high"]
    assert whole["n"] == 8
    assert rows.filter(pl.col("subject") == "e0")["detail"].to_list() == ["left out: ann"] * 6
    one = score_segmentation(activities(("e", "A5")), activities(("e", "A5")), "m", params=QUICK)
    assert one["low"].is_null().all()


def test_scoring_twice_gives_the_same_table():
    truth = activities(("a", "A5 B5"), ("b", "A2 B8"))
    predicted = activities(("a", "A6 B4"), ("b", "A1 B9"))
    one, two = (score_segmentation(predicted, truth, "m", params=QUICK) for _ in range(2))
    assert one.equals(two)


def test_confusion_says_what_was_taken_for_what_and_how_long():
    rows = confusion(activities(("e", "A8 B2")), activities(("e", "A5 B5")), "m")
    whole = rows.filter(pl.col("subject") == "all")
    assert [(r["truth"], r["predicted"], r["duration_ns"] / 1e9, r["share"]) for r in whole.to_dicts()] == [
        ("A", "A", 5.0, 1.0),
        ("B", "A", 3.0, 0.6),
        ("B", "B", 2.0, 0.4),
    ]


def test_the_majority_baseline_says_the_longest_activity_everywhere():
    truth = activities(("a", "A5 B1"), ("b", "B2 C3"))
    found = majority_activities(truth)
    assert found["activity"].to_list() == ["A", "A"]
    assert found["end_ns"].to_list() == [6_000_000_000, 5_000_000_000]


course = st.lists(st.tuples(st.sampled_from("ABCD"), st.integers(1, 5)), min_size=1, max_size=12)


def text_of(parts):
    return " ".join(f"{name}{length}" for name, length in parts)


def frames_of(parts, n):
    every = "".join(name * length for name, length in parts)
    return list((every + every[-1] * n)[:n])


@settings(max_examples=60, deadline=None)
@given(course, course)
def test_scores_equal_those_of_counted_frames(predicted, truth):
    n = sum(length for _, length in truth)
    shown = frames_of(predicted, n)
    padded = [(name, 1) for name in shown]
    found = scored(text_of(padded), text_of(truth))
    expected = frames_of(truth, n)
    assert found["frame accuracy"] == pytest.approx(accuracy_score(expected, shown))
    assert found["macro F1"] == pytest.approx(f1_score(expected, shown, average="macro"))


def collapsed(parts):
    names = [name for name, _ in parts]
    return [name for i, name in enumerate(names) if i == 0 or names[i - 1] != name]


def levenshtein(a, b):
    table = np.zeros((len(a) + 1, len(b) + 1), dtype=int)
    table[:, 0], table[0] = np.arange(len(a) + 1), np.arange(len(b) + 1)
    for i, x in enumerate(a, 1):
        for j, y in enumerate(b, 1):
            table[i, j] = min(table[i - 1, j] + 1, table[i, j - 1] + 1, table[i - 1, j - 1] + (x != y))
    return table[-1, -1]


@settings(max_examples=60, deadline=None)
@given(course, course)
def test_the_edit_score_is_that_of_the_textbook_distance(predicted, truth):
    length = sum(n for _, n in truth)
    shown = [(name, 1) for name in frames_of(predicted, length)]
    a, b = collapsed(truth), collapsed(shown)
    found = scored(text_of(shown), text_of(truth))
    assert found["edit score"] == pytest.approx(1 - levenshtein(a, b) / max(len(a), len(b)))


@settings(max_examples=60, deadline=None)
@given(course, course)
def test_scores_stay_between_zero_and_one_and_fall_with_the_overlap(predicted, truth):
    length = sum(n for _, n in truth)
    found = scored(text_of([(name, 1) for name in frames_of(predicted, length)]), text_of(truth))
    assert all(0.0 <= value <= 1.0 for value in found.values())
    assert found["F1@10"] >= found["F1@25"] >= found["F1@50"]
