"""The course of every atom along the activities of a hand, as arrays.

A course is one atom over one hand's sequence: what was read of it at the first tick and at the end of each
activity. Courses of equal length stand below each other, so that one step of all is one operation.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.encode import NOBODY, Encoded, Ints, distinct

Floats = NDArray[np.float64]
HAND_BIT, ACTED_ON_BIT, IN_HAND_BIT, RELEASED_BIT = 1, 2, 4, 8
"""What an argument is to an activity: its hand, what it acts on, what it holds, what the one before held."""
_N_MARKS = 16


@dataclass(frozen=True)
class Tracks:
    """Where each hand's sequence of transitions begins, and how many it has; shapes (m,)."""

    first: Ints
    length: Ints

    @classmethod
    def of(cls, data: Encoded) -> "Tracks":
        """The sequences of the transitions, in order."""
        first = np.flatnonzero(np.r_[True, data.sequence[1:] != data.sequence[:-1]][: data.n])
        return cls(first, np.diff(np.r_[first, data.n]))

    @property
    def n(self) -> int:
        """How many there are."""
        return len(self.first)

    def chunks(self, n_steps: int, n_courses_each: float = 1.0) -> Iterator[Ints]:
        """Tracks of like length together, so many that they have about ``n_steps`` steps."""
        order = np.argsort(self.length, kind="stable")
        # Padded to the longest of the chunk: lengths within a factor of two share one.
        band = np.frexp(self.length[order])[1]
        for value in np.unique(band):
            members = order[band == value]
            longest = int(self.length[members].max())
            size = max(1, int(n_steps / (longest * max(n_courses_each, 1.0))))
            for start in range(0, len(members), size):
                yield members[start : start + size]


@dataclass(frozen=True)
class Courses:
    """What was read of atoms, at the first tick and after each step; shapes (c,), (c, t + 1) or (c, t)."""

    track: Ints
    """Position among the chunk's tracks."""
    predicate: Ints
    arguments: Ints
    """Instance codes, shape (c, widest), padded with ``NOBODY``."""
    atom: Ints
    """Code of the atom, ``NOBODY`` for one that was never read as true."""
    n_true: Floats
    """How often the atom was read as true at that time (an end may have been read twice)."""
    n_false: Floats
    is_unknown: NDArray[np.bool_]
    kind: Ints
    """What kind of step each is: predicate, activity, and what each argument is to the activity; −1 beyond
    the end."""

    @property
    def n(self) -> int:
        """How many courses there are."""
        return len(self.track)


def read_courses(
    data: Encoded, tracks: Tracks, chosen: Ints, types: TypeHierarchy, *, is_complete: bool
) -> Courses:
    """The courses of atoms along some tracks.

    Args:
        data: The transitions.
        tracks: Their sequences.
        chosen: Positions of the tracks, of similar length.
        types: The hierarchy that objects' types belong to.
        is_complete: Whether to follow every atom that the objects' types allow, and not only those that were
            read as true, or not read, somewhere along the track.
    """
    length = tracks.length[chosen]
    n_times = int(length.max(initial=0)) + 1
    track, time, state = _readings(tracks, chosen)
    is_copy = _is_copy(data, tracks, chosen)
    weight = np.where(state % 2 == 1, 1.0, is_copy[track, np.maximum(time, 0)])
    owner, atom = data.true.gather(state)
    missing_owner, missing_atom = data.unknown.gather(state)
    n_atoms = max(len(data.atom_predicate), 1)
    seen = _seen(
        np.r_[track[owner] * n_atoms + atom, track[missing_owner] * n_atoms + missing_atom],
        len(chosen) * n_atoms,
    )
    own_track, own_atom = np.divmod(seen, n_atoms)
    predicate, arguments = data.atom_predicate[own_atom], data.atom_arguments[own_atom]
    n = len(seen)
    # Columns lie together: whatever goes along courses takes one time of all of them at once.
    row = np.searchsorted(seen, track[owner] * n_atoms + atom)
    counts: Floats = np.bincount(time[owner] * n + row, weight[owner], n * n_times).astype(np.float64)
    n_true = counts.reshape(n_times, n).T
    n_read = np.bincount(track * n_times + time, weight, len(chosen) * n_times).reshape(-1, n_times)
    is_unknown = np.zeros((n, n_times), dtype=bool)
    row = np.searchsorted(seen, track[missing_owner] * n_atoms + missing_atom)
    is_unknown[row, time[missing_owner]] = True
    if is_complete:
        more = _never_read(data, tracks, chosen, seen, types)
        own_track, predicate = np.r_[own_track, more[0]], np.r_[predicate, more[1]]
        arguments = np.concatenate([arguments, more[2]])
        own_atom = np.r_[own_atom, np.full(len(more[0]), NOBODY)]
        pad = ((0, len(more[0])), (0, 0))
        n_true, is_unknown = np.pad(n_true, pad), np.pad(is_unknown, pad)
    n_true, is_unknown = np.asfortranarray(n_true), np.asfortranarray(is_unknown)
    n_true[is_unknown] = 0.0
    n_false = np.asfortranarray(np.where(is_unknown, 0.0, n_read[own_track] - n_true))
    return Courses(
        track=own_track,
        predicate=predicate,
        arguments=arguments,
        atom=own_atom,
        n_true=n_true,
        n_false=np.maximum(n_false, 0.0),
        is_unknown=is_unknown,
        kind=_kinds(data, tracks, chosen, own_track, predicate, arguments),
    )


def _seen(keys: Ints, n_keys: int) -> Ints:
    """Sorted, each once; by marking them where there are few kinds of them, else by sorting."""
    if n_keys > 8 * len(keys):
        return distinct(keys)
    marks = np.zeros(n_keys, dtype=bool)
    marks[keys] = True
    return np.flatnonzero(marks)


def _readings(tracks: Tracks, chosen: Ints) -> tuple[Ints, Ints, Ints]:
    """Track, time and state of every reading: the state before a row belongs to the time before it."""
    length = tracks.length[chosen]
    track = np.repeat(np.arange(len(chosen)), length)
    step = np.arange(len(track)) - np.repeat(np.cumsum(length) - length, length)
    row = tracks.first[chosen][track] + step
    return np.r_[track, track], np.r_[step, step + 1], np.r_[2 * row, 2 * row + 1]


def _is_copy(data: Encoded, tracks: Tracks, chosen: Ints) -> Floats:
    """Weight of the reading before each row, by track and step: 0 where it repeats the one after the last.

    Two rows of a table share one instant. Where both give the very same reading, it is one reading.
    """
    length = tracks.length[chosen]
    weight = np.ones((len(chosen), int(length.max(initial=0)) + 1))
    track = np.repeat(np.arange(len(chosen)), length)
    step = np.arange(len(track)) - np.repeat(np.cumsum(length) - length, length)
    row = tracks.first[chosen][track] + step
    inner = step > 0
    same = _digests(data, 2 * row[inner]) == _digests(data, 2 * row[inner] - 1)
    weight[track[inner], step[inner]] = np.where(same, 0.0, 1.0)
    return weight


def _digests(data: Encoded, states: Ints) -> NDArray[np.uint64]:
    """A number for each of some states that equals another's if the states are the same."""
    chance = np.random.default_rng(0).integers(1, 2**63, size=len(data.atom_predicate) + 1, dtype=np.uint64)
    owner, atom = data.true.gather(states)
    sums = np.concatenate([np.zeros(1, dtype=np.uint64), np.cumsum(chance[atom], dtype=np.uint64)])
    offsets = np.r_[0, np.cumsum(np.bincount(owner, minlength=len(states)))]
    return np.asarray(sums[offsets[1:]] - sums[offsets[:-1]], dtype=np.uint64)


def _never_read(
    data: Encoded, tracks: Tracks, chosen: Ints, seen: Ints, types: TypeHierarchy
) -> tuple[Ints, Ints, Ints]:
    """Track, predicate and arguments of the atoms that types allow and that were never read as true."""
    n_atoms = max(len(data.atom_predicate), 1)
    base = len(data.names) + 1
    width = data.atom_arguments.shape[1]
    weights = base ** np.arange(width, dtype=np.int64)
    atom_keys = data.atom_predicate * base**width + (data.atom_arguments + 1) @ weights
    known = np.unique((seen // n_atoms) * (len(data.predicates) * base**width) + atom_keys[seen % n_atoms])
    found: list[tuple[Ints, Ints, Ints]] = []
    universes: dict[int, tuple[Ints, Ints]] = {}
    for position, track in enumerate(chosen.tolist()):
        row = int(tracks.first[track])
        episode = int(data.episode[row])
        if episode not in universes:
            universes[episode] = _universe(data, episode, types, width)
        predicate, arguments = universes[episode]
        found.append((np.full(len(predicate), position), predicate, arguments))
    if not found:
        return np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, width), np.int64)
    track_of = np.concatenate([each[0] for each in found])
    predicate = np.concatenate([each[1] for each in found])
    arguments = np.concatenate([each[2] for each in found])
    keys = track_of * (len(data.predicates) * base**width)
    keys = keys + predicate * base**width + (arguments + 1) @ weights
    is_new = ~np.isin(keys, known)
    return track_of[is_new], predicate[is_new], arguments[is_new]


def _universe(data: Encoded, episode: int, types: TypeHierarchy, width: int) -> tuple[Ints, Ints]:
    """Predicates and arguments of every atom over an episode's objects, none of them named twice."""
    names, kinds = data.objects_of(episode)
    predicates, arguments = [], []
    for code, signature in enumerate(data.predicates):
        choices = [
            names[[types.is_subtype(data.types[kind], wanted) for kind in kinds]].tolist()
            for wanted in signature.argument_types
        ]
        for chosen in product(*choices):
            if len(set(chosen)) == len(chosen) and len(chosen) <= width:
                predicates.append(code)
                arguments.append([*chosen, *[NOBODY] * (width - len(chosen))])
    return np.array(predicates, dtype=np.int64), np.array(arguments, dtype=np.int64).reshape(-1, width)


def _kinds(
    data: Encoded, tracks: Tracks, chosen: Ints, track: Ints, predicate: Ints, arguments: Ints
) -> Ints:
    length = tracks.length[chosen]
    n_steps = int(length.max(initial=0))
    held_before = np.where(
        np.r_[True, data.sequence[1:] != data.sequence[:-1]], NOBODY, np.roll(data.in_hand, 1)
    )
    kinds = np.full((len(track), n_steps), -1, dtype=np.int64, order="F")
    for step in range(n_steps):
        inside = np.flatnonzero(length[track] > step)
        row = tracks.first[chosen][track[inside]] + step
        code = predicate[inside] * len(data.activities) + data.activity[row]
        for column in range(arguments.shape[1]):
            argument = arguments[inside, column]
            is_there = argument != NOBODY
            marks = np.zeros(len(inside), dtype=np.int64)
            for bit, named in (
                (HAND_BIT, data.hand),
                (ACTED_ON_BIT, data.acted_on),
                (IN_HAND_BIT, data.in_hand),
                (RELEASED_BIT, held_before),
            ):
                marks += bit * ((argument == named[row]) & is_there)
            code = code * _N_MARKS + marks
        kinds[inside, step] = code
    return kinds
