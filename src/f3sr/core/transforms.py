"""Poses and rotations, in the project's one convention.

World: right-handed, +Z up, metres. Camera: OpenCV axes (x right, y down, z forward). ``T_a_b`` maps points of
frame b into frame a, so inner letters cancel: ``T_world_camera @ T_camera_object``. Pixel (0, 0) is the top-left
corner of the top-left pixel; pixel centres lie at +0.5. Quaternions are wxyz.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
"""Numbers of double precision; the docstring beside it names shape, unit and frame."""

UP = np.array([0.0, 0.0, 1.0])
"""(3,) unit vector against gravity, in the world."""
T_UP_FROM_CAMERA = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""World axes (Z up) for a camera that looks horizontally: x right, y forward, z up."""

NEXT, AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
"""The axes after x, y and z in turn, and those after these."""


def frozen(values: ArrayLike, dtype: Any = np.float64) -> NDArray[Any]:
    """A C-contiguous read-only array; copies only when ``values`` is writable or of another type."""
    array = np.ascontiguousarray(values, dtype=dtype)
    if array.flags.writeable:
        # Somebody else holds it: the argument itself, or a view of it. What ``ascontiguousarray`` made anew is ours.
        array = array.copy() if array is values or array.base is not None else array
        array.setflags(write=False)
    return array


def pose(R: ArrayLike | None = None, t: ArrayLike | None = None) -> Array:
    """The transform (4, 4) ``x -> R x + t``, of ``R`` (3, 3), the identity by default, and ``t`` (3,), zero by
    default."""
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if t is not None:
        T[:3, 3] = t
    return T


def turn_about(point: ArrayLike, R: Array) -> Array:
    """The transform (4, 4) that turns by ``R`` (3, 3) about ``point`` (3,)."""
    point = np.asarray(point, float)
    return pose(R, point - R @ point)


def invert_pose(T: Array) -> Array:
    """Inverse of a rigid transform T (4, 4)."""
    R = T[:3, :3]
    return pose(R.T, -R.T @ T[:3, 3])


def transform(T: Array, points: Array) -> Array:
    """Points (..., 3) under an affine transform T (4, 4)."""
    moved: Array = points @ np.ascontiguousarray(T[:3, :3].T)
    for k in range(3):  # by columns: rows of three are too short for NumPy's loops
        moved[..., k] += T[k, 3]
    return moved


def cross(a: Array, b: Array) -> Array:
    """Products (..., 3) of vectors (..., 3): ``np.cross`` to the bit, in a quarter of its time where they are few."""
    return a.take(NEXT, -1) * b.take(AFTER, -1) - a.take(AFTER, -1) * b.take(NEXT, -1)


def boxes_of(sets: Sequence[Array]) -> Array:
    """Lowest and highest corners (k, 2, 3) of the boxes about sets of points (n, 3), none of which is empty."""
    # The minimum of ``min(0)`` to the bit, in a twentieth of its time: rows of three are too short for its loops.
    points, starts = np.concatenate(sets), np.cumsum([0, *map(len, sets[:-1])])
    return np.stack([np.minimum.reduceat(points, starts), np.maximum.reduceat(points, starts)], axis=1)


def bounds_of(points: Array) -> Array:
    """Lowest and highest corner (2, 3) of the box about points (n, 3), at least one."""
    return boxes_of([points])[0]


def box_corners(bounds: Array) -> Array:
    """The corners (8, 3) of a box between its lowest and its highest, ``bounds`` (2, 3)."""
    # Bit i of k chooses low or high along axis i: corner 0 is the lowest, corner 7 the highest.
    return bounds[[[k >> i & 1 for i in range(3)] for k in range(8)], range(3)]


def skew(a: Array) -> Array:
    """The matrix (3, 3) of the cross product x -> a x x with ``a`` (3,)."""
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float)


def rotation_about(axis: ArrayLike, angle: float) -> Array:
    """Rotation matrix (3, 3) of ``angle`` [rad] about ``axis`` (3,) of any length but 0 (Rodrigues)."""
    return rotation_from_vector(np.asarray(axis, float) / np.linalg.norm(axis) * angle)


def rotation_from_vector(omega: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of the rotation vector ``omega`` (3,) [rad]: the exponential map of SO(3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(np.asarray(omega, float)).as_matrix())


def vector_from_rotation(R: Array) -> Array:
    """The rotation vector (3,) [rad] of a rotation matrix (3, 3), no longer than pi: the logarithm map of SO(3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def rotation_between(a: ArrayLike, b: ArrayLike) -> Array:
    """The shortest rotation (3, 3) that turns direction ``a`` (3,) onto direction ``b`` (3,): equation 6's R_g."""
    a, b = (np.asarray(v, float) / np.linalg.norm(v) for v in (a, b))
    axis, cosine = cross(a, b), float(a @ b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        # Opposite directions: half a turn about any axis across, here that farthest from a.
        axis, sine = cross(a, np.eye(3)[int(np.argmin(np.abs(a)))]), 0.0
    return rotation_about(axis, float(np.arctan2(sine, cosine)))


def rotation_from_quaternion(wxyz: ArrayLike) -> Array:
    """Rotation matrix (3, 3) of a quaternion (w, x, y, z), or (n, 3, 3) of (n, 4); they need not be normalised.

    Raises ValueError for a quaternion of length 0."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(np.asarray(wxyz, float)[..., [1, 2, 3, 0]]).as_matrix())


def quaternion_from_rotation(R: Array) -> Array:
    """Unit quaternion (w, x, y, z) of a rotation matrix (3, 3), w >= 0."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat(canonical=True)
    return np.array([w, x, y, z])


def rotation_angle(R: Array) -> float:
    """The angle [rad], from 0 to pi, of a rotation matrix (3, 3), as exact as that near 0 too: an arc cosine turns an
    error of 1e-9 into 4e-5 rad."""
    sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    return float(np.arctan2(sine, (np.trace(R) - 1) / 2))
