"""Orientations and poses, and how they chain.

Orientations are unit quaternions ``(n, 4)`` in the order w, x, y, z that rotate vectors of the body into the
reference frame; a pose ``a_from_b`` is a position and an orientation, and takes points of b to a.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def are_known(rows: Array) -> NDArray[np.bool_]:
    """Whether all entries of each row ``(..., k)`` are numbers ``(...)``: one pass, by their sums."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.isfinite(np.einsum("...i->...", rows)))


def normalised(quaternions_wxyz: Array) -> Array:
    """Unit quaternions ``(n, 4)``; rows whose norm is zero or not finite become NaN."""
    norms = np.sqrt(np.einsum("...i,...i->...", quaternions_wxyz, quaternions_wxyz))[..., None]
    if np.all(norms > 0):
        return np.asarray(quaternions_wxyz / norms)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(norms > 0, quaternions_wxyz / norms, np.nan)


def multiply(left_wxyz: Array, right_wxyz: Array) -> Array:
    """Hamilton products ``(n, 4)``: first ``right``, then ``left``."""
    w1, x1, y1, z1 = np.moveaxis(left_wxyz, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(right_wxyz, -1, 0)
    return np.stack(
        (
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ),
        axis=-1,
    )


def conjugate(quaternions_wxyz: Array) -> Array:
    """Inverse rotations ``(n, 4)`` of unit quaternions."""
    return np.asarray(quaternions_wxyz * np.array([1.0, -1.0, -1.0, -1.0]))


def rotate(quaternions_wxyz: Array, vectors_xyz: Array) -> Array:
    """Vectors ``(n, 3)`` of the body frame, expressed in the reference frame."""
    w, x, y, z = np.moveaxis(quaternions_wxyz, -1, 0)
    u, v, q = np.moveaxis(vectors_xyz, -1, 0)
    # v + w·t + a × t with t = 2·a × v, entry by entry: faster than cross products of short rows.
    t0, t1, t2 = 2.0 * (y * q - z * v), 2.0 * (z * u - x * q), 2.0 * (x * v - y * u)
    return np.stack(
        (
            u + w * t0 + (y * t2 - z * t1),
            v + w * t1 + (z * t0 - x * t2),
            q + w * t2 + (x * t1 - y * t0),
        ),
        axis=-1,
    )


def slerp(start_wxyz: Array, end_wxyz: Array, fraction: Array) -> Array:
    """Orientations ``(n, 4)`` on the shorter arc, at ``fraction`` ``(n,)`` of the way.

    Source: K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985,
    doi:10.1145/325334.325242, section 3.3.
    """
    dots = np.einsum("ni,ni->n", start_wxyz, end_wxyz)
    is_opposite = dots < 0
    if is_opposite.any():
        end_wxyz = np.where(is_opposite[:, None], -end_wxyz, end_wxyz)
    angle = np.arccos(np.minimum(np.abs(dots), 1.0))
    sine, rest = np.sin(angle), 1.0 - fraction
    weight_start, weight_end = np.sin(rest * angle), np.sin(fraction * angle)
    is_close = sine < 1e-6
    if is_close.any():
        sine = np.where(is_close, 1.0, sine)
        weight_start = np.where(is_close, rest, weight_start)
        weight_end = np.where(is_close, fraction, weight_end)
    weight_start, weight_end = (weight_start / sine)[:, None], (weight_end / sine)[:, None]
    return normalised(weight_start * start_wxyz + weight_end * end_wxyz)


def continuous(quaternions_wxyz: Array) -> Array:
    """The same orientations ``(n, 4)``, with signs chosen so that neighbours lie on one hemisphere.

    A quaternion and its negative are one orientation; without this, averaging or differencing neighbours
    would see a jump. The first row keeps its sign. NaN rows are passed over.
    """
    is_seen = are_known(quaternions_wxyz)
    seen = quaternions_wxyz if is_seen.all() else quaternions_wxyz[is_seen]
    turns = np.einsum("ni,ni->n", seen[1:], seen[:-1]) < 0
    if not turns.any():
        return quaternions_wxyz
    signs = np.where(np.cumsum(turns) % 2 == 1, -1.0, 1.0)
    result = quaternions_wxyz.copy()
    result[is_seen] = np.concatenate((seen[:1], seen[1:] * signs[:, None]))
    return result


def matrices(quaternions_wxyz: Array) -> Array:
    """Rotation matrices ``(..., 3, 3)`` of unit quaternions ``(..., 4)``; column k is the body's axis k.

    Each entry lies together in memory for all matrices, so that arithmetic entry by entry is fast.
    """
    w, x, y, z = np.ascontiguousarray(np.moveaxis(quaternions_wxyz, -1, 0))
    entries = np.empty((3, 3, *quaternions_wxyz.shape[:-1]))
    xx, yy, zz = x * x, y * y, z * z
    for i, one, other in ((0, yy, zz), (1, xx, zz), (2, xx, yy)):
        entries[i, i] = 1 - 2 * (one + other)
    for i, j, even, odd in ((1, 0, x * y, w * z), (0, 2, x * z, w * y), (2, 1, y * z, w * x)):
        entries[i, j] = 2 * (even + odd)
        entries[j, i] = 2 * (even - odd)
    return np.moveaxis(entries, (0, 1), (-2, -1))


def compose(
    outer_position: Array, outer_wxyz: Array, inner_position: Array, inner_wxyz: Array
) -> tuple[Array, Array]:
    """Pose ``a_from_c``, of ``a_from_b`` (outer) and ``b_from_c`` (inner): positions, orientations."""
    return outer_position + rotate(outer_wxyz, inner_position), multiply(outer_wxyz, inner_wxyz)


def inverted(position: Array, orientation_wxyz: Array) -> tuple[Array, Array]:
    """Pose ``b_from_a`` of ``a_from_b``: positions, orientations."""
    back = conjugate(orientation_wxyz)
    return -rotate(back, position), back
