"""Where the photo shows the surface that things stand on, and where it would without them: shadows fall there only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, transform
from f3sr.scene import Scene
from f3sr.vision.regions import Mask, closed, grown, opened, parts_of

NEAR = 0.02
"""Height over the ground up to which geometry is the support's, in diagonals of the scene."""
NOISE = 0.01
"""The same in distances from the camera: monocular depth is off by that."""
SPECK = 0.003
"""What is narrower than twice this, in shares of the photo's longer side, is noise of the geometry: support in the
rest, or rest in the support."""
ENOUGH = 0.01
"""Share of the photo from which on what is seen of the support tells how it goes on."""


def support_of(scene: Scene, hole: Mask) -> Mask:
    """Pixels (H, W) of a levelled scene's support, where ``hole`` (H, W) hides it too: table tops are convex, and
    stay so in perspective. All below the horizon, where neither geometry nor a ground mask tell more."""
    return support_behind(*_seen(scene), hole, scene.camera)


def support_behind(known: Mask, seen: Mask, hole: Mask, camera: Camera) -> Mask:
    """The same, from pixels (H, W) of which something tells what they show, and of these what shows the support."""
    below = faces_ground(camera)
    seen = _connected(seen & below & ~hole, hole)
    if seen.mean() < ENOUGH:
        return below
    support = closed(seen | (_hull(seen) & (hole | ~known)), _speck(seen)) & below
    return support | (_specks(~support, hole) & below)


def hiding(scene: Scene, support: Mask, hole: Mask) -> NDArray[np.float32]:
    """z-depths (H, W) [m] of pixels that are neither object nor support and may hide objects: a chair's back.

    Infinite elsewhere, and everywhere without geometry of more than the ground."""
    shape = (scene.photo.height, scene.photo.width)
    if scene.geometry is None or scene.geometry.source == "ground":
        return np.full(shape, np.inf, np.float32)
    depth = np.where(scene.geometry.valid & (scene.geometry.points[..., 2] > 0), scene.geometry.points[..., 2], np.inf)
    # Nearest geometry pixel of every photo pixel.
    rows, columns = ((np.arange(n) * m) // n for n, m in zip(shape, depth.shape, strict=True))
    depth = depth[rows][:, columns].astype(np.float32)
    kept = opened(np.isfinite(depth) & ~support & ~hole, _speck(support))
    return np.where(kept, depth, np.float32(np.inf))


def faces_ground(camera: Camera) -> Mask:
    """Pixels (H, W) whose rays meet the plane z = 0 in front of the camera."""
    # Height of the ray per pixel, (a, b, c) . (x, y, 1), times the camera's own height: negative where they meet ahead.
    a, b, c = camera.T_world_camera[2, :3] @ np.linalg.inv(camera.K) * camera.center[2]
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    return np.asarray((a * x + c)[None] < (-b * y)[:, None], np.bool_)


def _seen(scene: Scene) -> tuple[Mask, Mask]:
    """Pixels (H, W) of which something tells what they show, and those that show the support."""
    shape = (scene.photo.height, scene.photo.width)
    known, seen = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    # A ground plane alone is drawn over the whole photo: it shows no table's edge.
    if scene.geometry is not None and scene.geometry.source != "ground":
        height = _heights(scene.geometry.points.astype(float), scene.camera)
        far = np.linalg.norm(scene.geometry.points, axis=-1)
        close = scene.geometry.valid & (np.abs(height) <= NEAR * scene.diagonal + NOISE * far)
        rows, columns = ((np.arange(n) * m) // n for n, m in zip(shape, close.shape, strict=True))
        known |= scene.geometry.valid[rows][:, columns]
        seen |= close[rows][:, columns]
    if scene.ground_mask is not None:
        known |= True
        seen |= scene.ground_mask
    return known, seen


def _heights(points_camera: Array, camera: Camera) -> Array:
    """(h, w) over the ground [m]; 0 where there is no point."""
    points = np.nan_to_num(points_camera, posinf=0.0, neginf=0.0).reshape(-1, 3)
    return transform(camera.T_world_camera, points)[:, 2].reshape(points_camera.shape[:2])


def _connected(seen: Mask, hole: Mask) -> Mask:
    """What of it is connected with the hole: a wall at the table's height is not."""
    seen = opened(seen, _speck(seen))
    parts = parts_of(seen | hole)
    return np.isin(parts, np.unique(parts[hole])) & seen


def _specks(rest: Mask, hole: Mask) -> Mask:
    """Small parts of the rest beside the hole: at the outlines of objects, geometry is neither theirs nor the
    support's."""
    parts = parts_of(rest)
    small = np.bincount(parts.ravel()) < ENOUGH * rest.size
    return rest & small[parts] & np.isin(parts, np.unique(parts[grown(hole, 2)]))


def _speck(mask: Mask) -> int:
    return max(1, round(SPECK * max(mask.shape)))


def _hull(mask: Mask) -> Mask:
    """Pixels whose centres lie in the convex hull of a mask's."""
    from PIL import Image, ImageDraw
    from scipy.spatial import ConvexHull, QhullError

    rows = np.flatnonzero(mask.any(1))
    # First and last pixel of every row: no other pixel can be a corner of the hull.
    first, last = mask[rows].argmax(1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(1)
    points = np.concatenate([np.column_stack([first, rows]), np.column_stack([last, rows])])
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:  # all in one line
        return mask
    drawn = Image.new("1", mask.shape[::-1])
    ImageDraw.Draw(drawn).polygon([(int(x), int(y)) for x, y in corners], fill=1, outline=1)
    return np.asarray(drawn, np.bool_)
