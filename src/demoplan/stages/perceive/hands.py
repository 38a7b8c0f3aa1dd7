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
        speed = bodies.speed[body]
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

    It begins with o the nearest by surface of the bodies within ``enter_m`` that the gap to h closes by at
    least ``approach_m_per_s`` and by ``heading_ratio`` of the hand's speed, so that what lies beside the
    path does not count. Bodies that the mapping fixes, as a table, count only where no other does: an
    object on a table is nearly always farther than the table. It ends beyond ``exit_m``, when the gap
    grows by ``recede_m_per_s``, when the hand takes o, or turns to another. What the hand holds is left
    out, and nothing else of its class.

    Source: the rule 'nearest object within 0.15 m while the hand approaches it' of K. Ramirez-Amaro,
    M. Beetz, G. Cheng, "Transferring skills to humanoid robots by extracting semantic representations from
    observations of human activities", Artificial Intelligence 247 (2017), doi:10.1016/j.artint.2015.08.009;
    surface distance, heading and the order of fixed bodies are ours.
    """
    n_ticks = len(bodies.tick_ns)
    n = len(groundings)
    distance = np.full((n, n_ticks), np.nan)
    is_held = np.zeros((n, n_ticks), np.bool_)
    for row, (hand, target) in enumerate(groundings):
        distance[row] = bodies.distance(hand, target)
        is_held[row] = known["held"].state(hand, target) == TRUE
    rate = bodies.slope(distance)
    hand_rows = np.array([hand for hand, _ in groundings], np.int64)
    is_fixed = np.array([bodies.is_fixed[target] for _, target in groundings], np.bool_)
    speed = bodies.speed[hand_rows] if n else distance
    least = np.maximum(numbers["approach_m_per_s"], numbers["heading_ratio"] * speed)
    closes = (distance <= numbers["enter_m"]) & (-rate >= least) & ~is_held
    enters = np.zeros((n, n_ticks), np.bool_)
    for hand in np.unique(hand_rows):
        for rows in (
            np.flatnonzero((hand_rows == hand) & ~is_fixed),
            np.flatnonzero((hand_rows == hand) & is_fixed),
        ):
            taken = enters[hand_rows == hand].any(axis=0)
            enters[rows] = _nearest(distance[rows], closes[rows]) & ~taken
    stays = (distance <= numbers["exit_m"]) & (rate < numbers["recede_m_per_s"]) & ~is_held
    for hand in np.unique(hand_rows):
        rows = np.flatnonzero(hand_rows == hand)
        stays[rows] &= ~(enters[rows].any(axis=0) & ~enters[rows])
    return Evidence(enters, stays, np.isfinite(distance) & np.isfinite(rate))


def _nearest(distance: Array, candidates: Bools) -> Bools:
    """Of the candidates ``(k, n)`` at each tick, the nearest alone; of equals, the first."""
    if len(distance) == 0:
        return candidates
    masked = np.where(candidates, distance, np.inf)
    first = masked.argmin(axis=0)
    return np.asarray(candidates & (np.arange(len(distance))[:, None] == first))
