"""Touching, resting on, and having nothing on top."""

import numpy as np

from demoplan.geometry import heights, top_beneath
from demoplan.stages.perceive.bodies import Bodies
from demoplan.stages.perceive.evidence import (
    FALSE,
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


def in_touch(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The surfaces of x and y are at most ``enter_m`` apart; it ends beyond ``exit_m``."""
    parts = []
    for one, other in groundings:
        distance = bodies.distance(one, other, numbers["exit_m"] * _SLACK)
        parts.append((distance <= numbers["enter_m"], distance <= numbers["exit_m"], np.isfinite(distance)))
    return stacked(parts, len(bodies.tick_ns))


def rests_on(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The middle of x is over y, and y's top beneath it is within ``enter_m`` of x's lowest point.

    That is when gravity keeps a rigid x on y: its centre of mass is over its support. A margin of
    ``footprint_margin_m`` allows for noise at y's edge. Of several bodies that x could rest on, only the
    uppermost counts; x rests whether or not a hand holds it, and ceases beyond ``exit_m``.
    """
    shape = (len(groundings), len(bodies.tick_ns))
    enters, stays, observed = (np.zeros(shape, np.bool_) for _ in range(3))
    riders = {rider for rider, _ in groundings}
    lowest = {rider: heights(bodies.solids[rider])[0] for rider in riders}
    uppermost = {rider: np.full(shape[1], -np.inf) for rider in riders}
    found = []
    for row, (rider, support) in enumerate(groundings):
        observed[row] = bodies.is_seen[rider] & bodies.is_seen[support]
        riding, below = bodies.solids[rider], bodies.solids[support]
        x, y = (riding.position_xyz_m[:, axis] - below.position_xyz_m[:, axis] for axis in (0, 1))
        near = np.flatnonzero(x * x + y * y <= (below.radius_m + 2.0 * numbers["footprint_margin_m"]) ** 2)
        if not len(near):
            continue
        over, low = riding.position_xyz_m, lowest[rider]
        if len(near) < shape[1]:
            over, low, below = over.T[:, near].T, low[near], below.take(near)
        top = top_beneath(below, over, numbers["footprint_margin_m"])
        gap = np.abs(low - top)
        is_close = gap <= numbers["exit_m"]
        if not is_close.all():
            near, gap, top = near[is_close], gap[is_close], top[is_close]
        uppermost[rider][near] = np.maximum(uppermost[rider][near], top)
        found.append((row, rider, near, gap, top))
    for row, rider, near, gap, top in found:
        is_uppermost = top >= uppermost[rider][near]
        stays[row, near] = is_uppermost
        enters[row, near] = is_uppermost & (gap <= numbers["enter_m"])
    return Evidence(enters, stays, observed)


def nothing_on(bodies: Bodies, groundings: Groundings, _: Numbers, known: dict[str, Known]) -> Evidence:
    """No body rests on x and no hand holds it: something can be put on it, and a hand can take it.

    A held body is not free even if it rests somewhere: the hand is where the next body would go. Unknown
    where only unseen bodies could cover or hold it.
    """
    parts = []
    for (thing,) in groundings:
        takers = [codes for pair, codes in known["rests_on"].codes.items() if pair[1] == thing]
        takers += [codes for pair, codes in known["held"].codes.items() if pair[1] == thing]
        all_codes = np.stack(takers) if takers else np.full((1, len(bodies.tick_ns)), FALSE)
        is_taken = (all_codes == TRUE).any(axis=0)
        is_free = ~is_taken & ~(all_codes == UNKNOWN).any(axis=0)
        parts.append((is_free, is_free, is_free | is_taken))
    return stacked(parts, len(bodies.tick_ns))
