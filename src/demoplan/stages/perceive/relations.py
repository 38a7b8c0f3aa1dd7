"""Where objects are, seen from one another: near, inside, above, beside, centred, upright."""

import numpy as np

from demoplan.geometry import Array, heights, top_beneath
from demoplan.stages.perceive.bodies import Bodies
from demoplan.stages.perceive.evidence import Evidence, Groundings, Known, Numbers, stacked


def near(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The surfaces of x and y are at most ``enter_m`` apart; it ends beyond ``exit_m``."""
    return _below(
        [bodies.distance(one, other, numbers["exit_m"] * 1.5) for one, other in groundings],
        numbers,
        "m",
        bodies,
    )


def inside(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The middle of x is at least ``enter_m`` within the hull of y; it ends within ``exit_m`` of leaving.

    Depth is measured along y's axes; a negative number lets x stand out of y.
    """
    parts = []
    for inner, outer in groundings:
        container = bodies.solids[outer]
        away = bodies.solids[inner].position_xyz_m - container.position_xyz_m
        local = np.einsum("nji,nj->ni", container.rotation, away)
        if container.kind == "sphere":
            depth = container.half_xyz_m[0] - np.linalg.norm(local, axis=1)
        elif container.kind == "cylinder":
            aside = container.half_xyz_m[0] - np.hypot(local[:, 0], local[:, 1])
            depth = np.minimum(aside, container.half_xyz_m[2] - np.abs(local[:, 2]))
        else:
            depth = (container.half_xyz_m - np.abs(local)).min(axis=1)
        parts.append((depth >= numbers["enter_m"], depth >= numbers["exit_m"], np.isfinite(depth)))
    return stacked(parts, len(bodies.tick_ns))


def above(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The middle of x is over y, its lowest point at least ``enter_m`` higher than y's top beneath it."""
    parts = []
    for upper, lower in groundings:
        solid = bodies.solids[upper]
        top = top_beneath(bodies.solids[lower], solid.position_xyz_m, numbers["footprint_margin_m"])
        gap = heights(solid)[0] - top
        seen = bodies.is_seen[upper] & bodies.is_seen[lower]
        parts.append((gap >= numbers["enter_m"], gap >= numbers["exit_m"], seen))
    return stacked(parts, len(bodies.tick_ns))


def beside(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """X lies on one side of y: left, right, before, behind, as a vocabulary names it.

    The side is the direction ``direction_rad`` about the world's z from its x (so that with x to the right
    of the viewer, left is π), ``half_angle_rad`` to either side; x is at least ``enter_m`` that way, middle
    to middle (it ends below ``exit_m``), and within ``reach_m``.
    """
    direction = np.array([np.cos(numbers["direction_rad"]), np.sin(numbers["direction_rad"])])
    parts = []
    for one, other in groundings:
        away = (bodies.solids[one].position_xyz_m - bodies.solids[other].position_xyz_m)[:, :2]
        along = away @ direction
        length = np.linalg.norm(away, axis=1)
        is_that_way = along >= np.cos(numbers["half_angle_rad"]) * length
        is_that_way &= length <= numbers["reach_m"]
        parts.append(
            (
                is_that_way & (along >= numbers["enter_m"]),
                is_that_way & (along >= numbers["exit_m"]),
                np.isfinite(along),
            )
        )
    return stacked(parts, len(bodies.tick_ns))


def centred(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The middles of x and y are at most ``enter_m`` apart, seen from above; it ends beyond ``exit_m``."""
    offsets = [
        np.linalg.norm(
            (bodies.solids[one].position_xyz_m - bodies.solids[other].position_xyz_m)[:, :2], axis=1
        )
        for one, other in groundings
    ]
    return _below(offsets, numbers, "m", bodies)


def upright(bodies: Bodies, groundings: Groundings, numbers: Numbers, _: dict[str, Known]) -> Evidence:
    """The z axis of x is within ``enter_rad`` of the world's; it ends beyond ``exit_rad``."""
    angles = []
    for (body,) in groundings:
        is_turned = np.isfinite(bodies.orientation_wxyz[body]).all(axis=1)
        cosine = np.clip(bodies.solids[body].rotation[:, 2, 2], -1.0, 1.0)
        angles.append(np.where(is_turned, np.arccos(cosine), np.nan))
    return _below(angles, numbers, "rad", bodies)


def _below(values: list[Array], numbers: Numbers, unit: str, bodies: Bodies) -> Evidence:
    """Evidence of values that must be small."""
    return stacked(
        [
            (value <= numbers[f"enter_{unit}"], value <= numbers[f"exit_{unit}"], np.isfinite(value))
            for value in values
        ],
        len(bodies.tick_ns),
    )
