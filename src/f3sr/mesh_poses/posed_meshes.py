"""Meshes of a generator to assets in the camera's frame: given poses by their likeliest reading, others by masks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.backends.protocols import Axis, GeneratedAsset, ProducedMesh, PromptedImage
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, rotation_between
from f3sr.mesh_poses.pose_by_mask import (
    DEFAULT_SEARCH,
    STAGE,
    FoundPose,
    MaskedPhoto,
    PoseSearch,
    PoseSearchConfig,
    turn_between,
)
from f3sr.mesh_poses.read_poses import CLEAR, USABLE, JudgedReading, judged_readings
from f3sr.scene import GROUND, Geometry, Scene, SceneObject
from f3sr.vision.image_supports import below
from f3sr.vision.occlusion import comparable_region, nearer_objects

AXES: Mapping[Axis, tuple[int, int, int]] = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1),
}  # fmt: skip
USUAL_UPS: tuple[Axis, ...] = ("+y", "+z")
"""Tried where nobody tells which axis points up: glTF's, and that of most simulators."""
ROUNDS = 3
"""Steps in which an object and the place under its foot find each other."""
FOOT = 0.2
"""Share of an object's height that is its foot, and of its width that is looked at below the foot."""
ENOUGH = 0.965
"""IoU from which on an object is not sought again with what hides it known."""
DOUBT = 0.02
"""Difference in what two poses miss below which neither is better."""
ANOTHER = math.radians(20)
"""Turn from which on two poses are not the same, roughly."""


def upright(mesh: Mesh, up: Axis) -> Mesh:
    """The mesh turned so that an axis of its file is +Z."""
    return mesh.with_vertices(mesh.vertices @ _upright(up).T)


def posed_meshes(
    image: PromptedImage,
    geometry: Geometry,
    K: Array,
    meshes: Mapping[int, ProducedMesh],
    *,
    search: PoseSearchConfig = DEFAULT_SEARCH,
) -> Mapping[int, GeneratedAsset]:
    """Meshes of a generator, one per instance, where they stand in the photo. ``K`` (3, 3) in pixels of the photo.

    Where all have poses, the reading is taken that fits the masks best. Where none fits, or poses are absent, masks
    alone tell. Every asset says how it got its pose.
    """
    view = MaskedPhoto.of(image, geometry, K)
    if all(m.poses for m in meshes.values()):
        judged = judged_readings(view, meshes, search)
        if judged and judged[0].iou >= USABLE:
            return _as_read(view, judged, meshes)
    return {id: p.asset(view, meshes[id]) for id, p in _by_masks(view, meshes, search).items()}


def _as_read(
    view: MaskedPhoto, judged: Sequence[JudgedReading], meshes: Mapping[int, ProducedMesh]
) -> Mapping[int, GeneratedAsset]:
    """Assets by the likeliest reading; of readings that fit alike, the one that the producer names first."""
    alike = [j.reading for j in judged if j.missed <= judged[0].missed + CLEAR]
    taken = next(p.reading for p in next(iter(meshes.values())).poses if p.reading in alike)
    chosen = next(j for j in judged if j.reading == taken)
    rest = ", ".join(name for name in alike if name != taken)
    told = f"pose as given ({taken}), mean IoU with the masks {chosen.iou:.2f}{rest and f'; {rest} fits as well'}"
    return {
        id: asset_of(view, pose.object, "; ".join(filter(None, (meshes[id].told, told))))
        for id, pose in chosen.poses.items()
    }


def asset_of(view: MaskedPhoto, o: SceneObject, told: str) -> GeneratedAsset:
    """An object of the photo's world as an asset in the camera's frame."""
    T = view.camera.T_camera_world @ o.T_world_object
    return GeneratedAsset(mesh=o.mesh, T_camera_object=T, scale=o.scale, told=told)


def _by_masks(
    view: MaskedPhoto, meshes: Mapping[int, ProducedMesh], search: PoseSearchConfig
) -> Mapping[int, _RankedPoses]:
    """Poses by masks, in two rounds: the second knows which objects hide which."""
    placed = {
        id: _placed(PoseSearch(mesh=meshes[id].mesh, instance=i, view=view, config=search), meshes[id])
        for id, i in view.instances.items()
    }
    scene = Scene(
        photo=view.photo,
        camera=view.camera,
        geometry=view.geometry,
        objects=tuple(p.best.object for p in placed.values()),
    )
    nearer = nearer_objects(scene)
    for id, instance in view.instances.items():
        if nearer[id] and placed[id].best.iou < ENOUGH:
            valid = comparable_region(scene[id], nearer[id], scene)
            again = PoseSearch(mesh=meshes[id].mesh, instance=instance, view=view, valid=valid, config=search)
            placed[id] = _placed(again, meshes[id])
    return placed if view.geometry is not None else _on_supports(view, placed)


def _on_supports(view: MaskedPhoto, placed: Mapping[int, _RankedPoses]) -> Mapping[int, _RankedPoses]:
    """Objects along their viewing rays onto what is below them in the picture: where nothing else tells a distance.

    Under a homothety about the camera's centre C a height z becomes C + k (z - C): k follows in closed form."""
    under = below({id: i.mask for id, i in view.instances.items()})
    standing = dict[int, _RankedPoses]()

    def stand(id: int, above: frozenset[int]) -> None:
        carrier = under[id]
        if carrier in above or carrier == id:  # masks that lie below each other
            carrier = GROUND
        if carrier != GROUND and carrier not in standing:
            stand(carrier, above | {id})
        o, eye = placed[id].best.object, view.camera
        for _ in range(ROUNDS):
            top = 0.0 if carrier == GROUND else _top_under(o, standing[carrier].best.object)
            low, height = float(o.bounds_world[0, 2]), float(eye.center[2])
            k = (height - top) / (height - low) if low < height and top < height else 1.0
            o = o.moved(eye.homothety(k), scale=k, stage=STAGE, reason="")
        best = replace(placed[id].best, object=o)
        standing[id] = replace(placed[id], poses=(best, *placed[id].poses[1:]))

    for id in placed:
        if id not in standing:
            stand(id, frozenset())
    return standing


def _top_under(o: SceneObject, carrier: SceneObject) -> float:
    """Height [m] of a carrier's surface under an object's foot; its highest place where nothing is under that."""
    own, theirs = o.vertices_world, carrier.vertices_world
    low, high = own.min(0), own.max(0)
    foot = own[own[:, 2] <= low[2] + FOOT * (high[2] - low[2])].mean(0)
    near = np.linalg.norm(theirs[:, :2] - foot[:2], axis=1) <= FOOT * float(np.hypot(*(high - low)[:2]))
    return float((theirs[near] if near.any() else theirs)[:, 2].max())


@dataclass(frozen=True, eq=False, kw_only=True)
class _RankedPoses:
    """Poses of one object, best first; ``up`` is the axis of its file that they have upright."""

    poses: tuple[FoundPose, ...]
    up: Axis

    @property
    def best(self) -> FoundPose:
        return self.poses[0]

    def asset(self, view: MaskedPhoto, produced: ProducedMesh) -> GeneratedAsset:
        return asset_of(view, self.best.object, "; ".join(filter(None, (produced.told, self._told()))))

    def _told(self) -> str:
        best = self.best
        detail = "" if best.correlation is None else f", correlation with the photo {best.correlation:.2f}"
        side = "" if best.side == 0 else ", not upright"
        told = f"pose by its mask: IoU {best.iou:.2f}{detail}{side}"
        rival = next((p for p in self.poses[1:] if turn_between(best, p) > ANOTHER), None)
        if rival is not None and rival.missed < best.missed + DOUBT:
            told += f"; turned by {math.degrees(turn_between(best, rival)):.0f} degrees it fits as well"
        return told


def _placed(search: PoseSearch, produced: ProducedMesh) -> _RankedPoses:
    """The best poses over the axes that may point up."""
    ups = (produced.up,) if produced.up else USUAL_UPS
    tried = [_RankedPoses(poses=tuple(replace(search, mesh=upright(produced.mesh, up)).found()), up=up) for up in ups]
    return min(tried, key=lambda p: p.best.missed)


def _upright(up: Axis) -> Array:
    """The rotation (3, 3) that turns an axis of a file onto +Z; +y as glTF has it, (x, y, z) to (x, -z, y)."""
    return rotation_between(np.array(AXES[up], float), np.array([0.0, 0, 1]))
