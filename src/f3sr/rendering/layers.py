"""Everything that is drawn of some objects before light: nearest faces, maps of the lights, bits of ground shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, transform
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.light import DIRECT, DIRECT_ON_GROUND, SKY, SKY_ON_GROUND, Light, disc, even_sky, ground_sky
from f3sr.rendering.shadow_kernels import cast_on_ground
from f3sr.rendering.shadow_maps import Caster, Maps, world_casters
from f3sr.rendering.shapes import casters_of, faces_outward, shapes_of, starts_of
from f3sr.rendering.surface_kernels import FrameGeometry, Shapes, Textures, find_extents, nearest_faces
from f3sr.rendering.textures import textures_of
from f3sr.runtime.daemon_thread import begun
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.scan_conversion import project

WORD = 8
"""Lights whose shadows share a byte of every cell, one bit each."""
DISC_WORDS = DIRECT_ON_GROUND // WORD
"""How many bytes of every cell are of the disc's lights; those of the sky follow."""


class Casting(NamedTuple):
    """Surfaces in the world that cast shadows of the disc, and simpler ones for those of the sky."""

    disc: list[Caster]
    sky: list[Caster]


@dataclass(frozen=True, eq=False, kw_only=True)
class Things:
    """The objects, ready to be drawn at any pose."""

    shapes: Shapes
    textures: Textures
    vertices: tuple[Array, ...]
    """(n, 3) [m] per object, in its frame, scaled."""
    outward: tuple[bool, ...]
    """Per object, whether its back is always hidden by its front."""
    casters: tuple[tuple[Caster, ...], ...]
    """Two tuples, for shadows of the disc and of the sky: a simplified surface per object, in its frame, scaled."""
    first_face: NDArray[np.int64]
    """(N + 1,) where the faces of every object begin among all, and their number."""
    first_vertex: NDArray[np.int64]
    """(N + 1,) the same of vertices."""

    @classmethod
    def of(cls, objects: Sequence[SceneObject], config: RenderConfig) -> Self:
        """Objects in the scene's order; their poses do not matter."""
        shadows = config.shadows
        # Simplification runs in a thread of its own while textures are made.
        casters = begun(casters_of, objects, shadows.caster_faces, shadows.sky_caster_faces)
        return cls(
            shapes=shapes_of(objects, crease=config.crease),
            textures=textures_of(objects),
            vertices=tuple(o.scale * o.mesh.vertices for o in objects),
            outward=tuple(faces_outward(*o.mesh.welded) for o in objects),
            casters=casters.result(),
            first_face=starts_of([len(o.mesh.faces) for o in objects]),
            first_vertex=starts_of([len(o.mesh.vertices) for o in objects]),
        )

    def seen_by(self, camera: Camera, poses: Array, near: float) -> FrameGeometry:
        """Vertices on the pixels of ``camera``, with the objects at ``poses`` (N, 4, 4); ``near`` is the near plane
        [m]."""
        points = np.empty((int(self.first_vertex[-1]), 5))
        K = rasterizer.fixed(camera.K, np.float64)
        for k, (T, v) in enumerate(zip(poses, self.vertices, strict=True)):
            seen = rasterizer.fixed(camera.to_camera(transform(T, v)), np.float64)
            project(seen, K, near, points[self.first_vertex[k] : self.first_vertex[k + 1]])
        extents = np.empty((len(self.vertices), 4))
        find_extents(points, rasterizer.fixed(self.first_vertex, np.int64), near, extents)
        # q = (x, y, 1) is the point K^-1 q at depth 1 in camera axes.
        rays = np.column_stack([camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K), camera.center])
        return FrameGeometry(
            points=rasterizer.fixed(points, np.float64),
            turns=rasterizer.fixed(poses[:, :3, :3], np.float64),
            extents=rasterizer.fixed(extents, np.float64),
            rays=rasterizer.fixed(rays, np.float64),
        )

    def casting(self, poses: Array, chosen: Sequence[int]) -> Casting:
        """What some objects at ``poses`` (N, 4, 4) cast shadows with."""
        disc, sky = (world_casters([kind[k] for k in chosen], poses[list(chosen)]) for kind in self.casters)
        return Casting(disc, sky)


@dataclass(frozen=True, eq=False)
class Buffers:
    """What some objects have been drawn into; mutable."""

    face: NDArray[np.int32]
    """(samples h, samples w), -1 where nothing is."""
    nearness: NDArray[np.float32]
    """(samples h, samples w) 1 / z [1/m], 0 where nothing is."""
    maps: Maps
    bits: NDArray[np.uint8]
    """(words, cells h, cells w): bit k of word i is 1 where light 8 i + k is hidden from the ground."""
    kept: NDArray[np.float32]
    """(samples h, samples w) 1 / z of what the background shows and may hide objects, 0 where nothing does."""

    @classmethod
    def empty(
        cls, fine: Camera, maps: Maps, cells: Camera, words: int, kept: NDArray[np.float32] | None = None
    ) -> Self:
        """Empty buffers: ``fine`` has a pixel per sample, ``cells`` one per cell of the ground, with ``words`` bytes
        each."""
        face = np.full((fine.height, fine.width), -1, np.int32)
        bits = np.zeros((words, cells.height, cells.width), np.uint8)
        kept = np.zeros(face.shape, np.float32) if kept is None else kept
        return cls(face, kept.copy(), maps, bits, kept)

    def clear(self) -> None:
        """Forget everything drawn."""
        for array, value in zip(self._arrays, (-1, self.kept, -np.inf, 0), strict=True):
            array[:] = value

    def take(self, other: Buffers) -> None:
        """Become equal to other buffers of the same shape."""
        for own, its in zip(self._arrays, other._arrays, strict=True):
            np.copyto(own, its)

    @property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return self.face, self.nearness, self.maps.nearest, self.bits


def draw_surfaces(things: Things, view: FrameGeometry, chosen: Sequence[int], near: float, buffers: Buffers) -> None:
    """Draw the faces of the objects ``chosen`` (indices) into ``face`` and ``nearness``; ``near`` is the near plane
    [m]."""

    def draw(band: tuple[int, int]) -> None:
        for k in chosen:
            # Backs are skipped only where no vertex is before the near plane: a cut surface is open, and its back
            # shows.
            faces = int(things.first_face[k]), int(things.first_face[k + 1])
            nearest_faces(
                *(
                    view.points,
                    things.shapes.faces,
                    *faces,
                    things.outward[k] and bool(np.isfinite(view.extents[k, 0])),
                ),
                *(near, *band, buffers.face, buffers.nearness),
            )

    rasterizer.in_bands(draw, _rows(view, chosen, len(buffers.face)), rasterizer.THREADS)


def _rows(view: FrameGeometry, chosen: Sequence[int], height: int) -> tuple[int, int]:
    """The rows that some objects may touch."""
    low, high = view.extents[list(chosen), 2].min(initial=np.inf), view.extents[list(chosen), 3].max(initial=-np.inf)
    if low > high:
        return 0, 0
    first, last = np.clip([low - 1, high + 1], 0, height)
    return int(np.floor(first)), int(np.ceil(last))


def ground_words(light: Light) -> list[Array]:
    """Directions of the lights, ``WORD`` to a byte: first those of the disc, then those of the sky."""
    lights = np.concatenate([disc(light.direction, light.angle, DIRECT_ON_GROUND), ground_sky(SKY_ON_GROUND)])
    return [rasterizer.fixed(lights[k : k + WORD], np.float64) for k in range(0, len(lights), WORD)]


def draw_ground_shadows(
    casting: Casting, camera: Camera, words: Sequence[Array], near: float, bits: NDArray[np.uint8]
) -> None:
    """Set the bits (words, h, w) of the lights that some casters hide from the ground, as ``camera`` sees it."""
    P = rasterizer.fixed(camera.K @ camera.T_camera_world[:3], np.float64)

    def draw(word: int) -> None:
        for caster in casting.disc if word < DISC_WORDS else casting.sky:
            cast_on_ground(*caster, P, words[word], near, bits[word])

    rasterizer.share(draw, range(len(words)))


def draw_maps(casting: Casting, maps: Maps) -> None:
    """Draw some casters into the maps of the disc's lights, which come first, and of the sky's."""
    maps.cast(casting.disc, slice(0, DIRECT))
    maps.cast(casting.sky, slice(DIRECT, None))


def light_maps(light: Light, ball: tuple[Array, float], side: int) -> Maps:
    """Empty maps of the DIRECT lights of the disc, then the SKY lights, each ``side`` texels wide, over the
    ``ball``."""
    return Maps.empty(np.concatenate([disc(light.direction, light.angle, DIRECT), even_sky(SKY)]), *ball, side)
