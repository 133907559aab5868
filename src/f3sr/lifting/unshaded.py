"""The photo's light on solids of unknown colours, and the photo without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Mesh
from f3sr.core.srgb import srgb
from f3sr.core.transforms import UP, Array
from f3sr.lifting.solids import Solid
from f3sr.rendering.config import LightConfig
from f3sr.rendering.evidence import Evidence, Samples, ground_points
from f3sr.rendering.light_fit import find_light
from f3sr.rendering.shadow_maps import MARGIN, Caster
from f3sr.rendering.textures import LINEAR
from f3sr.vision import rasterizer
from f3sr.vision.regions import grown, shrunk
from f3sr.vision.silhouette import union_of

BORDER = 3
"""Pixels from a mask's border that are left out: colours mix there, and the solid's normals are least sure."""
LIGHT = LightConfig(overhead=0.05)
"""Colours are unknown here, and print passes for light from the side: lamps and windows are rarely low."""
MAP_SIDE = 192
"""Side of a light's shadow map [texel]."""
REACH = 1.5
"""How far from the middle of the solids ground is looked at, in their radius."""
DARKEST = 0.3
"""Least share of the open ground's light by which a colour is divided: darker places hold little but noise and light
that other things throw."""
BRIGHTEST = 0.99
"""Share of the colours that no division makes brighter than white."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenSolid:
    """What a mask shows of a solid in its window of the photo: ``rows`` and ``columns`` of that."""

    solid: Solid
    mask: NDArray[np.bool_]
    camera: Camera
    rows: slice
    columns: slice

    @classmethod
    def of(cls, solid: Solid, mask: NDArray[np.bool_], camera: Camera) -> Self:
        """A solid in the world, and the mask (H, W) in the photo that it explains."""
        rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
        return cls(
            solid=solid,
            mask=mask,
            camera=camera,
            rows=slice(int(rows[0]), int(rows[-1]) + 1),
            columns=slice(int(columns[0]), int(columns[-1]) + 1),
        )

    @property
    def own(self) -> NDArray[np.bool_]:
        """(h, w) the mask in the window."""
        return self.mask[self.rows, self.columns]

    @cached_property
    def _drawn(self) -> rasterizer.Fragments:
        h, w = self.own.shape
        view = self.camera.cropped(self.columns.start, self.rows.start, w, h)
        faces = self.solid.faces
        return rasterizer.rasterize(
            view.to_camera(self.solid.vertices), faces, np.zeros(len(faces), np.int32), view.K, w, h
        )

    @cached_property
    def normals(self) -> Array:
        """(h, w, 3) of the solid's front, unit; beyond its outline those of the nearest place on it."""
        from scipy.ndimage import distance_transform_edt

        drawn = self._drawn
        corners = corner_normals(Mesh(vertices=self.solid.vertices, faces=self.solid.faces))
        normals = np.einsum("hwk,hwkc->hwc", drawn.bary, corners[np.maximum(drawn.face, 0)], dtype=float)
        lengths = np.linalg.norm(normals, axis=2)
        known = (drawn.face >= 0) & (lengths > 0)
        if not known.any():
            return np.broadcast_to(UP, normals.shape)
        normals /= np.maximum(lengths, 1e-12)[..., None]
        nearest: Any = distance_transform_edt(~known, return_distances=False, return_indices=True)
        return normals[tuple(nearest)]

    @cached_property
    def _rays(self) -> Array:
        """(h, w, 3) in the world, through pixel centres, of depth 1."""
        h, w = self.own.shape
        x, y = np.meshgrid(np.arange(w) + self.columns.start + 0.5, np.arange(h) + self.rows.start + 0.5)
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(self.camera.K).T
        return rays @ self.camera.T_world_camera[:3, :3].T

    @property
    def facing(self) -> Array:
        """(h, w) cosine between the normals and the rays to the camera."""
        return -(self.normals * self._rays).sum(2) / np.linalg.norm(self._rays, axis=2)

    def samples(self, group: int, rgb: NDArray[np.uint8], step: int) -> Samples:
        """Some of the photo's colours (H, W, 3) on the solid, which is white here."""
        at = tuple(np.argwhere(shrunk(self.own, BORDER) & (self._drawn.face >= 0))[::step].T)
        world = self._drawn.depth[at][:, None] * self._rays[at] + self.camera.center
        seen = LINEAR[rgb[self.rows, self.columns][at]]
        return np.full(len(seen), group), np.ones_like(seen), seen, world, self.normals[at]


@dataclass(frozen=True, eq=False)
class PhotoLight:
    """Light on surfaces by their normals, and by how much colours without it are darkened so that they stay below
    white."""

    strength: Array
    """(4,) even, direct, sky, below: on open level ground they sum to 1."""
    direction: Array
    exposure: float = 1.0

    def on(self, normals: Array) -> Array:
        """(...,) the light on surfaces with unit normals (..., 3) that nothing shades, 1 on open level ground."""
        even, direct, sky, below = self.strength
        z = normals[..., 2]
        return even + direct * np.maximum(normals @ self.direction, 0) + (sky * (1 + z) + below * (1 - z)) / 2

    def without(self, shown: SeenSolid, rgb: NDArray[np.uint8]) -> Array:
        """(n, 3) linear colours of the mask's pixels, in rows, from the photo (H, W, 3)."""
        light = np.maximum(self.on(shown.normals), DARKEST)
        own = LINEAR[rgb[shown.rows, shown.columns][shown.own]]
        return self.exposure * own / light[shown.own][:, None]

    def removed(self, rgb: NDArray[np.uint8], shown: SeenSolid) -> NDArray[np.uint8]:
        """The photo (H, W, 3) with the colours of one solid as they would be in even light."""
        changed = rgb.copy()
        plain = srgb(np.clip(self.without(shown, rgb), 0, 1))
        changed[shown.rows, shown.columns][shown.own] = np.round(255 * plain)
        return changed


def light_of(
    shown: Sequence[SeenSolid], rgb: NDArray[np.uint8], ground: NDArray[np.bool_] | None, camera: Camera
) -> PhotoLight:
    """The light that explains best how colours of the photo (H, W, 3) change over solids, as if each had one colour.

    The ``ground`` (H, W) between them counts with the shadows that they cast on it.

    Print and stains are outliers of the fit, and its misfits are relative to each solid's own. See
    ``rendering.light_fit``."""
    corners = np.concatenate([s.solid.vertices for s in shown])
    middle = (corners.min(0) + corners.max(0)) / 2
    radius = max(float(np.linalg.norm(np.ptp(corners, axis=0))) / 2, 1e-3)
    step = max(1, sum(int(s.own.sum()) for s in shown) // LIGHT.samples)
    parts = [s.samples(k, rgb, step) for k, s in enumerate(shown)]
    parts.append(_ground_samples(shown, rgb, ground, camera, middle, REACH * radius))
    evidence = Evidence.of(parts)
    casters = [
        Caster(rasterizer.fixed(s.solid.vertices, np.float64), rasterizer.fixed(s.solid.faces, np.int32), closed=True)
        for s in shown
    ]
    ball = middle, MARGIN * radius
    found = find_light(evidence, casters, ball=ball, objects=len(shown), side=MAP_SIDE, config=LIGHT)
    light = found.light
    strength = np.array([part[0] for part in (light.even, light.direct, light.sky, light.below)])
    plain = PhotoLight(strength, light.direction)
    white = max(float(np.quantile(plain.without(s, rgb), BRIGHTEST)) for s in shown)
    return replace(plain, exposure=min(1.0, 1 / max(white, 1e-9)))


def _ground_samples(
    shown: Sequence[SeenSolid],
    rgb: NDArray[np.uint8],
    ground: NDArray[np.bool_] | None,
    camera: Camera,
    middle: Array,
    reach: float,
) -> Samples:
    """Some of the ground's colours within ``reach`` [m] of the ``middle`` (3,), as if it were white."""
    seen = np.ones(rgb.shape[:2], np.bool_) if ground is None else ground
    pixels = np.argwhere(seen & ~grown(union_of((s.mask for s in shown), seen.shape), BORDER))
    points = ground_points(camera, pixels)
    near = np.linalg.norm(points[:, :2] - middle[:2], axis=1) < reach  # NaN, above the horizon, is not
    step = max(1, np.count_nonzero(near) // LIGHT.samples)
    pixels, points = pixels[near][::step], points[near][::step]
    whole = np.ones((len(pixels), 3))
    return np.full(len(pixels), len(shown)), whole, LINEAR[rgb[tuple(pixels.T)]], points, whole * UP
