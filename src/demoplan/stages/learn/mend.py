"""Readings that are likelier wrong than not, put right: the first step of learning from logs.

A predicate that is misread at the end of one segment makes an operator of its own, unless it is seen for what
it is. Here the course of every atom over a hand's activities, the rates of misreading, and groups of atoms of
which only one can hold are inferred together from all the data (``courses``, ``misreadings``,
``exclusion``), and states are set to what is then likelier. Where readings are as good as sure, they are left
as they are, gaps and all.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.courses import Courses, Floats, Tracks, read_courses
from demoplan.stages.learn.encode import NOBODY, Codes, Encoded, Ints, States
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
    sure_log_odds = float(np.log(params.sure / (1 - params.sure)))

    def mended(chosen: Ints) -> _Changes:
        own = read_courses(data, tracks, chosen, types, is_complete=False)
        believed = smooth_exclusively(data, tracks, chosen, own, rates, exclusions, params)
        return _changes(own, believed, tracks, chosen, n_predicates, sure_log_odds)

    chunks = list(tracks.chunks(params.steps_per_chunk, courses.n / max(len(sample), 1)))
    # Threads are enough: arrays are worked on without the interpreter.
    with ThreadPoolExecutor(params.n_threads) as pool:
        changes = list(pool.map(mended, chunks))
    return replace(
        result,
        data=replace(
            data,
            true=_states([each.held for each in changes], data.n),
            unknown=_joined(data.unknown, _states([each.doubted for each in changes], data.n)),
        ),
        n_read=np.sum([each.n_read for each in changes], axis=0),
        n_to_true=np.sum([each.n_to_true for each in changes], axis=0),
        n_to_false=np.sum([each.n_to_false for each in changes], axis=0),
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


@dataclass(frozen=True)
class _Changes:
    """What came of some tracks; counts by predicate."""

    n_read: Floats
    n_to_true: Floats
    n_to_false: Floats
    held: "_Atoms"
    """Those that are likelier true than not."""
    doubted: "_Atoms"
    """Those of which neither is sure."""


@dataclass(frozen=True)
class _Atoms:
    """Atoms of some states, those of one state together."""

    states: Codes
    """Ascending."""
    counts: Codes
    atoms: Codes


def _changes(
    courses: Courses,
    believed: Smoothed,
    tracks: Tracks,
    chosen: Ints,
    n_predicates: int,
    sure_log_odds: float,
) -> _Changes:
    length = tracks.length[chosen][courses.track]
    is_read = (courses.n_true + courses.n_false) > 0
    is_true = (believed.log_odds > 0) & is_read
    was_true = courses.n_true > courses.n_false
    within = np.arange(is_true.shape[1]) <= length[:, None]
    is_doubted = (np.abs(believed.log_odds) < sure_log_odds) & is_read & within

    def counted(cells: NDArray[np.bool_]) -> Floats:
        n_cells = np.bincount(courses.predicate, cells.sum(axis=1), n_predicates)
        return np.asarray(n_cells, dtype=np.float64)

    return _Changes(
        n_read=counted(is_read),
        n_to_true=counted(is_true & ~was_true & is_read),
        n_to_false=counted(~is_true & was_true & is_read),
        held=_atoms(courses, tracks, chosen, is_true & within),
        doubted=_atoms(courses, tracks, chosen, is_doubted),
    )


def _atoms(courses: Courses, tracks: Tracks, chosen: Ints, is_chosen: NDArray[np.bool_]) -> _Atoms:
    """The chosen cells of courses: each time's, given to what ends a row and to what begins the next."""
    course, time = np.nonzero(is_chosen)
    has_atom = courses.atom[course] != NOBODY
    course, time = course[has_atom], time[has_atom]
    atom, track = courses.atom[course], chosen[courses.track[course]]
    row = tracks.first[track] + time
    after = np.flatnonzero(time > 0)
    before = np.flatnonzero(time < tracks.length[track])
    state = np.r_[2 * (row[after] - 1) + 1, 2 * row[before]]
    span = int(courses.atom.max(initial=0)) + 1
    # One number for both: sorting it sorts by state, then by atom.
    state, atom = np.divmod(np.sort(state * span + np.r_[atom[after], atom[before]]), span)
    first = np.flatnonzero(np.r_[True, state[1:] != state[:-1]][: len(state)])
    return _Atoms(
        state[first].astype(np.int32),
        np.diff(np.r_[first, len(state)]).astype(np.int32),
        atom.astype(np.int32),
    )


def _states(parts: list[_Atoms], n: int) -> States:
    """The parts' atoms as states of ``n`` transitions; no state is in two parts."""
    counts = np.zeros(2 * n, dtype=np.int64)
    for part in parts:
        counts[part.states] = part.counts
    offsets = np.r_[np.zeros(1, dtype=np.int64), np.cumsum(counts)]
    atoms = np.empty(int(offsets[-1]), dtype=np.int32)
    for part in parts:
        own = part.counts.astype(np.int64)
        position = np.repeat(offsets[part.states] - (np.cumsum(own) - own), own)
        position += np.arange(len(position))
        atoms[position] = part.atoms
    return States(offsets, atoms)


def _joined(one: States, other: States) -> States:
    """The atoms of both, state by state."""
    n = len(one.offsets) - 1
    every = np.arange(n)
    first, second = one.gather(every), other.gather(every)
    state, atom = np.r_[first[0], second[0]], np.r_[first[1], second[1]]
    order = np.lexsort((atom, state))
    counts = np.bincount(state, minlength=n)
    return States(np.r_[np.zeros(1, dtype=np.int64), np.cumsum(counts)], atom[order].astype(np.int32))
