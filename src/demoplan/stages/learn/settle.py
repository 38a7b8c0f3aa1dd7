"""Boundaries that cut a change in two: give the whole change to one activity.

A hand is open or holds; an object rests on one thing or, once carried, on another. There is nothing in
between that an operator could state. But segments and predicates come from different thresholds, so that an
end can fall into the gap: the hand has closed and does not hold yet, the cube has left the table as Put ends
and touches the next cube in Release. Operators learned from such halves are unsound together: one that adds
``onTop(c, to)`` without removing ``onTop(c, from)`` leaves a cube in two places.

A gap is therefore closed: what was before it, and what was after it, are moved to the boundaries of one
activity, its owner. Where several ends in a row fall into it (a hesitation in mid-carry), all of them before
the owner agree with what was before, and all after it with what came after. Nothing is invented: every value
comes from a state that was observed, and only where it was first (or last) seen changes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from demoplan.language.types import ROOT, TypeHierarchy
from demoplan.stages.learn.encode import NOBODY, Encoded, Ints
from demoplan.stages.learn.params import LearnParams

FREE = -2
"""Value of a hand that is open, and so holds nothing."""
Votes: TypeAlias = Mapping[tuple[str, int, int], int]
"""Activity, kind of value before, kind after → how often it makes that change within itself."""

Preference: TypeAlias = Callable[[range, int, int], Sequence[tuple[int, ...]]]
"""For the rows of a run and the values on its two sides, how well each row would do as owner."""

GAP = -1
"""Value of a hand that is neither or both of open and holding, and of an object that rests on nothing."""
_UNSEEN = -3


@dataclass(frozen=True)
class Settled:
    """Where each transition's ends are read once gaps are closed; shapes (n, 2), before and after."""

    hand_source: Ints
    """States that say whether the hand is open, and what it holds."""
    support_source: Ints
    """States that say what the manipulated object rests on."""
    holds: Ints
    """Object held: its code, ``FREE``, or another negative number where nothing is known."""
    manipulated: Ints
    """Object that is grasped, released, held, or acted on; ``NOBODY`` where there is none. Shape (n,)."""


def settle(
    data: Encoded,
    types: TypeHierarchy,
    params: LearnParams,
    *,
    grip_votes: Votes | None = None,
    support_votes: Votes | None = None,
) -> Settled:
    """Close the gaps of every hand's sequence of transitions.

    Args:
        data: Transitions of logs (symbolic traces have no gaps).
        types: What may be held depends on the type that ``params.holding`` takes.
        params: Which predicates exclude each other.
        grip_votes: Which activities take hold and let go within themselves; by default as these data have it.
            Only their order matters.
        support_votes: The same of what objects rest on.
    """
    own, chain, holds, hand_source, manipulated, rests = _observed(data, types, params, grip_votes)
    support_source = _close(
        own,
        rests,
        chain,
        data.activity,
        votes=_by_code(data, support_votes) or _votes(rests, data.activity),
        preference=lambda run, _old, new: _carry_preference(data, holds, run, new),
    )
    return Settled(hand_source, support_source, holds, manipulated)


def count_grip_votes(data: Encoded, params: LearnParams) -> Votes:
    """How often each activity changes what a hand holds within itself; counts of several data add up."""
    return _by_name(data, _votes(_holding(data, params), data.activity))


def count_support_votes(data: Encoded, types: TypeHierarchy, params: LearnParams, grip_votes: Votes) -> Votes:
    """How often each activity changes what an object rests on within itself, once hands are settled."""
    *_, rests = _observed(data, types, params, grip_votes)
    return _by_name(data, _votes(rests, data.activity))


def _observed(
    data: Encoded, types: TypeHierarchy, params: LearnParams, grip_votes: Votes | None
) -> tuple[Ints, Ints, Ints, Ints, Ints, Ints]:
    """Own states, chains of one object, holds, their sources, manipulated objects, and what they rest on."""
    own = 2 * np.arange(data.n)[:, None] + np.array([0, 1])
    holds = _holding(data, params)
    hand_source = _close(
        own,
        holds,
        data.sequence,
        data.activity,
        votes=_by_code(data, grip_votes) or _votes(holds, data.activity),
        preference=lambda run, old, new: _grip_preference(data, run, old, new),
    )
    holds = holds.reshape(-1)[hand_source]
    manipulated = _manipulated(data, holds, types, params)
    rests = _resting(data, manipulated, holds, params)
    chain = np.cumsum(
        np.r_[True, (data.sequence[1:] != data.sequence[:-1]) | (manipulated[1:] != manipulated[:-1])]
    )[: data.n]
    return own, chain, holds, hand_source, manipulated, rests


def _holding(data: Encoded, params: LearnParams) -> Ints:
    """What each hand holds before and after each transition, shape (n, 2)."""
    holds = np.full(2 * data.n, GAP, dtype=np.int64)
    holding, empty = data.predicate_code(params.holding), data.predicate_code(params.empty)
    every = np.arange(2 * data.n)
    wanted = data.has_predicate(params.holding, params.empty)
    for states, is_known in ((data.unknown, False), (data.true, True)):
        state, atom = states.only(wanted).gather(every)
        predicate, subject = data.atom_predicate[atom], data.atom_arguments[atom, 0]
        own = subject == data.hand[state // 2]
        is_empty = own & (predicate == empty)
        is_held = own & (predicate == holding)
        if is_known:
            holds[state[is_empty]] = FREE
            held_state, held = state[is_held], data.atom_arguments[atom[is_held], 1]
            # Where two are said to be held, the one that the activity names counts, else the last by name.
            named = (held == data.in_hand[held_state // 2]) | (held == data.acted_on[held_state // 2])
            order = np.argsort(named, kind="stable")
            holds[held_state[order]] = held[order]
            # Open and holding at once is as little a state of a hand as neither is.
            holds[np.intersect1d(state[is_empty], held_state)] = GAP
        else:
            holds[state[is_empty | is_held]] = _UNSEEN
    if empty < 0:
        holds[holds == GAP] = _UNSEEN
    return holds.reshape(-1, 2)


def _manipulated(data: Encoded, holds: Ints, types: TypeHierarchy, params: LearnParams) -> Ints:
    """The object grasped, else released or held, else named by the activity, else come to; shape (n,).

    An activity may name nothing, or what no hand can hold (the table, when the hand comes down beside a
    cube). Then the object is the one that the hand grasps next, if the hand came into a relation with it.
    """
    before, after = holds[:, 0], holds[:, 1]
    rows = np.arange(data.n)
    code = data.predicate_code(params.holding)
    wanted = data.predicates[code].argument_types[1] if code >= 0 else ROOT
    may_hold = np.array([types.is_subtype(name, wanted) for name in data.types] + [False])
    named = np.where(data.in_hand != NOBODY, data.in_hand, data.acted_on)
    named = np.where(may_hold[data.type_of(rows, named)] & (named != data.hand), named, NOBODY)
    grasps = (after >= 0) & (after != before)
    following = _next(np.where(grasps, after, NOBODY), data.sequence)
    named = np.where((named == NOBODY) & (following >= 0) & _approached(data, following), following, named)
    return np.where(grasps, after, np.where(before >= 0, before, named))


def _next(values: Ints, sequence: Ints) -> Ints:
    """The next value that is not ``NOBODY``, at or after each row, within its sequence."""
    n = len(values)
    place = np.where(values != NOBODY, np.arange(n), n)
    place = np.minimum.accumulate(place[::-1])[::-1]
    found = np.minimum(place, n - 1)
    return np.where((place < n) & (sequence[found] == sequence), values[found], NOBODY)


def _approached(data: Encoded, instances: Ints) -> NDArray[np.bool_]:
    """Whether some relation between the row's hand and its instance begins to hold; shape (n,)."""
    keys = []
    has_hand: NDArray[np.bool_] = np.isin(data.atom_arguments, np.unique(data.hand)).max(
        axis=1, initial=False
    )
    states = data.true.only(has_hand)
    for side in (0, 1):
        row, atom = states.gather(2 * np.arange(data.n) + side)
        arguments = data.atom_arguments[atom]
        with_hand = (arguments == data.hand[row][:, None]).any(axis=1)
        with_instance = (arguments == instances[row][:, None]).any(axis=1) & (instances[row] != NOBODY)
        is_relation = with_hand & with_instance
        keys.append(row[is_relation] * len(data.atom_predicate) + atom[is_relation])
    began = np.setdiff1d(keys[1], keys[0]) // max(len(data.atom_predicate), 1)
    result = np.zeros(data.n, dtype=bool)
    result[began] = True
    return result


def _resting(data: Encoded, manipulated: Ints, holds: Ints, params: LearnParams) -> Ints:
    """What the manipulated object rests on (one thing), before and after: a code, a gap, or unseen."""
    rests = np.full(2 * data.n, GAP, dtype=np.int64)
    supports = data.has_predicate(*params.supports)
    state, atom = data.true.only(supports).gather(np.arange(2 * data.n))
    is_rest = data.atom_arguments[atom, 0] == manipulated[state // 2]
    rests[state[is_rest]] = data.atom_arguments[atom[is_rest], 1]
    sides = rests.reshape(-1, 2)
    sides[manipulated == NOBODY] = _UNSEEN
    # An object that nobody holds and whose support was not observed is not in the air: leave it.
    state, atom = data.unknown.only(supports).gather(np.arange(2 * data.n))
    is_unseen = data.atom_arguments[atom, 0] == manipulated[state // 2]
    unseen = np.zeros(2 * data.n, dtype=bool)
    unseen[state[is_unseen]] = True
    loose = unseen.reshape(-1, 2) & (sides == GAP) & (holds != manipulated[:, None])
    sides[loose] = _UNSEEN
    return sides


def _kinds(values: Ints) -> Ints:
    """Values without saying which object: any object is 1."""
    return np.where(values >= 0, 1, values)


def _votes(values: Ints, activity: Ints) -> dict[tuple[int, int, int], int]:
    """How often each activity, by code, changes one kind of value to another within itself."""
    kinds = _kinds(values)
    whole = (
        (values[:, 0] != GAP) & (values[:, 1] != GAP) & (values[:, 0] != _UNSEEN) & (values[:, 1] != _UNSEEN)
    )
    changes = whole & (values[:, 0] != values[:, 1])
    seen, counts = np.unique(np.column_stack([activity[changes], kinds[changes]]), axis=0, return_counts=True)
    return {
        (activity, old, new): count
        for (activity, old, new), count in zip(seen.tolist(), counts.tolist(), strict=True)
    }


def _by_name(data: Encoded, votes: Mapping[tuple[int, int, int], int]) -> dict[tuple[str, int, int], int]:
    return {(data.activities[code], old, new): count for (code, old, new), count in votes.items()}


def _by_code(data: Encoded, votes: Votes | None) -> dict[tuple[int, int, int], int]:
    code_of = {name: code for code, name in enumerate(data.activities)}
    return {
        (code_of[name], old, new): count
        for (name, old, new), count in (votes or {}).items()
        if name in code_of
    }


def _close(
    own: Ints,
    values: Ints,
    chain: Ints,
    activity: Ints,
    votes: Mapping[tuple[int, int, int], int],
    preference: Preference,
) -> Ints:
    """Sources of each end's value after every gap is closed; shape (n, 2).

    A run is a maximal stretch of one chain whose inner boundaries all fall into a gap and whose two ends
    do not. Its owner is the activity that, over all the data, most often makes the same kind of change
    within itself; where the data have no word on it, ``preference`` decides.
    """
    source = own.copy()
    n = len(own)
    if n == 0:
        return source
    joined = np.r_[chain[1:] == chain[:-1], False]
    open_end = joined & (values[:, 1] == GAP)
    open_end[:-1] &= values[1:, 0] == GAP
    starts = np.flatnonzero(open_end & ~np.r_[False, open_end[:-1]])
    ends = np.flatnonzero(~open_end & np.r_[False, open_end[:-1]])
    kinds = _kinds(values)
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        old, new = int(values[start, 0]), int(values[end, 1])
        if old in (GAP, _UNSEEN) or new in (GAP, _UNSEEN):
            continue
        key = (int(kinds[start, 0]), int(kinds[end, 1]))
        run = range(start, end + 1)
        choice = preference(run, old, new)
        owner = max(run, key=lambda row: (votes.get((int(activity[row]), *key), 0), choice[row - start]))
        source[start:owner, 1] = own[start, 0]
        source[start + 1 : owner + 1, 0] = own[start, 0]
        source[owner:end, 1] = own[end, 1]
        source[owner + 1 : end + 1, 0] = own[end, 1]
    return source


def _grip_preference(data: Encoded, run: range, old: int, new: int) -> list[tuple[int, ...]]:
    """The first activity whose named object in hand agrees with the new state of the hand."""
    held = data.in_hand[run.start : run.stop]
    agrees = held == new if new >= 0 else held != old
    return [(int(fits), -row) for fits, row in zip(agrees, run, strict=True)]


def _carry_preference(data: Encoded, holds: Ints, run: range, new: int) -> list[tuple[int, ...]]:
    """What acts on the new support, else carries throughout, else is of the kind that carries longest."""
    span = data.duration_ns[run.start : run.stop]
    activity = data.activity[run.start : run.stop]
    carried = (holds[run.start : run.stop] >= 0).sum(axis=1)
    total = [int(span[activity == code].sum()) for code in activity]
    aims = data.acted_on[run.start : run.stop] == new
    return [
        (int(aim), int(ends), long, -row)
        for aim, ends, long, row in zip(aims, carried, total, run, strict=True)
    ]
