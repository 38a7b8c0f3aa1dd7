"""Of which atoms only one can hold at a time: groups that the readings show, and what they say of each atom.

A cube is on one thing; a hand is open or holds one thing. Such groups are looked for in the data: for each
object in some place of a predicate, or of one of two predicates, at most one atom is ever true where
independent atoms would often coincide. A reading that breaks a group is then one that is wrong, and which one
it is, the rest of its course tells.

Source: for the groups, M. Helmert, "Concise finite-domain representations for PDDL planning tasks",
Artificial Intelligence 173, 2009, doi:10.1016/j.artint.2008.10.013, section 5; here from data instead of from
operators.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import lgamma, log, log1p

import numpy as np
from numpy.typing import NDArray

from demoplan.stages.learn.courses import Courses, Floats, Tracks
from demoplan.stages.learn.encode import Encoded, Ints
from demoplan.stages.learn.misreadings import MendParams, Rates, Smoothed, read_log_odds, smooth

_SLIP = 0.005
"""Rate at which states may break a group that is one."""
_BROKEN_PRIOR = (1.0, 39.0)
"""Beta prior over the share of states that break a group, what is still misread included."""


@dataclass(frozen=True)
class Exclusion:
    """Atoms of which at most one holds for each object of a type, and what speaks for it."""

    members: tuple[tuple[int, int], ...]
    """(predicate, position of the object) pairs, as codes; sorted."""
    key_type: int
    n_states: int
    """States of an object of the type."""
    n_none: int
    n_one: int
    n_many: int
    expected_many: float
    """How many would have more than one, if atoms came about independently."""
    log_bayes_factor: float
    """Natural logarithm, of exclusion against independence."""
    weight_none: float
    """Odds that none holds, relative to what independent atoms would give."""


def find_exclusions(
    data: Encoded,
    tracks: Tracks,
    chosen: Ints,
    courses: Courses,
    believed: Smoothed,
    params: MendParams,
) -> tuple[Exclusion, ...]:
    """The groups that complete courses show, those of two predicates before those of one."""
    is_true = believed.log_odds > 0
    length = tracks.length[chosen]
    within = np.arange(is_true.shape[1]) <= length[courses.track][:, None]
    types = _types(data, tracks, chosen, courses)
    places = [
        (code, position)
        for code, signature in enumerate(data.predicates)
        for position in range(min(len(signature.argument_types), courses.arguments.shape[1]))
    ]
    candidates: list[tuple[tuple[int, int], ...]] = [(place,) for place in places]
    candidates += [tuple(sorted(pair)) for pair in combinations(places, 2) if pair[0][0] != pair[1][0]]
    found: list[Exclusion] = []
    for members in candidates:
        rows, position = _of_group(courses, members)
        if not len(rows):
            continue
        key_type = types[rows, position]
        for code in np.unique(key_type).tolist():
            is_own = key_type == code
            own = rows[is_own]
            group = _measured(
                members,
                int(code),
                courses.track[own] * len(data.names) + courses.arguments[own, position[is_own]],
                courses.predicate[own],
                is_true[own],
                within[own],
            )
            if (
                group is not None
                and group.log_bayes_factor >= params.exclusion_log_odds
                and group.n_many <= min(params.max_broken * group.n_states, group.expected_many / 4)
            ):
                found.append(group)
    return tuple(sorted(found, key=lambda each: (-len(each.members), each.members, each.key_type)))


def _measured(
    members: tuple[tuple[int, int], ...],
    key_type: int,
    owner: Ints,
    predicate: Ints,
    is_true: NDArray[np.bool_],
    within: NDArray[np.bool_],
) -> Exclusion | None:
    """How well the readings fit a group; None where they cannot tell.

    One predicate excludes itself: how many of its atoms coincide is held against how many would by chance.
    Two predicates exclude each other: how often both have an atom, against how often they would by chance.
    """
    names, key = np.unique(owner, return_inverse=True)
    shape = (len(names), is_true.shape[1])
    is_state = np.zeros(shape, dtype=bool)
    is_state[key] = within
    changes = np.c_[np.ones(len(key), dtype=bool), is_true[:, 1:] != is_true[:, :-1]] & within
    is_new = _summed(changes, key, len(names)) > 0
    counts = []
    for code, _ in members:
        own = predicate == code
        counts.append(_summed(is_true[own] & within[own], key[own], len(names))[is_state].astype(np.int64))
    n_states = len(counts[0])
    if not all(count.any() for count in counts):
        return None
    total = np.sum(counts, axis=0)
    none, one, many = int((total == 0).sum()), int((total == 1).sum()), int((total > 1).sum())
    if len(members) == 1:
        n_members = len(owner) / len(names)
        rate = min(float(total.mean()) / n_members, 1 - 1e-9)
        no_atom = (1 - rate) ** n_members
        chance = 1 - no_atom - n_members * rate * (1 - rate) ** (n_members - 1)
    else:
        shares = [float((count > 0).mean()) for count in counts]
        chance, no_atom = shares[0] * shares[1], (1 - shares[0]) * (1 - shares[1])
    chance = min(max(chance, 1e-9), 1 - 1e-9)
    # States of one course resemble each other: there are as many independent ones as changes.
    n, k = int(is_new.sum()), many / n_states * int(is_new.sum())
    exclusive = _log_beta_binomial(k, n - k)
    independent = k * log(chance) + (n - k) * log1p(-chance)
    shown = (none + 0.5) / (n_states - none + 0.5)
    usual = no_atom / max(1 - no_atom, 1e-9)
    return Exclusion(
        members=members,
        key_type=key_type,
        n_states=n_states,
        n_none=none,
        n_one=one,
        n_many=many,
        expected_many=chance * n_states,
        log_bayes_factor=exclusive - independent,
        # That a hand is neither open nor holds is what ends of activities fall into; it is settled later.
        weight_none=float(np.clip(shown / max(usual, 1e-9), 0.01, 1.0)) if len(members) == 1 else 1.0,
    )


def _summed(values: NDArray[np.bool_] | Floats, key: Ints, n: int) -> Floats:
    """Rows of equal key added up, shape (n, times)."""
    result = np.zeros((n, values.shape[1]))
    if len(key):
        order = np.argsort(key, kind="stable")
        first = np.flatnonzero(np.r_[True, key[order][1:] != key[order][:-1]])
        result[key[order][first]] = np.add.reduceat(values[order].astype(np.float64), first, axis=0)
    return result


def _log_beta_binomial(n_many: float, n_fine: float) -> float:
    a, b = _BROKEN_PRIOR
    return (
        lgamma(a + n_many)
        + lgamma(b + n_fine)
        - lgamma(a + b + n_many + n_fine)
        - (lgamma(a) + lgamma(b) - lgamma(a + b))
    )


def smooth_exclusively(
    data: Encoded,
    tracks: Tracks,
    chosen: Ints,
    courses: Courses,
    rates: Rates,
    exclusions: tuple[Exclusion, ...],
    params: MendParams,
) -> Smoothed:
    """Courses smoothed with the groups' say.

    Each atom is told by its groups how likely the other members are, and is smoothed again: belief
    propagation on a graph with loops, a few rounds of it.
    """
    told = np.zeros_like(courses.n_true)
    own, start, steps = (
        read_log_odds(courses, rates),
        rates.at_first[courses.predicate],
        rates.step(courses.kind),
    )
    believed = smooth(own, start, steps, is_counted=False)
    spots = list(_spots(data, tracks, chosen, courses, exclusions))
    messages = [np.zeros((len(rows), told.shape[1]), order="F") for rows, _, _ in spots]
    for _ in range(params.n_exclusion_rounds if spots else 0):
        for number, (rows, key, group) in enumerate(spots):
            cavity = np.exp(np.clip(believed.log_odds[rows] - messages[number], -30, 30))
            together = _summed(cavity, key, int(key.max()) + 1)
            others = np.maximum(together[key] - cavity, 0.0)
            message = np.log1p(_SLIP * others) - np.log(group.weight_none + others)
            told[rows] += 0.5 * (message - messages[number])
            messages[number] += 0.5 * (message - messages[number])
        believed = smooth(own + told, start, steps, is_counted=False)
    return believed


def _spots(
    data: Encoded, tracks: Tracks, chosen: Ints, courses: Courses, exclusions: tuple[Exclusion, ...]
) -> Iterator[tuple[Ints, Ints, Exclusion]]:
    """Courses of each group, and a number for the object that each is about."""
    types = _types(data, tracks, chosen, courses)
    for group in exclusions:
        rows, position = _of_group(courses, group.members)
        is_typed = types[rows, position] == group.key_type
        rows, position = rows[is_typed], position[is_typed]
        if len(rows):
            owner = courses.track[rows] * len(data.names) + courses.arguments[rows, position]
            yield rows, np.unique(owner, return_inverse=True)[1], group


def _of_group(courses: Courses, members: tuple[tuple[int, int], ...]) -> tuple[Ints, Ints]:
    position_of = dict(members)
    rows = np.flatnonzero(np.isin(courses.predicate, list(position_of)))
    positions = np.array([position_of[code] for code in courses.predicate[rows].tolist()], dtype=np.int64)
    return rows, positions


def _types(data: Encoded, tracks: Tracks, chosen: Ints, courses: Courses) -> Ints:
    row = tracks.first[chosen][courses.track]
    columns = [data.type_of(row, courses.arguments[:, place]) for place in range(courses.arguments.shape[1])]
    return np.stack(columns, axis=1) if columns else np.empty((courses.n, 0), np.int64)
