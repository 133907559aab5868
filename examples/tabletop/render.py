"""A small path tracer over Embree: the example's photo, and exact surfaces and depths at pixel centres."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, invert_pose, transform
from tabletop import looks
from tabletop.things import Thing, arrange, room

TABLE = 0
"""The table's place in the furnished world."""
BOUNCES = 5
NUDGE = 1e-4
"""Rays start this far off a surface [m]."""
BRIGHTEST = 5.0
"""Radiance of one sample is cut here: rare bright paths would leave specks."""


@dataclass(frozen=True, kw_only=True)
class Lamp:
    """A window: centre, half sides u and v, all (3,) [m], radiance (3,); it shines along u x v."""

    center: Array
    u: Array
    v: Array
    radiance: Array

    @property
    def normal(self) -> Array:
        return unit(np.cross(self.u, self.v))

    @property
    def area(self) -> float:
        return 4 * float(np.linalg.norm(np.cross(self.u, self.v)))

    def seen(self, origin: Array, direction: Array, before: Array) -> Array:
        """Radiance (n, 3) of rays that meet the window ``before`` a surface; two bars cross it."""
        facing = dot(direction, self.normal[None])
        t = ((self.center - origin) @ self.normal) / np.where(np.abs(facing) < 1e-9, 1e-9, facing)
        local = origin + t[:, None] * direction - self.center
        a, b = (local @ s / (s @ s) for s in (self.u, self.v))
        pane = (np.abs(a) < 1) & (np.abs(b) < 1) & (np.abs(a) > 0.04) & (np.abs(b) > 0.04)
        lit = pane & (facing < 0) & (t > 0) & (t < before)
        return lit[:, None] * self.radiance


WINDOW = Lamp(
    center=np.array([-0.95, 0.30, 1.10]),
    u=np.array([0.18, 0.36, 0.0]),
    v=np.array([0.26, -0.13, 0.28]),
    radiance=np.array([1.0, 0.95, 0.87]) * 13.5,
)
ABOVE, BELOW = np.array([0.46, 0.50, 0.56]), np.array([0.27, 0.24, 0.21])
"""Radiance of the rest of the room."""


class World:
    """All things in one ray-casting scene; ``owner`` (m,) is the thing of each triangle."""

    def __init__(self, things: Sequence[Thing], poses: Sequence[Array]) -> None:
        self.things, self.T_object_world = things, [invert_pose(T) for T in poses]
        placed = [
            (transform(T, t.triangles[0]), t.triangles[1] @ T[:3, :3].T) for t, T in zip(things, poses, strict=True)
        ]
        corners, self.normals = (np.concatenate(a) for a in zip(*placed, strict=True))
        self.owner = np.repeat(np.arange(len(things)), [len(c) for c, _ in placed])
        faces = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
        self.scene = EmbreeScene()
        self.mesh: Any = TriangleMesh(self.scene, corners.reshape(-1, 3).astype(np.float32), faces)

    def cast(self, origin: Array, direction: Array) -> tuple[NDArray[np.int32], Array, Array, Array]:
        """Triangle (n,) or -1, distance (n,), flat and shading normals (n, 3) on the ray's side."""
        hit = self.scene.run(origin.astype(np.float32), direction.astype(np.float32), query="INTERSECT", output=1)
        triangle, u, v = hit["primID"], hit["u"][:, None], hit["v"][:, None]
        corner = self.normals[np.maximum(triangle, 0)]
        shading = unit(corner[:, 0] * (1 - u - v) + corner[:, 1] * u + corner[:, 2] * v)
        flat = unit(hit["Ng"].astype(float))
        flat *= -np.sign(dot(flat, direction))[:, None]
        shading *= np.sign(dot(shading, flat))[:, None]
        grazing = dot(shading, direction) > -1e-3
        return triangle, hit["tfar"].astype(float), flat, np.where(grazing[:, None], flat, shading)

    def blocked(self, origin: Array, direction: Array, distance: Array) -> NDArray[np.bool_]:
        query = (origin.astype(np.float32), direction.astype(np.float32), distance.astype(np.float32))
        return np.asarray(self.scene.run(*query, query="OCCLUDED") >= 0)

    def look_up(self, triangle: NDArray[np.int32], points: Array) -> tuple[Array, Array, Array]:
        """Colour (n, 3), reflectance (n,) and roughness (n,) at world points."""
        values, roughness, owner = np.zeros((len(points), 4)), np.zeros(len(points)), self.owner[triangle]
        for k in np.unique(owner):
            on = owner == k
            values[on] = self.things[k].look(transform(self.T_object_world[k], points[on]))
            roughness[on] = self.things[k].roughness
        return values[:, :3], values[:, 3], roughness


def rays(camera: Camera, offset: Array | float = 0.5) -> tuple[Array, Array]:
    """Origins and unit directions (h * w, 3) through each pixel at ``offset`` from its corner."""
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    pixel = np.stack([columns, rows], -1).reshape(-1, 2) + offset
    directions = np.column_stack([pixel, np.ones(len(pixel))]) @ np.linalg.inv(camera.K).T
    return np.broadcast_to(camera.center, directions.shape), unit(directions @ camera.T_world_camera[:3, :3].T)


def first_hits(world: World, camera: Camera) -> tuple[NDArray[np.int64], Array, Array]:
    """At exact pixel centres: thing (h, w) or -1, points and normals (h, w, 3) in camera axes."""
    origin, direction = rays(camera)
    triangle, distance, flat, _ = world.cast(origin, direction)
    points = camera.to_camera(origin + distance[:, None] * direction)
    shape = (camera.height, camera.width)
    thing = np.where(triangle >= 0, world.owner[triangle], -1).reshape(shape)
    return thing, points.reshape(*shape, 3), (flat @ camera.T_world_camera[:3, :3]).reshape(*shape, 3)


def trace(world: World, origin: Array, direction: Array, rng: np.random.Generator) -> Array:
    """Radiance (n, 3) along rays: the window's light sampled directly, the rest by chance.

    Light that reaches a dull surface by way of a mirror (caustics) is left out.
    """
    radiance, weight, pixel = np.zeros(direction.shape), np.ones(direction.shape), np.arange(len(direction))
    sees_window = np.ones(len(direction), bool)
    for bounce in range(BOUNCES):
        triangle, distance, flat, normal = world.cast(origin, direction)
        hit = triangle >= 0
        window = WINDOW.seen(origin, direction, np.where(hit, distance, np.inf)) * sees_window[:, None]
        bright = window.any(1)
        np.add.at(radiance, pixel, weight * np.where(bright[:, None], window, sky(direction) * ~hit[:, None]))

        keep = np.flatnonzero(hit & ~bright)
        point = origin[keep] + distance[keep, None] * direction[keep]
        color, reflectance, roughness = world.look_up(triangle[keep], point)
        mirror = fresnel(reflectance, -dot(normal[keep], direction[keep]), roughness)
        take, mirrored, share = branch(mirror, rng, both=bounce == 0)
        keep, color, reflectance, roughness = keep[take], color[take], reflectance[take], roughness[take]

        pixel, normal, sees_window = pixel[keep], normal[keep], sees_window[keep] & mirrored
        tint = np.where((reflectance > 0.3)[:, None], color + 0.25, 1.0)
        weight = weight[keep] * share[:, None] * np.where(mirrored[:, None], tint, color)
        origin = point[take] + NUDGE * flat[keep]
        direct = ~mirrored[:, None] * from_window(world, origin, normal, rng)
        np.add.at(radiance, pixel, weight * direct)
        glossy = reflect(direction[keep], normal) + 0.9 * roughness[:, None] ** 2 * rng.normal(size=normal.shape)
        diffuse = normal + unit(rng.normal(size=normal.shape))
        direction = unit(np.where(mirrored[:, None], glossy, diffuse))
    return np.minimum(radiance, BRIGHTEST)


def branch(
    mirror: Array, rng: np.random.Generator, *, both: bool
) -> tuple[NDArray[np.int64], NDArray[np.bool_], Array]:
    """Which hits go on, whether as mirror rays, and the share of light each carries: by chance or both."""
    every = np.arange(len(mirror))
    if not both:
        return every, rng.random(len(mirror)) < mirror, np.ones(len(mirror))
    glossy = np.flatnonzero(mirror > 0)
    mirrored = np.arange(len(every) + len(glossy)) >= len(every)
    return np.concatenate([every, glossy]), mirrored, np.concatenate([1 - mirror, mirror[glossy]])


def sky(direction: Array) -> Array:
    return looks.mix(BELOW, ABOVE, np.clip(0.5 + 0.8 * direction[:, 2], 0, 1))


def fresnel(reflectance: Array, cosine: Array, roughness: Array) -> Array:
    """Schlick's reflectance; rough surfaces brighten less towards grazing."""
    limit = np.maximum(1 - 2.2 * roughness, reflectance)
    return np.where(reflectance > 0, reflectance + (limit - reflectance) * (1 - np.clip(cosine, 0, 1)) ** 5, 0)


def reflect(direction: Array, normal: Array) -> Array:
    return direction - 2 * dot(direction, normal)[:, None] * normal


def from_window(world: World, point: Array, normal: Array, rng: np.random.Generator) -> Array:
    """Irradiance over pi (n, 3) from one random point of the window, shadow included."""
    a, b = rng.uniform(-1, 1, (2, len(point), 1))
    to = WINDOW.center + a * WINDOW.u + b * WINDOW.v - point
    distance = np.linalg.norm(to, axis=1)
    to /= distance[:, None]
    form = np.maximum(dot(to, normal), 0) * np.maximum(-(to @ WINDOW.normal), 0) * WINDOW.area / (np.pi * distance**2)
    lit = np.flatnonzero(form > 0)
    form[lit] *= ~world.blocked(point[lit], to[lit], distance[lit])
    return form[:, None] * WINDOW.radiance


def photo(poses: Sequence[Array], camera: Camera, *, samples: int, workers: int, seed: int) -> NDArray[np.uint8]:
    """The developed picture (h, w, 3) of the room and the things at their poses."""
    job = partial(_one_sample, camera=camera, seed=seed)
    total = np.zeros((camera.height * camera.width, 3))
    with ProcessPoolExecutor(workers, initializer=_open_world, initargs=(poses,)) as pool:
        for light in pool.map(job, range(samples)):
            total += light
    radiance = total.reshape(camera.height, camera.width, 3) / samples
    return develop(radiance, np.random.default_rng(seed))


def furnished(poses: Sequence[Array]) -> World:
    """The world of ``room()`` followed by ``arrange()``."""
    scenery = room()
    return World([*scenery, *arrange()], [*(t.T_start for t in scenery), *poses])


_world: World
"""Of a worker process: looks are closures, so each worker builds its own."""


def _open_world(poses: Sequence[Array]) -> None:
    global _world
    _world = furnished(poses)


def _one_sample(index: int, *, camera: Camera, seed: int) -> NDArray[np.float32]:
    rng = np.random.default_rng([seed, index])
    jitter = rng.uniform(0, 1, (camera.height * camera.width, 2))
    return trace(_world, *rays(camera, jitter), rng).astype(np.float32)


def develop(radiance: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Bloom, vignette, a soft shoulder, gamma and sensor noise."""
    glow = gaussian_filter(np.maximum(radiance - 1.0, 0), (5, 5, 0))
    h, w = radiance.shape[:2]
    y, x = np.mgrid[-1 : 1 : h * 1j, -1 : 1 : w * 1j]
    light = (radiance + 0.15 * glow) * (1 - 0.08 * (x**2 + y**2))[..., None]
    srgb = looks.to_srgb(tone(light)) + rng.normal(0, 1.2 / 255, radiance.shape)
    return np.round(255 * np.clip(srgb, 0, 1)).astype(np.uint8)


def tone(light: Array) -> Array:
    """Straight in the shadows, rolling off towards white."""
    knee = 0.5
    over = np.maximum(light - knee, 0)
    return np.where(light <= knee, light, knee + (1 - knee) * (1 - np.exp(-over / (1 - knee))))


def dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(-1))


def unit(v: Array) -> Array:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)
