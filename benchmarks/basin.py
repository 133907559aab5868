"""The basin of alignment: single real meshes, disturbed by random starts, aligned by what the product runs.

A mesh rests on its nearest stable facet, turned at random about the vertical, and is seen in a square picture from a
random height. Its silhouette there is the mask. A start shifts it in the image plane by a given length in a random
direction, turns it about the vertical and scales it about its middle, both uniformly up to a bound, either way. It has
arrived where its whole silhouette meets the whole true mask, hidden parts included, with an IoU above ARRIVED.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import looks
from f3sr.contact.stable_facets import resting_turn
from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh, mass_properties
from f3sr.core.transforms import pose, rotation_about
from f3sr.io.mesh_files import load_mesh
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Photo, Scene, SceneObject
from f3sr.stages.align import AlignConfig, align
from f3sr.vision.silhouette import Mask, iou, union_of

MESHES = (
    *("ycb_mug", "gso_frypan", "ycb_a_toy_airplane", "ycb_windex_bottle", "ycb_mustard_bottle", "ycb_cracker_box"),
    *("ycb_b_lego_duplo", "ycb_hammer", "ycb_padlock", "ycb_bowl"),
)
"""Half of them far from convex; one, the bowl, round: there IoU counts, not yaw."""
STARTS = 21
"""Per mesh: more than two hundred in all."""
PIXELS, FOCAL = 512, 600.0
"""Sides and focal length [px] of the picture."""
DIAGONAL = 290.0
"""Pixels that the diagonal of a mesh's bounding box spans; silhouettes are 150 to 290 long. With less, the farthest
starts, at four fifths of the true size, would lie outside the product's bound on shifts."""
HEIGHTS = (math.radians(15), math.radians(55))
"""Least and most elevation of the camera [rad]."""
ARRIVED = 0.98
"""IoU with the true mask."""
CARD = (0.5, 1.5)
"""Distance of what hides a part, and its reach from the object's middle: shares of the object's distance and size."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """Magnitudes of a disturbance, and how much of the object's mask something nearer hides."""

    key: str
    name: str
    shift: float
    """[px]"""
    yaw: float
    """[rad]"""
    scale: float
    hidden: float
    target: float
    """Share of starts that should arrive."""


KINDS = (
    Start(key="near", name="20 px, 15 deg, 10 %", shift=20, yaw=math.radians(15), scale=0.1, hidden=0, target=0.99),
    Start(key="far", name="80 px, 40 deg, 20 %", shift=80, yaw=math.radians(40), scale=0.2, hidden=0, target=0.95),
    Start(key="hidden", name="20 px, 30 % hidden", shift=20, yaw=math.radians(15), scale=0.1, hidden=0.3, target=0.95),
)


@dataclass(frozen=True, kw_only=True)
class Run:
    """One start and where it ended."""

    kind: str
    mesh: str
    seed: int
    before: float
    """IoU with the true mask."""
    after: float
    seen: float
    """The same, where nothing hides the object: all that a search can know."""
    reachable: bool
    """The true pose lies inside the product's bounds around the start."""
    evaluations: int
    cpu: float
    """[s]"""


def run(objects: Path, kinds: Sequence[Start] = KINDS, *, starts: int = STARTS, config: AlignConfig) -> Iterator[Run]:
    """All starts of all meshes that are there."""
    for name in MESHES:
        if (objects / f"{name}.glb").exists():
            mesh = load_mesh(objects / f"{name}.glb")
            for kind in kinds:
                for seed in range(starts):
                    yield one(mesh, name, kind, seed, config)


def one(mesh: Mesh, name: str, kind: Start, seed: int, config: AlignConfig) -> Run:
    rng = np.random.default_rng([seed, *name.encode()])
    camera, truth = placed(mesh, rng)
    whole = full_silhouette(truth, camera)
    hiding = _hiding(truth, whole, camera, kind.hidden, rng)
    start, reachable = disturbed(truth, kind, camera, rng, config)
    photo = Photo(rgb=np.zeros((camera.height, camera.width, 3), np.uint8))
    free = ~union_of((h.mask for h in hiding), whole.shape)
    scene = Scene(photo=photo, camera=camera, objects=(replace(start, mask=whole & free), *hiding))
    with looks.counted() as work:
        aligned, _ = align(scene, config, only=[start.id])
    end = full_silhouette(aligned[start.id], camera)
    return Run(
        kind=kind.key,
        mesh=name,
        seed=seed,
        before=iou(full_silhouette(start, camera), whole),
        after=iou(end, whole),
        seen=iou(end, whole, free),
        reachable=reachable,
        evaluations=work.evaluations,
        cpu=work.cpu,
    )


def placed(mesh: Mesh, rng: np.random.Generator) -> tuple[Camera, SceneObject]:
    """A camera, and the object at rest in the middle of its picture."""
    solid = mesh.welded if mesh.is_solid else (mesh.hull.vertices, mesh.hull.faces)
    R = resting_turn(mesh.hull, mass_properties(*solid).center, np.eye(3), max_tilt=math.pi)
    assert R is not None
    R = rotation_about([0, 0, 1], rng.uniform(-math.pi, math.pi)) @ R
    low, high = (f((mesh.vertices @ R.T), axis=0) for f in (np.min, np.max))
    o = SceneObject(
        id=1,
        label="",
        mask_name="",
        mask=np.zeros((PIXELS, PIXELS), np.bool_),
        mesh=mesh,
        T_world_object=pose(R, -(low + high) / 2 - [0, 0, (low - high)[2] / 2]),
    )
    middle, size = o.middle, o.size
    K = np.array([[FOCAL, 0, PIXELS / 2], [0, FOCAL, PIXELS / 2], [0, 0, 1]])
    elevation = rng.uniform(*HEIGHTS)
    forward = np.array([0, math.cos(elevation), -math.sin(elevation)])
    axes = np.column_stack([[1, 0, 0], np.cross(forward, [1, 0, 0]), forward])
    eye = middle - FOCAL * size / DIAGONAL * forward
    return Camera(width=PIXELS, height=PIXELS, K=K, T_world_camera=pose(axes, eye)), o


def disturbed(
    truth: SceneObject, kind: Start, camera: Camera, rng: np.random.Generator, config: AlignConfig
) -> tuple[SceneObject, bool]:
    """The object at a random start, and whether the way back lies inside the bounds that the start gives."""
    middle = truth.middle
    direction, yaw, scale = (
        rng.uniform(0, 2 * math.pi),
        rng.uniform(-1, 1) * kind.yaw,
        1 + rng.uniform(-1, 1) * kind.scale,
    )
    metres = kind.shift * camera.to_camera(middle[None])[0, 2] / FOCAL
    shift = metres * camera.T_world_camera[:3, :2] @ [math.cos(direction), math.sin(direction)]
    R = rotation_about([0, 0, 1], yaw)
    start = truth.moved(pose(R, middle + shift - R @ (scale * middle)), scale=scale, stage="start", reason="disturbed")
    reachable = (
        metres <= config.max_shift * start.size
        and abs(yaw) <= config.max_yaw
        and abs(1 / scale - 1) <= config.max_scale
    )
    return start, reachable


def with_faces(mesh: Mesh, count: int) -> Mesh:
    """The same surface with at least as many triangles, then simplified to ``count`` of them."""
    import fast_simplification
    import trimesh

    vertices, faces = mesh.welded
    while len(faces) < count:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    if len(faces) > count:
        vertices, faces = fast_simplification.simplify(np.asarray(vertices), np.asarray(faces), target_count=count)
    return Mesh(vertices=np.asarray(vertices, float), faces=np.asarray(faces, np.int32))


def _hiding(o: SceneObject, mask: Mask, camera: Camera, share: float, rng: np.random.Generator) -> list[SceneObject]:
    """A card between camera and object that hides a share of its mask from a random side."""
    if not share:
        return []
    angle = rng.uniform(0, 2 * math.pi)
    across, along = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    rows, columns = np.nonzero(mask)
    pixels = np.column_stack([columns, rows]) + 0.5
    middle = pixels.mean(0)
    edge, reach = np.quantile((pixels - middle) @ across, 1 - share), CARD[1] * DIAGONAL
    corners = middle + np.array([
        edge * across - reach * along, edge * across + reach * along,
        (edge + reach) * across + reach * along, (edge + reach) * across - reach * along,
    ])  # fmt: skip
    depth = CARD[0] * camera.to_camera(o.middle[None])[0, 2]
    rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(camera.K).T
    vertices = np.concatenate([depth * rays, 0.99 * depth * rays])
    quads = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))], np.int32)
    card = replace(o, id=2, mesh=Mesh(vertices=vertices, faces=faces), T_world_object=camera.T_world_camera)
    return [replace(card, mask=full_silhouette(card, camera))]
