"""The measures of a scene, defined once: image agreement, penetration, stability, gaps and proxies (docs: measures)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import Array, bounds_of
from f3sr.metrics import penetration
from f3sr.metrics.point_in_mesh import union_distance, winding_number
from f3sr.physics import release
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.silhouette import iou, union_of

Point = tuple[float, float, float]
"""A place in the world [m]."""
SAMPLES = 20_000
"""Surface points per object for gaps."""
ROUNDING = 1e-9
"""Share by which the computed distance of two boxes may exceed that of points in them."""
IMAGE_MEASURES = ("mIoU", "mIoU_visible", "PSNR")
"""Those that depend on the camera; all others do not."""
PART_SAMPLES = 600
"""Surface points per convex part for the distance of proxies from their mesh."""


@dataclass(frozen=True, kw_only=True)
class Measures:
    """One row of the result table. Lower is better except for mIoU, mIoU_visible and PSNR."""

    n: int
    """Objects."""
    excluded: int
    """Masks that are no objects."""
    fixed: int
    """Objects that physics does not move."""
    mIoU: float
    """Mean IoU of full silhouettes with the masks; an excluded mask counts 0."""
    mIoU_visible: float
    """Mean IoU of visible pixels (id buffer) with the masks; an excluded mask counts 0."""
    PSNR: float
    """Unlit colours against the photo over the union of masks [dB]."""
    R_pen: float
    """Crossings times mean edge length over the scene's diagonal (equation 12)."""
    N_cross: int
    """Pairs of triangles of different objects that pierce each other, on refined surfaces."""
    K_max_J: float
    """Largest kinetic energy in the first second after release [J] (equation 13)."""
    D_max_cm: float
    """Largest travel of a centre of mass in 5 s [cm] (equation 14)."""
    gap_pct: float
    """Distance of the worst floating object to its nearest neighbour, in % of its size."""
    below_pct: float
    """Deepest point under the ground, in % of the object's size."""
    inside: int
    """Vertices of an object inside another's solid."""
    proxy_out_pct: float
    """Protrusion of a visual mesh from its proxy (99.9th percentile), in % of its size; the worst object."""
    proxy_far_pct: float
    """Mean distance of a proxy's surface from its mesh, in % of its size; the worst object."""

    def as_dict(self) -> dict[str, float]:
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class Gap:
    """The gap from an object to its nearest neighbour, the ground included; 0 in contact.

    ``below`` is the depth of the object's lowest point under the ground.
    """

    id: int
    nearest: int
    """Id of the nearest neighbour, GROUND for the ground."""
    distance: float
    """[m]"""
    below: float
    """[m]"""
    size: float
    """Size of the object [m]; ``gap_pct`` and ``below_pct`` are relative to it."""
    start: Point
    """The object's point at the gap [m]."""
    end: Point
    """The neighbour's point at the gap [m]."""
    lowest: Point
    """The object's lowest point [m]."""


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Where two objects pierce each other: pairs of triangles inside the world box ``low`` to ``high`` [m]."""

    a: int
    b: int
    crossings: int
    low: Point
    high: Point


@dataclass(frozen=True, kw_only=True)
class ObjectMeasures:
    """The per-object terms of the scene's measures."""

    id: int
    IoU: float
    IoU_visible: float
    proxy_out: float
    """Protrusion of the mesh from its proxy, as a share of its size."""
    proxy_far: float
    """Mean distance of the proxy's surface from the mesh, as a share of its size."""


@dataclass(frozen=True, kw_only=True)
class Details:
    """The terms of ``Measures``, per object and with places."""

    objects: tuple[ObjectMeasures, ...]
    gaps: tuple[Gap, ...]
    overlaps: tuple[Overlap, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshMeasures:
    """What is measured of a scene's meshes and masks, without proxies and physics."""

    image: Mapping[str, float]
    """The IMAGE_MEASURES by name."""
    full: Sequence[float]
    """IoU of every object's full silhouette."""
    visible: Sequence[float]
    """IoU of every object's visible pixels."""
    crossings: penetration.Penetration
    gaps: Sequence[Gap]
    inside: int
    """See ``points_inside``."""

    @classmethod
    def of(cls, scene: Scene) -> Self:
        image, full, visible = _seen(scene)
        surfaces = [(o.T_world_asset, o.mesh.welded) for o in scene]
        return cls(
            image=image,
            full=full,
            visible=visible,
            crossings=penetration.penetration([(v @ T[:3, :3].T + T[:3, 3], f) for T, (v, f) in surfaces]),
            gaps=gaps_of(scene.objects),
            inside=points_inside(scene.objects),
        )


def measure(scene: Scene, *, true_scale: float = 1.0) -> Measures:
    """All measures of a scene. ``true_scale`` is the factor from its lengths to true metres, for physics."""
    return measure_with_details(scene, true_scale=true_scale)[0]


def measure_with_details(
    scene: Scene, *, true_scale: float = 1.0, of_meshes: Callable[[], MeshMeasures] | None = None
) -> tuple[Measures, Details]:
    """``measure``, with the terms per object and their places. ``of_meshes`` gives what is measured of its meshes, at
    last, by default here."""
    K, D = release.release(scene.objects, true_scale=true_scale)
    out, far = zip(*(proxy_distances(o) for o in scene), strict=True)
    found = of_meshes() if of_meshes else MeshMeasures.of(scene)
    measures = Measures(
        n=len(scene.objects),
        excluded=len(scene.excluded),
        fixed=sum(o.mobility == "fixed" for o in scene),
        **found.image,
        R_pen=found.crossings.r_pen,
        N_cross=found.crossings.crossings,
        K_max_J=K,
        D_max_cm=100 * D,
        gap_pct=100 * max(g.distance / g.size for g in found.gaps),
        below_pct=100 * max(g.below / g.size for g in found.gaps),
        inside=found.inside,
        proxy_out_pct=100 * max(out),
        proxy_far_pct=100 * max(far),
    )
    return measures, Details(
        objects=tuple(
            ObjectMeasures(id=o.id, IoU=f, IoU_visible=v, proxy_out=out, proxy_far=far)
            for o, f, v, out, far in zip(scene, found.full, found.visible, out, far, strict=True)
        ),
        gaps=tuple(found.gaps),
        overlaps=tuple(_overlap(pair, scene.objects) for pair in found.crossings.pairs),
    )


def image_measures(scene: Scene) -> dict[str, float]:
    """The IMAGE_MEASURES of a scene by name."""
    return _seen(scene)[0]


def _overlap(pair: penetration.Crossing, objects: Sequence[SceneObject]) -> Overlap:
    low, high = pair.bounds
    return Overlap(a=objects[pair.a].id, b=objects[pair.b].id, crossings=pair.count, low=_point(low), high=_point(high))


def _point(p: Array) -> Point:
    return float(p[0]), float(p[1]), float(p[2])


# --- image agreement ----------------------------------------------------------------------------------------------


def _seen(scene: Scene) -> tuple[dict[str, float], list[float], list[float]]:
    """The IMAGE_MEASURES by name; per object the IoU of its full silhouette and of its visible pixels."""
    total = len(scene.objects) + len(scene.excluded)
    full, visible, psnr = image_agreement(scene)
    return dict(zip(IMAGE_MEASURES, (sum(full) / total, sum(visible) / total, psnr), strict=True)), full, visible


def image_agreement(scene: Scene) -> tuple[list[float], list[float], float]:
    """IoU of each full silhouette, IoU of each object's visible pixels, and PSNR [dB] over the union of masks.

    Pixels are sampled at their centres. PSNR compares unlit texture colours with the photo; mask pixels without an
    object are black.
    """
    camera, photo = scene.camera, scene.photo.rgb
    union = union_of((o.mask for o in scene), photo.shape[:2])
    ids = np.empty(union.shape, np.int32)
    errors: list[Array] = []
    for strip, fragments in rasterizer.strips(scene.objects, camera):
        ids[strip] = fragments.ids
        rendered = rasterizer.shade(fragments, scene.objects, filter="nearest")
        errors.append(rendered[union[strip]] - photo[strip][union[strip]] / 255)
    full = [iou(full_silhouette(o, camera), o.mask) for o in scene]
    visible = [iou(ids == o.id, o.mask) for o in scene]
    return full, visible, float(-10 * np.log10(max(np.mean(np.concatenate(errors) ** 2), 1e-12)))


def mean_over_masks(ious: Mapping[int, float], scene: Scene) -> float:
    """The mean of IoUs by id over all masks of a scene. A mask without an object counts 0."""
    return sum(ious.values()) / (len(scene.objects) + len(scene.excluded))


def visible_ious(scene: Scene) -> dict[int, float]:
    """The IoU of every object's visible pixels with its mask, by id."""
    ids = rasterizer.visible_ids(scene.objects, scene.camera)
    return {o.id: iou(ids == o.id, o.mask) for o in scene}


def full_silhouette(o: SceneObject, camera: Camera) -> NDArray[np.bool_]:
    """The object's silhouette (H, W) as if it were alone."""
    vertices = camera.to_camera(o.vertices_world)
    return rasterizer.silhouette(vertices, o.mesh.faces, camera.K, camera.width, camera.height)


# --- floating, sunken and contained objects -------------------------------------------------------------------------


def gaps_of(objects: Sequence[SceneObject]) -> tuple[Gap, ...]:
    """Per object the gap to its nearest neighbour, the ground included, and its depth under the ground."""
    from scipy.spatial import KDTree

    points = [
        np.concatenate([o.vertices_world, sample_surface(o.vertices_world, o.mesh.faces, SAMPLES)]) for o in objects
    ]
    boxes = [bounds_of(p) for p in points]
    trees = dict[int, KDTree]()
    gaps: list[Gap] = []
    for i, (o, p) in enumerate(zip(objects, points, strict=True)):
        lowest = p[np.argmin(p[:, 2])]
        nearest, distance, start, end = GROUND, max(0.0, float(lowest[2])), lowest, lowest * [1, 1, 0]
        for j in range(len(objects)):
            # Only gaps shorter than the best so far are looked for.
            if j == i or distance == 0 or _boxes_apart(boxes[i], boxes[j]) > distance * (1 + ROUNDING):
                continue
            if j not in trees:
                trees[j] = KDTree(points[j])
            # Every seventh point asks, all points answer.
            distances, hits = trees[j].query(p[::7], distance_upper_bound=distance)
            k = int(np.argmin(distances))
            if distances[k] < distance:
                nearest, distance = objects[j].id, float(distances[k])
                start, end = p[7 * k], points[j][int(np.asarray(hits)[k])]
        gaps.append(
            Gap(
                id=o.id,
                nearest=nearest,
                distance=distance,
                below=max(0.0, -float(lowest[2])),
                size=o.size,
                start=_point(start),
                end=_point(end),
                lowest=_point(lowest),
            )
        )
    return tuple(gaps)


def _boxes_apart(a: Array, b: Array) -> float:
    """Distance of two boxes (2, 3), low and high."""
    return float(np.linalg.norm(np.maximum(np.maximum(a[0] - b[1], b[0] - a[1]), 0)))


def points_inside(objects: Sequence[SceneObject], stride: int = 40) -> int:
    """Number of vertices (every ``stride``-th) of objects in another object's solid. Open meshes contain none."""
    samples = {o.id: o.vertices_world[::stride].copy() for o in objects}
    total = 0
    for a in objects:
        if not a.mesh.is_solid:
            continue
        vertices, faces = a.mesh.welded
        low, high = a.bounds_world
        for id, points in samples.items():
            points = points[np.all((points > low) & (points < high), axis=1)]
            if id != a.id and len(points):
                # Into the asset's frame, where the welded mesh is: rows times inverse transposed.
                local = (points - a.T_world_asset[:3, 3]) @ np.linalg.inv(a.T_world_asset[:3, :3]).T
                total += int(np.count_nonzero(winding_number(local, vertices, faces) > 0))
    return total


# --- proxies ------------------------------------------------------------------------------------------------------


def proxy_distances(o: SceneObject) -> tuple[float, float]:
    """Protrusion of the mesh from its proxy, and mean distance of the proxy's surface from the mesh, in sizes."""
    from scipy.spatial import KDTree

    vertices = o.mesh.vertices[:: max(1, len(o.mesh.vertices) // 4000)]
    size = o.size / o.scale
    out = union_distance(vertices, o.colliders)
    surface = np.concatenate([o.mesh.vertices, sample_surface(o.mesh.vertices, o.mesh.faces, SAMPLES)])
    samples = np.concatenate([sample_surface(p.vertices, p.faces, PART_SAMPLES) for p in o.colliders])
    # Only the union's own surface: faces of parts inside other parts are no surface of the proxy.
    free = samples[union_distance(samples, o.colliders) >= -1e-4 * size]
    tree = KDTree(surface, balanced_tree=False, compact_nodes=False)  # faster for few queries, with the same distances
    far = float(tree.query(free)[0].mean()) if len(free) else 0.0
    return float(np.percentile(np.maximum(out, 0), 99.9)) / size, far / size
