"""Balls: a sphere's outline gives its ray and its angle, and what it rests on its distance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from f3sr.core.transforms import Array
from f3sr.lifting.fits import FittedShape
from f3sr.lifting.many_starts import BEHIND_CAMERA, refined
from f3sr.lifting.outlined import Outlined
from f3sr.lifting.solids import Solid, revolved

FAMILY = "ball"
AROUND = 48
"""Points of a sphere's outline."""
RINGS = 16
"""Rings of its surface."""


def fit_ball(seen: Outlined, floor: float) -> FittedShape | None:
    """A sphere on the height ``floor`` [m]: its outline touches the lines that the mask's touches, in all directions.

    Rays along its outline make an angle a with the ray u through its centre. At the distance d its radius is d sin a,
    and it rests on the floor: d = (floor - z) / (u_z - sin a), z being the camera's height. None beyond the horizon."""
    directions, wanted, scatter = seen.support
    rows, columns = np.nonzero(seen.mask)
    middle = np.array([columns.mean() + 0.5, rows.mean() + 0.5])
    focal = float(seen.camera.K[0, 0])
    first = math.log(max(1.0, math.sqrt(len(rows) / math.pi)) / focal)
    turns = 2 * np.pi * np.arange(AROUND) / AROUND
    K = seen.camera.K

    def cone(x: Array) -> tuple[Array, float]:
        """The unit ray (3,) through the centre in camera axes, and the angle [rad] of x (3,): pixels, log radius."""
        ray = np.linalg.solve(K, [*(middle + focal * x[:2]), 1.0])
        return ray / np.linalg.norm(ray), math.atan(math.exp(x[2]))

    def residual(x: Array) -> Array:
        ray, angle = cone(x)
        side = np.cross(ray, [0.0, 1, 0])
        side /= np.linalg.norm(side)
        ring = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * np.cross(ray, side)
        outline = (math.cos(angle) * ray + math.sin(angle) * ring) @ K.T
        if outline[:, 2].min() < 0.05:
            return np.full(len(wanted), BEHIND_CAMERA)
        reached = ((outline[:, :2] / outline[:, 2:]) @ directions.T).max(0)
        return (reached - wanted) / scatter

    if len(wanted) < 4:
        return None
    start = np.array([[0.0, 0.0, first]])
    x = refined(lambda x: np.array([residual(one) for one in x]), start, iterations=25)[0][0]
    ray, angle = cone(x)
    direction = seen.camera.T_world_camera[:3, :3] @ ray
    falls = float(direction[2]) - math.sin(angle)
    if falls >= -1e-3:
        return None
    distance = (floor - float(seen.camera.center[2])) / falls
    if distance <= 0:
        return None
    radius = distance * math.sin(angle)
    centre = seen.camera.center + distance * direction
    return FittedShape.of(FAMILY, _sphere(centre, radius), seen)


def _sphere(centre: Array, radius: float) -> Solid:
    polar = np.linspace(0, np.pi, RINGS + 1)
    profile = radius * np.column_stack([np.sin(polar), 1 - np.cos(polar)])
    profile[[0, -1], 0] = 0.0
    return replace(revolved(centre - [0, 0, radius], profile), symmetry="round")
