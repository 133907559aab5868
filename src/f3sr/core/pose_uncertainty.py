"""How well one pose is known: covariances of its seven parameters, and 90 % intervals that people read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from f3sr.core.transforms import Array, cross, pose, rotation_from_vector, vector_from_rotation

Matrix7 = tuple[tuple[float, ...], ...]
"""(7, 7)."""
SHIFT, TURN, SCALE = slice(0, 3), slice(3, 6), 6
"""Places of the parameters: a shift along the world's axes [m], a rotation vector [rad] and the logarithm of the scale,
both about the middle of the object's box in the world."""
PARAMETERS = 7
"""Of a pose."""
NINETY, NINETY_OF_TWO = 1.645, 2.146
"""Standard deviations of a normal distribution that 90 % are within: of one variable, and of the length of two."""
HALF_TURN = float(np.pi)


@dataclass(frozen=True, kw_only=True)
class PoseUncertainty:
    """Half widths of intervals that hold the truth with 90 %, up to the scene's own scale, and covariances.

    ``along_ray`` and ``across_ray`` are of the middle, relative to the camera.
    """

    along_ray: float
    """[m]"""
    across_ray: float
    """[m]"""
    yaw: float
    """About the vertical [rad]; pi where nothing shows it."""
    tilt: float
    """Of the object's own vertical [rad]."""
    size: float
    """Share of the size."""
    covariance: Matrix7
    """All else is as uncertain as it is: camera, ground and other objects."""
    conditional: Matrix7
    """All else is as the scene has it."""

    @classmethod
    def of(cls, covariance: Array, conditional: Array, ray: Array) -> Self:
        """``ray`` (3,): the unit vector from the camera to the object, in the world."""
        shift, turn = covariance[SHIFT, SHIFT], covariance[TURN, TURN]
        across = np.trace(shift) - ray @ shift @ ray
        return cls(
            along_ray=NINETY * float(np.sqrt(ray @ shift @ ray)),
            across_ray=NINETY_OF_TWO * float(np.sqrt(max(across, 0.0) / 2)),
            yaw=min(HALF_TURN, NINETY * float(np.sqrt(turn[2, 2]))),
            tilt=min(HALF_TURN, NINETY_OF_TWO * float(np.sqrt(np.trace(turn[:2, :2]) / 2))),
            size=NINETY * float(np.sqrt(covariance[SCALE, SCALE])),
            covariance=tuple(tuple(row) for row in covariance.tolist()),
            conditional=tuple(tuple(row) for row in conditional.tolist()),
        )


def similarity(q: Array, middle: Array) -> tuple[Array, float]:
    """The motion x -> T (scale x) of the parameters (7,) of a pose about its ``middle`` (3,)."""
    R, scale = rotation_from_vector(q[TURN]), math.exp(q[SCALE])
    return pose(R, middle + q[SHIFT] - scale * R @ middle), scale


def motions_along(directions: Array, arms: Array) -> Array:
    """(k, 7) how far points at ``arms`` (k, 3) from the middle move along ``directions`` (k, 3) with each parameter."""
    # A point moves by d + w x r + s r; n . (w x r) = w . (r x n).
    return np.column_stack([directions, cross(arms, directions), np.einsum("ij,ij->i", arms, directions)])


def parameters(T: Array, scale: float, middle: Array) -> Array:
    """The parameters (7,) of a motion x -> T (scale x) about a ``middle`` (3,): the inverse of ``similarity``."""
    shift = scale * T[:3, :3] @ middle + T[:3, 3] - middle
    return np.concatenate([shift, vector_from_rotation(T[:3, :3]), [math.log(scale)]])
