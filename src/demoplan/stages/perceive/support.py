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
    n_ticks = len(bodies.tick_ns)
    gaps = np.full((len(groundings), n_ticks), np.nan)
    tops = np.full((len(groundings), n_ticks), -np.inf)
    observed = np.zeros((len(groundings), n_ticks), np.bool_)
    lowest = {rider: heights(bodies.solids[rider])[0] for rider in {rider for rider, _ in groundings}}
    for row, (rider, support) in enumerate(groundings):
        riding, below = bodies.solids[rider], bodies.solids[support]
        aside = np.hypot(*(riding.position_xyz_m - below.position_xyz_m).T[:2])
        near = np.flatnonzero(aside <= below.radius_m + 2.0 * numbers["footprint_margin_m"])
        if len(near):
            over, low = riding.position_xyz_m, lowest[rider]
            if len(near) < n_ticks:
                over, low, below = over[near], low[near], below.take(near)
            top = top_beneath(below, over, numbers["footprint_margin_m"])
            gap = np.abs(low - top)
            gaps[row, near] = gap
            tops[row, near] = np.where(gap <= numbers["exit_m"], top, -np.inf)
        observed[row] = bodies.is_seen[rider] & bodies.is_seen[support]
    uppermost: dict[int, np.typing.NDArray[np.float64]] = {}
    for row, (rider, _support) in enumerate(groundings):
        uppermost[rider] = np.maximum(uppermost.get(rider, np.full(n_ticks, -np.inf)), tops[row])
    is_uppermost = (
        np.stack([tops[row] >= uppermost[rider] for row, (rider, _support) in enumerate(groundings)])
        if groundings
        else np.zeros((0, n_ticks), np.bool_)
    )
    return Evidence(
        (gaps <= numbers["enter_m"]) & is_uppermost, (gaps <= numbers["exit_m"]) & is_uppermost, observed
    )


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
