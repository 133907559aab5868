"""Maps of what lies nearest to each of some lights: where they cover the world, and drawing them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, transform
from f3sr.rendering.shadow_kernels import arrivals, cast_map
from f3sr.vision import rasterizer

MARGIN = 1.6
"""Radius of the ball that maps cover, in radii of the scene at rest.

What moves out of it loses its shadows on objects, not those on the ground."""
OFFSET, BIAS = 1.2, 1.0
"""Texels by which points are moved along their normals, and by which an occluder must be nearer to the light: half a
texel is a map's own error, the rest that of the simpler triangles in it."""


class Caster(NamedTuple):
    """A surface that casts shadows."""

    vertices: Array
    """(n, 3) [m]"""
    faces: NDArray[np.int32]
    """(m, 3)"""
    closed: bool
    """Whether it is closed and outward: what faces away from a light then adds nothing."""


@dataclass(frozen=True, eq=False)
class Maps:
    """Shadow maps of L lights: ``nearest`` (L, s, s) is the height of the nearest occluder [m], -inf without one.

    ``directions`` (L, 3) are unit vectors to the lights. ``frames`` (L, 3, 4) map world points to columns, rows and
    heights: see ``cast_map``. ``texel`` [m] is the side of a texel, the same in all maps. ``nearest`` is drawn into."""

    directions: Array
    frames: Array
    nearest: NDArray[np.float32]
    texel: float

    @classmethod
    def empty(cls, directions: Array, center: Array, radius: float, side: int) -> Maps:
        """Empty maps, ``side`` texels wide, of the ball of ``radius`` [m] around ``center`` (3,) in the world."""
        texel = 2 * radius / side
        frames = np.array([_frame(d, center, texel, side) for d in directions]).reshape(-1, 3, 4)
        nearest = np.full((len(directions), side, side), -np.inf, np.float32)
        return cls(rasterizer.fixed(directions, np.float64), rasterizer.fixed(frames, np.float64), nearest, texel)

    @property
    def offset(self) -> float:
        """By how much points are moved along their normals before they are looked up [m]."""
        return OFFSET * self.texel

    @property
    def bias(self) -> float:
        """By how much an occluder must be nearer to the light than a point [m]."""
        return BIAS * self.texel

    def cast(self, casters: Sequence[Caster], lights: slice = slice(None)) -> None:
        """Draw some casters, in the world, into the maps of some ``lights``, which threads share."""

        def draw(light: int) -> None:
            for caster in casters:
                cast_map(*caster, self.frames[light], self.nearest[light])

        rasterizer.share(draw, range(len(self.directions))[lights])

    def reached(self, points: Array) -> NDArray[np.int64]:
        """(L, 4): first and last column, first and last row of every map that a surface can change.

        The surface lies inside the hull of points (n, 3). Without points the ranges are empty."""
        if not len(points):
            return np.tile([0, -1, 0, -1], (len(self.directions), 1))
        # (L, 2, 3) @ (3, n) + (L, 2, 1) = (L, 2, n): column and row of every point in every map.
        placed = self.frames[:, :2, :3] @ points.T + self.frames[:, :2, 3:]
        low, high = placed.min(2), placed.max(2)
        texels = np.floor(np.column_stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]]))
        # -1 and s, one beyond the map, stand for all places outside it.
        return np.clip(texels, -1, self.nearest.shape[1]).astype(np.int64)

    def arriving(self, points: Array, normals: Array) -> Array:
        """(n, L) cosines times visibility at world points (n, 3) [m] with unit normals (n, 3)."""
        out = np.empty((len(points), len(self.directions)))
        arrivals(
            rasterizer.fixed(points, np.float64),
            rasterizer.fixed(normals, np.float64),
            self.directions,
            self.frames,
            self.nearest,
            self.offset,
            self.bias,
            out,
        )
        return out


def _frame(direction: Array, center: Array, texel: float, side: int) -> Array:
    """(3, 4) rows: column and row [texel], height against the rays [m]; ``center`` lies in the middle of the map."""
    # Any axis that is not nearly along the light; x, direction x x, direction is right-handed.
    x = np.cross([0.0, 1, 0] if abs(direction[1]) < 0.9 else [1.0, 0, 0], direction)
    x /= np.linalg.norm(x)
    axes = np.stack([x / texel, np.cross(direction, x) / texel, direction])
    # The height of ``center`` is 0.
    return np.column_stack([axes, -axes @ center + [side / 2, side / 2, 0]])


def world_casters(casters: Sequence[Caster], poses: Array) -> list[Caster]:
    """Casters of objects at ``poses`` (N, 4, 4), as kernels take them."""
    return [
        Caster(rasterizer.fixed(transform(T, c.vertices), np.float64), rasterizer.fixed(c.faces, np.int32), c.closed)
        for T, c in zip(poses, casters, strict=True)
    ]
