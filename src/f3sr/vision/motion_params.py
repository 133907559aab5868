"""Motion parameters of alignment: a unit box of parameters, their poses, and velocities of points in camera axes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose, rotation_from_vector, skew


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectFreedom:
    """Equation 8, extended by tilt: x -> R s (x - anchor) + anchor + B a, in the world.

    Parameters u (6,) in [-1, 1] are multiplied by ``reach``. The first two are shifts a [m] along the columns of
    ``basis`` (3, 2). Yaw about +Z and two tilts about X and Y [rad] follow, and s - 1. Yaw and tilts form the rotation
    vector of R. A reach of 0 fixes a parameter. ``anchor`` (3,) [m] is the fixed point of rotation and scale.
    """

    anchor: Array
    basis: Array
    reach: Array

    def similarity(self, u: Array) -> tuple[Array, float]:
        """The rigid (4, 4) T and the scale s of x -> T (s x)."""
        a, omega, s = self._values(u)
        R = rotation_from_vector(omega)
        return pose(R, self.anchor + self.basis @ a - R @ (s * self.anchor)), s

    def velocities(self, u: Array, camera: Camera) -> Array:
        """(6, 3, 4): how points of the moved object, in camera axes, move with each parameter."""
        a, omega, s = self._values(u)
        center = self.anchor + self.basis @ a
        # Parameters come as yaw, tilt x, tilt y, the rotation vector as x, y, z: columns in the parameters' order.
        turns = _left_jacobian(omega)[:, [2, 0, 1]].T
        fields = [
            *(_velocity(shift=b) for b in self.basis.T),
            *(_velocity(turn=axis, about=center) for axis in turns),
            # The moved point is x = center + s (...), so dx/ds = (x - center) / s.
            _velocity(growth=1 / s, about=center),
        ]
        return np.array([r * _in_camera(f, camera) for r, f in zip(self.reach, fields, strict=True)])

    def _values(self, u: Array) -> tuple[Array, Array, float]:
        v = self.reach * u
        # Rotation vector (x, y, z) = (tilt about X, tilt about Y, yaw).
        return v[:2], v[[3, 4, 2]], 1 + float(v[5])


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraFreedom:
    """Six degrees of freedom about the scene's centre, so that turning and shifting decouple, or seven.

    Parameters u (6,) in [-1, 1] are multiplied by ``reach``: a rotation vector [rad] and a shift [m] of the scene along
    ``axes``. The motion is x -> R (x - center) + center + t, in the axes of the initial ``camera``. ``center`` (3,) [m]
    and the unit columns of ``axes`` (3, 3) are in these axes too. A seventh parameter is the logarithm of the factor on
    the focal lengths.
    """

    camera: Camera
    center: Array
    reach: Array
    axes: Array = field(default_factory=lambda: np.eye(3))

    def at(self, u: Array) -> Camera:
        """The camera that sees the scene so."""
        turn, shift, zoom = self._values(u)
        R = rotation_from_vector(turn)
        # Moving the scene by M is moving the camera by M^-1: T_old_new = M^-1.
        T_old_new = pose(R.T, self.center - R.T @ (self.center + shift))
        return self.camera.moved(self.camera.T_world_camera @ T_old_new).zoomed(zoom)

    def velocities(self, u: Array) -> Array:
        """Affine velocity fields (6 or 7, 3, 4), one per parameter, in the axes of the moved camera.

        A longer focal length moves the picture as if its points moved away from the axis."""
        turn, shift, _ = self._values(u)
        center = self.center + shift
        fields = [
            *(_velocity(turn=axis, about=center) for axis in (_left_jacobian(turn) @ self.axes).T),
            *(_velocity(shift=axis) for axis in self.axes.T),
            # d log f scales X and Y at fixed depth.
            np.diag([1.0, 1, 0, 0])[:3],
        ]
        return self.reach[:, None, None] * np.array(fields[: len(u)])

    def _values(self, u: Array) -> tuple[Array, Array, float]:
        """Rotation vector and shift in camera axes, and the factor on the focal lengths."""
        v = self.reach * u
        return self.axes @ v[:3], self.axes @ v[3:6], float(np.exp(v[6])) if len(v) > 6 else 1.0


def similarity_velocities(center: Array, camera: Camera) -> Array:
    """(7, 3, 4): how points of an object, in camera axes, move with the parameters of its pose.

    These are a shift along the world's axes [m], a turn about them [rad] and the logarithm of the scale. Turn and scale
    are about ``center`` (3,) [m]."""
    fields = [
        *(_velocity(shift=axis) for axis in np.eye(3)),
        *(_velocity(turn=axis, about=center) for axis in np.eye(3)),
        _velocity(growth=1.0, about=center),
    ]
    return np.array([_in_camera(field, camera) for field in fields])


def intrinsics_velocities(camera: Camera) -> Array:
    """(3, 3, 4): how points, in camera axes, seem to move by the principal point [px] and by the logarithm of the focal
    length."""
    fields = np.zeros((3, 3, 4))
    fields[0, 0, 2], fields[1, 1, 2] = 1 / camera.K[0, 0], 1 / camera.K[1, 1]
    fields[2, 0, 0] = fields[2, 1, 1] = 1
    return fields


def _velocity(
    *, shift: Array | None = None, turn: Array | None = None, growth: float = 0.0, about: Array | None = None
) -> Array:
    """The affine velocity (3, 4) of x -> shift + (turn x + growth) (x - about)."""
    L = growth * np.eye(3) + (skew(turn) if turn is not None else 0)
    t = np.zeros(3) if shift is None else np.asarray(shift, float)
    return np.column_stack([L, t if about is None else t - L @ about])


def _in_camera(field: Array, camera: Camera) -> Array:
    """A velocity of world points (3, 4) as one of points in camera axes."""
    R, eye = camera.T_camera_world[:3, :3], camera.center
    # World point x = R' y + eye: its velocity L x + t seen in camera axes y.
    L = R @ field[:, :3] @ R.T
    return np.column_stack([L, R @ (field[:, :3] @ eye + field[:, 3])])


def _left_jacobian(omega: Array) -> Array:
    """(3, 3): a change d of a rotation vector turns by ``J d`` after the rotation (Sola et al. 2018, equation 145)."""
    angle = float(np.linalg.norm(omega))
    W = skew(omega)
    # First order of the series; the next term is below 1e-12.
    if angle < 1e-6:
        return np.eye(3) + W / 2
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * W + (angle - np.sin(angle)) / angle**3 * W @ W
