"""What is in a hand: by grip and contact, or, without a grip signal, by moving together."""

import numpy as np

from demoplan.geometry import Array, Bools, conjugate, hysteresis, rotate, velocities
from demoplan.stages.perceive.bodies import Bodies
from demoplan.stages.perceive.evidence import Evidence, Groundings, Known, Numbers


def held(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The object o is in hand h.

    With a grip signal: the hand is closed (below ``closed_fraction``, until above ``open_fraction``) and o
    is the nearest object within ``enter_m`` of it; it was so when the hand closed, or o moves with the hand
    (so that a fist passing over an object does not hold it). It ends when the hand opens or o is farther than
    ``exit_m``: dropped.

    Without: o is within ``enter_m`` of h and faster than ``carry_m_per_s``, while the hand sees it move at
    less than ``slip_ratio`` of that. It began when they came to rest against each other
    (within ``slip_m_per_s``), and lasts until o is farther than ``exit_m``, or h moves away while o lies
    still.
    """
    n, n_ticks = len(groundings), len(bodies.tick_ns)
    enters = np.zeros((n, n_ticks), np.bool_)
    stays = np.zeros((n, n_ticks), np.bool_)
    observed = np.zeros((n, n_ticks), np.bool_)
    rows_of: dict[int, list[int]] = {}
    for row, (hand, _object) in enumerate(groundings):
        rows_of.setdefault(hand, []).append(row)
    for hand, rows in rows_of.items():
        objects = [groundings[row][1] for row in rows]
        distance = np.stack([bodies.distance(hand, other) for other in objects])
        near = distance <= numbers["enter_m"]
        nearest = near & (distance <= np.where(near, distance, np.inf).min(axis=0))
        grip = bodies.grip[hand]
        if np.isfinite(grip).any():
            closed = hysteresis(grip <= numbers["closed_fraction"], ~(grip >= numbers["open_fraction"]))
            at_closing = _at_onset(closed, distance <= numbers["exit_m"])
            grasped = closed & nearest & at_closing
            if (closed & nearest & ~at_closing).any():
                grasped |= closed & nearest & _together(bodies, hand, objects, numbers)
            enters[rows] = grasped
            stays[rows] = closed & (distance <= numbers["exit_m"])
            observed[rows] = np.isfinite(distance) & np.isfinite(grip)
        else:
            carried = nearest & _together(bodies, hand, objects, numbers)
            slip, speed = _slip(bodies, hand, objects), np.nan_to_num(bodies.speed(objects))
            enters[rows], stays[rows] = _by_motion(distance, carried, slip, speed, numbers)
            observed[rows] = np.isfinite(distance)
    return Evidence(enters, stays, observed)


def _together(bodies: Bodies, hand: int, objects: list[int], numbers: Numbers) -> Bools:
    """Where objects ``(k, n)`` move with the hand."""
    slip, speed = _slip(bodies, hand, objects), bodies.speed(objects)
    return np.asarray((speed > numbers["carry_m_per_s"]) & (slip <= numbers["slip_ratio"] * speed))


def _slip(bodies: Bodies, hand: int, objects: list[int]) -> Array:
    """Speeds [m/s] ``(k, n)`` of objects as the hand sees them: 0 for what it carries, however it turns.

    Without an orientation of the hand, differences of velocities, which turning makes larger.
    """
    away = bodies.position_xyz_m[objects] - bodies.position_xyz_m[hand]
    turned = bodies.orientation_wxyz[hand]
    seen_by_hand = rotate(np.broadcast_to(conjugate(turned), (*away.shape[:-1], 4)), away)
    in_hand_frame = velocities(seen_by_hand, bodies.tick_s, bodies.velocity_window_s)
    in_world = bodies.velocity(objects) - bodies.velocity([hand])
    is_turned = np.isfinite(turned).all(axis=-1, keepdims=True) & np.isfinite(in_hand_frame)
    return np.asarray(np.linalg.norm(np.where(is_turned, in_hand_frame, in_world), axis=-1))


def _at_onset(state: Bools, condition: Bools) -> Bools:
    """Where a state ``(n,)`` holds: whether the condition ``(k, n)`` held when it began."""
    begins = state & ~np.append(False, state[:-1])
    ticks = np.arange(len(state))
    onset = np.maximum.accumulate(np.where(begins, ticks, 0))
    return np.asarray(state & condition[:, onset])


def _by_motion(
    distance: Array, carried: Bools, slip: Array, speed: Array, numbers: Numbers
) -> tuple[Bools, Bools]:
    """Held by moving together: enters and stays ``(k, n)``, extended back to when the hand came to rest."""
    is_left = (slip > numbers["slip_m_per_s"]) & (speed <= numbers["carry_m_per_s"])
    stays = (distance <= numbers["exit_m"]) & ~is_left
    resting = (distance <= numbers["exit_m"]) & (slip <= numbers["slip_m_per_s"])
    before = hysteresis(carried[:, ::-1], (resting | carried)[:, ::-1])[:, ::-1]
    return carried | before, stays
