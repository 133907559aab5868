"""One mask as the fits see it: a small window about it, where it is not hidden, and the camera above its support."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array
from f3sr.vision import rasterizer
from f3sr.vision.image_supports import underside
from f3sr.vision.regions import depth_inside, distance_to, grown, opened, shrunk
from f3sr.vision.silhouette import iou

RESOLUTION, FINEST = 160, 400
"""Longer side of the window [px], and the most of it for thin masks: finer outlines are no shape of a family's."""
FULL = 0.3
"""Share of the square around a mask that it fills, below which it counts as thin."""
DIRECTIONS = 48
"""Directions of a support function."""
PIXEL, ROUNDED = 0.5, 0.01
"""Standard error of an outline [px], and of a real box's corner [size of its mask]: corners are round."""
NARROW = 0.5
"""Width of a handle at most, as a share of its body's."""
MARGIN = 0.15
"""Of the window about the mask's box, as a share of its longer side."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Outlined:
    """A mask (h, w) in its window. ``valid`` (h, w) is where the object would be seen; ``camera`` looks at the window,
    in a world whose z = 0 is the support."""

    mask: NDArray[np.bool_]
    valid: NDArray[np.bool_]
    camera: Camera
    inside: NDArray[np.bool_]
    """(h, w): the window's pixels that lie in the photo."""
    places: tuple[NDArray[np.int64], NDArray[np.int64]]
    """Rows (h,) and columns (w,) of the photo that the window shows."""
    colours: NDArray[np.uint8] | None = None
    """(h, w, 3) sRGB of the photo there, where it is known."""

    @classmethod
    def of(cls, mask: NDArray[np.bool_], camera: Camera, rgb: NDArray[np.uint8] | None = None) -> Outlined:
        """A mask (H, W) of the photo, ``rgb`` (H, W, 3), which nothing hides. It has a pixel."""
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        top, bottom, left, right = rows[0], rows[-1] + 1, columns[0], columns[-1] + 1
        margin = math.ceil(MARGIN * max(bottom - top, right - left)) + 2
        window = camera.cropped(
            left - margin, top - margin, right - left + 2 * margin, bottom - top + 2 * margin
        ).limited(_resolution(mask[top:bottom, left:right]))
        x = ((np.arange(window.width) + 0.5) * (right - left + 2 * margin) / window.width).astype(int) + left - margin
        y = ((np.arange(window.height) + 0.5) * (bottom - top + 2 * margin) / window.height).astype(int) + top - margin
        inside = ((y >= 0) & (y < mask.shape[0]))[:, None] & ((x >= 0) & (x < mask.shape[1]))
        places = np.clip(y, 0, mask.shape[0] - 1), np.clip(x, 0, mask.shape[1] - 1)
        shown = mask[places[0]][:, places[1]] & inside
        colours = None if rgb is None else rgb[places[0]][:, places[1]]
        return cls(mask=shown, valid=inside, camera=window, inside=inside, places=places, colours=colours)

    def behind(self, hidden: NDArray[np.bool_]) -> Outlined:
        """The same mask, where pixels (H, W) of the photo may be ``hidden`` by what stands before it."""
        rows, columns = self.places
        return replace(self, valid=self.inside & ~hidden[rows][:, columns])

    def overlap(self, vertices: Array, faces: NDArray[np.int32]) -> float:
        """IoU of a mesh, vertices (n, 3) in the world, with the mask, where it is valid."""
        return iou(self.silhouette(vertices, faces), self.mask, self.valid)

    def most_overlap(self, shown: NDArray[np.bool_]) -> float:
        """The largest IoU that a shape can have which shows in no other pixels than ``shown`` (h, w)."""
        whole = int(np.count_nonzero(self.mask & self.valid))
        return np.count_nonzero(shown & self.mask & self.valid) / whole if whole else 0.0

    def silhouette(self, vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
        """(h, w) in the window."""
        camera = self.camera
        return rasterizer.silhouette(camera.to_camera(vertices), faces, camera.K, camera.width, camera.height)

    @cached_property
    def convex(self) -> NDArray[np.bool_]:
        """The convex hull (h, w) of the mask."""
        from scipy.spatial import ConvexHull

        rows, columns = np.nonzero(self.mask)
        corners = np.concatenate([np.column_stack([columns + i, rows + j]) for i in (0, 1) for j in (0, 1)])
        x, y = np.meshgrid(np.arange(self.mask.shape[1]) + 0.5, np.arange(self.mask.shape[0]) + 0.5)
        inside = np.ones(self.mask.shape, bool)
        for a, b, c in ConvexHull(corners).equations:
            inside &= a * x + b * y + c <= 1e-9
        return inside

    @cached_property
    def possible(self) -> NDArray[np.bool_]:
        """(h, w): the mask, and what is hidden within its hull."""
        return self.mask | (~self.valid & self.convex)

    @cached_property
    def depth_inside(self) -> Array:
        """Distance of pixels (h, w) to the mask's outline [px], negative outside; hidden pixels count as inside."""
        return depth_inside(self.possible)

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom of the mask [px of the window]."""
        rows, columns = np.flatnonzero(self.mask.any(1)), np.flatnonzero(self.mask.any(0))
        return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)

    @cached_property
    def foot(self) -> Array:
        """(2,) [px]: the middle of the mask's lowest rows."""
        _, top, _, bottom = self.bounds
        low = self.mask[int(max(top, bottom - max(1.0, 0.04 * (bottom - top)))) : int(bottom)]
        return np.array([float(np.median(np.nonzero(low)[1])) + 0.5, bottom])

    @cached_property
    def underside(self) -> Array:
        """(n, 2) [px]: the lower edge where the mask may touch what it stands on."""
        columns, ends = underside(self.mask)
        return np.column_stack([columns + 0.5, ends]).astype(float)

    @cached_property
    def cut(self) -> float:
        """Share of the mask's outline that lies on the photo's border."""
        beyond = grown(~self.inside, 1)
        outline = self.mask & ~shrunk(self.mask, 1)
        return float((outline & beyond).sum() / max(1, outline.sum()))

    @cached_property
    def foot_width(self) -> float:
        """The largest width of the mask in its lowest fifth [px]."""
        _, top, _, bottom = self.bounds
        low = self.mask[int(bottom - 0.2 * (bottom - top)) : int(bottom)]
        return float(low.sum(1).max(initial=1))

    @cached_property
    def widest(self) -> Array:
        """(2,) [px]: the middle of the largest disk in the mask, hidden pixels counted as its own."""
        depth = np.where(self.mask, self.depth_inside, -1)
        row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
        return np.array([column + 0.5, row + 0.5])

    @cached_property
    def handles(self) -> NDArray[np.bool_]:
        """(h, w): what is much narrower than the mask's body, where circles on the ground are circles."""
        tall = max(1.0, 1 / max(0.05, abs(float(self.camera.T_world_camera[2, 2]))))
        rows = np.minimum((np.arange(round(tall * len(self.mask))) / tall).astype(int), len(self.mask) - 1)
        stretched = self.possible[rows]
        inner = distance_to(~stretched)
        reach = NARROW * float(inner.max())
        body = distance_to(inner >= reach) <= reach
        back = np.minimum(((np.arange(len(self.mask)) + 0.5) * tall).astype(int), len(rows) - 1)
        return opened(self.mask & self.valid & ~body[back], 1)

    @cached_property
    def solidity(self) -> float:
        """Share of its convex hull that the mask covers."""
        return float(self.mask.sum() / max(1, self.convex.sum()))

    @cached_property
    def support(self) -> tuple[Array, Array, Array]:
        """The mask's support function: unit directions (n, 2), the farthest that the mask reaches along each (n,) [px],
        and the standard error of that [px]. Where the farthest pixel may be cut off by what stands before, none."""
        rows, columns = np.nonzero(self.mask & ~shrunk(self.mask, 1))
        corners = np.concatenate([np.column_stack([columns + i, rows + j]) for i in (0, 1) for j in (0, 1)])
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        directions = np.column_stack([np.cos(angles), np.sin(angles)])
        reached = corners @ directions.T
        last = np.argmax(reached, axis=0)
        cut = grown(~self.valid, 2)
        x, y = np.clip(corners[last], 0, [self.mask.shape[1] - 1, self.mask.shape[0] - 1]).T
        shown = ~cut[y, x]
        size = math.sqrt(float(self.mask.sum()))
        scatter = np.full(len(angles), math.hypot(PIXEL, ROUNDED * size))
        # Corners of pixels reach beyond the outline through their centres.
        excess = 0.5 * np.abs(directions).sum(1) - 0.5
        return directions[shown], (reached.max(0) - excess)[shown], scatter[shown]

    def reached(self, points: Array, directions: Array) -> tuple[Array, Array]:
        """How far shapes of points (s, n, 3) reach along directions (d, 2) of the picture: (s, d) [px].

        And the least depth of each shape (s,) [m]."""
        pixels, depth = self.camera.project(points.reshape(-1, 3))
        reached = (pixels.reshape(*points.shape[:2], 2) @ directions.T).max(1)
        return reached, depth.reshape(points.shape[:2]).min(1)

    def rays(self, pixels: Array) -> Array:
        """Directions (n, 3) in the world through pixels (n, 2), of depth 1."""
        K = self.camera.K
        xy = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(K).T
        return xy @ self.camera.T_world_camera[:3, :3].T

    def on_plane(self, pixels: Array, normal: Array, offset: float) -> Array:
        """Points (n, 3) where rays through pixels (n, 2) meet ``normal . x = offset``; not finite where they do not."""
        rays, centre = self.rays(pixels), self.camera.center
        along = rays @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (offset - normal @ centre) / along
        return centre + np.where(t > 0, t, np.nan)[:, None] * rays

    def apparent_size(self, point: Array) -> float:
        """Longer side of the mask's box [m], at the distance of a point (3,) of the world."""
        left, top, right, bottom = self.bounds
        return self.metres_per_pixel(point) * max(right - left, bottom - top)

    def metres_per_pixel(self, point: Array) -> float:
        """At a point (3,) of the world, across the ray."""
        return float(self.camera.to_camera(point[None])[0, 2] / self.camera.K[0, 0])


def _resolution(box: NDArray[np.bool_]) -> int:
    """Longer side of the window [px] of a mask in its box (h, w)."""
    fills = float(box.sum()) / max(box.shape) ** 2
    return round(min(FINEST, RESOLUTION * math.sqrt(max(1.0, FULL / fills))))
