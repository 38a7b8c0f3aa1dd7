"""Poses and frames, as functions of arrays.

Positions are ``(n, 3)`` in metres. Orientations are unit quaternions ``(n, 4)`` in the order w, x, y, z,
that rotate vectors of the body into the reference frame. Transforms read right to left:
``point_in_world = world_from_body @ point_in_body``.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]


def normalised(quaternions_wxyz: Array) -> Array:
    """Unit quaternions ``(n, 4)``; rows whose norm is zero or not finite become NaN."""
    norms = np.linalg.norm(quaternions_wxyz, axis=-1, keepdims=True)
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
    return quaternions_wxyz * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(quaternions_wxyz: Array, vectors_xyz: Array) -> Array:
    """Vectors ``(n, 3)`` of the body frame, expressed in the reference frame."""
    w = quaternions_wxyz[..., :1]
    axis = quaternions_wxyz[..., 1:]
    twice = 2.0 * np.cross(axis, vectors_xyz)
    return vectors_xyz + w * twice + np.cross(axis, twice)


def slerp(start_wxyz: Array, end_wxyz: Array, fraction: Array) -> Array:
    """Orientations ``(n, 4)`` on the shorter arc, at ``fraction`` ``(n,)`` of the way.

    Source: K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985,
    doi:10.1145/325334.325242, section 3.3.
    """
    dots = np.sum(start_wxyz * end_wxyz, axis=-1, keepdims=True)
    end_wxyz = np.where(dots < 0, -end_wxyz, end_wxyz)
    angle = np.arccos(np.clip(np.abs(dots), 0.0, 1.0))
    sine = np.sin(angle)
    t = fraction[:, None]
    is_close = sine < 1e-6
    safe = np.where(is_close, 1.0, sine)
    weight_start = np.where(is_close, 1.0 - t, np.sin((1.0 - t) * angle) / safe)
    weight_end = np.where(is_close, t, np.sin(t * angle) / safe)
    return normalised(weight_start * start_wxyz + weight_end * end_wxyz)
