"""Meshes of a generator to assets in the camera's frame: given poses by the reading that is meant, others by masks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from f3sr.backends.protocols import CameraByPoses, GeneratedAsset, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.io.pose_conventions import SAM3D, all_conventions
from f3sr.mesh_poses.camera_by_poses import camera_by_poses
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.placed_by_reading import asset_of, placed_by_reading
from f3sr.mesh_poses.pose_by_mask import DEFAULT_SEARCH, MaskedPhoto, PoseSearchConfig
from f3sr.mesh_poses.poses_by_masks import RankedPoses, poses_by_masks
from f3sr.mesh_poses.reading_votes import Votes, voted
from f3sr.scene import Geometry, names_of

NAMED = 4
"""Most other readings that a report names."""


def posed_meshes(
    image: PromptedImage,
    geometry: Geometry,
    K: Array,
    meshes: Mapping[int, ProducedMesh],
    *,
    search: PoseSearchConfig = DEFAULT_SEARCH,
) -> Mapping[int, GeneratedAsset]:
    """Meshes of a generator, one per instance, where they stand in the photo. ``K`` (3, 3) in pixels of the photo.

    Where all have poses, the masks vote on how these are read. Where no reading fits, or poses are absent, masks alone
    tell. Every asset says how it got its pose, and whether that is in doubt.
    """
    view = MaskedPhoto.of(image, geometry, K)
    if (places := _readings(meshes)) is not None:
        votes = voted(view, {id: m.mesh for id, m in meshes.items()}, places, units=False, search=search)
        if votes.usable:
            return _as_read(view, votes, meshes)
    ranked = poses_by_masks(view, meshes, search)
    unposed = [id for id, m in meshes.items() if m.pose is None]
    why = f"{names_of(unposed)} told none" if unposed else "no reading of it shows what the masks show"
    unused = {id: f"its pose is not used: {why}" for id, m in meshes.items() if m.pose}
    return {id: _by_mask(view, found, meshes[id], unused.get(id, "")) for id, found in ranked.items()}


def camera_of(image: PromptedImage, meshes: Mapping[int, ProducedMesh]) -> CameraByPoses | None:
    """What meshes of a generator tell of their camera, where all have poses; None where they do not."""
    places = _readings(meshes)
    masks, shapes = {i.id: i.mask for i in image.instances}, {id: m.mesh for id, m in meshes.items()}
    return None if places is None else camera_by_poses(masks, shapes, places, units=False)


def _readings(meshes: Mapping[int, ProducedMesh]) -> CandidatePlaces | None:
    """All readings of the poses, of which a producer's scale is that of its own file; None where a mesh has none."""
    poses = {id: m.pose for id, m in meshes.items() if m.pose is not None}
    return CandidatePlaces.of_poses(poses, all_conventions()) if len(poses) == len(meshes) else None


def _as_read(view: MaskedPhoto, votes: Votes, meshes: Mapping[int, ProducedMesh]) -> Mapping[int, GeneratedAsset]:
    """Assets by the documented reading, if it fits as well as any, else by the likeliest."""
    alike = [votes.places.names[k] for k in votes.alike]
    taken = alike.index(SAM3D.name) if SAM3D.name in alike else votes.likeliest
    rivals = [votes.places.names[k] for k in (0, *votes.rivals) if k != taken and votes.differ(k, taken)]
    told = f"pose as given ({alike[taken]}), mean IoU with the masks {votes.ious[taken]:.2f} once corrected"
    if rivals:
        told += f"; {', '.join(rivals[:NAMED])} would fit as well"
    placed = placed_by_reading(view, votes.meshes, votes.places, taken)
    told = "; ".join((told, *(f"{d.choice.removeprefix('assets: ')}: {d.reason}" for d in placed.decisions)))
    return {
        id: replace(
            asset,
            told="; ".join(filter(None, (meshes[id].told, told))),
            doubted=bool(rivals),
            file=meshes[id].file,
        )
        for id, asset in placed.assets.items()
    }


def _by_mask(view: MaskedPhoto, ranked: RankedPoses, mesh: ProducedMesh, unused: str) -> GeneratedAsset:
    doubt = ranked.doubt()
    told = "; ".join(filter(None, (mesh.told, ranked.told, unused, doubt)))
    return replace(asset_of(view, ranked.object, told), doubted=bool(doubt or unused), file=mesh.file)
