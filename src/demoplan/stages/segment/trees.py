"""Decision trees as data: arrays that anybody can read, and their evaluation without scikit-learn.

A trained model is stored as numbers, never as a pickle: it can be opened anywhere, compared byte for byte,
and cannot run code. Nodes of all trees stand in one set of arrays; a child's index is always greater than
its parent's, so that evaluation ends whatever a file says.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from demoplan.errors import DataError
from demoplan.geometry import Array

Link = Literal["mean", "softmax"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trees:
    """One tree or many over the same features and classes."""

    link: Link
    """How trees combine: the mean of leaf probabilities, or the softmax of summed scores (boosting)."""
    root: NDArray[np.int32]
    """Root of each tree ``(trees,)``."""
    feature: NDArray[np.int32]
    """Feature that a node asks about ``(nodes,)``; −1 at a leaf."""
    threshold: Array
    """Go left where the feature is at most this ``(nodes,)``."""
    left: NDArray[np.int32]
    """Index of the left child ``(nodes,)``; a leaf's own index at a leaf."""
    right: NDArray[np.int32]
    leaf_value: Array
    """Probabilities (or scores) of each class ``(nodes, classes)``; zero at inner nodes."""
    baseline: Array
    """Added to the summed scores ``(classes,)``; zero for ``mean``."""
    depth: int
    """Length of the longest path from a root to a leaf."""

    @property
    def n_leaves(self) -> int:
        """Leaves of all trees together."""
        return int((self.feature < 0).sum())


_CHUNK_ROWS = 4096
"""Rows are walked in chunks so that the walk's indices stay in the processor's cache."""


def probabilities(trees: Trees, values: NDArray[np.float32]) -> Array:
    """Probability of each class ``(n, classes)`` for feature rows ``(n, features)`` in single precision.

    All rows walk down all trees at once, one level per step: no loop over rows.

    Source: L. Breiman, "Random forests", Machine Learning 45 (2001), doi:10.1023/A:1010933404324, for the
    mean of leaves; J. H. Friedman, "Greedy function approximation: a gradient boosting machine", Annals of
    Statistics 29 (2001), doi:10.1214/aos/1013203451, section 4.6, for the softmax of sums.
    """
    summed = np.empty((len(values), trees.leaf_value.shape[1]))
    for start in range(0, len(values), _CHUNK_ROWS):
        rows = values[start : start + _CHUNK_ROWS]
        total = np.tile(trees.baseline, (len(rows), 1))
        for root in trees.root:
            total += trees.leaf_value[_leaves(trees, rows, int(root))]
        summed[start : start + len(rows)] = total
    if trees.link == "mean":
        mean: Array = summed / len(trees.root)
        return mean
    shifted = np.exp(summed - summed.max(axis=1, keepdims=True))
    softmax: Array = shifted / shifted.sum(axis=1, keepdims=True)
    return softmax


def _leaves(trees: Trees, rows: NDArray[np.float32], root: int) -> NDArray[np.int32]:
    """Leaf that each row ends in; rows that have arrived drop out of the walk."""
    node = np.full(len(rows), root, dtype=np.int32)
    walking = np.arange(len(rows)) if trees.feature[root] >= 0 else np.arange(0)
    while len(walking):
        here = node[walking]
        goes_left = rows[walking, trees.feature[here]] <= trees.threshold[here]
        there = np.where(goes_left, trees.left[here], trees.right[here])
        node[walking] = there
        walking = walking[trees.feature[there] >= 0]
    return node


def over_columns(trees: Trees, columns: Sequence[int]) -> Trees:
    """The same trees over rows that have only these features, which must be all that they ask about."""
    place = np.full(int(trees.feature.max(initial=-1)) + 2, -1, dtype=np.int32)
    kept = np.asarray(columns, dtype=np.int64)
    kept = kept[kept < len(place) - 1]
    place[kept] = np.arange(len(kept), dtype=np.int32)
    # A leaf asks for −1: the last entry, which stays −1.
    return replace(trees, feature=place[trees.feature])


def to_plain(trees: Trees) -> dict[str, Any]:
    """The trees as lists and numbers, for JSON; floats survive exactly."""
    is_leaf = trees.feature < 0
    return {
        "link": trees.link,
        "root": trees.root.tolist(),
        "feature": trees.feature.tolist(),
        "threshold": np.where(is_leaf, 0.0, trees.threshold).tolist(),
        "left": trees.left.tolist(),
        "right": trees.right.tolist(),
        "leaf_value": trees.leaf_value[is_leaf].tolist(),
        "baseline": trees.baseline.tolist(),
    }


def from_plain(plain: Mapping[str, Any], n_features: int, n_classes: int) -> Trees:
    """Trees from lists and numbers, checked so that no file can make evaluation fail or never end.

    Raises:
        DataError: If arrays are missing, differ in length, or point outside of themselves.
    """
    try:
        link = plain["link"]
        root = np.asarray(plain["root"], dtype=np.int32)
        feature = np.asarray(plain["feature"], dtype=np.int32)
        threshold = np.asarray(plain["threshold"], dtype=np.float64)
        left = np.asarray(plain["left"], dtype=np.int32)
        right = np.asarray(plain["right"], dtype=np.int32)
        values = np.asarray(plain["leaf_value"], dtype=np.float64)
        baseline = np.asarray(plain["baseline"], dtype=np.float64)
    except (KeyError, ValueError, TypeError, OverflowError) as error:
        raise DataError(f"trees: an array is missing or not made of numbers: {error}") from None
    if link not in ("mean", "softmax"):
        raise DataError(f"trees: link {link!r}; available: mean, softmax")
    n = len(feature)
    index = np.arange(n)
    if feature.ndim != 1 or not (feature.shape == threshold.shape == left.shape == right.shape) or n == 0:
        raise DataError("trees: feature, threshold, left and right must be lists of one length, at least 1")
    is_leaf = feature < 0
    if values.shape != (int(is_leaf.sum()), n_classes) or baseline.shape != (n_classes,):
        raise DataError(
            f"trees: leaf_value has shape {values.shape}, baseline {baseline.shape}; "
            f"expected {(int(is_leaf.sum()), n_classes)} and {(n_classes,)}"
        )
    if not (np.isfinite(values).all() and np.isfinite(baseline).all() and np.isfinite(threshold).all()):
        raise DataError("trees: thresholds, leaf values and baselines must be finite")
    inner = ~is_leaf
    is_sound = (
        (feature[inner] < n_features).all()
        and (left[inner] > index[inner]).all()
        and (right[inner] > index[inner]).all()
        and (left < n).all()
        and (right < n).all()
        and root.ndim == 1
        and len(root) > 0
        and (root >= 0).all()
        and (root < n).all()
    )
    if not is_sound:
        raise DataError(
            "trees: a node points backwards, outside of the arrays, or at a feature that is not there"
        )
    leaf_value = np.zeros((n, n_classes))
    leaf_value[is_leaf] = values
    return Trees(
        link=link,
        root=root,
        feature=np.where(is_leaf, -1, feature).astype(np.int32),
        threshold=threshold,
        left=np.where(is_leaf, index, left).astype(np.int32),
        right=np.where(is_leaf, index, right).astype(np.int32),
        leaf_value=leaf_value,
        baseline=baseline,
        depth=_depth(feature, left, right, root),
    )


def _depth(
    feature: NDArray[np.int32], left: NDArray[np.int32], right: NDArray[np.int32], root: NDArray[np.int32]
) -> int:
    level = root
    depth = 0
    while True:
        level = level[feature[level] >= 0]
        if not len(level):
            return depth
        level = np.unique(np.concatenate((left[level], right[level])))
        depth += 1
