"""Everything that is drawn of some objects before light: nearest faces, maps of the lights, bits of ground shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from f3sr import raster
from f3sr.frames import Array, Camera, transform
from f3sr.rendering.light import Light, even_sky, ground_sky
from f3sr.rendering.shadow_kernels import cast_on_ground
from f3sr.rendering.shadow_maps import Caster, Maps, world_casters
from f3sr.rendering.shapes import casters_of, shapes_of, starts_of
from f3sr.rendering.surface_kernels import Shapes, Textures, View, nearest_faces
from f3sr.rendering.textures import textures_of
from f3sr.scene import SceneObject
from f3sr.triangles import project

WORD = 8
"""Lights whose shadows share a byte of every pixel."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Things:
    """The objects, ready to be drawn at any pose."""

    shapes: Shapes
    textures: Textures
    vertices: tuple[Array, ...]
    """Per object, in its frame at its scale."""
    casters: tuple[Caster, ...]
    """Per object, likewise."""
    first_face: NDArray[np.int64]
    first_vertex: NDArray[np.int64]

    @classmethod
    def of(cls, objects: Sequence[SceneObject], *, crease: float, caster_faces: int) -> Self:
        return cls(
            shapes=shapes_of(objects, crease=crease),
            textures=textures_of(objects),
            vertices=tuple(o.scale * o.mesh.vertices for o in objects),
            casters=tuple(casters_of(objects, caster_faces)),
            first_face=starts_of([len(o.mesh.faces) for o in objects]),
            first_vertex=starts_of([len(o.mesh.vertices) for o in objects]),
        )

    def seen_by(self, camera: Camera, poses: Array, near: float) -> View:
        """Vertices on the pixels of ``camera``, with the objects at ``poses`` (N, 4, 4)."""
        points = np.empty((int(self.first_vertex[-1]), 5))
        K = raster.fixed(camera.K, np.float64)
        for k, (T, v) in enumerate(zip(poses, self.vertices, strict=True)):
            seen = raster.fixed(camera.to_camera(transform(T, v)), np.float64)
            project(seen, K, near, points[self.first_vertex[k] : self.first_vertex[k + 1]])
        rays = np.column_stack([camera.T_world_camera[:3, :3] @ np.linalg.inv(camera.K), camera.center])
        return View(
            points=raster.fixed(points, np.float64),
            turns=raster.fixed(poses[:, :3, :3], np.float64),
            rays=raster.fixed(rays, np.float64),
        )

    def casting(self, poses: Array, chosen: Sequence[int]) -> list[Caster]:
        return world_casters([self.casters[k] for k in chosen], poses[list(chosen)])


@dataclass(frozen=True, eq=False)
class Buffers:
    """What some objects have been drawn into; mutable."""

    face: NDArray[np.int32]
    """(samples h, samples w), -1 where nothing is."""
    nearness: NDArray[np.float32]
    """1 / z, 0 where nothing is."""
    maps: Maps
    bits: NDArray[np.uint8]
    """(words, h, w)"""

    @classmethod
    def empty(cls, camera: Camera, samples: int, maps: Maps, words: int) -> Self:
        h, w = camera.height, camera.width
        face = np.full((samples * h, samples * w), -1, np.int32)
        return cls(face, np.zeros(face.shape, np.float32), maps, np.zeros((words, h, w), np.uint8))

    def clear(self) -> None:
        """Forget everything drawn."""
        for array, value in zip(self._arrays, (-1, 0, -np.inf, 0), strict=True):
            array.fill(value)

    def take(self, other: Buffers) -> None:
        """Become equal to other buffers of the same shape."""
        for own, its in zip(self._arrays, other._arrays, strict=True):
            np.copyto(own, its)

    @property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        return self.face, self.nearness, self.maps.nearest, self.bits


def draw_surfaces(things: Things, view: View, chosen: Sequence[int], near: float, buffers: Buffers) -> None:
    """Draw the faces of some objects."""
    height = len(buffers.face)

    def draw(band: tuple[int, int]) -> None:
        for k in chosen:
            faces = int(things.first_face[k]), int(things.first_face[k + 1])
            nearest_faces(view.points, things.shapes.faces, *faces, near, *band, buffers.face, buffers.nearness)

    raster.in_bands(draw, _rows(view, things, chosen, height), raster.THREADS)


def _rows(view: View, things: Things, chosen: Sequence[int], height: int) -> tuple[int, int]:
    """The rows that some objects may touch: all, when one reaches behind the near plane."""
    low, high = float(height), 0.0
    for k in chosen:
        v = view.points[things.first_vertex[k] : things.first_vertex[k + 1], 4]
        if len(v):
            low, high = np.minimum(low, v.min()), np.maximum(high, v.max())
    if not np.isfinite(low + high):
        return 0, height
    first, last = np.clip([np.floor(low - 1), np.ceil(high + 1)], 0, height)
    return int(first), max(int(first), int(last))


def ground_words(light: Light) -> list[Array]:
    """Directions of the lights, ``WORD`` to a byte: first those of the disc, then those of the sky."""
    lights = np.concatenate([light.disc, ground_sky()])
    return [raster.fixed(lights[k : k + WORD], np.float64) for k in range(0, len(lights), WORD)]


def draw_ground_shadows(
    casters: Sequence[Caster], camera: Camera, words: Sequence[Array], near: float, bits: NDArray[np.uint8]
) -> None:
    """Set the bits (words, h, w) of the lights that some casters hide from the ground."""
    P = raster.fixed(camera.K @ camera.T_camera_world[:3], np.float64)
    fixed = [(raster.fixed(v, np.float64), raster.fixed(f, np.int32)) for v, f in casters]

    def draw(word: int) -> None:
        rows = np.array([camera.height, -1])
        for vertices, faces in fixed:
            cast_on_ground(vertices, faces, P, words[word], near, bits[word], rows)

    raster.share(draw, range(len(words)))


def light_maps(light: Light, ball: tuple[Array, float], side: int, sky: int) -> Maps:
    """Empty maps of the lights of the disc and of ``sky`` lights of the sky."""
    return Maps.empty(np.concatenate([light.disc, even_sky(sky)]), *ball, side)
