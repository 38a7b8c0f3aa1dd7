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
    dots = np.einsum("ni,ni->n", start_wxyz, end_wxyz)[:, None]
    end_wxyz = np.where(dots < 0, -end_wxyz, end_wxyz)
    angle = np.arccos(np.clip(np.abs(dots), 0.0, 1.0))
    sine = np.sin(angle)
    t = fraction[:, None]
    is_close = sine < 1e-6
    safe = np.where(is_close, 1.0, sine)
    weight_start = np.where(is_close, 1.0 - t, np.sin((1.0 - t) * angle) / safe)
    weight_end = np.where(is_close, t, np.sin(t * angle) / safe)
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
    result = np.moveaxis(np.empty((3, 3, *quaternions_wxyz.shape[:-1])), (0, 1), (-2, -1))
    result[..., 0, 0] = 1 - 2 * (y * y + z * z)
    result[..., 0, 1] = 2 * (x * y - w * z)
    result[..., 0, 2] = 2 * (x * z + w * y)
    result[..., 1, 0] = 2 * (x * y + w * z)
    result[..., 1, 1] = 1 - 2 * (x * x + z * z)
    result[..., 1, 2] = 2 * (y * z - w * x)
    result[..., 2, 0] = 2 * (x * z - w * y)
    result[..., 2, 1] = 2 * (y * z + w * x)
    result[..., 2, 2] = 1 - 2 * (x * x + y * y)
    return result


def compose(
    outer_position: Array, outer_wxyz: Array, inner_position: Array, inner_wxyz: Array
) -> tuple[Array, Array]:
    """Pose ``a_from_c``, of ``a_from_b`` (outer) and ``b_from_c`` (inner): positions, orientations."""
    return outer_position + rotate(outer_wxyz, inner_position), multiply(outer_wxyz, inner_wxyz)


def inverted(position: Array, orientation_wxyz: Array) -> tuple[Array, Array]:
    """Pose ``b_from_a`` of ``a_from_b``: positions, orientations."""
    back = conjugate(orientation_wxyz)
    return -rotate(back, position), back
