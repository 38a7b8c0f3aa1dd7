"""What is told of each feature: extremes, mean, deviation and quantiles, per episode and for all.

Source: lerobot 0.6, ``datasets/compute_stats.py``: the names of the figures, and how episodes are joined.
Quantiles of the whole are means of the episodes' quantiles, weighted by frames, as LeRobot joins them.
"""

from collections.abc import Iterable, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Figures: TypeAlias = dict[str, NDArray[np.float64]]
"""Figure → ``(d,)`` values; ``count`` is ``(1,)``."""

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}


def figures_of(values: NDArray[np.generic]) -> Figures:
    """Figures of a feature over an episode.

    Args:
        values: ``(n,)`` or ``(n, d)``.
    """
    table = values.reshape(len(values), -1).astype(np.float64)
    quantiles = np.quantile(table, list(QUANTILES.values()), axis=0)
    return {
        "min": table.min(axis=0),
        "max": table.max(axis=0),
        "mean": table.mean(axis=0),
        "std": table.std(axis=0),
        "count": np.array([float(len(table))]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def joined(episodes: Iterable[Mapping[str, Figures]]) -> dict[str, Figures]:
    """Figures over all episodes; means and deviations are exact."""
    totals: dict[str, Figures] = {}
    for episode in episodes:
        for feature, figures in episode.items():
            totals[feature] = _pair(totals[feature], figures) if feature in totals else dict(figures)
    return totals


def _pair(one: Figures, other: Figures) -> Figures:
    """Two disjoint sets of frames as one.

    Source: Chan, Golub, LeVeque, *Algorithms for computing the sample variance*, The American Statistician
    37 (1983), doi:10.1080/00031305.1983.10483115, equation 2.1.
    """
    n, m = float(one["count"][0]), float(other["count"][0])
    share = m / (n + m)
    step = other["mean"] - one["mean"]
    variance = (one["std"] ** 2 * n + other["std"] ** 2 * m) / (n + m) + step**2 * share * (1 - share)
    return {
        "min": np.minimum(one["min"], other["min"]),
        "max": np.maximum(one["max"], other["max"]),
        "mean": one["mean"] + step * share,
        "std": np.sqrt(variance),
        "count": np.array([n + m]),
        **{name: one[name] * (1 - share) + other[name] * share for name in QUANTILES},
    }
