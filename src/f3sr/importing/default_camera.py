"""Cameras where a scene has none: one around it that sees every object, and a lens where only that is unknown."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import UP, Array, cross, pose, transform
from f3sr.errors import InputError
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer

WIDTH, HEIGHT = 1024, 768
"""Of drawn photos [px]."""
USUAL_FOCAL = 1.0
"""Focal length [longer image sides] of an ordinary lens: 53 degrees, as phones and depth estimators have."""
ELEVATION = math.radians(35)
"""From which things on a table are seen apart, and their fronts too."""
AZIMUTHS = 12
"""Directions that are tried around a scene."""
MARGIN = 1.08
"""Room around what must be seen, as a factor."""
TRIED = 256
"""Longer side of the pictures in which views are compared [px]."""
HIDDEN = 0.05
"""Share of its own silhouette below which an object counts as unseen."""


def usual_lens(width: int, height: int) -> Array:
    """K (3, 3) of an ordinary lens, its axis through the picture's middle."""
    focal = USUAL_FOCAL * max(width, height)
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])


def lens_that_sees(points_camera: Array, width: int, height: int) -> Array:
    """K (3, 3) of an ordinary lens, or a shorter one where points (n, 3) in OpenCV axes ask for it.

    Raises InputError for points that are not before the camera."""
    if points_camera[:, 2].min() <= rasterizer.NEAR:
        accepted = "meshes in front of it: another --asset-frame, or --masks"
        raise InputError("poses", found="an object behind the camera", accepted=accepted)
    K = usual_lens(width, height)
    slopes = np.abs(points_camera[:, :2] / points_camera[:, 2:]).max(0) * MARGIN
    needed = min(width / 2 / max(slopes[0], 1e-9), height / 2 / max(slopes[1], 1e-9))
    K[[0, 1], [0, 1]] = min(K[0, 0], needed)
    return K


def view_of_all(objects: Sequence[SceneObject], width: int = WIDTH, height: int = HEIGHT) -> Camera:
    """A camera over an upright scene: of the directions around it, the one from which most of every object is seen."""
    points = np.concatenate([transform(o.T_world_object, o.scale * o.mesh.hull.vertices) for o in objects])
    views = [_facing(points, 2 * math.pi * k / AZIMUTHS, width, height) for k in range(AZIMUTHS)]
    return max(views, key=lambda view: _shown(objects, view.limited(TRIED)))


def _facing(points: Array, azimuth: float, width: int, height: int) -> Camera:
    """The camera that looks at points (n, 3) from a direction, as near as all of them are in its picture."""
    forward = -np.array(
        [math.cos(ELEVATION) * math.cos(azimuth), math.cos(ELEVATION) * math.sin(azimuth), math.sin(ELEVATION)]
    )
    right = cross(forward[None], UP[None])[0]
    right /= np.linalg.norm(right)
    R = np.stack([right, cross(forward[None], right[None])[0], forward], axis=1)
    K = usual_lens(width, height)
    middle = (points.min(0) + points.max(0)) / 2
    x, y, z = ((points - middle) @ R).T
    # A point at depth z + d is in the picture where |x| f <= (z + d) W / 2.
    d = max(float((np.abs(x) * MARGIN * 2 * K[0, 0] / width - z).max()),
            float((np.abs(y) * MARGIN * 2 * K[1, 1] / height - z).max()))  # fmt: skip
    return Camera(width=width, height=height, K=K, T_world_camera=pose(R, middle - d * forward))


def _shown(objects: Sequence[SceneObject], view: Camera) -> tuple[int, float]:
    """How many objects are seen, and the mean share that others leave of them."""
    ids = rasterizer.visible_ids(objects, view)
    shares = list[float]()
    for o in objects:
        alone = int((rasterizer.visible_ids([o], view) == o.id).sum())
        shares.append(int((ids == o.id).sum()) / alone if alone else 0.0)
    return sum(share > HIDDEN for share in shares), float(np.mean(shares))
