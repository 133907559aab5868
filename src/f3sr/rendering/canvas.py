"""Drawing one frame after another: what did not move stays drawn, and the result equals that of a fresh canvas."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr import raster
from f3sr.frames import Array, Camera
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.layers import (
    Buffers,
    Things,
    DISC_WORDS,
    draw_ground_shadows,
    draw_maps,
    draw_surfaces,
    ground_words,
    light_maps,
)
from f3sr.rendering.light import DIRECT, Light
from f3sr.rendering.picture_kernels import BLUR_SUM, STEPS, blur, compose, count_lights, light_left
from f3sr.rendering.surface_kernels import Lamps, shade
from f3sr.rendering.textures import linear, srgb

GRID = 2.0**17
"""Poses are rounded to one part of this [1/m, 1]: an engine's tremble at rest of a few micrometres is no motion."""

CELL = 2
"""Side of the cells that the ground's shadows are drawn in [px]: they are soft."""

LINEAR = raster.fixed(linear(np.arange(256) / 255), np.float64)
TABLE = raster.fixed(np.rint(255 * srgb(np.arange(STEPS + 1) / STEPS)), np.uint8)
SET_BITS = raster.fixed([bin(k).count("1") for k in range(256)], np.int64)


@dataclass(frozen=True, eq=False, kw_only=True)
class Setting:
    """Everything about a film that does not move."""

    camera: Camera
    background: NDArray[np.uint8]
    light: Light
    gains: Array
    """(N, 3) exposure of every object, in linear light."""
    config: RenderConfig
    things: Things
    ball: tuple[Array, float]
    """Middle and radius [m] of what the light's maps cover."""
    receives: NDArray[np.float32]
    """(h, w) how much of its shadows the ground shows."""
    already: NDArray[np.float32]
    """(h, w, 3) the share of its light that the background shows."""


class Canvas:
    """Buffers of one film, from frame to frame; one thread at a time may draw on it."""

    def __init__(self, setting: Setting) -> None:
        s, samples = setting, setting.config.samples
        self._setting = setting
        self._fine = s.camera.resized(samples * s.camera.width, samples * s.camera.height)
        h, w = s.camera.height, s.camera.width
        K = s.camera.K * [[1 / CELL], [1 / CELL], [1]]
        self._cells = replace(s.camera, K=K, width=-(-w // CELL), height=-(-h // CELL))
        self._words = ground_words(s.light)
        maps = light_maps(s.light, s.ball, s.config.shadows.map_size)
        self._drawn = Buffers.empty(self._fine, maps, self._cells, len(self._words))
        self._color, self._cover = np.zeros((h, w, 3), np.float32), np.zeros((h, w), np.uint8)
        self._counts, self._blurred = (np.zeros((2, self._cells.height, self._cells.width), np.int32) for _ in range(2))
        self._weight = raster.fixed(s.light.hidden / BLUR_SUM, np.float64)

    def drawn(self, poses: Array) -> NDArray[np.uint8]:
        """The picture (h, w, 3) with the objects at ``poses`` (N, 4, 4)."""
        s = self._setting
        poses = np.rint(poses * GRID) / GRID
        self._draw_layers(poses)
        self._shade(poses)
        self._count()
        picture = np.empty((s.camera.height, s.camera.width, 3), np.uint8)

        def finish(band: tuple[int, int]) -> None:
            compose(
                raster.fixed(s.background, np.uint8),
                LINEAR,
                self._blurred,
                CELL,
                self._weight,
                raster.fixed(s.receives, np.float32),
                raster.fixed(s.already, np.float32),
                s.config.samples,
                self._color,
                self._cover,
                TABLE,
                *band,
                picture,
            )

        raster.in_bands(finish, (0, s.camera.height), raster.THREADS)
        return picture

    def light_left(self, poses: Array) -> NDArray[np.float32]:
        """(h, w, 3) the share of its light that the ground keeps beside objects at ``poses`` (N, 4, 4)."""
        s = self._setting
        self._draw_layers(np.rint(poses * GRID) / GRID)
        self._count()
        left = np.empty((*s.receives.shape, 3), np.float32)
        light_left(self._blurred, CELL, self._weight, raster.fixed(s.receives, np.float32), left)
        return left

    def _draw_layers(self, poses: Array) -> None:
        s, drawn = self._setting, self._drawn
        everything = range(len(s.things.vertices))
        drawn.clear()
        self._view = s.things.seen_by(self._fine, poses, s.config.near)
        draw_surfaces(s.things, self._view, everything, s.config.near, drawn)
        if s.config.shadows.enabled and len(everything):
            casting = s.things.casting(poses, everything)
            draw_maps(casting, drawn.maps)
            draw_ground_shadows(casting, self._cells, self._words, s.config.near, drawn.bits)

    def _shade(self, poses: Array) -> None:
        s, drawn = self._setting, self._drawn
        lamps = Lamps(
            directions=drawn.maps.directions,
            frames=drawn.maps.frames,
            maps=drawn.maps.nearest,
            direct=DIRECT,
            offset=drawn.maps.offset,
            bias=drawn.maps.bias,
            strength=raster.fixed(s.light.strength, np.float64),
            gains=raster.fixed(s.gains, np.float64),
        )

        def draw(band: tuple[int, int]) -> None:
            shade(
                s.things.shapes,
                s.things.textures,
                self._view,
                lamps,
                s.config.samples,
                s.config.near,
                *band,
                drawn.face,
                drawn.nearness,
                self._color,
                self._cover,
            )

        raster.in_bands(draw, (0, s.camera.height), raster.THREADS)

    def _count(self) -> None:
        def count(band: tuple[int, int]) -> None:
            count_lights(self._drawn.bits, DISC_WORDS, SET_BITS, *band, self._counts)

        def smooth(band: tuple[int, int]) -> None:
            blur(self._counts, *band, self._blurred)

        raster.in_bands(count, (0, self._cells.height), raster.THREADS)
        raster.in_bands(smooth, (0, self._cells.height), raster.THREADS)
