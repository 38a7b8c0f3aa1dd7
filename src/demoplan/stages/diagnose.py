"""What a discrepancy comes from: perception, motion, execution offset, operator model, or somebody else.

The classes, in the order in which they are tried, since each explains away what would speak for a later one:

- *perception*: it passed when looked at again, or what is perceived contradicts itself;
- *motion*: the robot itself says that it did not get there, was blocked, or left its path;
- *exogenous*: an object moved with no hand near it, faster than anything falls, or is gone;
- *execution offset*: the hand went where it was told, and the object did not come to lie as it should;
- *operator model*: hand and object did what the motion is for, and the operator promised something else.

Only what was sensed and what the robot reports is looked at; who injected what is not known here.

Source: the levels of failure (execution, motion, operator) are those of M. Diehl, K. Ramirez-Amaro, "Work in
Progress: Automated Generation of Robotic Planning Domains from Observations"; rules and numbers are ours.
"""

from dataclasses import dataclass, field
from typing import Literal as Choice
from typing import TypeAlias

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.geometry import Array
from demoplan.language.atoms import Atom, Literal
from demoplan.language.execution import State

FailureClass: TypeAlias = Choice["perception", "motion", "execution_offset", "operator_model", "exogenous"]


@dataclass(frozen=True, kw_only=True)
class DiagnoseParams:
    """Thresholds, and the words in which the laws of a tabletop are put."""

    course_error_m: float = 0.03
    """A hand that was farther off its path did not move as commanded [m]."""
    jump_speed_m_per_s: float = 3.0
    """Nothing on a table falls or is carried that fast (a fall of 0.46 m ends at 3 m/s) [m/s]."""
    jump_m: float = 0.025
    """And it moves at least so far between two sightings [m]."""
    moved_m: float = 0.02
    """An object that moved less lies still [m]."""
    hand_near_m: float = 0.14
    """Middle of a hand's grasp to an object's middle, within which the hand can have moved it [m]."""
    offset_m: float = 0.012
    """An object put down farther off its support's middle lies badly [m]."""
    slip_m: float = 0.012
    """An object that moved farther within the hand has slipped [m]."""
    gone_s: float = 0.8
    """An object not seen for so long, up to now, is gone [s]."""
    holding: str = "inHand"
    resting: str = "onTop"
    is_open: str = "handOpen"
    free: str = "clear"
    touching: str = "inTouch"


@dataclass(frozen=True, kw_only=True)
class Case:
    """All that is known about a discrepancy."""

    literals: tuple[Literal, ...]
    """What should be so and is not."""
    passed_after_s: float | None
    """The discrepancy was gone when looked at again after this long [s]."""
    held: State
    """Atoms that are sensed now, of those that last."""
    unknown: State
    frames: pl.DataFrame
    """Rows of ``Frames`` from a little before the step was dispatched until now."""
    hands: tuple[str, ...]
    fixed: frozenset[str]
    """Entities that nothing moves, as the table."""
    objects: tuple[str, ...]
    """Loose objects of the scene."""
    hand: str | None = None
    """Hand of the step, if the discrepancy came with one."""
    activity: str | None = None
    thing: str | None = None
    """What the step takes, carries or lets go."""
    support: str | None = None
    """What it is put on."""
    was_held: bool = False
    """The object was in the hand when the step was dispatched."""
    motion_state: str | None = None
    motion_problem: str | None = None
    motion_reason: str | None = None
    tracking_error_m: float = 0.0
    n_collisions: int = 0
    n_alike_before: int = 0
    """Times that the same operator's same literals failed before in this run, the motion being well."""
    n_good_before: int = 0
    """Times that the same operator's same literals came about in this run."""
    since_ns: int = 0
    """When the step was dispatched; what lies before shows how things stood [ns]."""


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """A class, and why."""

    failure: FailureClass
    cause: str


@dataclass(frozen=True, eq=False)
class _Tracks:
    """Sightings of bodies."""

    seconds: dict[str, Array] = field(default_factory=dict)
    places: dict[str, Array] = field(default_factory=dict)
    last_s: float = 0.0

    @classmethod
    def of(cls, frames: pl.DataFrame) -> "_Tracks":
        tracks = cls({}, {}, float(frames["tick_ns"].max() or 0) / 1e9)  # type: ignore[arg-type]
        for (name,), rows in frames.group_by("entity", maintain_order=True):
            seen = rows.filter(pl.col("position_xyz_m").is_not_null())
            tracks.seconds[str(name)] = seen["tick_ns"].to_numpy() / 1e9
            tracks.places[str(name)] = np.asarray(
                seen["position_xyz_m"].to_numpy() if seen.height else np.zeros((0, 3)), np.float64
            ).reshape(-1, 3)
        return tracks

    def end(self, name: str) -> Array | None:
        """Where a body is now, ``(3,)``: the middle of its last sightings."""
        places = self.places.get(name)
        return None if places is None or not len(places) else np.asarray(np.median(places[-5:], axis=0))

    def between(self, one: str, other: str) -> tuple[Array, Array]:
        """Seconds ``(n,)`` and vectors ``(n, 3)`` from one body to another, when both are seen."""
        common, rows, other_rows = np.intersect1d(
            self.seconds.get(one, np.zeros(0)), self.seconds.get(other, np.zeros(0)), return_indices=True
        )
        if not len(common):
            return np.zeros(0), np.zeros((0, 3))
        return common, self.places[other][other_rows] - self.places[one][rows]


def diagnose(case: Case, params: DiagnoseParams = DiagnoseParams()) -> Diagnosis:
    """The class of a discrepancy, and its cause in words with figures."""
    if case.passed_after_s is not None:
        return Diagnosis(
            failure="perception",
            cause=f"{_listed(case.literals)}: passed when looked at again {case.passed_after_s:.1f} s later",
        )
    tracks = _Tracks.of(case.frames)
    found = (
        _gone_or_jumped(case, tracks, params)
        or _moved_by_nobody(case, tracks, params)
        or _contradiction(case, params)
        or _bad_motion(case, tracks, params)
        or _badly_placed(case, tracks, params)
    )
    if found is not None:
        return found
    if case.activity is not None and case.motion_state == "succeeded":
        if case.n_good_before > case.n_alike_before:
            return Diagnosis(
                failure="perception",
                cause=f"{_listed(case.literals)}: hand and object are where they should be, and the step "
                f"has shown it {case.n_good_before} times before",
            )
        again = f", {case.n_alike_before + 1} times now" if case.n_alike_before else ""
        return Diagnosis(
            failure="operator_model",
            cause=f"hand and object did what {case.activity} is for, yet {_listed(case.literals)}{again}",
        )
    return Diagnosis(
        failure="exogenous", cause=f"{_listed(case.literals)}: nothing that the robot did explains it"
    )


def _listed(literals: tuple[Literal, ...]) -> str:
    """What is not so, in words."""
    return ", ".join(
        f"{each.atom} is not sensed" if each.is_positive else f"{each.atom} is sensed" for each in literals
    )


def _involved(case: Case) -> list[str]:
    """Loose objects that the discrepancy is about, those of the step first."""
    named = {name for literal in case.literals for name in literal.atom.arguments}
    named |= {name for name in (case.thing, case.support) if name is not None}
    return sorted(named & set(case.objects))


def _gone_or_jumped(case: Case, tracks: _Tracks, params: DiagnoseParams) -> Diagnosis | None:
    for name in _involved(case):
        seconds, places = tracks.seconds.get(name, np.zeros(0)), tracks.places.get(name, np.zeros((0, 3)))
        unseen_s = tracks.last_s - (seconds[-1] if len(seconds) else -np.inf)
        if unseen_s >= params.gone_s:
            return Diagnosis(
                failure="exogenous",
                cause=f"{name} has not been seen for {min(unseen_s, 99.0):.1f} s: it is gone",
            )
        if len(seconds) < 2:
            continue
        step_m = np.linalg.norm(np.diff(places, axis=0), axis=1)
        jumps = (step_m >= params.jump_m) & (step_m >= params.jump_speed_m_per_s * np.diff(seconds))
        if jumps.any():
            first = int(np.argmax(jumps))
            if np.linalg.norm(places[-1] - places[first]) < params.moved_m:
                return Diagnosis(
                    failure="perception", cause=f"{name} was seen {step_m[first]:.2f} m away for a while"
                )
            return Diagnosis(
                failure="exogenous",
                cause=f"{name} went {step_m[first]:.2f} m between two sightings: somebody moved it",
            )
    return None


def _moved_by_nobody(case: Case, tracks: _Tracks, params: DiagnoseParams) -> Diagnosis | None:
    """Objects that began to move with no hand near, and nothing in a hand near either."""
    for name in _involved(case):
        places, seconds = tracks.places.get(name, np.zeros((0, 3))), tracks.seconds.get(name, np.zeros(0))
        if len(places) < 2:
            continue
        away = np.linalg.norm(places - places[0], axis=1)
        if away[-1] < params.moved_m:
            continue
        begin = int(np.argmax(away >= params.moved_m))
        nearest = np.inf
        for other in (*case.hands, *case.objects):
            if other == name:
                continue
            when, vectors = tracks.between(name, other)
            at = np.abs(when - seconds[begin]) <= 0.15
            # Another object counts only if it moved itself: it may have knocked this one over.
            if other not in case.hands and not _moves(tracks, other, seconds[begin], params):
                continue
            if at.any():
                nearest = min(nearest, float(np.linalg.norm(vectors[at], axis=1).min()))
        if nearest > params.hand_near_m:
            return Diagnosis(
                failure="exogenous",
                cause=f"{name} moved {away[-1]:.2f} m with no hand within {params.hand_near_m:.2f} m of it",
            )
    return None


def _moves(tracks: _Tracks, name: str, at_s: float, params: DiagnoseParams) -> bool:
    seconds, places = tracks.seconds.get(name, np.zeros(0)), tracks.places.get(name, np.zeros((0, 3)))
    around = places[np.abs(seconds - at_s) <= 0.3]
    return len(around) > 1 and float(np.linalg.norm(np.ptp(around, axis=0))) >= params.moved_m


def contradictions(
    held: State, unknown: State, hands: tuple[str, ...], objects: tuple[str, ...], params: DiagnoseParams
) -> tuple[str, ...]:
    """Why a perceived state cannot be, whatever happened; sorted.

    Args:
        held: Atoms that are perceived.
        unknown: Atoms that could not be.
        hands: Names of hands.
        objects: Loose objects.
        params: The words.
    """
    below = {(a.arguments[0], a.arguments[1]) for a in held if a.predicate == params.resting}
    in_hand = {(a.arguments[0], a.arguments[1]) for a in held if a.predicate == params.holding}
    free = {a.arguments[0] for a in held if a.predicate == params.free}
    touching = {frozenset(a.arguments) for a in held if a.predicate == params.touching}
    unsure = {name for atom in unknown for name in atom.arguments}
    found = set()
    for hand, thing in in_hand:
        if Atom(params.is_open, (hand,)) in held:
            found.add(f"{hand} is open and holds {thing}")
        if thing in free:
            found.add(f"{thing} is free and in {hand}")
    for thing in objects:
        supports = sorted(support for rider, support in below if rider == thing)
        riders = sorted(rider for rider, support in below if support == thing)
        is_held = any(thing == each for _, each in in_hand)
        if len(supports) > 1:
            found.add(f"{thing} rests on {' and on '.join(supports)}")
        if thing in free and riders:
            found.add(f"{thing} is free and carries {riders[0]}")
        if thing in unsure:
            continue
        if thing not in free and not riders and not is_held:
            found.add(f"{thing} is not free and nothing is on it or holds it")
        if not supports and not is_held and not any(thing in pair for pair in touching):
            found.add(f"{thing} floats")
    return tuple(sorted(found))


def _contradiction(case: Case, params: DiagnoseParams) -> Diagnosis | None:
    about = {name for literal in case.literals for name in literal.atom.arguments}
    found = [
        text
        for text in contradictions(case.held, case.unknown, case.hands, case.objects, params)
        if about & set(text.split())
    ]
    if found:
        return Diagnosis(failure="perception", cause=f"what is perceived cannot be: {found[0]}")
    if case.literals and all(literal.atom in case.unknown for literal in case.literals):
        return Diagnosis(
            failure="perception",
            cause=f"not observed: {', '.join(str(literal.atom) for literal in case.literals)}",
        )
    return None


def _bad_motion(case: Case, tracks: _Tracks, params: DiagnoseParams) -> Diagnosis | None:
    """The robot did not do what it was told, or lost what it carried on a path that was as planned."""
    if case.motion_state is None:
        return None
    why = case.motion_reason or case.motion_problem or case.motion_state
    is_off_course = case.tracking_error_m > params.course_error_m or case.n_collisions > 0
    if case.was_held and case.motion_state != "succeeded" and not is_off_course:
        in_hand = Atom(params.holding, (case.hand or "", case.thing or ""))
        if in_hand not in case.held | case.unknown:
            return Diagnosis(
                failure="execution_offset",
                cause=f"{case.thing} left {case.hand} on the way, with the hand on its course: {why}",
            )
    if case.motion_problem in {"object_lost", "not_holding", "no_contact", "grasped_nothing"}:
        # The hand went where it was told; it is the object that did not follow.
        if is_off_course:
            return Diagnosis(
                failure="motion",
                cause=f"{why}; the hand was {case.tracking_error_m * 1e3:.0f} mm off its path, "
                f"{case.n_collisions} collisions",
            )
        return Diagnosis(failure="execution_offset", cause=why)
    if case.motion_problem == "not_seen":
        return Diagnosis(failure="perception", cause=why)
    if case.motion_state in {"failed", "blocked"}:
        return Diagnosis(failure="motion", cause=why)
    if case.tracking_error_m > params.course_error_m:
        return Diagnosis(
            failure="motion",
            cause=f"the hand was {case.tracking_error_m * 1e3:.0f} mm off its path, more than "
            f"{params.course_error_m * 1e3:.0f} mm",
        )
    return None


def _badly_placed(case: Case, tracks: _Tracks, params: DiagnoseParams) -> Diagnosis | None:
    """The object is not where the hand should have brought or left it."""
    if case.thing is None:
        return None
    if case.hand is not None:
        seconds, held = tracks.between(case.hand, case.thing)
        drift_m = _drift_while_closed(case, seconds, held)
        if drift_m is not None and drift_m > params.slip_m:
            return Diagnosis(
                failure="execution_offset",
                cause=f"{case.thing} moved {drift_m * 1e3:.0f} mm within {case.hand}",
            )
    pairs = [
        (literal.atom.arguments[0], literal.atom.arguments[1])
        for literal in case.literals
        if literal.is_positive and literal.atom.predicate == params.resting
    ]
    for name, support in pairs:
        top, base = tracks.end(name), tracks.end(support)
        if support in case.fixed or top is None or base is None:
            continue
        offset_m = float(np.linalg.norm((top - base)[:2]))
        if top[2] <= base[2] + params.offset_m:
            return Diagnosis(
                failure="execution_offset",
                cause=f"{name} lies beside {support}, {offset_m * 1e3:.0f} mm off, and not on it",
            )
        if offset_m > params.offset_m:
            return Diagnosis(
                failure="execution_offset",
                cause=f"{name} lies {offset_m * 1e3:.0f} mm off the middle of {support}",
            )
    for other in _involved(case):
        places = tracks.places.get(other, np.zeros((0, 3)))
        if other != case.thing and len(places) > 1:
            moved_m = float(np.linalg.norm(places[-1] - places[0]))
            if moved_m >= params.moved_m:
                return Diagnosis(
                    failure="execution_offset",
                    cause=f"{other} was pushed {moved_m * 1e3:.0f} mm while {case.thing} was handled",
                )
    return None


def _drift_while_closed(case: Case, seconds: Array, held: Array) -> float | None:
    """How far an object moved within a closed hand [m]; None if it was not in one."""
    hand = case.frames.filter((pl.col("entity") == case.hand) & pl.col("grip").is_not_null())
    if hand.is_empty() or not len(seconds):
        return None
    grips = np.interp(seconds, hand["tick_ns"].to_numpy() / 1e9, hand["grip"].to_numpy())
    is_held: NDArray[np.bool_] = (grips < 0.3) & (seconds >= case.since_ns / 1e9)
    inside = held[is_held]
    if len(inside) < 10:
        return None
    # Once it is out of the hand it has slipped all the way: the largest distance counts.
    start = np.median(inside[:5], axis=0)
    smooth = np.stack([np.convolve(inside[:, axis], np.ones(5) / 5, mode="valid") for axis in range(3)], 1)
    return float(np.linalg.norm(smooth - start, axis=1).max())
