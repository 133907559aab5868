"""Tiny scenes for tests: boxes on a plane, with a camera, masks that cover them and no pictures to load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Material, Mesh, union
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose
from f3sr.metrics.measures import mean_over_masks, visible_ious
from f3sr.scene import (
    GROUND,
    Geometry,
    GeometrySource,
    Ground,
    Photo,
    Relation,
    Scene,
    SceneGraph,
    SceneObject,
    Support,
)
from f3sr.vision import rasterizer

WIDTH, HEIGHT = 64, 48


def chair() -> Mesh:
    """Nothing of it is symmetric: a seat with a back, and an arm on one side, 1 unit wide."""
    parts = [
        box_mesh((1.0, 0.8, 0.3)).hull,
        box_mesh((1.0, 0.2, 1.1)).hull.moved(pose(t=[0, 0.3, 0.4])),
        box_mesh((0.2, 0.6, 0.6)).hull.moved(pose(t=[0.4, -0.1, 0.3])),
    ]
    vertices, faces = union(parts)
    return Mesh(vertices=vertices, faces=np.asarray(faces, np.int32))


def box_mesh(size: Sequence[float] = (0.1, 0.1, 0.1), *, textured: bool = False) -> Mesh:
    """A closed box (12 faces) centred at the origin; ``textured``: a texture, vertices split."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2
    hull = _hull(corners.tobytes())
    if not textured:
        return Mesh(vertices=hull.vertices, faces=hull.faces)
    faces = np.arange(36, dtype=np.int32).reshape(-1, 3)
    uv = np.tile([[0.1, 0.1], [0.9, 0.1], [0.5, 0.8]], (12, 1))
    texture = np.random.default_rng(0).integers(0, 256, (8, 6, 3), np.uint8)
    return Mesh(vertices=hull.vertices[hull.faces.ravel()], faces=faces, uv=uv, materials=(Material(texture=texture),))


def box(
    id: int,
    *,
    size: Sequence[float] = (0.1, 0.1, 0.1),
    at: Sequence[float] = (0.0, 0.0, 0.05),
    R: Array | None = None,
    scale: float = 1.0,
    textured: bool = False,
    label: str = "box",
) -> SceneObject:
    """A box of ``size`` [m] in the world whose asset is 1 / ``scale`` as large, centred at ``at``."""
    mesh = box_mesh(np.array(size) / scale, textured=textured)
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[4:40, 2 + 6 * (id % 10) : 8 + 6 * (id % 10)] = True
    return SceneObject(
        id=id,
        label=label,
        mask_name=f"{id:02d}_box.png",
        mask=mask,
        mesh=mesh,
        T_world_object=pose(R, at),
        scale=scale,
        parts=(_hull(mesh.vertices.tobytes()),),
        supports=(Support(id=GROUND),),
        supported_by=GROUND,
    )


@cache
def _hull(points: bytes) -> ConvexPart:
    """The hull of the points (n, 3) of a box: many tests ask for few boxes."""
    return ConvexPart.hull_of(np.frombuffer(points).reshape(-1, 3))


def scene_of(*objects: SceneObject) -> Scene:
    """A scene around given objects, seen from 1 m away and .3 m up."""
    K = np.array([[60.0, 0, WIDTH / 2], [0, 60.0, HEIGHT / 2], [0, 0, 1]])
    T_world_camera = pose(t=[0, -1, 0.3]) @ T_UP_FROM_CAMERA
    rgb = np.random.default_rng(1).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    return Scene(
        photo=Photo(rgb=rgb),
        camera=Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=T_world_camera),
        objects=objects,
        ground=Ground(source="test", confidence=1.0),
    )


def box_stack_scene(count: int = 3) -> Scene:
    """``count`` boxes of 10, 9, 8... cm on each other, textured in turns, one asset in other units."""
    boxes, top = [], 0.0
    for id in range(count):
        side = 0.1 - 0.01 * id
        o = box(
            id,
            size=(side, side, side),
            at=(0.003 * id, 0.0, top + side / 2),
            scale=0.01 if id == 1 else 1.0,
            textured=id % 2 == 0,
            label=f"box {id}",
        )
        below = GROUND if id == 0 else id - 1
        boxes.append(replace(o, supports=(Support(id=below),), supported_by=below))
        top += side
    relations = tuple(
        Relation(subject=id, predicate="supported_by", object=id - 1, confidence=1.0, evidence="test")
        for id in range(1, count)
    )
    return replace(scene_of(*boxes), graph=SceneGraph(relations=relations, source="test"))


def ball_mesh(radius: float, rings: int = 32) -> Mesh:
    """A closed ball about the origin whose poles are vertices."""
    angles = np.linspace(0, np.pi, rings + 1)[1:-1]
    return _revolved(radius * np.column_stack([np.sin(angles), -np.cos(angles)]), (-radius, radius))


def dish_mesh(radius: float = 0.25, width: float = 0.1, wall: float = 0.005) -> Mesh:
    """A closed dish, a shell of a ball of ``radius`` and ``wall`` thick; its inside touches the origin from below."""
    x = np.linspace(0, width, 13)[1:]
    inside = np.column_stack([x, radius - np.sqrt(radius**2 - x**2)])
    outside = inside - [0, wall]
    return _revolved(np.concatenate([outside, inside[::-1]]), (-wall, 0.0))


def _revolved(profile: Array, poles: tuple[float, float], sides: int = 32) -> Mesh:
    """A closed surface about z: a profile of radius and height (n, 2), counter-clockwise from the height of the first
    pole to that of the second."""
    turns = 2 * np.pi * np.arange(sides) / sides
    r, z = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), sides))
    rings = np.stack([r * np.cos(turns), r * np.sin(turns), z], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([[(0, 0, poles[0]), (0, 0, poles[1])], rings])
    i = np.arange(sides)
    j = (i + 1) % sides
    first, last = 2, 2 + (len(profile) - 1) * sides
    faces = [np.column_stack([np.zeros(sides, int), first + j, first + i])]
    faces.append(np.column_stack([np.ones(sides, int), last + i, last + j]))
    for k in range(len(profile) - 1):
        a, b = 2 + k * sides, 2 + (k + 1) * sides
        faces += [np.column_stack([a + i, a + j, b + j]), np.column_stack([a + i, b + j, b + i])]
    return Mesh(vertices=vertices, faces=np.concatenate(faces).astype(np.int32))


def visible_iou(scene: Scene) -> float:
    """mIoU_visible at the pixel centres: the mean IoU of visible pixels with the masks."""
    return mean_over_masks(visible_ious(scene), scene)


def measured(scene: Scene, source: GeometrySource) -> Scene:
    """The scene with the depth of its own surfaces as the photo's geometry, and with the masks that it shows."""
    seen = rasterizer.render(scene.objects, scene.camera)
    z = np.where(np.isfinite(seen.depth), seen.depth, 1.0).astype(np.float32)
    v, u = np.indices(z.shape) + 0.5
    K = scene.camera.K
    points = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], -1)
    return replace(
        scene,
        ground=replace(scene.ground, height_error=0.0),
        geometry=Geometry(points=points.astype(np.float32), valid=np.isfinite(seen.depth), source=source),
        objects=tuple(replace(o, mask=seen.ids == o.id) for o in scene.objects),
    )
