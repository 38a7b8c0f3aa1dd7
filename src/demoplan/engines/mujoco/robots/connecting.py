"""Paths through configuration space, for where no straight way of the hand exists: RRT-Connect, shortened.

Sources: J. Kuffner, S. LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA
2000, doi:10.1109/ROBOT.2000.844730. R. Geraerts, M. Overmars, "Creating high-quality paths for motion
planning", IJRR 26(8), 2007, doi:10.1177/0278364907079280 (random shortcuts).

OMPL has both, but seeds its random numbers once per process: two sessions of one process would change each
other's paths, and equal seeds would not give equal executions.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from demoplan.geometry import Array

CountFree: TypeAlias = Callable[[Array], int]
"""How many of the first configurations ``(n, d)`` are free, one after the other."""


@dataclass(frozen=True, kw_only=True)
class ConnectParams:
    """How long, and how finely, to look for a path."""

    n_samples: int = 600
    """Samples drawn before it is given up."""
    longest_edge: float = 8.0
    """Longest growth towards a sample, in spacings."""
    near_share: float = 0.6
    """Share of samples from about start and goals; the others come from everywhere."""
    near_margin: float = 10.0
    """How far about start and goals is near, in spacings."""
    n_shortcuts: int = 60


@dataclass(frozen=True)
class Space:
    """Configurations: their bounds ``(d,)``, and how far apart two may be that are checked in turn."""

    low: Array
    high: Array
    spacing: Array

    def between(self, start: Array, end: Array) -> Array:
        """Configurations on the straight line to ``end``, which is the last; ``start`` is left out."""
        n = max(1, int(np.ceil(np.abs((end - start) / self.spacing).max())))
        return np.asarray(start + (end - start) * (np.arange(1, n + 1) / n)[:, None])

    def distance(self, one: Array, others: Array) -> Array:
        """In spacings, ``(n,)``."""
        return np.asarray(np.linalg.norm((others - one) / self.spacing, axis=-1))

    def dense(self, corners: Array) -> Array:
        """All configurations along corners ``(m, d)``, the first included."""
        parts = [corners[:1], *(self.between(one, other) for one, other in pairwise(corners))]
        return np.concatenate(parts)


class _Tree:
    """Configurations that can be reached from roots, and from which each was."""

    def __init__(self, roots: Sequence[Array]) -> None:
        self.nodes = [np.asarray(root, dtype=float) for root in roots]
        self.parents = [-1] * len(roots)

    def grow(self, space: Space, target: Array, count_free: CountFree, longest: float) -> tuple[int, bool]:
        """Grow from the nearest node towards a target; the node that was added, or -1, and if it is there."""
        gaps = space.distance(target, np.array(self.nodes))
        nearest = int(np.argmin(gaps))
        line = space.between(self.nodes[nearest], target)
        n_wanted = len(line) if gaps[nearest] <= longest else max(1, int(len(line) * longest / gaps[nearest]))
        n_free = count_free(line[:n_wanted])
        if n_free == 0:
            return -1, False
        self.nodes.append(line[n_free - 1])
        self.parents.append(nearest)
        return len(self.nodes) - 1, n_free == len(line)

    def back(self, node: int) -> list[Array]:
        """From a node to its root."""
        way = []
        while node >= 0:
            way.append(self.nodes[node])
            node = self.parents[node]
        return way


def connect(
    start: Array,
    goals: Sequence[Array],
    space: Space,
    count_free: CountFree,
    rng: np.random.Generator,
    params: ConnectParams = ConnectParams(),
) -> Array | None:
    """Corners ``(m, d)`` of a free path from a configuration to one of several; None if none was found.

    Args:
        start: Where it begins; free.
        goals: Where it may end; each of them free.
        space: Bounds and spacing.
        count_free: Tells how far a line is free.
        rng: Source of samples.
        params: How long to look.
    """
    if not goals:
        return None
    trees = (_Tree([start]), _Tree(goals))
    about = np.array([start, *goals])
    margin = params.near_margin * space.spacing
    near = (
        np.maximum(about.min(axis=0) - margin, space.low),
        np.minimum(about.max(axis=0) + margin, space.high),
    )
    for number in range(-len(goals), params.n_samples):
        grown, other = trees[number % 2], trees[1 - number % 2]
        if number < 0:
            # A straight line to a goal is the best path that there can be.
            grown, other = trees
            sample, longest = goals[number + len(goals)], np.inf
        else:
            low, high = near if rng.random() < params.near_share else (space.low, space.high)
            sample, longest = rng.uniform(low, high), params.longest_edge
        node, is_there = grown.grow(space, sample, count_free, longest)
        if node < 0:
            continue
        if number < 0 and is_there:
            return np.array(grown.back(node)[::-1])
        met, is_there = other.grow(space, grown.nodes[node], count_free, np.inf)
        if met >= 0 and is_there:
            first, last = (node, met) if grown is trees[0] else (met, node)
            return np.array(trees[0].back(first)[::-1] + trees[1].back(last)[1:])
    return None


def shortened(
    corners: Array, space: Space, count_free: CountFree, rng: np.random.Generator, n_shortcuts: int
) -> Array:
    """A free path with the same ends that is no longer: random pieces of it replaced by straight lines."""
    path = corners
    for _ in range(n_shortcuts):
        if len(path) < 3:
            break
        lengths = np.concatenate([[0.0], np.cumsum(space.distance(path[:-1], path[1:]))])
        begin, end = np.sort(rng.uniform(0.0, lengths[-1], 2))
        one, other = (
            np.array([np.interp(at, lengths, path[:, k]) for k in range(path.shape[1])])
            for at in (begin, end)
        )
        line = space.between(one, other)
        if count_free(line) == len(line):
            before, after = path[lengths < begin], path[lengths > end]
            path = np.concatenate([before, [one, other], after])
    return path
