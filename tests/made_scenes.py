"""Seeded scenes of primitives that physics has brought to rest, with masks and known supports: stacks, bowls with
fruit, planks across or against blocks, piles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import trimesh

from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import Array, pose, rotation_about
from f3sr.physics import settling
from f3sr.scene import Ground, Photo, Scene, SceneObject
from f3sr.vision import rasterizer

WIDTH, HEIGHT = 640, 480
FEWEST_PIXELS = 80
"""Visible pixels below which nobody would have drawn a mask."""
SECTORS = 16
"""Convex parts of a bowl's wall."""
SHARE = 0.05
"""Share of an object's load from which on something counts as its support, as in ``settle``."""

Shape = tuple[Mesh, tuple[ConvexPart, ...]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Made:
    """A scene at rest with its true supports (object, carrier)."""

    scene: Scene
    supports: frozenset[tuple[int, int]]


def made(family: str, seed: int) -> Made | None:
    """A scene of one of FAMILIES; None where it does not come to rest or something cannot be seen."""
    rng = np.random.default_rng([seed, sorted(FAMILIES).index(family)])
    shapes = FAMILIES[family](rng)
    objects = objects_of(shapes)
    rest = settling.settle(objects)
    if not rest.at_rest:
        return None
    objects = tuple(replace(o, T_world_object=rest.T_world_object[o.id]) for o in objects)
    if max(np.abs(o.bounds_world).max() for o in objects) > 0.5:
        return None  # rolled away
    scene = photographed(objects, camera(rng), rng)
    if min(np.count_nonzero(o.mask) for o in scene) < FEWEST_PIXELS:
        return None
    load = {o.id: sum(f for (a, _), f in rest.loads.items() if a == o.id) for o in objects}
    supports = frozenset(pair for pair, force in rest.loads.items() if force >= SHARE * load[pair[0]])
    return Made(scene=scene, supports=supports)


def jittered(scene: Scene, rng: np.random.Generator, *, depth: float = 0.03, tilt: float = np.radians(3)) -> Scene:
    """Every object moved along its middle's viewing ray and turned about its middle, as generated poses are off."""
    moved: list[SceneObject] = []
    for o in scene:
        middle = o.bounds_world.mean(0)
        away = (float(np.exp(depth * rng.normal())) - 1) * (middle - scene.camera.center)
        R = rotation_about(rng.normal(size=3), float(tilt * rng.normal()))
        moved.append(o.moved(pose(R, middle - R @ middle + away), stage="jitter", reason="a generated pose"))
    return scene.with_objects(*moved)


def block(x: float, y: float, z: float) -> Shape:
    return _convex(np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)]) / 2)


def can(radius: float, height: float) -> Shape:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    return _convex(np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (-height / 2, height / 2)]))


def ball(radius: float, subdivisions: int = 2) -> Shape:
    return _convex(np.asarray(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius).vertices))


def bowl(radius: float, height: float) -> Shape:
    """An open bowl whose origin is its foot: a floor and a wall of convex sectors."""
    foot, wall = 0.5 * radius, 0.008
    profile = np.array([(0, 0), (foot, 0), (radius, height), (radius - wall, height), (foot, wall), (0, wall)])
    revolved = trimesh.creation.revolve(profile, sections=2 * SECTORS)
    mesh = Mesh(vertices=np.asarray(revolved.vertices), faces=np.asarray(revolved.faces, np.int32))
    turns = np.linspace(0, 2 * np.pi, SECTORS + 1)
    parts = [can(foot, wall)[1][0].moved(pose(t=[0, 0, wall / 2]))]
    for a, b in pairwise(turns):
        corners = [(r * np.cos(t), r * np.sin(t), z) for t in (a, b) for r, z in profile[1:5]]
        parts.append(ConvexPart.hull_of(np.array(corners)))
    return mesh, tuple(parts)


def _stack(rng: np.random.Generator) -> list[tuple[Shape, Array]]:
    found: list[tuple[Shape, Array]] = []
    for x in (-0.15, 0.15):
        top = 0.0
        for level in range(int(rng.integers(1, 5))):
            side = float(rng.uniform(0.05, 0.12)) * 0.85**level
            shape = block(side, side * rng.uniform(0.7, 1.2), h := float(rng.uniform(0.02, 0.09)))
            if rng.random() < 0.3:
                shape = can(side / 2, h)
            at = [x + 0.1 * side * rng.normal(), 0.1 * side * rng.normal(), top + h / 2 + 0.001]
            found.append((shape, _upright(rng, at)))
            top += h + 0.001
    return [*found, *_scattered(rng, 3)]


def _contain(rng: np.random.Generator) -> list[tuple[Shape, Array]]:
    found: list[tuple[Shape, Array]] = []
    for x in (-0.17, 0.17):
        radius, height = float(rng.uniform(0.08, 0.13)), float(rng.uniform(0.025, 0.08))
        found.append((bowl(radius, height), _upright(rng, [x, 0, 0.001])))
        r = float(rng.uniform(0.02, 0.04))
        for k in range(int(rng.integers(1, 3))):
            shape = ball(r) if rng.random() < 0.6 else block(1.5 * r, 1.2 * r, 1.3 * r)
            found.append((shape, _upright(rng, [x, 0.01 * k, 0.02 + r + 2.4 * r * k])))
    return [*found, *_scattered(rng, 3)]


def _bridge(rng: np.random.Generator) -> list[tuple[Shape, Array]]:
    """A plank across two blocks, and one that leans against a third."""
    h, gap = float(rng.uniform(0.03, 0.1)), float(rng.uniform(0.12, 0.2))
    y = float(rng.uniform(-0.1, 0.0))
    found = [(block(0.06, 0.07, h), pose(t=[x, y, h / 2 + 5e-4])) for x in (-gap / 2, gap / 2)]
    found.append((block(gap + 0.05, 0.05, 0.015), pose(t=[0, y, h + 0.009])))
    side = float(rng.uniform(0.07, 0.11))
    found.append((block(side, side, side), pose(t=[0.3, 0.1, side / 2 + 5e-4])))
    length, angle = float(rng.uniform(0.16, 0.2)), float(rng.uniform(0.7, 1.0))
    R = rotation_about([0, 1, 0], angle)
    x = 0.3 - side / 2 - 0.5 * length * np.cos(angle) - 0.02
    found.append((block(length, 0.05, 0.012), pose(R.T @ np.eye(3), [x, 0.1, 0.5 * length * np.sin(angle) + 0.012])))
    return [*found, *_scattered(rng, 2, y=-0.25)]


def _pile(rng: np.random.Generator) -> list[tuple[Shape, Array]]:
    found: list[tuple[Shape, Array]] = []
    for k in range(8):
        a, b, c = rng.uniform(0.03, 0.14, 3)
        shape = block(a, b, 0.6 * c) if rng.random() < 0.7 else can(0.4 * a, c)
        R = rotation_about(rng.normal(size=3), float(rng.uniform(0, 3)))
        found.append((shape, pose(R, [*rng.uniform(-0.09, 0.09, 2), 0.1 + 0.12 * k])))
    return found


def _scatter(rng: np.random.Generator) -> list[tuple[Shape, Array]]:
    """Things behind things on the floor, flat ones in front of others among them."""
    places = [(x, y) for x in (-0.2, -0.05, 0.1, 0.25) for y in (-0.2, -0.05, 0.1)]
    found: list[tuple[Shape, Array]] = []
    for k in rng.permutation(len(places))[:9]:
        x, y = places[k] + rng.uniform(-0.015, 0.015, 2)
        w, h = float(rng.uniform(0.04, 0.11)), float(rng.choice([0.012, 0.03, 0.08, 0.18]))
        shape = can(w / 2, h) if rng.random() < 0.4 else block(w, 0.8 * w, h)
        found.append((shape, _upright(rng, [x, y, h / 2 + 5e-4])))
    return found


FAMILIES: dict[str, Callable[[np.random.Generator], list[tuple[Shape, Array]]]] = {
    "bridge": _bridge,
    "contain": _contain,
    "pile": _pile,
    "scatter": _scatter,
    "stack": _stack,
}


def _scattered(rng: np.random.Generator, count: int, y: float = 0.0) -> list[tuple[Shape, Array]]:
    found: list[tuple[Shape, Array]] = []
    for k in range(count):
        size = rng.uniform(0.03, 0.1, 3)
        shape = block(*size.tolist())
        x = (k - (count - 1) / 2) * 0.22 + rng.uniform(-0.02, 0.02)
        found.append((shape, _upright(rng, [x, y + float(rng.choice([-0.22, 0.22])), size[2] / 2 + 5e-4])))
    return found


def _upright(rng: np.random.Generator, at: list[float]) -> Array:
    return pose(rotation_about([0, 0, 1], float(rng.uniform(0, 2 * np.pi))), at)


def _convex(points: Array) -> Shape:
    hull = ConvexPart.hull_of(points)
    return Mesh(vertices=hull.vertices, faces=hull.faces), (hull,)


def objects_of(shapes: list[tuple[Shape, Array]]) -> tuple[SceneObject, ...]:
    """Objects of some shapes at their poses, numbered from 0."""
    return tuple(_object(id, shape, T) for id, (shape, T) in enumerate(shapes))


def _object(id: int, shape: Shape, T: Array) -> SceneObject:
    empty = np.zeros((HEIGHT, WIDTH), bool)
    return SceneObject(
        id=id, label="", mask_name=f"{id:02d}.png", mask=empty, mesh=shape[0], parts=shape[1], T_world_object=T
    )


def camera(rng: np.random.Generator) -> Camera:
    """About a metre away, 20 to 50 degrees above the middle."""
    elevation, azimuth = np.radians(rng.uniform(20, 50)), rng.uniform(0, 2 * np.pi)
    forward = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), -np.sin(elevation)])
    right = np.cross(forward, [0, 0, 1]) / np.cos(elevation)
    R = np.column_stack([right, np.cross(forward, right), forward])
    K = np.array([[520.0, 0, WIDTH / 2], [0, 520.0, HEIGHT / 2], [0, 0, 1]])
    return Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=pose(R, [0, 0, 0.05] - 1.0 * forward))


def photographed(objects: tuple[SceneObject, ...], camera: Camera, rng: np.random.Generator) -> Scene:
    ids = rasterizer.visible_ids(objects, camera)
    return Scene(
        photo=Photo(rgb=rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)),
        camera=camera,
        objects=tuple(replace(o, mask=ids == o.id) for o in objects),
        ground=Ground(source="made", confidence=1.0),
    )
