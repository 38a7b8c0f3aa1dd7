"""What a participant did when: true activities, from intentions and physics, never from what a rig saw.

The definitions, which ``datasets/cube-stacking/README.md`` repeats in prose:

- Reach begins when, with the intention to take a cube, the hand's intended speed first exceeds
  ``moving_m_per_s``.
- Take begins when, at the object, the trigger first leaves its open end by ``trigger_margin``.
- Put begins when, with the intention to carry, the intended speed first exceeds ``moving_m_per_s`` and the
  cube comes along. Did it not come along, Release begins there instead; is it lost on the way, Release begins
  when it is lost.
- Release begins when the trigger first leaves its closed end by ``trigger_margin``.
- Idle begins when, with nothing in the hand and nothing begun, the intended speed stays at or below
  ``moving_m_per_s`` for at least ``shortest_rest_s``. A shorter stop belongs to what was before it.

Hesitations, loosening and closing the grip again at the object, and waits before the trigger moves belong
to the activity in which they happen.
"""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.engines.mujoco.demonstration import Demonstration, HandArrays, Phase


@dataclass(frozen=True, kw_only=True)
class LabelParams:
    """Thresholds of the true labels."""

    moving_m_per_s: float = 0.03
    trigger_margin: float = 0.05
    shortest_rest_s: float = 0.20
    carried_m: float = 0.010
    """A cube that came along less far than that was not carried [m]."""


@dataclass(frozen=True)
class LabelledStretch:
    """One hand doing one thing, on the demonstration's clock."""

    start_s: float
    end_s: float
    activity: str
    acted_on: str | None
    in_hand: str | None


def label(
    demonstration: Demonstration, hand: str, params: LabelParams = LabelParams()
) -> tuple[LabelledStretch, ...]:
    """True activities of one hand, which tile the demonstration without gap or overlap.

    Args:
        demonstration: What really happened.
        hand: The hand.
        params: Thresholds.
    """
    arrays = demonstration.hands[hand]
    times = demonstration.time_s
    marks = _marks(demonstration, arrays, params)
    starts = [0, *(tick for tick, *_ in marks)]
    states: list[tuple[str, str | None, str | None]] = [("Idle", None, None), *(mark[1:] for mark in marks)]
    end_s = float(times[-1] + (times[1] - times[0]))
    stretches: list[LabelledStretch] = []
    for k, (tick, state) in enumerate(zip(starts, states, strict=True)):
        start = float(times[tick])
        end = float(times[starts[k + 1]]) if k + 1 < len(starts) else end_s
        if end > start:
            stretches.append(LabelledStretch(start, end, *state))
    return tuple(stretches)


def _first(condition: NDArray[np.bool_], start: int, end: int) -> int | None:
    """First tick in ``[start, end)`` at which a condition holds."""
    hits = np.flatnonzero(condition[start:end])
    return start + int(hits[0]) if hits.size else None


def _marks(
    demonstration: Demonstration, arrays: HandArrays, params: LabelParams
) -> list[tuple[int, str, str | None, str | None]]:
    """(tick, activity, acted on, in hand) wherever a new activity begins, in order of time."""
    moving = arrays.speed_m_per_s > params.moving_m_per_s
    closing = arrays.trigger > params.trigger_margin
    opening = arrays.trigger < 1.0 - params.trigger_margin
    cuts = np.flatnonzero((np.diff(arrays.phase) != 0) | (np.diff(arrays.step) != 0)) + 1
    bounds = [0, *(int(cut) for cut in cuts), len(arrays.phase)]
    shortest_rest = params.shortest_rest_s / float(demonstration.time_s[1] - demonstration.time_s[0])
    marks: list[tuple[int, str, str | None, str | None]] = []
    may_rest_from: int | None = None

    def rest_until(tick: int) -> None:
        """Insert Idle if the hand came to rest, long enough, between its last release and ``tick``."""
        if may_rest_from is None:
            return
        last_moved = np.flatnonzero(moving[may_rest_from:tick])
        begin = may_rest_from + (int(last_moved[-1]) + 1 if last_moved.size else 0)
        if tick - begin >= shortest_rest:
            marks.append((begin, "Idle", None, None))

    for start, end in itertools.pairwise(bounds):
        phase, number = Phase(int(arrays.phase[start])), int(arrays.step[start])
        if number < 0:
            continue
        step = demonstration.task.steps[number]
        if phase is Phase.APPROACH:
            begin = _first(moving, start, end)
            begin = start if begin is None else begin
            rest_until(begin)
            may_rest_from = None
            marks.append((begin, "Reach", step.cube, None))
        elif phase is Phase.GRASP:
            begin = _first(closing, start, end)
            marks.append((start if begin is None else begin, "Take", step.cube, None))
        elif phase is Phase.CARRY:
            begin = _first(moving, start, end)
            begin = start if begin is None else begin
            lost = _lost(demonstration, arrays, step.cube, begin, end, params)
            if lost != begin:
                # The hand that will carry the cube holds it by the end of Take.
                tick, activity, acted_on, _ = marks[-1]
                marks[-1] = (tick, activity, acted_on, step.cube)
                marks.append((begin, "Put", step.onto, step.cube))
            if lost is not None:
                marks.append((lost, "Release", step.cube, None))
                may_rest_from = None
        elif phase is Phase.LET_GO:
            begin = _first(opening, start, end)
            if marks[-1][1] != "Release":
                marks.append((start if begin is None else begin, "Release", step.cube, None))
            may_rest_from = end
        elif may_rest_from is None:
            may_rest_from = start
    rest_until(len(arrays.phase))
    return marks


def _lost(
    demonstration: Demonstration, arrays: HandArrays, cube: str, begin: int, end: int, params: LabelParams
) -> int | None:
    """When a cube that was to be carried in ``[begin, end)`` was no longer in the hand; null if it stayed."""
    gone = _first(~arrays.is_held, begin, end)
    if gone is None:
        return None
    path = demonstration.cube_position_xyz_m[begin : gone + 1, demonstration.cubes.index(cube)]
    came_along = np.linalg.norm(path - path[0], axis=1).max(initial=0.0)
    return gone if came_along > params.carried_m else begin
