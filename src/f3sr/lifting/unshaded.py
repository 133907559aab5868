"""The photo's light on solids of unknown colours, and the photo without it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from f3sr.core.camera import Camera
from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Mesh
from f3sr.core.srgb import srgb
from f3sr.core.transforms import UP, Array
from f3sr.lifting.solids import Solid
from f3sr.rendering.config import LightConfig
from f3sr.rendering.evidence import REACH, Evidence, Samples, of_shaded_ground
from f3sr.rendering.light import DIRECT, disc, even_sky
from f3sr.rendering.light_fit import find_light
from f3sr.rendering.shadow_maps import MARGIN, Caster, Maps
from f3sr.rendering.textures import LINEAR
from f3sr.vision import rasterizer
from f3sr.vision.regions import interpolated, nearest_in, shrunk

BORDER = 3
"""Pixels from a mask's border that are left out: colours mix there, and the solid's normals are least sure."""
LIGHT = LightConfig(overhead=0.05, typical=20.0)
"""Colours are unknown here, and print passes for light from the side: lamps and windows are rarely low, and light comes
from all around too."""
SKY = 64
"""Lights that stand for the sky: between few, shadows show as steps in colours."""
MAP_SIDE = 192
"""Side of a light's shadow map [texel]."""
DARKEST = 0.3
"""Least share of the open ground's light by which a colour is divided: darker places hold little but noise and light
that other things throw."""
EDGE = 0.05
"""How far a shadow on a solid may lie off that in the photo, in roots of the mask's area."""
MOST_REACH = 8
"""The same [px] beyond which a coarser picture tells where its edges are: medians take the fourth power of it."""
OWN_LIGHT = 1e-3
"""Weight of even light beside all that is seen of a thing: normals that the photo hardly shows tell no curve."""
FAINTEST = 1e-3
"""Least linear colour, and least misfit of its logarithm, that are told from none."""
ROUNDS = 6
"""Rounds of weights of that fit."""
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
        return self.solid.drawn(self.camera.cropped(self.columns.start, self.rows.start, w, h))

    @cached_property
    def normals(self) -> Array:
        """(h, w, 3) of the solid's front, unit; beyond its outline those of the nearest place on it."""
        drawn = self._drawn
        corners = corner_normals(Mesh(vertices=self.solid.vertices, faces=self.solid.faces))
        normals = np.einsum("hwk,hwkc->hwc", drawn.bary, corners[np.maximum(drawn.face, 0)], dtype=float)
        lengths = np.linalg.norm(normals, axis=2)
        known = (drawn.face >= 0) & (lengths > 0)
        if not known.any():
            return np.broadcast_to(UP, normals.shape)
        normals /= np.maximum(lengths, 1e-12)[..., None]
        return normals[nearest_in(known)]

    @cached_property
    def _rays(self) -> Array:
        """(h, w, 3) in the world, through pixel centres, of depth 1."""
        h, w = self.own.shape
        x, y = np.meshgrid(np.arange(w) + self.columns.start + 0.5, np.arange(h) + self.rows.start + 0.5)
        rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(self.camera.K).T
        return rays @ self.camera.T_world_camera[:3, :3].T

    @cached_property
    def points(self) -> Array:
        """(h, w, 3) of the solid's front in the world; beyond its outline at the depth of the nearest place on it."""
        drawn = self._drawn
        known = drawn.face >= 0
        if not known.any():
            return self.camera.center + np.zeros_like(self._rays)
        return self.camera.center + drawn.depth[nearest_in(known)][..., None] * self._rays

    @property
    def facing(self) -> Array:
        """(h, w) cosine between the normals and the rays to the camera."""
        return -(self.normals * self._rays).sum(2) / np.linalg.norm(self._rays, axis=2)

    def samples(self, group: int, rgb: NDArray[np.uint8], step: int) -> Samples:
        """Some of the photo's colours (H, W, 3) on the solid, which is white here."""
        at = tuple(np.argwhere(shrunk(self.own, BORDER) & (self._drawn.face >= 0))[::step].T)
        seen = LINEAR[rgb[self.rows, self.columns][at]]
        return np.full(len(seen), group), np.ones_like(seen), seen, self.points[at], self.normals[at]


@dataclass(frozen=True, eq=False)
class PhotoLight:
    """Light on surfaces by their normals, and by how much colours without it are darkened so that they stay below
    white."""

    strength: Array
    """(4,) even, direct, sky, below: on open level ground they sum to 1."""
    direction: Array
    shaded: tuple[Maps, Maps]
    """What the solids hide from the direct light, and from the sky."""
    exposure: float = 1.0

    @classmethod
    def of(
        cls, strength: Array, direction: Array, angle: float, casters: Sequence[Caster], ball: tuple[Array, float]
    ) -> Self:
        """From the ``direction`` within an ``angle`` [rad], hidden by ``casters`` in a ``ball`` (middle (3,), radius
        [m])."""
        maps = [Maps.empty(lights, *ball, MAP_SIDE) for lights in (disc(direction, angle, DIRECT), even_sky(SKY))]
        for m in maps:
            m.cast(casters)
        return cls(strength, direction, (maps[0], maps[1]))

    def on(self, points: Array, normals: Array) -> Array:
        """(n,) the light at points (n, 3) of surfaces with unit normals (n, 3), 1 on open level ground."""
        direct, sky = (m.arriving(points, normals).mean(1) for m in self.shaded)
        return np.column_stack([np.ones(len(points)), direct, 2 * sky, (1 - normals[:, 2]) / 2]) @ self.strength

    def without(self, shown: SeenSolid, rgb: NDArray[np.uint8]) -> Array:
        """(n, 3) linear colours of the mask's pixels, in rows, from the photo (H, W, 3)."""
        normals = shown.normals[shown.own]
        light = np.maximum(self.on(shown.points[shown.own], normals), DARKEST)
        seen = LINEAR[rgb[shown.rows, shown.columns][shown.own]]
        plain = self.exposure * seen / placed_as_seen(light, seen.mean(1), shown.own)[:, None]
        if shown.solid.symmetry != "round" or shown.solid.stands_flat:
            return plain
        return plain / light_of_its_own(normals, plain, shown.facing[shown.own])[:, None]

    def removed(self, rgb: NDArray[np.uint8], shown: SeenSolid) -> NDArray[np.uint8]:
        """The photo (H, W, 3) with the colours of one solid as they would be in even light."""
        changed = rgb.copy()
        plain = srgb(np.clip(self.without(shown, rgb), 0, 1))
        changed[shown.rows, shown.columns][shown.own] = np.round(255 * plain)
        return changed


def placed_as_seen(light: Array, bright: Array, mask: NDArray[np.bool_]) -> Array:
    """The ``light`` (n,) on the pixels of a mask (h, w), in rows, with its edges where the photo has them.

    A shadow on a solid lies a little off that in the photo, as solids are guessed. Divided by it, ``bright`` (n,), the
    photo's brightness, has a seam. Any light nearby is as likely; the one is taken under which colours differ least
    from those around. Medians keep the photo's edges and drop what is narrower: print stays."""
    reach = EDGE * math.sqrt(len(light))
    nearby = 2 * max(1, round(reach)) + 1

    def over(values: Array, outside: float) -> Array:
        field = np.full(mask.shape, outside, np.float64)
        field[mask] = values
        return field

    step = math.ceil(reach / MOST_REACH)
    few = mask[::step, ::step]
    if step > 1 and few.any():
        coarse, its_bright = (over(values, 0)[::step, ::step] for values in (light, bright))
        coarse[few] = placed_as_seen(coarse[few], its_bright[few], few) / coarse[few]
        rows, columns = np.nonzero(mask)
        return light * interpolated(coarse[nearest_in(few)], np.column_stack([columns, rows]) / step + 0.5)
    weight = ndimage.gaussian_filter(mask.astype(float), (wide := 4 * reach))[mask]
    plain = np.log(np.maximum(bright, FAINTEST) / light)
    around = ndimage.gaussian_filter(over(plain, 0), wide)[mask] / weight
    least = ndimage.minimum_filter(over(light, np.inf), nearby)[mask]
    most = ndimage.maximum_filter(over(light, -np.inf), nearby)[mask]
    coarse = ndimage.median_filter(over(bright, 0)[nearest_in(mask)], nearby)[mask]
    return np.clip(coarse / np.exp(around), least, most)


def light_of(
    shown: Sequence[SeenSolid], rgb: NDArray[np.uint8], background: NDArray[np.uint8], camera: Camera
) -> PhotoLight:
    """The light that explains best how colours of the photo (H, W, 3) change over solids, as if each had one colour.

    Their shadows on the ground count too: the photo beside the completed ``background`` (H, W, 3).

    Print and stains are outliers of the fit, and its misfits are relative to each solid's own. See
    ``rendering.light_fit``."""
    corners = np.concatenate([s.solid.vertices for s in shown])
    middle = (corners.min(0) + corners.max(0)) / 2
    radius = max(float(np.linalg.norm(np.ptp(corners, axis=0))) / 2, 1e-3)
    step = max(1, sum(int(s.own.sum()) for s in shown) // LIGHT.samples)
    parts = [s.samples(k, rgb, step) for k, s in enumerate(shown)]
    parts.append(
        of_shaded_ground(
            rgb,
            background,
            [s.mask for s in shown],
            camera=camera,
            middle=middle,
            reach=REACH * radius,
            samples=LIGHT.samples,
        )
    )
    evidence = Evidence.of(parts)
    casters = [
        Caster(rasterizer.fixed(s.solid.vertices, np.float64), rasterizer.fixed(s.solid.faces, np.int32), closed=True)
        for s in shown
    ]
    ball = middle, MARGIN * radius
    found = find_light(evidence, casters, ball=ball, objects=len(shown), side=MAP_SIDE, config=LIGHT)
    light = found.light
    strength = np.array([part[0] for part in (light.even, light.direct, light.sky, light.below)])
    plain = PhotoLight.of(strength, light.direction, light.angle, casters, ball)
    white = max(float(np.quantile(plain.without(s, rgb), BRIGHTEST)) for s in shown)
    return replace(plain, exposure=min(1.0, 1 / max(white, 1e-9)))


def light_of_its_own(normals: Array, colours: Array, facing: Array) -> Array:
    """(n,) by how much linear colours (n, 3) of one round thing are brighter, 1 in the mean of their logarithms, where
    its unit normals (n, 3) turn: light that its neighbours throw or take, as fruit and balls have no brighter side.

    Irradiance is a function of second order of the normal (Ramamoorthi and Hanrahan 2001). Its logarithm is fitted.
    Print is an outlier, and borders tell least: weights are the cosines ``facing`` (n,) the camera."""
    x, y, z = normals.T
    basis = np.column_stack([np.ones(len(x)), x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1])
    bright = np.log(np.maximum(colours.mean(1), FAINTEST))
    weight = seen = np.maximum(facing, 0)
    fitted = np.full(len(x), np.average(bright, weights=seen + 1e-9))
    prior = np.diag([0.0, *8 * [OWN_LIGHT * float(seen.sum())]])
    for _ in range(ROUNDS):
        off = bright - fitted
        weight = seen / (1 + (off / max(float(np.average(np.abs(off), weights=seen + 1e-9)), FAINTEST)) ** 2)
        weighted = basis * weight[:, None]
        fitted = basis @ np.linalg.solve(weighted.T @ basis + prior + 1e-9 * np.eye(9), weighted.T @ bright)
    return np.exp(np.clip(fitted - fitted.mean(), math.log(DARKEST), -math.log(DARKEST)))
