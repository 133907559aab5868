"""Drawing one frame after another: what did not move stays drawn, and the result equals that of a fresh canvas."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.srgb import srgb
from f3sr.core.transforms import Array, transform
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.layers import (
    DISC_WORDS,
    Buffers,
    Things,
    draw_ground_shadows,
    draw_maps,
    draw_surfaces,
    ground_words,
    light_maps,
)
from f3sr.rendering.light import DIRECT, Light
from f3sr.rendering.picture_kernels import (
    BLUR_SUM,
    STEPS,
    blur_columns,
    blur_rows,
    compose,
    count_lights,
    light_left,
    mark_changed,
)
from f3sr.rendering.shadow_kernels import note_changes
from f3sr.rendering.surface_kernels import FrameGeometry, Lamps, mark_shadowed, shade, tile_depths
from f3sr.rendering.textures import LINEAR
from f3sr.vision import rasterizer
from f3sr.vision.regions import parts_alike

CELL = 2
"""Side of the cells that the ground's shadows are drawn in [px]: shadows are soft, and half as fine is enough."""
TILE = 8
"""Side of the tiles whose objects are coloured anew or not at all [px]; a multiple of ``CELL``."""
BLURS = 1, 2, 1, 2
"""Reach of the filters over shadows of the disc and of the sky, now and at rest [cells].

The sky's lights are far from each other, and each has an edge."""
BLOCK = 2
"""Side of the squares of a light's map that have changed or not [texel]."""
QUIET = 12
"""Frames without motion after which an object is drawn with those that stay."""
HIDES = 1.03
"""How much farther than what the background shows something is that it hides: geometry from one photo is no better."""
LEAST_SIDE = 0.01
"""Share of an object's pixels that a side of it has at least: less is a bump."""
BANDS = 4
"""Bands of rows per thread that are coloured: what is dear lies together."""

TABLE = rasterizer.fixed(np.rint(255 * srgb(np.arange(STEPS + 1) / STEPS)), np.uint8)
"""(STEPS + 1,) sRGB byte of every step of linear light in [0, 1]."""
SET_BITS = rasterizer.fixed([bin(k).count("1") for k in range(256)], np.int64)
"""(256,) how many bits of a byte are 1: how many lights are hidden."""

Rectangle = tuple[int, int, int, int]
"""First row, row after the last, first column, column after the last, in tiles."""


@dataclass(frozen=True, eq=False, kw_only=True)
class StillScene:
    """Everything about a film that does not move."""

    camera: Camera
    background: NDArray[np.uint8]
    """(h, w, 3) sRGB, what is seen without the objects."""
    light: Light
    exposures: Array
    """(N, 3, 3) of every object, from a texture's colour to its exposed one, in linear light."""
    config: RenderConfig
    things: Things
    ball: tuple[Array, float]
    """Middle (3,) in the world and radius [m] of what the light's maps cover."""
    receives: NDArray[np.float32]
    """(h, w) in [0, 1]: how much of its shadows the ground shows."""
    kept: NDArray[np.float32]
    """(h, w) depth [m] of what the background shows and may hide objects, inf where nothing does."""


class Canvas:
    """Buffers of one film, from frame to frame; one thread at a time may draw on it.

    ``_still`` holds objects that have not moved for a while. Every frame copies it where something moved and draws the
    rest on top. No buffer depends on the order of drawing, so each equals that of a fresh canvas. A tile keeps its
    colours while neither its faces nor a light texel that it reads have changed.
    """

    def __init__(self, setting: StillScene) -> None:
        s, samples = setting, setting.config.samples
        self.setting = setting
        self._rest = self._shown = np.ones((s.camera.height, s.camera.width, 3), np.float32)
        h, w = s.camera.height, s.camera.width
        # Scaled, not resized: cells keep their size where the picture's side is no multiple of theirs.
        K = s.camera.K * [[1 / CELL], [1 / CELL], [1]]
        self._fine = s.camera.resized(samples * w, samples * h)
        self._cells = replace(s.camera, K=K, width=-(-w // CELL), height=-(-h // CELL))
        self._words = ground_words(s.light)
        self._weight = rasterizer.fixed(s.light.hidden / BLUR_SUM, np.float64)
        self._still, self._drawn = self._buffers(), self._buffers()
        self._rest_bits = np.zeros_like(self._drawn.bits)
        lights, size, _ = self._drawn.maps.nearest.shape
        self._nearest_before = self._drawn.maps.nearest.copy()
        self._spans = np.empty((lights, -(-size // BLOCK), -(-size // BLOCK), 2), np.float32)
        self._color, self._cover = np.zeros((h, w, 3), np.float32), np.zeros((h, w), np.uint8)
        shape = len(BLURS), self._cells.height, self._cells.width
        self._counts, self._rows, self._blurred = (np.zeros(shape, np.int32) for _ in range(3))
        # -(-a // b) is a / b rounded up: the last tile may be cut.
        tiles = -(-h // TILE), -(-w // TILE)
        self._depths, self._dirty = np.zeros((*tiles, 2), np.float32), np.ones(tiles, np.bool_)
        count = len(s.things.vertices)
        # NaN equals nothing: the first frame finds every object moved.
        self._poses = np.full((count, 4, 4), np.nan)
        self._quiet = np.full(count, QUIET)
        self._stays: frozenset[int] = frozenset()
        self._view: FrameGeometry | None = None
        self._blurred_before = np.full_like(self._blurred, -1)
        self._picture, self._composed = np.empty_like(s.background), False

    def drawn(self, poses: Array) -> NDArray[np.uint8]:
        """The picture (h, w, 3) uint8 sRGB with the objects at ``poses`` (N, 4, 4), T_world_object; a copy."""
        self._draw(poses)
        if not self._composed:
            self._compose()
        return self._picture.copy()

    def rests(self, light: NDArray[np.float32], shown: NDArray[np.float32]) -> None:
        """Take the last frame as the scene at rest.

        ``light`` (h, w, 3) is ``light_left`` there; ``shown`` (h, w, 3) is the photo's share of the background's light.
        """
        self._rest, self._shown, self._rest_bits = light, shown, self._drawn.bits.copy()
        self._count()
        self._composed = False

    def light_left(self, poses: Array) -> NDArray[np.float32]:
        """(h, w, 3) the share of its light that the ground keeps beside objects at ``poses`` (N, 4, 4)."""
        self._draw(poses)
        left = np.empty((*self.setting.receives.shape, 3), np.float32)
        light_left(self._blurred, CELL, self._weight, rasterizer.fixed(self.setting.receives, np.float32), left)
        return left

    def cover(self, chosen: Sequence[int]) -> NDArray[np.uint8]:
        """(h, w) how many samples of each pixel show one of the objects ``chosen`` (indices) in the last frame."""
        s, side = self.setting, self.setting.config.samples
        found = np.zeros(self._cover.shape, np.uint8)
        if self._view is None or not len(chosen):
            return found
        mine = np.zeros(int(s.things.first_face[-1]) + 1, np.uint8)  # the last one is for no face, -1
        for k in chosen:
            mine[s.things.first_face[k] : s.things.first_face[k + 1]] = 1
        for k in chosen:
            window = self.window(k)
            rows, columns = (slice(side * part.start, side * part.stop) for part in window)
            samples = mine[self._drawn.face[rows, columns]]
            height, width = found[window].shape
            found[window] = samples.reshape(height, side, width, side).sum((1, 3))
        return found

    def sides(self, k: int) -> NDArray[np.int32]:
        """(h, w) numbers of the sides of an object in its window of the last frame, -1 where it is not seen.

        Neighbours are of one side where their faces turn by less than a crease; what is too small to be one is 0."""
        s, step = self.setting, self.setting.config.samples
        rows, columns = self.window(k)
        row, column = (slice(step * part.start, step * part.stop, step) for part in (rows, columns))
        face = self._drawn.face[row, column]
        first, last = s.things.first_face[k : k + 2]
        mine = (face >= first) & (face < last)
        normal = np.where(mine[..., None], s.things.shapes.flat[np.maximum(face, 0)], 0)
        sides = parts_alike(mine, normal, math.cos(s.config.crease))
        small = np.bincount(sides[mine], minlength=1) < LEAST_SIDE * np.count_nonzero(mine)
        return np.where(mine, np.where(small[sides], 0, sides), -1)

    def window(self, k: int) -> tuple[slice, slice]:
        """Rows and columns of pixels in which an object may be seen in the last frame."""
        if self._view is None:
            return slice(0, 0), slice(0, 0)
        top, bottom, left, right = (TILE * side for side in self._square(self._view, k))
        height, width = self._cover.shape
        return slice(min(top, height), min(bottom, height)), slice(min(left, width), min(right, width))

    def _buffers(self) -> Buffers:
        s = self.setting
        maps = light_maps(s.light, s.ball, s.config.shadows.map_size)
        side = s.config.samples
        # From pixels to samples: every pixel's value on side x side of them. 1 / inf is 0, which hides nothing.
        kept = np.repeat(np.repeat((1 / (HIDES * s.kept)).astype(np.float32), side, 0), side, 1)
        return Buffers.empty(self._fine, maps, self._cells, len(self._words), kept)

    def _draw(self, poses: Array) -> None:
        """Bring every buffer from the poses drawn last to ``poses``."""
        s, before, old = self.setting, self._view, self._poses
        if before is not None and np.array_equal(poses, old):
            return
        view = s.things.seen_by(self._fine, poses, s.config.near)
        changed = np.flatnonzero((poses != old).any((1, 2))).tolist()
        if before is None:
            # The first frame: all objects rest, and both buffers are equal.
            self._stays = frozenset(range(len(poses)))
            self._add(self._still, view, poses, sorted(self._stays))
            self._drawn.take(self._still)
            np.copyto(self._nearest_before, self._drawn.maps.nearest)
            self._measure([(0, self._dirty.shape[0], 0, self._dirty.shape[1])])
        else:
            self._settle(view, poses, changed)
            # Where an object left and where it arrived, both in the picture and in the lights' maps.
            squares = [self._square(v, k) for v in (before, view) for k in changed]
            texels = np.stack([self._texels(T[k], k) for k in changed for T in (old, poses)])
            self._restore(squares, texels)
            # All that does not stay is drawn, moved or not: restoring erased what others had in the same squares.
            # Drawing an object twice changes nothing.
            self._add(self._drawn, view, poses, [k for k in range(len(poses)) if k not in self._stays])
            self._measure(squares)
            self._mark_shadowed(view, texels)
        self._poses, self._view, self._composed = poses, view, False
        self._shade(view)
        self._count()

    def _settle(self, view: FrameGeometry, poses: Array, changed: Sequence[int]) -> None:
        """Take what begins to move out of the still buffers and what has come to rest into them."""
        self._quiet += 1
        self._quiet[changed] = 0
        quiet = frozenset(np.flatnonzero(self._quiet >= QUIET).tolist())
        # Nothing can be erased from a z-buffer: when a still object starts to move, the others are drawn anew.
        if self._stays.intersection(changed):
            self._still.clear()
            self._add(self._still, view, poses, sorted(quiet))
        else:
            self._add(self._still, view, poses, sorted(quiet - self._stays))
        self._stays = quiet

    def _add(self, buffers: Buffers, view: FrameGeometry, poses: Array, chosen: Sequence[int]) -> None:
        """Draw some objects into all buffers."""
        s = self.setting
        if not chosen:
            return
        draw_surfaces(s.things, view, chosen, s.config.near, buffers)
        if s.config.shadows.enabled:
            casting = s.things.casting(poses, chosen)
            draw_maps(casting, buffers.maps)
            draw_ground_shadows(casting, self._cells, self._words, s.config.near, buffers.bits)

    def _square(self, view: FrameGeometry, k: int) -> Rectangle:
        """The tiles that an object may be seen in."""
        side, most = TILE * self.setting.config.samples, self._dirty.shape
        # A sample wider on each side, for the slack of edge functions. Columns of extents: v before u, as rows come
        # first.
        low = np.clip(np.floor((view.extents[k, [2, 0]] - 1) / side), 0, most)
        high = np.clip(np.floor((view.extents[k, [3, 1]] + 1) / side) + 1, 0, most)
        (top, left), (bottom, right) = low.astype(int).tolist(), high.astype(int).tolist()
        return top, bottom, left, right

    def _texels(self, T: Array, k: int) -> NDArray[np.int64]:
        """(L, 4) what of every map an object at a pose reaches: see ``Maps.reached``."""
        points = [transform(T, kind[k].vertices) for kind in self.setting.things.casters]
        return self._drawn.maps.reached(np.concatenate(points))

    def _restore(self, squares: Sequence[Rectangle], texels: NDArray[np.int64]) -> None:
        """Take over the still buffers where something moved."""
        side = TILE * self.setting.config.samples
        for top, bottom, left, right in squares:
            window = slice(top * side, bottom * side), slice(left * side, right * side)
            self._drawn.face[window] = self._still.face[window]
            self._drawn.nearness[window] = self._still.nearness[window]
        # -1 is left of the map; as a slice's start it would count from the end.
        for reached in np.maximum(texels, 0).tolist():
            for light, (left, right, top, bottom) in enumerate(reached):
                window = light, slice(top, bottom + 1), slice(left, right + 1)
                self._drawn.maps.nearest[window] = self._still.maps.nearest[window]
        # Bits have no depth and cannot be restored by parts: shadows of other objects fall anywhere on the ground.
        np.copyto(self._drawn.bits, self._still.bits)

    def _measure(self, squares: Sequence[Rectangle]) -> None:
        """Look at what some squares of tiles show, which are to be coloured."""
        self._dirty[:] = False
        for top, bottom, left, right in squares:
            side = TILE * self.setting.config.samples
            tile_depths(self._drawn.nearness, side, top, bottom, left, right, self._depths)
            self._dirty[top:bottom, left:right] = True

    def _mark_shadowed(self, view: FrameGeometry, texels: NDArray[np.int64]) -> None:
        """Find the tiles whose light has changed with some ``texels`` (k, L, 4) of the maps."""
        maps, spans, limits = self._drawn.maps, self._spans, np.empty((len(self._spans), 5))
        # (k, L, 4) -> (L, k, 4): a kernel call per light.
        parts = rasterizer.fixed(texels.swapaxes(0, 1), np.int64)

        def note(light: int) -> None:
            before = self._nearest_before[light]
            note_changes(maps.nearest[light], before, parts[light], BLOCK, spans[light], limits[light])

        rasterizer.share(note, range(len(spans)))

        def mark(band: tuple[int, int]) -> None:
            mark_shadowed(
                *(self._depths, TILE * self.setting.config.samples, view.rays, maps.frames, spans, BLOCK, limits),
                *(maps.offset, maps.bias, maps.texel, *band, self._dirty),
            )

        rasterizer.in_bands(mark, (0, len(self._dirty)), BANDS * rasterizer.THREADS)

    def _shade(self, view: FrameGeometry) -> None:
        s, drawn = self.setting, self._drawn
        maps = drawn.maps
        strength, exposed = (rasterizer.fixed(values, np.float64) for values in (s.light.strength, s.exposures))
        lamps = Lamps(maps.directions, maps.frames, maps.nearest, DIRECT, maps.offset, maps.bias, strength, exposed)

        def draw(band: tuple[int, int]) -> None:
            shade(
                *(s.things.shapes, s.things.textures, view, lamps, s.config.samples, s.config.near, *band),
                *(TILE, self._dirty, drawn.face, drawn.nearness, self._color, self._cover),
            )

        rasterizer.in_bands(draw, (0, s.camera.height), BANDS * rasterizer.THREADS)

    def _count(self) -> None:
        def count(band: tuple[int, int]) -> None:
            count_lights(self._drawn.bits, self._rest_bits, DISC_WORDS, SET_BITS, *band, self._counts)

        def along_rows(band: tuple[int, int]) -> None:
            for kind, reach in enumerate(BLURS):
                blur_rows(self._counts[kind], reach, *band, self._rows[kind])

        def along_columns(band: tuple[int, int]) -> None:
            for kind, reach in enumerate(BLURS):
                blur_columns(self._rows[kind], reach, *band, self._blurred[kind])

        for step in (count, along_rows, along_columns):
            rasterizer.in_bands(step, (0, self._cells.height), rasterizer.THREADS)

    def _compose(self) -> None:
        """Bring the picture up to date where colours or the ground's shadows have changed."""
        s = self.setting
        # ``_dirty`` holds tiles with new colours already; tiles with new shadows on the ground join them.
        mark_changed(self._blurred, self._blurred_before, TILE // CELL, self._dirty)
        np.copyto(self._blurred_before, self._blurred)
        background, picture = rasterizer.fixed(s.background, np.uint8), self._picture
        ground = (rasterizer.fixed(values, np.float32) for values in (s.receives, self._rest, self._shown))
        receives, rest, shown = ground

        def finish(band: tuple[int, int]) -> None:
            compose(
                *(background, LINEAR, self._blurred, CELL, self._weight, receives, rest, shown, s.config.samples),
                *(self._color, self._cover, TABLE, TILE, self._dirty, *band, picture),
            )

        rasterizer.in_bands(finish, (0, s.camera.height), rasterizer.THREADS)
        self._composed = True
