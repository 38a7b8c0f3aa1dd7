"""Timelines written down by hand."""

import numpy as np
import pytest

from demoplan.inference import Timelines


@pytest.fixture(scope="session")
def timelines_of():
    """Makes timelines with so many touches each (not increasing) and (true, false) counts of their segments.

    Every touch has one entry, of literal 0. Counts of the segments before first touches stand first, then those
    after touches, timeline by timeline.
    """

    def make(sizes, counts):
        sizes = np.array(sizes)
        n_by_rank = [int((sizes > rank).sum()) for rank in range(int(sizes.max()))]
        order = [(int(sizes[:line].sum()) + rank) for rank, n in enumerate(n_by_rank) for line in range(n)]
        before, after = (
            np.array(counts[: len(sizes)], dtype=float),
            np.array(counts[len(sizes) :], dtype=float),
        )
        return Timelines(
            n_by_rank=tuple(n_by_rank),
            timeline_predicate=np.zeros(len(sizes), dtype=np.int64),
            before_true=before[:, 0],
            before_false=before[:, 1],
            after_true=after[order, 0],
            after_false=after[order, 1],
            entry_literal=np.zeros(len(order), dtype=np.int64),
            entry_touch=np.arange(len(order)),
        )

    return make
