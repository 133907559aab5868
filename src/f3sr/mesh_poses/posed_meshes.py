"""Meshes of a generator to assets in the camera's frame: given poses by their likeliest reading, others by masks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from f3sr.backends.protocols import GeneratedAsset, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.mesh_poses.pose_by_mask import DEFAULT_SEARCH, MaskedPhoto, PoseSearchConfig
from f3sr.mesh_poses.poses_by_masks import RankedPoses, poses_by_masks
from f3sr.mesh_poses.read_poses import CLEAR, USABLE, JudgedReading, judged_readings
from f3sr.scene import Geometry, SceneObject


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
    ranked = poses_by_masks(view, meshes, search)
    return {id: _by_mask(view, ranked[id], meshes[id].told) for id in ranked}


def _by_mask(view: MaskedPhoto, ranked: RankedPoses, told: str) -> GeneratedAsset:
    doubt = ranked.doubt()
    told = "; ".join(filter(None, (told, ranked.told, doubt)))
    return replace(asset_of(view, ranked.object, told), doubted=bool(doubt))


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


