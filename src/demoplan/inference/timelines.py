"""What was observed of ground atoms over time, and which literals could have changed them when."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from demoplan.inference.roles import Floats, Ints


@dataclass(frozen=True, eq=False)
class Timelines:
    """Courses of ground atoms, cut into segments by touches: moments at which some literal could change them.

    A timeline with k touches has k + 1 segments, within each of which the atom is constant. Timelines are
    sorted by their number of touches, most first; touches by rank (the first ones of all timelines, then all
    second ones …), within a rank by timeline. So touch k of timeline t is the t-th of its rank, and one step
    along all timelines at once is arithmetic on neighbouring stretches of memory.

    Entries say which literals meet in a touch; they are sorted by literal.
    """

    n_by_rank: tuple[int, ...]
    """Touches of each rank; the first number is the number of timelines."""
    timeline_predicate: Ints
    """``(n_timelines,)``: observations of one predicate are wrong equally often."""
    before_true: Floats
    """``(n_timelines,)``: how often the atom was seen true before its first touch."""
    before_false: Floats
    after_true: Floats
    """``(n_touches,)``: how often it was seen true after the touch, and before the next one."""
    after_false: Floats
    entry_literal: Ints
    """``(n_entries,)``, not decreasing."""
    entry_touch: Ints
    n_alike: Floats | None = None
    """``(n_timelines,)``: how many timelines of these observations there are; one each if not given."""

    @cached_property
    def bounds(self) -> Ints:
        """Where each rank's touches begin, and the number of touches at the end."""
        return np.asarray(np.r_[0, np.cumsum(self.n_by_rank)], dtype=np.int64)

    @cached_property
    def touch_timeline(self) -> Ints:
        """``(n_touches,)``: timeline of each touch."""
        counts = np.array(self.n_by_rank, dtype=np.int64)
        return np.asarray(np.arange(counts.sum()) - np.repeat(self.bounds[:-1], counts))

    @cached_property
    def touch_before(self) -> Ints:
        """``(n_touches,)``: the touch before each on its timeline; negative for the first ones."""
        counts = np.array(self.n_by_rank, dtype=np.int64)
        return np.asarray(np.arange(counts.sum()) - np.repeat(np.r_[counts[:1], counts[:-1]], counts))

    @cached_property
    def is_last(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """``(n_touches,)``: whether no touch of its timeline follows."""
        following = np.r_[np.array(self.n_by_rank[1:], dtype=np.int64), 0]
        return np.asarray(self.touch_timeline >= np.repeat(following, self.n_by_rank))

    @cached_property
    def touch_predicate(self) -> Ints:
        """``(n_touches,)``: predicate of each touch's atom."""
        return np.asarray(self.timeline_predicate[self.touch_timeline])
