"""What hands do: open, move, come near enough to grasp, approach."""

import numpy as np

from demoplan.geometry import Array, Bools
from demoplan.stages.perceive.bodies import Bodies
from demoplan.stages.perceive.evidence import (
    TRUE,
    UNKNOWN,
    Evidence,
    Groundings,
    Known,
    Numbers,
    stacked,
)

_SLACK = 1.5
"""Distances are asked for exactly up to this multiple of the threshold."""


def hand_open(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The grip of h is open by at least ``enter_fraction``; it ends below ``exit_fraction``.

    Without a grip signal it is unknown: whether a hand is open cannot be told from where it is.
    """
    parts = []
    for (hand,) in groundings:
        grip = bodies.grip[hand]
        parts.append((grip >= numbers["enter_fraction"], grip >= numbers["exit_fraction"], np.isfinite(grip)))
    return stacked(parts, len(bodies.tick_ns))


def moving(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The tracked point of x is faster than ``enter_m_per_s``; it ends below ``exit_m_per_s``."""
    parts = []
    for (body,) in groundings:
        speed = bodies.speed([body])[0]
        parts.append((speed > numbers["enter_m_per_s"], speed >= numbers["exit_m_per_s"], np.isfinite(speed)))
    return stacked(parts, len(bodies.tick_ns))


def can_grasp(bodies: Bodies, groundings: Groundings, numbers: Numbers, known: dict[str, Known]) -> Evidence:
    """The hand h is open, holds nothing, and its surface is within ``enter_m`` of o's.

    Far is false whatever the grip; near with an unknown grip is unknown.
    """
    parts = []
    held = known["held"]
    for hand, target in groundings:
        distance = bodies.distance(hand, target, numbers["exit_m"] * 1.5)
        openness = known["hand_open"].state(hand)
        is_full = np.zeros(len(distance), np.bool_)
        for (holder, _held), codes in held.codes.items():
            if holder == hand:
                is_full |= codes == TRUE
        is_able = (openness == TRUE) & ~is_full
        is_near = distance <= numbers["exit_m"]
        parts.append(
            (
                is_able & (distance <= numbers["enter_m"]),
                is_able & is_near,
                np.isfinite(distance) & ((openness != UNKNOWN) | ~is_near | is_full),
            )
        )
    return stacked(parts, len(bodies.tick_ns))


def approached(bodies: Bodies, groundings: Groundings, numbers: Numbers, known: dict[str, Known]) -> Evidence:
    """The body o is what h moves towards, or has come to and not left: one at a time.

    It begins with o the nearest by surface of the bodies within ``enter_m`` that h itself moves towards, by
    at least ``approach_m_per_s`` and ``heading_ratio`` of its speed: neither what lies beside the path
    counts, nor what another hand brings near. Bodies that nothing moves, as a table, count only where no
    other does, and the hand is not at another (within ``rest_m``): an object on a table is nearly always
    farther than the table. It ends when h moves away by
    ``recede_m_per_s``, is farther than ``exit_m``, rests (slower than ``approach_m_per_s``) farther than
    ``rest_m``, takes o, or turns to another. What the hand holds is left out, and nothing else of its class.

    Source: the rule 'nearest object within 0.15 m while the hand approaches it' of K. Ramirez-Amaro,
    M. Beetz, G. Cheng, "Transferring skills to humanoid robots by extracting semantic representations from
    observations of human activities", Artificial Intelligence 247 (2017), doi:10.1016/j.artint.2015.08.009;
    surface distance, heading, rest and the order of fixed bodies are ours.
    """
    n_ticks = len(bodies.tick_ns)
    enters, stays, observed = (np.zeros((len(groundings), n_ticks), np.bool_) for _ in range(3))
    rows_of: dict[int, list[int]] = {}
    for row, (hand, _target) in enumerate(groundings):
        rows_of.setdefault(hand, []).append(row)
    for hand, rows in rows_of.items():
        targets = [groundings[row][1] for row in rows]
        reach_m = max(numbers["enter_m"], numbers["exit_m"])
        distance = np.stack([bodies.distance(hand, target, reach_m * _SLACK) for target in targets])
        closing = np.zeros_like(distance)
        for row, target in enumerate(targets):
            near = np.flatnonzero(distance[row] <= reach_m)
            closing[row, near] = bodies.closing_speed(hand, target, near)
        is_held = np.stack([known["held"].state(hand, target) == TRUE for target in targets])
        speed = bodies.speed([hand])[0]
        least = np.maximum(numbers["approach_m_per_s"], numbers["heading_ratio"] * speed)
        candidates = (distance <= numbers["enter_m"]) & (closing >= least) & ~is_held
        is_fixed = np.array([bodies.is_fixed[target] for target in targets])
        is_at = (distance <= numbers["rest_m"]) & ~is_held
        candidates[is_fixed] &= ~(candidates | is_at)[~is_fixed].any(axis=0)
        begins = _nearest(distance, candidates)
        is_there = (speed >= numbers["approach_m_per_s"]) | (distance <= numbers["rest_m"])
        goes_on = (distance <= numbers["exit_m"]) & (closing > -numbers["recede_m_per_s"]) & is_there
        enters[rows] = begins
        stays[rows] = goes_on & ~is_held & ~(begins.any(axis=0) & ~begins)
        observed[rows] = np.isfinite(distance) & np.isfinite(speed)
    return Evidence(enters, stays, observed)


def _nearest(distance: Array, candidates: Bools) -> Bools:
    """Of the candidates ``(k, n)`` at each tick, the nearest alone; of equals, the first."""
    if len(distance) == 0:
        return candidates
    masked = np.where(candidates, distance, np.inf)
    first = masked.argmin(axis=0)
    return np.asarray(candidates & (np.arange(len(distance))[:, None] == first))
