"""Boxes, cylinders, spheres and points: distances between their surfaces, and what lies beneath what.

Where one of two solids is a point or a sphere, or both are boxes, distances are exact and closed; where a
cylinder meets a box or a cylinder they converge from above (see :func:`surface_distances`).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from demoplan.geometry.rotations import Array, are_known, matrices, normalised, rotate
from demoplan.geometry.switching import Bools

SOLID_KINDS = ("box", "cylinder", "point", "sphere")

_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_RIM = np.array(
    [
        [np.cos(angle), np.sin(angle), z]
        for z in (-1.0, 0.0, 1.0)
        for angle in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    ]
)
_N_PROJECTIONS = 40
_CHUNK_ROWS = 4096
"""Poses are gone through in chunks so that what is worked on stays in the processor's cache."""


@dataclass(frozen=True, eq=False)
class Solid:
    """One convex body, at ``n`` poses. NaN where its pose is not known."""

    kind: str
    """One of :data:`SOLID_KINDS`; a cylinder's axis is its z axis, its radius half its x extent."""
    half_xyz_m: Array
    """Half extents ``(3,)`` along the body's axes."""
    position_xyz_m: Array
    """Where its middle is ``(n, 3)``."""
    rotation: Array
    """World from body ``(n, 3, 3)``."""

    @classmethod
    def placed(
        cls,
        kind: str,
        size_xyz_m: Array,
        centre_xyz_m: Array,
        positions_xyz_m: Array,
        orientations_wxyz: Array,
    ) -> Self:
        """A solid about a tracked origin.

        Args:
            kind: One of :data:`SOLID_KINDS`.
            size_xyz_m: Full extents ``(3,)``.
            centre_xyz_m: Where the middle lies ``(3,)``, seen from the tracked origin, in the body's axes.
            positions_xyz_m: Tracked origin ``(n, 3)``.
            orientations_wxyz: Body to world ``(n, 4)``; NaN rows with a known position, as of a sensor that
                tells no orientation, count as not rotated.
        """
        identity = np.array([1.0, 0.0, 0.0, 0.0])
        is_turned = are_known(orientations_wxyz)[..., None]
        turned = normalised(
            orientations_wxyz if is_turned.all() else np.where(is_turned, orientations_wxyz, identity)
        )
        middle = positions_xyz_m
        if np.any(centre_xyz_m):
            middle = positions_xyz_m + rotate(turned, np.broadcast_to(centre_xyz_m, positions_xyz_m.shape))
        half = np.zeros(3) if kind == "point" else np.asarray(size_xyz_m, np.float64) / 2.0
        return cls(kind, half, np.asfortranarray(middle), matrices(turned))

    @property
    def radius_m(self) -> float:
        """Radius of the smallest ball about the middle that holds the whole body."""
        if self.kind == "sphere":
            return float(self.half_xyz_m[0])
        if self.kind == "cylinder":
            return float(np.hypot(self.half_xyz_m[0], self.half_xyz_m[2]))
        return float(np.linalg.norm(self.half_xyz_m))

    def take(self, rows: NDArray[np.intp] | slice) -> "Solid":
        """The same solid, at some of its poses only."""
        if isinstance(rows, slice):
            return Solid(self.kind, self.half_xyz_m, self.position_xyz_m[rows], self.rotation[rows])
        # Along the last axis of the transposed arrays, so that entries stay together in memory.
        position = self.position_xyz_m.T[:, rows].T
        rotation = self.rotation.transpose(1, 2, 0)[..., rows].transpose(2, 0, 1)
        return Solid(self.kind, self.half_xyz_m, position, rotation)


def surface_distances(a: Solid, b: Solid, exact_below_m: float = np.inf) -> Array:
    """Distances [m] ``(n,)`` between the surfaces of two solids; 0 where they touch or overlap.

    Args:
        a: One solid, at n poses.
        b: The other, at the same n poses.
        exact_below_m: What is certainly farther apart than this may be given as a lower bound that is
            itself not below it; asking for less costs less.

    Returns:
        Distances, NaN where a pose is not known. Box to box is exact: the distance of disjoint convex bodies
        is the largest gap that any direction shows, and that direction is one of the fifteen of the
        separating-axis test, or (where a corner takes part) the line from the nearest corner. With a
        cylinder against a box or a cylinder, alternating projections from the nearest of a set of surface
        points give an upper bound, within 2 % of the smaller body's size of the truth.

        Source: S. Gottschalk, M. C. Lin, D. Manocha, "OBBTree", SIGGRAPH 1996, doi:10.1145/237170.237244,
        section 5 (separating axes); W. Cheney, A. A. Goldstein, "Proximity maps for convex sets", Proc. AMS
        10 (1959), doi:10.1090/S0002-9939-1959-0105008-8 (alternating projections).
    """
    between = b.position_xyz_m - a.position_xyz_m
    centres = np.sqrt(np.einsum("ni,ni->n", between, between))
    distances: Array = np.maximum(centres - (a.radius_m + b.radius_m), 0.0)
    round_a, round_b = a.kind in ("point", "sphere"), b.kind in ("point", "sphere")
    if round_a and round_b:
        return distances
    near = np.flatnonzero(distances < exact_below_m)
    if len(near) == 0:
        return distances
    every = len(near) == len(distances)
    for start in range(0, len(near), _CHUNK_ROWS):
        rows = slice(start, start + _CHUNK_ROWS) if every else near[start : start + _CHUNK_ROWS]
        near_a, near_b = a.take(rows), b.take(rows)
        if round_a or round_b:
            ball, other = (near_a, near_b) if round_a else (near_b, near_a)
            exact = _point_to(other, ball.position_xyz_m) - ball.radius_m
        elif a.kind == b.kind == "box":
            exact = _box_to_box(near_a, near_b, exact_below_m)
        else:
            exact = _by_projections(near_a, near_b)
        distances[rows] = np.maximum(exact, 0.0)
    return distances


def nearest_points(solid: Solid, points_xyz_m: Array) -> Array:
    """Points ``(n, 3)`` of a solid that are nearest to given ones ``(n, 3)``, one for each pose.

    A point within the solid is its own nearest point. NaN where a pose is not known.
    """
    if solid.kind in ("point", "sphere"):
        away = points_xyz_m - solid.position_xyz_m
        length = np.linalg.norm(away, axis=-1, keepdims=True)
        shrink = np.minimum(1.0, solid.radius_m / np.maximum(length, 1e-12))
        return np.asarray(solid.position_xyz_m + away * shrink)
    return _in_world(solid, _nearest_in_body(solid, _in_body(solid, points_xyz_m)))


def heights(solid: Solid) -> tuple[Array, Array]:
    """Lowest and highest point [m] of a solid along the world's z ``(n,)`` each."""
    if solid.kind == "sphere":
        reach: Array | float = solid.radius_m
    elif solid.kind == "cylinder":
        upright = np.clip(np.abs(solid.rotation[:, 2, 2]), 0.0, 1.0)
        reach = upright * solid.half_xyz_m[2] + np.sqrt(1.0 - upright**2) * solid.half_xyz_m[0]
    else:
        reach = np.abs(solid.rotation[:, 2, :]) @ solid.half_xyz_m
    middle = solid.position_xyz_m[:, 2]
    return middle - reach, middle + reach


def top_beneath(support: Solid, points_xyz_m: Array, margin_m: float = 0.0) -> Array:
    """Height [m] ``(n,)`` at which the vertical line through each point leaves a solid at its top.

    Args:
        support: The solid, at n poses; a point supports nothing.
        points_xyz_m: ``(n, 3)``; only x and y count.
        margin_m: A line that passes within this of the solid still counts.

    Returns:
        Heights; NaN where the line misses the solid, or a pose is not known.
    """
    if len(points_xyz_m) > _CHUNK_ROWS:
        chunks = [slice(i, i + _CHUNK_ROWS) for i in range(0, len(points_xyz_m), _CHUNK_ROWS)]
        return np.concatenate(
            [top_beneath(support.take(rows), points_xyz_m[rows], margin_m) for rows in chunks]
        )
    half = support.half_xyz_m
    away = points_xyz_m - support.position_xyz_m
    if support.kind == "point":
        return np.full(len(points_xyz_m), np.nan)
    if support.kind == "sphere":
        aside = np.hypot(away[:, 0], away[:, 1])
        top = support.position_xyz_m[:, 2] + np.sqrt(np.maximum(half[0] ** 2 - aside**2, 0.0))
        return np.where(aside <= half[0] + margin_m, top, np.nan)
    # Line o + t·u in the body's axes; it is inside a slab for t between the two crossings of its faces.
    origin = _turned_back(support.rotation, away)
    upward = support.rotation[:, 2, :]
    enters, leaves, steepest = np.full(len(away), -np.inf), np.full(len(away), np.inf), np.zeros(len(away))
    for axis in range(3):
        along = np.abs(upward[:, axis])
        slope = np.where(along < 1e-9, 1e-9, upward[:, axis])
        first = (-half[axis] - margin_m - origin[:, axis]) / slope
        second = (half[axis] + margin_m - origin[:, axis]) / slope
        np.maximum(enters, np.minimum(first, second), out=enters)
        np.minimum(leaves, np.maximum(first, second), out=leaves)
        np.maximum(steepest, along, out=steepest)
    hits = enters <= leaves
    if support.kind == "cylinder":
        at_top = origin + leaves[:, None] * upward
        hits &= np.hypot(at_top[:, 0], at_top[:, 1]) <= half[0] + margin_m + 1e-9
    top = points_xyz_m[:, 2] + leaves - margin_m / steepest
    return np.where(hits, top, np.nan)


def _in_body(solid: Solid, points_xyz_m: Array) -> Array:
    """Points ``(n, …, 3)`` in the solid's own axes, about its middle."""
    if points_xyz_m.ndim == 2:
        away = points_xyz_m - solid.position_xyz_m
        return _turned_back(solid.rotation, away)
    middle = solid.position_xyz_m.reshape(-1, *(1,) * (points_xyz_m.ndim - 2), 3)
    return np.asarray(np.einsum("nji,n...j->n...i", solid.rotation, points_xyz_m - middle))


def _turned_back(rotation: Array, vectors: Array) -> Array:
    """World vectors ``(n, 3)`` in a body's axes; entry by entry is faster than products of small matrices."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    result = np.empty((3, len(vectors)))
    for axis in range(3):
        result[axis] = rotation[:, 0, axis] * x + rotation[:, 1, axis] * y + rotation[:, 2, axis] * z
    return result.T


def _in_world(solid: Solid, points_in_body_m: Array) -> Array:
    if points_in_body_m.ndim == 2:
        x, y, z = points_in_body_m.T
        world = np.empty((3, len(points_in_body_m)))
        for axis in range(3):
            row = solid.rotation[:, axis]
            world[axis] = row[:, 0] * x + row[:, 1] * y + row[:, 2] * z + solid.position_xyz_m[:, axis]
        return world.T
    middle = solid.position_xyz_m.reshape(-1, *(1,) * (points_in_body_m.ndim - 2), 3)
    return np.asarray(np.einsum("nij,n...j->n...i", solid.rotation, points_in_body_m) + middle)


def _nearest_in_body(solid: Solid, local_m: Array) -> Array:
    """Nearest points of a box or cylinder to points, both in its own axes."""
    if solid.kind == "box":
        return np.clip(local_m, -solid.half_xyz_m, solid.half_xyz_m)
    radius, half_z = solid.half_xyz_m[0], solid.half_xyz_m[2]
    aside = np.hypot(local_m[..., 0], local_m[..., 1])
    shrink = np.minimum(1.0, radius / np.maximum(aside, 1e-12))
    return np.stack(
        (local_m[..., 0] * shrink, local_m[..., 1] * shrink, np.clip(local_m[..., 2], -half_z, half_z)),
        axis=-1,
    )


def _point_to(solid: Solid, points_xyz_m: Array) -> Array:
    local = _in_body(solid, points_xyz_m)
    return np.asarray(np.linalg.norm(local - _nearest_in_body(solid, local), axis=-1))


def _box_to_box(a: Solid, b: Solid, exact_below_m: float) -> Array:
    """Largest gap over the separating axes, and over the line from the nearest corner where that may win.

    Where the gap is largest along the normal of a face, and the other box's corner nearest to that face lies
    over it, the corner's height is the distance: no other direction has to be tried. So it is of bodies that
    rest on each other, nearly always.
    """
    # The larger box first: a smaller one mostly lies over one of its faces, which settles the matter.
    if b.radius_m > a.radius_m:
        a, b = b, a
    axes_a = [[a.rotation[:, row, i] for row in range(3)] for i in range(3)]
    axes_b = [[b.rotation[:, row, j] for row in range(3)] for j in range(3)]
    turn = [[_sum(u[0] * v[0], u[1] * v[1], u[2] * v[2]) for v in axes_b] for u in axes_a]
    away = [b.position_xyz_m[:, row] - a.position_xyz_m[:, row] for row in range(3)]
    apart_a = [_sum(u[0] * away[0], u[1] * away[1], u[2] * away[2]) for u in axes_a]
    largest, is_settled = _gap_of_faces(turn, apart_a, a.half_xyz_m, b.half_xyz_m)
    rows = np.flatnonzero((largest < exact_below_m) & ~is_settled)
    if len(rows):
        every = len(rows) == len(largest)
        back = [[turn[i][j] if every else turn[i][j][rows] for i in range(3)] for j in range(3)]
        apart_b = [_sum(*(v[row][rows] * away[row][rows] for row in range(3))) for v in axes_b]
        other, is_settled = _gap_of_faces(back, [-apart for apart in apart_b], b.half_xyz_m, a.half_xyz_m)
        is_open = ~(is_settled & (other > largest[rows]))
        largest[rows] = np.maximum(largest[rows], other)
        rows = rows[is_open & (largest[rows] < exact_below_m)]
    if len(rows):
        largest[rows] = np.maximum(
            largest[rows],
            _gap_of_edges(
                [[entry[rows] for entry in row] for row in turn],
                [entry[rows] for entry in apart_a],
                a.half_xyz_m,
                b.half_xyz_m,
            ),
        )
        rows = rows[(largest[rows] > 0.0) & (largest[rows] < exact_below_m)]
    if len(rows):
        some_a, some_b = a.take(rows), b.take(rows)
        largest[rows] = np.maximum(
            largest[rows],
            np.maximum(_gap_from_corner(some_a, some_b), _gap_from_corner(some_b, some_a)),
        )
    return largest


def _gap_of_faces(
    turn: list[list[Array]], apart: list[Array], half: Array, other: Array
) -> tuple[Array, Bools]:
    """Largest gap along the normals of one box's faces, and whether a corner of the other lies over the face.

    Args:
        turn: Cosines between the box's axes (outer) and the other's (inner).
        apart: The other's middle, in the box's axes.
        half: Half extents of the box.
        other: Half extents of the other.
    """
    gaps = []
    for i in range(3):
        reach = _sum(
            other[0] * np.abs(turn[i][0]), other[1] * np.abs(turn[i][1]), other[2] * np.abs(turn[i][2])
        )
        gaps.append(np.abs(apart[i]) - half[i] - reach)
    largest = np.maximum(np.maximum(gaps[0], gaps[1]), gaps[2])
    is_settled = np.zeros(len(largest), np.bool_)
    for i in range(3):
        rows = np.flatnonzero((gaps[i] == largest) & (largest > -half[i]))
        if not len(rows):
            continue
        every = len(rows) == len(largest)
        side = np.sign(apart[i] if every else apart[i][rows])
        corner = [side * other[j] * np.sign(turn[i][j] if every else turn[i][j][rows]) for j in range(3)]
        is_over = np.ones(len(rows), np.bool_)
        for k in ((i + 1) % 3, (i + 2) % 3):
            along, cosines = apart[k], turn[k]
            if not every:
                along, cosines = along[rows], [cosine[rows] for cosine in cosines]
            place = along - _sum(corner[0] * cosines[0], corner[1] * cosines[1], corner[2] * cosines[2])
            is_over &= np.abs(place) <= half[k]
        is_settled[rows] = is_over
    return largest, is_settled


def _gap_of_edges(turn: list[list[Array]], apart: list[Array], half_a: Array, half_b: Array) -> Array:
    """Largest gap of two boxes along the cross products of their edges; parallel edges show nothing new."""
    spread = [[np.abs(entry) for entry in row] for row in turn]
    largest: Array = np.full(len(apart[0]), -np.inf)
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            squared = 1.0 - turn[i][j] ** 2
            gap = np.abs(apart[i2] * turn[i1][j] - apart[i1] * turn[i2][j])
            gap -= half_a[i1] * spread[i2][j] + half_a[i2] * spread[i1][j]
            gap -= half_b[j1] * spread[i][j2] + half_b[j2] * spread[i][j1]
            gap /= np.sqrt(np.maximum(squared, 1e-12))
            np.maximum(largest, np.where(squared > 1e-12, gap, -np.inf), out=largest)
    return largest


def _sum(x: Array, y: Array, z: Array) -> Array:
    return x + y + z


def _gap_from_corner(a: Solid, b: Solid) -> Array:
    """Gap of two boxes along the line from a's corner nearest to b to its nearest point on b."""
    corners = _in_world(a, np.broadcast_to(_CORNERS * a.half_xyz_m, (len(a.position_xyz_m), 8, 3)))
    local = _in_body(b, corners)
    offsets = local - _nearest_in_body(b, local)
    lengths = np.linalg.norm(offsets, axis=-1)
    nearest = lengths.argmin(axis=1)
    rows = np.arange(len(nearest))
    length = lengths[rows, nearest]
    # A direction in b's axes, from b to a; the gap along it is what remains of the middles' distance.
    direction = offsets[rows, nearest] / np.maximum(length, 1e-12)[:, None]
    in_world = np.einsum("nij,nj->ni", b.rotation, direction)
    middles = np.einsum("ni,ni->n", in_world, a.position_xyz_m - b.position_xyz_m)
    reach_a = np.abs(np.einsum("nij,ni->nj", a.rotation, in_world)) @ a.half_xyz_m
    reach_b = np.abs(direction) @ b.half_xyz_m
    return np.where(length > 0.0, middles - reach_a - reach_b, 0.0)


def _by_projections(a: Solid, b: Solid) -> Array:
    """Upper bound on the distance of two solids: project to and fro, from the nearest of some points."""
    best = np.full(len(a.position_xyz_m), np.inf)
    point = a.position_xyz_m.copy()
    for one, other in ((a, b), (b, a)):
        marks = np.concatenate(
            ((_RIM if one.kind == "cylinder" else _CORNERS) * one.half_xyz_m, np.zeros((1, 3)))
        )
        local = _in_body(other, _in_world(one, np.broadcast_to(marks, (len(best), *marks.shape))))
        onto = _nearest_in_body(other, local)
        lengths = np.linalg.norm(local - onto, axis=-1)
        nearest = lengths.argmin(axis=1)
        rows = np.arange(len(best))
        is_better = lengths[rows, nearest] < best
        best = np.where(is_better, lengths[rows, nearest], best)
        point = np.where(is_better[:, None], _in_world(other, onto[rows, nearest]), point)
    active = np.flatnonzero(np.isfinite(best) & (best > 0.0))
    for _ in range(_N_PROJECTIONS):
        if len(active) == 0:
            break
        some_a, some_b = a.take(active), b.take(active)
        on_a = _in_world(some_a, _nearest_in_body(some_a, _in_body(some_a, point[active])))
        local = _in_body(some_b, on_a)
        onto = _nearest_in_body(some_b, local)
        length = np.linalg.norm(local - onto, axis=-1)
        gain = best[active] - length
        best[active] = np.minimum(best[active], length)
        point[active] = _in_world(some_b, onto)
        active = active[gain > 1e-6]
    return np.where(np.isfinite(best), best, np.nan)
