"""Readings that are likelier wrong than not, put right: the first step of learning from logs.

A predicate that is misread at the end of one segment makes an operator of its own, unless it is seen for what
it is. Here the course of every atom over a hand's activities, the rates of misreading, and groups of atoms of
which only one can hold are inferred together from all the data (``courses``, ``misreadings``,
``exclusion``), and states are set to what is then likelier. Where readings are as good as sure, they are left
as they are, gaps and all.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.courses import Courses, Floats, Tracks, read_courses
from demoplan.stages.learn.encode import NOBODY, Encoded, Ints, States
from demoplan.stages.learn.exclusion import Exclusion, find_exclusions, smooth_exclusively
from demoplan.stages.learn.misreadings import MendParams, Rates, Smoothed, estimate, smooth_readings


@dataclass(frozen=True)
class Mended:
    """Transitions with likelier states, and what was inferred on the way; arrays by predicate."""

    data: Encoded
    rates: Rates
    is_needed: bool
    """Whether readings are wrong so often that states were changed at all."""
    n_read: Floats
    """Readings of each predicate: one for each course and end of a step."""
    n_to_true: Floats
    """Readings of false that are taken to be wrong."""
    n_to_false: Floats
    exclusions: tuple[Exclusion, ...]


def mend(data: Encoded, types: TypeHierarchy, params: MendParams = MendParams()) -> Mended:
    """States as they likely were.

    Args:
        data: Transitions of logs.
        types: The hierarchy that objects' types belong to.
        params: Priors and limits.
    """
    n_predicates = len(data.predicates)
    tracks = Tracks.of(data)
    nothing = np.zeros(n_predicates)
    sample = _sample(data, tracks, types, params)
    courses = read_courses(data, tracks, sample, types, is_complete=True)
    if not courses.n:
        empty = Rates(nothing, nothing, nothing, np.empty(0, np.int64), np.zeros(1), np.zeros(1))
        return Mended(data, empty, False, nothing, nothing, nothing, ())
    rates = estimate(courses, n_predicates, params)
    believed = smooth_readings(courses, rates)
    for _ in range(2 if rates.overall >= params.needed_rate else 1):
        # What the clearest groups put right shows the others.
        exclusions = find_exclusions(data, tracks, sample, courses, believed, params)
        believed = smooth_exclusively(data, tracks, sample, courses, rates, exclusions, params)
    result = Mended(data, rates, rates.overall >= params.needed_rate, nothing, nothing, nothing, exclusions)
    if not result.is_needed:
        return result
    changes = _Changes(n_predicates, float(np.log(params.sure / (1 - params.sure))))
    for chosen in tracks.chunks(params.steps_per_chunk, courses.n / max(len(sample), 1)):
        own = read_courses(data, tracks, chosen, types, is_complete=False)
        believed = smooth_exclusively(data, tracks, chosen, own, rates, exclusions, params)
        changes.add(own, believed, tracks, chosen)
    return replace(
        result,
        data=replace(
            data,
            true=changes.states(data, tracks),
            unknown=_joined(data.unknown, changes.doubts(data, tracks)),
        ),
        n_read=changes.n_read,
        n_to_true=changes.n_to_true,
        n_to_false=changes.n_to_false,
    )


def _sample(data: Encoded, tracks: Tracks, types: TypeHierarchy, params: MendParams) -> Ints:
    """Tracks to estimate from: all, or as many as the limit allows, evenly spaced."""
    if not tracks.n:
        return np.empty(0, dtype=np.int64)
    _, kinds = data.objects_of(int(data.episode[tracks.first[0]]))
    n_courses = 1
    for signature in data.predicates:
        n_courses += int(
            np.prod(
                [
                    sum(types.is_subtype(data.types[kind], wanted) for kind in kinds)
                    for wanted in signature.argument_types
                ]
            )
        )
    longest = int(np.quantile(tracks.length, 0.99)) + 1
    wanted = max(2, params.max_sample_steps // max(longest * n_courses, 1))
    fitting = np.flatnonzero(tracks.length <= longest)
    step = max(1, -(-len(fitting) // wanted))
    return np.asarray(fitting[::step])


class _Changes:
    """Collects mended courses; then makes states of them."""

    def __init__(self, n_predicates: int, sure_log_odds: float) -> None:
        self._sure_log_odds = sure_log_odds
        self.n_read, self.n_to_true, self.n_to_false = (np.zeros(n_predicates) for _ in range(3))
        self._held: list[tuple[Ints, Ints, Ints]] = []
        self._doubted: list[tuple[Ints, Ints, Ints]] = []

    def add(self, courses: Courses, believed: Smoothed, tracks: Tracks, chosen: Ints) -> None:
        length = tracks.length[chosen][courses.track]
        is_read = (courses.n_true + courses.n_false) > 0
        is_true = (believed.log_odds > 0) & is_read
        was_true = courses.n_true > courses.n_false
        n = len(self.n_read)

        def counted(cells: NDArray[np.bool_]) -> Floats:
            return np.asarray(np.bincount(courses.predicate, cells.sum(axis=1), n), dtype=np.float64)

        self.n_read += counted(is_read)
        self.n_to_true += counted(is_true & ~was_true & is_read)
        self.n_to_false += counted(~is_true & was_true & is_read)
        within = np.arange(is_true.shape[1]) <= length[:, None]
        self._held.append(_cells(courses, chosen, is_true & within))
        is_doubted = (np.abs(believed.log_odds) < self._sure_log_odds) & is_read & within
        self._doubted.append(_cells(courses, chosen, is_doubted))

    def states(self, data: Encoded, tracks: Tracks) -> States:
        """The atoms that are likelier true than not."""
        return _as_states(self._held, data, tracks)

    def doubts(self, data: Encoded, tracks: Tracks) -> States:
        """The atoms of which neither is sure."""
        return _as_states(self._doubted, data, tracks)


def _cells(courses: Courses, chosen: Ints, is_chosen: NDArray[np.bool_]) -> tuple[Ints, Ints, Ints]:
    """Track, time and atom of the chosen cells of courses."""
    course, time = np.nonzero(is_chosen)
    has_atom = courses.atom[course] != NOBODY
    course, time = course[has_atom], time[has_atom]
    return chosen[courses.track[course]], time.astype(np.int64), courses.atom[course]


def _as_states(cells: list[tuple[Ints, Ints, Ints]], data: Encoded, tracks: Tracks) -> States:
    """Every time's atoms, given to the state that ends a row and to the one that begins the next."""
    track, time, atom = (np.concatenate([each[place] for each in cells]) for place in range(3))
    row = tracks.first[track] + time
    after = np.flatnonzero(time > 0)
    before = np.flatnonzero(time < tracks.length[track])
    return _states(np.r_[2 * (row[after] - 1) + 1, 2 * row[before]], np.r_[atom[after], atom[before]], data.n)


def _joined(one: States, other: States) -> States:
    n = len(one.offsets) - 1
    every = np.arange(n)
    first, second = one.gather(every), other.gather(every)
    return _states(np.r_[first[0], second[0]], np.r_[first[1], second[1]], n // 2)


def _states(state: Ints, atom: Ints, n: int) -> States:
    order = np.lexsort((atom, state))
    counts = np.bincount(state, minlength=2 * n)
    return States(np.r_[np.zeros(1, dtype=np.int64), np.cumsum(counts)], atom[order])
