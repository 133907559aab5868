"""The camera of a photo of a known scene, by where masks and objects lie: their extents in the picture.

Pose and focal length are found by least squares on the sides of every object's box in the picture. A side at the
photo's border, where the object may go on, is left out. What others hide pulls less, for the loss is robust.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose, rotation_about, rotation_from_vector, vector_from_rotation
from f3sr.errors import InputError
from f3sr.importing.default_camera import usual_lens
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import iou

AZIMUTHS, ELEVATIONS = 12, tuple(map(math.radians, (15, 40, 70)))
"""Directions around the scene from which the search begins."""
POINTS = 60
"""Most points of an object's hull: its extents need no more."""
KEPT = 3
"""Ends of searches that are polished and drawn."""
SPREAD = 0.2
"""Standard deviation of the logarithm of an unknown focal length about an ordinary lens."""
SOFT = 0.02
"""Error of a side [shares of the picture's longer side] from which it pulls less: half hidden things."""
FITS = 0.5
"""Least mean visible IoU of a camera that shows what the masks show."""


def fitted_camera(
    objects: Sequence[SceneObject], masks: Mapping[int, NDArray[np.bool_]], focal: float | None, where: str
) -> tuple[Camera, float]:
    """The camera, and the mean IoU of what it sees with the masks (H, W), both by object id.

    ``focal`` [px] is kept where it is known. Raises InputError where no camera shows what the masks show."""
    from scipy.optimize import least_squares

    height, width = next(iter(masks.values())).shape
    problem = _Sides(objects, masks, focal)
    ends = [
        least_squares(problem.residuals, start, loss="soft_l1", f_scale=1.0, max_nfev=60) for start in problem.starts()
    ]
    order = np.argsort([float(end.cost) for end in ends])[:KEPT]
    polished = [least_squares(problem.residuals, ends[k].x, loss="soft_l1", f_scale=1.0, max_nfev=400) for k in order]
    cameras = [problem.camera(end.x) for end in polished]
    scored = [(mean_iou(objects, masks, camera), k) for k, camera in enumerate(cameras)]
    best, k = max(scored, key=lambda s: s[0])
    if best < FITS:
        found = f"no camera that shows what the masks show (mean IoU {best:.2f} at best, {width}x{height} pixels)"
        raise InputError(where, found=found, accepted="masks of this scene's objects, with their numbers or labels")
    return cameras[k], best


def mean_iou(objects: Sequence[SceneObject], masks: Mapping[int, NDArray[np.bool_]], camera: Camera) -> float:
    """Mean IoU of what a camera sees of every object with its mask."""
    ids = rasterizer.visible_ids(objects, camera)
    return float(np.mean([iou(ids == o.id, masks[o.id]) for o in objects]))


class _Sides:
    """Sides of boxes in the picture as a function of turn (3), shift (3) and, where unknown, log focal length."""

    def __init__(
        self, objects: Sequence[SceneObject], masks: Mapping[int, NDArray[np.bool_]], focal: float | None
    ) -> None:
        self.height, self.width = next(iter(masks.values())).shape
        self.longest = max(self.height, self.width)
        self.focal = focal
        points = [_outline(o) for o in objects]
        everything = np.concatenate(points)
        self.middle = (everything.min(0) + everything.max(0)) / 2
        self.size = float(np.linalg.norm(np.ptp(everything, axis=0)))
        self.points = (everything - self.middle) / self.size
        self.starts_of = np.concatenate([[0], np.cumsum([len(p) for p in points])])[:-1]
        self.sides = np.array([_sides(masks[o.id]) for o in objects], float)
        limits = np.array([0, 0, self.width, self.height])
        self.known = np.abs(self.sides - limits) > 1

    def starts(self) -> list[Array]:
        """Cameras around the scene that see it at the masks' size, upright; turns are from world to camera."""
        seen = float(np.hypot(*(self.sides[:, 2:].max(0) - self.sides[:, :2].min(0))))
        distance = float(usual_lens(self.width, self.height)[0, 0] if self.focal is None else self.focal) / seen
        level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # looks along +Y, z down in the picture
        shift = np.array([0, 0, max(distance, 1.0)])
        turns = [
            rotation_about([1, 0, 0], elevation) @ level @ rotation_about([0, 0, 1], 2 * math.pi * k / AZIMUTHS)
            for elevation in ELEVATIONS
            for k in range(AZIMUTHS)
        ]
        more = [] if self.focal is not None else [0.0]
        return [np.concatenate([vector_from_rotation(R), shift, more]) for R in turns]

    def residuals(self, x: Array) -> Array:
        """Differences of sides in SOFT units, and the prior on the focal length."""
        focal = self._focal(x)
        p = self.points @ rotation_from_vector(x[:3]).T + x[3:6]
        z = np.maximum(p[:, 2], 1e-3)
        u = np.clip(focal * p[:, 0] / z + self.width / 2, -10 * self.longest, 10 * self.longest)
        v = np.clip(focal * p[:, 1] / z + self.height / 2, -10 * self.longest, 10 * self.longest)
        low, high = np.minimum.reduceat, np.maximum.reduceat
        at = self.starts_of
        seen = np.stack([low(u, at), low(v, at), high(u, at), high(v, at)], axis=1)
        off = np.where(self.known, seen - self.sides, 0.0).ravel() / (SOFT * self.longest)
        behind = 10 * np.minimum(p[:, 2].min() - 0.05, 0.0)
        prior = [] if self.focal is not None else [x[6] / SPREAD]
        return np.concatenate([off, [behind], prior])

    def camera(self, x: Array) -> Camera:
        """The camera of parameters, in the world of the objects."""
        K = np.diag([self._focal(x), self._focal(x), 1.0])
        K[:2, 2] = self.width / 2, self.height / 2
        R = rotation_from_vector(x[:3])
        # x_camera = R (x_world - middle) / size + t, so the camera's centre is middle - size R^T t.
        T = pose(R.T, self.middle - self.size * (R.T @ x[3:6]))
        return Camera(width=self.width, height=self.height, K=K, T_world_camera=T)

    def _focal(self, x: Array) -> float:
        usual = float(usual_lens(self.width, self.height)[0, 0])
        return self.focal if self.focal is not None else usual * math.exp(float(np.clip(x[6], -1.5, 1.5)))


def _outline(o: SceneObject) -> Array:
    """Points (n, 3) of an object's hull in the world, spread evenly over its list."""
    hull = o.scale * o.mesh.hull.vertices @ o.T_world_object[:3, :3].T + o.T_world_object[:3, 3]
    directions = _sphere()
    return hull[np.unique((hull @ directions.T).argmax(0))]


def _sphere() -> Array:
    """Directions (n, 3), spread evenly over the sphere (Fibonacci's lattice)."""
    k = np.arange(POINTS) + 0.5
    z = 1 - 2 * k / POINTS
    angle = math.pi * (1 + math.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def _sides(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of a mask [px]."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
