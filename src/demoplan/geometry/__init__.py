"""Poses, motion and surfaces, as functions of arrays; nothing here knows tables, logs or predicates.

Positions are ``(n, 3)`` in metres. Orientations are unit quaternions ``(n, 4)`` in the order w, x, y, z,
that rotate vectors of the body into the reference frame. Transforms read right to left:
``point_in_world = world_from_body @ point_in_body``. Not a number stands for what was not observed, and
whatever is computed from it is not a number either.
"""

from demoplan.geometry.motion import speeds, velocities
from demoplan.geometry.rotations import (
    Array,
    are_known,
    compose,
    conjugate,
    continuous,
    inverted,
    matrices,
    multiply,
    normalised,
    rotate,
    slerp,
)
from demoplan.geometry.solids import (
    SOLID_KINDS,
    Solid,
    heights,
    nearest_points,
    surface_distances,
    top_beneath,
)
from demoplan.geometry.switching import Bools, Codes, hysteresis, run_lengths, without_short_runs

__all__ = [
    "SOLID_KINDS",
    "Array",
    "Bools",
    "Codes",
    "Solid",
    "are_known",
    "compose",
    "conjugate",
    "continuous",
    "heights",
    "hysteresis",
    "inverted",
    "matrices",
    "multiply",
    "nearest_points",
    "normalised",
    "rotate",
    "run_lengths",
    "slerp",
    "speeds",
    "surface_distances",
    "top_beneath",
    "velocities",
    "without_short_runs",
]
