"""Training: the same data give the same bytes, and what is left out is not seen."""

import json

import numpy as np
import polars as pl
import pytest

from demoplan.errors import DataError, UnknownNameError
from demoplan.stages.segment import (
    TrainParams,
    parse_segmenter,
    render_segmenter,
    segment,
    segment_held_out,
    train,
)
from demoplan.tables import Activities

QUICK = {"n_variations": 1, "min_leaf_s": 0.1, "n_trees": 5}
METHODS = [
    "decision_tree",
    "distilled_tree",
    "random_forest",
    "extra_trees",
    pytest.param("gradient_boosting", marks=pytest.mark.slow),
]


def fit(d, **changes):
    return train(d.frames, d.facts, d.truth, d.entities, d.types, params=TrainParams(**{**QUICK, **changes}))


@pytest.mark.parametrize("method", METHODS)
def test_training_twice_gives_the_same_bytes(method, three):
    assert render_segmenter(fit(three, method=method)) == render_segmenter(fit(three, method=method))


@pytest.mark.parametrize("method", METHODS)
def test_a_segmenter_read_from_its_text_says_the_same(method, three, demonstrate):
    segmenter = fit(three, method=method)
    again = parse_segmenter(render_segmenter(segmenter))
    assert render_segmenter(again) == render_segmenter(segmenter)
    assert again.segmenter_id == segmenter.segmenter_id
    d = demonstrate("new", seed=8)
    one = segment(d.frames, d.facts, d.entities, d.types, segmenter)
    assert one.equals(segment(d.frames, d.facts, d.entities, d.types, again))


def test_the_seed_matters_where_something_is_random(three):
    one, two = (fit(three, method="random_forest", seed=seed) for seed in (0, 1))
    assert render_segmenter(one) != render_segmenter(two)


def test_a_segmenter_knows_what_it_was_trained_on(three, demonstrate, together):
    segmenter = fit(three)
    assert segmenter.training_episodes == ("e0", "e1", "e2")
    assert len(segmenter.training_hash) == 64
    other = fit(together(three, demonstrate("e9", seed=9)))
    assert other.training_hash != segmenter.training_hash
    assert dict(segmenter.versions).keys() == {"demoplan", "numpy", "scikit-learn"}
    assert dict(segmenter.options)["n_variations"] == "1"


def test_the_training_hash_does_not_change_with_the_order_of_rows(three):
    shuffled = type(three)(**vars(three))
    shuffled.truth = Activities.cast(three.truth.sample(fraction=1.0, shuffle=True, seed=3))
    assert fit(shuffled).training_hash == fit(three).training_hash


def test_held_out_episodes_are_segmented_without_their_own_labels(three):
    nonsense = three.truth.with_columns(
        activity=pl.when(pl.col("episode_id") == "e1").then(pl.lit("Dance")).otherwise(pl.col("activity"))
    )
    groups = {name: name for name in ("e0", "e1", "e2")}
    found = segment_held_out(
        three.frames,
        three.facts,
        Activities.cast(nonsense),
        three.entities,
        three.types,
        groups=groups,
        params=TrainParams(**QUICK),
    )
    assert "Dance" not in found.filter(pl.col("episode_id") == "e1")["activity"].to_list()
    assert "Dance" in found.filter(pl.col("episode_id") == "e0")["activity"].to_list()
    assert set(found["episode_id"]) == {"e0", "e1", "e2"}


def test_leaving_out_needs_two_groups(three):
    groups = dict.fromkeys(("e0", "e1", "e2"), "ann")
    with pytest.raises(DataError, match="two"):
        segment_held_out(three.frames, three.facts, three.truth, three.entities, three.types, groups=groups)


def test_leaving_out_needs_a_group_of_every_episode(three):
    with pytest.raises(DataError, match="'e2'"):
        segment_held_out(
            three.frames, three.facts, three.truth, three.entities, three.types, groups={"e0": "a", "e1": "b"}
        )


def test_ticks_without_a_label_are_not_learned_from(three, demonstrate):
    part = type(three)(**vars(three))
    part.truth = Activities.cast(three.truth.filter(pl.col("activity") != "Put"))
    assert fit(part).activities == ("Idle", "Reach", "Release", "Take")


def test_training_without_labels_is_refused(three):
    bare = type(three)(**vars(three))
    bare.truth = Activities.create_empty()
    with pytest.raises(DataError, match="no labelled ticks"):
        fit(bare)


def test_training_on_one_activity_is_refused(three):
    bare = type(three)(**vars(three))
    bare.truth = Activities.cast(three.truth.filter(pl.col("hand") == "Left_hand"))
    with pytest.raises(DataError, match="'Idle'"):
        fit(bare)


def test_an_unknown_method_is_refused(three):
    with pytest.raises(UnknownNameError, match="extra_trees"):
        fit(three, method="crystal_ball")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda plain: plain.update(format="pickle"), "format is 'pickle'"),
        (lambda plain: plain.pop("trees"), "missing"),
        (lambda plain: plain.update(activities=["Idle", "Idle"]), "repeats"),
        (lambda plain: plain.update(activities="Idle"), "list of names"),
        (lambda plain: plain["grammar"].update(initial=[0.0]), "grammar.initial"),
        (lambda plain: plain["grammar"].update(leave_per_s=[0.0] * 5), "leave_per_s"),
        (lambda plain: plain["feature_params"].update(horizon_s=-1.0), "horizon_s"),
        (lambda plain: plain["feature_params"].update(wings=2), "feature_params"),
        (lambda plain: plain["trees"].update(root=[10**6]), "outside"),
    ],
)
def test_a_damaged_segmenter_is_refused_with_its_fault(three, change, says):
    plain = json.loads(render_segmenter(fit(three)))
    change(plain)
    with pytest.raises(DataError, match=says):
        parse_segmenter(json.dumps(plain))


@pytest.mark.parametrize("text", ["", "[]", "not json", '{"format": 1}'])
def test_what_is_not_a_segmenter_is_refused(text):
    with pytest.raises(DataError, match="segmenter"):
        parse_segmenter(text)


def test_probabilities_are_learned_for_every_labelled_activity(three):
    segmenter = fit(three)
    assert segmenter.activities == ("Idle", "Put", "Reach", "Release", "Take")
    leaves = segmenter.trees.leaf_value[segmenter.trees.feature < 0]
    np.testing.assert_allclose(leaves.sum(axis=1), 1.0)
