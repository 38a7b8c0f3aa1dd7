"""Trees as data: the same probabilities as scikit-learn's, and no file that can do harm."""

import json

import numpy as np
import pytest
from sklearn.ensemble import ExtraTreesClassifier, HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.tree import DecisionTreeClassifier, DecisionTreeRegressor

from demoplan.errors import DataError
from demoplan.stages.segment.fitting import boosted_trees_of, fitted, trees_of
from demoplan.stages.segment.trees import from_plain, over_columns, probabilities, to_plain


@pytest.fixture(scope="module")
def examples():
    rng = np.random.default_rng(3)
    values = rng.standard_normal((1500, 6)).astype(np.float32)
    values[:, 3] = np.round(values[:, 3])  # ties at thresholds
    target = (values[:, 0] > 0).astype(int) + 2 * (values[:, 1] + values[:, 2] > 0.3).astype(int)
    return values, target


@pytest.mark.parametrize(
    "model",
    [
        DecisionTreeClassifier(random_state=0),
        DecisionTreeClassifier(max_leaf_nodes=9, random_state=0),
        RandomForestClassifier(n_estimators=12, random_state=0),
        ExtraTreesClassifier(n_estimators=12, min_samples_leaf=5, random_state=0),
    ],
    ids=lambda model: type(model).__name__,
)
def test_walking_the_arrays_gives_the_probabilities_of_scikit_learn(model, examples):
    values, target = examples
    model.fit(values, target)
    trees = trees_of(getattr(model, "estimators_", [model]), values.shape[1])
    fresh = np.random.default_rng(9).standard_normal((5000, 6)).astype(np.float32)
    np.testing.assert_allclose(probabilities(trees, fresh), model.predict_proba(fresh), atol=1e-12)


def test_a_tree_of_regressions_gives_the_shares_of_scikit_learn(examples):
    values, target = examples
    shares = np.eye(4)[target] * 0.8 + 0.05
    model = DecisionTreeRegressor(min_samples_leaf=9, random_state=0).fit(values, shares)
    fresh = np.random.default_rng(9).standard_normal((3000, 6)).astype(np.float32)
    found = probabilities(trees_of([model], values.shape[1]), fresh)
    np.testing.assert_allclose(found, model.predict(fresh), atol=1e-12)
    np.testing.assert_allclose(found.sum(axis=1), 1.0)


@pytest.mark.parametrize("n_classes", [2, 4])
def test_boosted_trees_give_the_probabilities_of_scikit_learn(n_classes, examples):
    values, target = examples
    model = HistGradientBoostingClassifier(max_iter=8, early_stopping=False, random_state=0)
    model.fit(values, target % n_classes)
    trees = boosted_trees_of(model, values.shape[1])
    fresh = np.random.default_rng(9).standard_normal((2000, 6)).astype(np.float32)
    np.testing.assert_allclose(probabilities(trees, fresh), model.predict_proba(fresh), atol=1e-12)


def test_trees_come_back_exactly_from_their_text(examples):
    values, target = examples
    model = RandomForestClassifier(n_estimators=5, random_state=0).fit(values, target)
    trees = trees_of(model.estimators_, values.shape[1])
    again = from_plain(json.loads(json.dumps(to_plain(trees))), 6, 4)
    np.testing.assert_array_equal(probabilities(again, values), probabilities(trees, values))
    assert to_plain(again) == to_plain(trees)


def test_a_tree_that_is_one_leaf_answers_with_its_share():
    trees = from_plain(
        {
            "link": "mean",
            "root": [0],
            "feature": [-1],
            "threshold": [0.0],
            "left": [0],
            "right": [0],
            "leaf_value": [[0.25, 0.75]],
            "baseline": [0.0, 0.0],
        },
        3,
        2,
    )
    assert probabilities(trees, np.zeros((2, 3), dtype=np.float32)).tolist() == [[0.25, 0.75]] * 2


STUMP = {
    "link": "mean",
    "root": [0],
    "feature": [0, -1, -1],
    "threshold": [0.5, 0.0, 0.0],
    "left": [1, 1, 2],
    "right": [2, 1, 2],
    "leaf_value": [[1.0, 0.0], [0.0, 1.0]],
    "baseline": [0.0, 0.0],
}


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"left": [0, 1, 2]}, "points backwards"),
        ({"right": [7, 1, 2]}, "outside of the arrays"),
        ({"feature": [9, -1, -1]}, "feature that is not there"),
        ({"root": [5]}, "outside"),
        ({"root": []}, "outside"),
        ({"threshold": [float("nan"), 0.0, 0.0]}, "finite"),
        ({"leaf_value": [[1.0, 0.0]]}, "leaf_value has shape"),
        ({"threshold": [0.5]}, "one length"),
        ({"threshold": ["x", 0, 0]}, "not made of numbers"),
        ({"link": "exec"}, "link 'exec'"),
    ],
)
def test_a_damaged_tree_is_refused_with_its_fault(change, says):
    with pytest.raises(DataError, match=says):
        from_plain({**STUMP, **change}, 2, 2)


def test_an_unknown_method_is_refused_with_the_known_ones(examples):
    values, target = examples
    with pytest.raises(Exception, match="decision_tree"):
        fitted(
            values,
            target,
            np.ones(len(target)),
            method="oracle",
            n_least=5,
            max_leaves=None,
            n_trees=3,
            seed=0,
        )


def test_trees_over_the_columns_that_they_ask_about_say_the_same():
    plain = {
        "link": "mean",
        "root": [0],
        "feature": [4, -1, 1, -1, -1],
        "threshold": [0.5, 0.0, 0.25, 0.0, 0.0],
        "left": [1, 1, 3, 3, 4],
        "right": [2, 1, 4, 3, 4],
        "leaf_value": [[1.0, 0.0], [0.25, 0.75], [0.0, 1.0]],
        "baseline": [0.0, 0.0],
    }
    trees = from_plain(plain, 6, 2)
    values = np.random.default_rng(0).random((50, 6), dtype=np.float32)
    expected = probabilities(trees, values)
    assert len(np.unique(expected[:, 0])) == 3
    for columns in ([1, 4], [4, 1], [0, 1, 4]):
        np.testing.assert_array_equal(
            probabilities(over_columns(trees, columns), values[:, columns]), expected
        )
