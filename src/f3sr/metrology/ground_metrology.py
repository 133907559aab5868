"""The built-in GeometryEstimator: the camera from the photo's edges and rims, and the ground plane below it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import EstimatedGeometry, KnownFocal, PromptedImage
from f3sr.core.resampling import resample
from f3sr.core.transforms import Array
from f3sr.metrology.camera_estimate import CameraEstimate, CameraPriors, estimate_camera
from f3sr.metrology.ground_normal import ground_normal
from f3sr.vision.ground_plane import GroundNormal
from f3sr.vision.silhouette import union_of

LONGEST = 512
"""Longer side of the point map: a plane needs no more."""
ROOM, TABLE = 1.4, 0.7
"""Height of the camera over the ground where nothing tells it [m]: a person's in a room, where the horizon is in the
photo, and over a table, which is seen from above."""
CONTRADICTED = 3.0
"""Standard errors by which two focal lengths contradict each other."""
FARTHEST = 60.0
"""Farthest ground point, in camera heights: beyond it a pixel is metres of ground."""


@dataclass(frozen=True, eq=False)
class GroundMetrology:
    """Focal length, gravity and ground of one photo (Criminisi, Reid and Zisserman 2000); no network."""

    priors: CameraPriors = field(default_factory=CameraPriors)
    takes_normals: ClassVar[bool] = True

    def estimate(self, image: PromptedImage) -> EstimatedGeometry:
        """The ground's points where the photo shows it; objects get none. K has its principal point in the middle,
        unless somebody tells it."""
        photo, masks = image.photo, [i.mask for i in image.instances]
        normal = ground_normal(image)
        focals = _known_focals(image)
        camera = estimate_camera(
            photo.rgb, masks, image.ground_mask,
            focal=focals[0] if focals else None, priors=self.priors, normal=normal,
            upward=image.posed.upward if image.posed else (),
        )  # fmt: skip
        x, y = (image.focal and image.focal.centre) or (photo.width / 2, photo.height / 2)
        K = np.array([[camera.focal, 0, x], [0, camera.focal, y], [0, 0, 1]])
        height = image.camera_height or (ROOM if _shows_horizon(camera, K) else TABLE)
        h, w = (max(1, round(n * min(1, LONGEST / max(photo.rgb.shape[:2])))) for n in photo.rgb.shape[:2])
        points, seen = _plane(K, camera.up, height, (photo.width, photo.height), (w, h))
        valid = seen & ~resample(union_of((i.mask for i in image.instances), photo.rgb.shape[:2]), w, h)
        told = _told(camera, image, height, normal)
        focal_error, pitch, roll = camera.errors
        return EstimatedGeometry(
            points=points,
            valid=valid,
            K=K,
            ground_only=True,
            up_error=2 * math.sqrt((pitch**2 + roll**2) / 2),
            focal_error=focal_error,
            told=told,
        )


def _known_focals(image: PromptedImage) -> list[KnownFocal]:
    """What somebody and the poses of meshes tell of the focal length, the surest first."""
    told = [image.focal, image.posed and image.posed.focal]
    return sorted((f for f in told if f), key=lambda f: f.sigma)


def _shows_horizon(camera: CameraEstimate, K: Array) -> bool:
    return abs(math.tan(camera.pitch)) * camera.focal < K[1, 2]


def _plane(
    K: Array, up: Array, height: float, photo: tuple[int, int], size: tuple[int, int]
) -> tuple[Array, NDArray[np.bool_]]:
    """Points (h, w, 3) where rays meet the plane ``height`` [m] below the camera, and where they do (h, w)."""
    (width, rows), (w, h) = photo, size
    x, y = np.meshgrid((np.arange(w) + 0.5) * width / w, (np.arange(h) + 0.5) * rows / h)
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], -1)
    with np.errstate(divide="ignore"):
        depth = -height / (rays @ up)
    valid = (depth > 0) & (depth < FARTHEST * height)
    return rays * np.where(valid, depth, 0)[..., None], valid


def _against(other: KnownFocal, surest: KnownFocal) -> str:
    """What another focal length says that is off the surest by more than both err."""
    off = abs(math.log(other.pixels / surest.pixels))
    is_against = off > CONTRADICTED * math.hypot(other.sigma, surest.sigma)
    return f", against {other.pixels:.0f} px +- {100 * other.sigma:.0f} % by {other.source}" if is_against else ""


def _told(camera: CameraEstimate, image: PromptedImage, height: float, normal: GroundNormal | None) -> str:
    degrees = math.degrees
    f, pitch, roll = camera.errors
    focals = _known_focals(image)
    against = "".join(_against(other, focals[0]) for other in focals[1:])
    known = f" (told by {focals[0].source}{against})" if focals else ""
    seen = ""
    if normal is not None and camera.normal_off is not None:
        error = degrees(normal.error) / 2
        seen = f" and a network's normals of the ground, {degrees(camera.normal_off):.1f} +- {error:.1f} degrees off"
    elif image.normals is not None:
        seen = "; the network's normals show no plane where the ground is"
    if image.posed and image.posed.upward:
        count = len(image.posed.upward)
        seen += f", and the stable facets of {count} posed mesh{'es' * (count != 1)}"
    over = "is, as given," if image.camera_height else "is taken to be"
    return (
        f"focal length {camera.focal:.0f} px +- {100 * f:.0f} %{known}, pitch {degrees(camera.pitch):.1f} +- "
        f"{degrees(pitch):.1f} and roll {degrees(camera.roll):.1f} +- {degrees(roll):.1f} degrees by {camera.segments} "
        f"line segments and {camera.rims} rims{seen}; the camera {over} {height:g} m above the ground"
    )
