"""Trees fitted by scikit-learn, and taken out of it as arrays.

This is the only module that loads scikit-learn; whatever uses a trained segmenter does without.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import ExtraTreesClassifier, HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.tree import DecisionTreeClassifier, DecisionTreeRegressor

from demoplan.errors import UnknownNameError
from demoplan.geometry import Array
from demoplan.stages.segment.trees import Trees, from_plain

METHODS = ("decision_tree", "distilled_tree", "random_forest", "extra_trees", "gradient_boosting")


def fitted(
    values: NDArray[np.float32],
    target: NDArray[np.int64],
    weight: Array,
    *,
    method: str,
    n_least: int,
    max_leaves: int | None,
    n_trees: int,
    seed: int,
) -> Trees:
    """Trees fitted to examples.

    A distilled tree is one tree that is fitted to the answers of an ensemble, which are smoother than labels:
    it is as fast and as readable as any tree, and nearer to the ensemble in what it knows.

    Source: L. Breiman, N. Shang, "Born again trees", technical report, University of California, Berkeley,
    1996; C. Bucila, R. Caruana, A. Niculescu-Mizil, "Model compression", KDD 2006,
    doi:10.1145/1150402.1150464.

    Args:
        values: Features ``(n, f)``.
        target: Classes ``(n,)``, 0 to k − 1, each at least once.
        weight: Weights of the examples ``(n,)``.
        method: One of `METHODS`.
        n_least: Examples that every leaf of a single tree holds at least. Trees of a forest, which average
            their errors out, may have leaves of a quarter of that.
        max_leaves: Leaves that a tree has at most.
        n_trees: Trees of a forest; rounds of boosting.
        seed: Of whatever is random.

    Raises:
        UnknownNameError: If the method is not known.
    """
    forest = {
        "n_estimators": n_trees,
        "min_samples_leaf": max(1, n_least // 4),
        "max_leaf_nodes": max_leaves,
        "random_state": seed,
    }
    match method:
        case "decision_tree":
            tree = DecisionTreeClassifier(
                min_samples_leaf=n_least, max_leaf_nodes=max_leaves, random_state=seed
            )
            return trees_of([tree.fit(values, target, sample_weight=weight)], values.shape[1])
        case "distilled_tree":
            teacher = ExtraTreesClassifier(max_features=0.3, **forest)
            shares = teacher.fit(values, target, sample_weight=weight).predict_proba(values)
            pupil = DecisionTreeRegressor(
                min_samples_leaf=n_least, max_leaf_nodes=max_leaves, random_state=seed
            )
            return trees_of([pupil.fit(values, shares, sample_weight=weight)], values.shape[1])
        case "random_forest":
            model = RandomForestClassifier(max_features=0.2, **forest)
            return trees_of(model.fit(values, target, sample_weight=weight).estimators_, values.shape[1])
        case "extra_trees":
            model = ExtraTreesClassifier(max_features=0.3, **forest)
            return trees_of(model.fit(values, target, sample_weight=weight).estimators_, values.shape[1])
        case "gradient_boosting":
            boosting = HistGradientBoostingClassifier(
                max_iter=n_trees,
                max_leaf_nodes=max_leaves or 15,
                min_samples_leaf=n_least,
                early_stopping=False,
                random_state=seed,
            )
            return boosted_trees_of(boosting.fit(values, target, sample_weight=weight), values.shape[1])
        case _:
            raise UnknownNameError("segmenter method", method, METHODS)


def trees_of(models: Sequence[DecisionTreeClassifier | DecisionTreeRegressor], n_features: int) -> Trees:
    """The trees of fitted scikit-learn models, as arrays; a regressor has one output per class."""
    parts = []
    for model in models:
        tree = model.tree_
        is_leaf = tree.children_left < 0
        parts.append(
            (
                np.where(is_leaf, -1, tree.feature),
                tree.threshold,
                tree.children_left,
                tree.children_right,
                # One output with a share per class, or one output per class.
                tree.value[:, 0] if tree.value.shape[1] == 1 else tree.value[:, :, 0],
            )
        )
    n_classes = parts[0][4].shape[1]
    return _joined("mean", parts, np.zeros(n_classes), n_features)


def boosted_trees_of(model: HistGradientBoostingClassifier, n_features: int) -> Trees:
    """The trees of a fitted scikit-learn gradient boosting classifier, as arrays."""
    n_classes = len(model.classes_)
    per_round = 1 if n_classes == 2 else n_classes
    parts = []
    for predictors in model._predictors:
        for column, predictor in enumerate(predictors):
            nodes = predictor.nodes
            is_leaf = nodes["is_leaf"].astype(bool)
            value = np.zeros((len(nodes), n_classes))
            value[:, column if per_round > 1 else 1] = nodes["value"]
            parts.append(
                (
                    np.where(is_leaf, -1, nodes["feature_idx"].astype(np.int64)),
                    nodes["num_threshold"],
                    nodes["left"].astype(np.int64),
                    nodes["right"].astype(np.int64),
                    value,
                )
            )
    baseline = np.zeros(n_classes)
    baseline[-per_round:] = np.ravel(model._baseline_prediction)
    return _joined("softmax", parts, baseline, n_features)


def _joined(link: str, parts: list[tuple[Any, ...]], baseline: Array, n_features: int) -> Trees:
    """Trees in one set of arrays; thresholds of boosting that are infinite become the largest number."""
    sizes = [len(part[0]) for part in parts]
    offsets = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    feature = np.concatenate([part[0] for part in parts])
    is_leaf = feature < 0
    threshold = np.concatenate([part[1] for part in parts]).astype(np.float64)
    value = np.concatenate([part[4] for part in parts])
    plain = {
        "link": link,
        "root": offsets,
        "feature": feature,
        "threshold": np.where(is_leaf, 0.0, np.nan_to_num(threshold)),
        "left": np.concatenate([part[2] + offset for part, offset in zip(parts, offsets, strict=True)]),
        "right": np.concatenate([part[3] + offset for part, offset in zip(parts, offsets, strict=True)]),
        "leaf_value": value[is_leaf],
        "baseline": baseline,
    }
    return from_plain(plain, n_features, value.shape[1])
