"""Meshes with the masks they belong to, as an input folder without agreed poses: the pose search places them."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.errors import InputError
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.importing.found_meshes import FoundMesh, FoundMeshes
from f3sr.importing.import_source import ImportSource, Masks
from f3sr.importing.imported_folder import IMPORTED, as_json, grey, photo_name
from f3sr.importing.mesh_matching import matched
from f3sr.io.gltf_writer import mesh_to_glb
from f3sr.io.masks import MIN_PIXELS
from f3sr.scene import Photo
from f3sr.segmentation.input_folder_writer import mask_name
from f3sr.segmentation.selection import Selection, told_apart
from f3sr.workers.mesh_job import MeshAnswer, WorkerPose


@dataclass(frozen=True, eq=False, kw_only=True)
class MaskedMeshes:
    """A mesh for every mask of a photo, by id."""

    found: FoundMeshes
    photo: bytes
    labels: Mapping[int, str]
    masks: Mapping[int, NDArray[np.bool_]]
    """(H, W), disjoint."""
    ground: NDArray[np.bool_]
    """(H, W): what is seen of their support, by its colours."""
    meshes: Mapping[int, FoundMesh]
    focal: float | None = None
    """[px], where the user tells it; K of a point map is its own."""
    remarks: tuple[str, ...] = ()

    @property
    def has_poses(self) -> bool:
        """Whether all of them have one: a search finds none of some only."""
        return all(m.pose for m in self.meshes.values())


def with_masks(found: FoundMeshes, masks: Masks, source: ImportSource) -> MaskedMeshes:
    """Meshes and masks that belong together. Raises InputError where names do not tell which."""
    if found.photo is None:
        raise InputError(source.path, found="no photo", accepted="--photo FILE")
    if not 1 <= len(masks) <= MAX_OBJECTS:
        raise InputError(source.path, found=f"{len(masks)} masks", accepted=f"1 to {MAX_OBJECTS}")
    by_name = {m.name: m for m in found.meshes}
    names = matched(source.path, {id: o.label for id, o in masks.items()}, list(by_name), in_order=source.in_order)
    meshes = {id: by_name[name] for id, name in sorted(names.items())}
    apart, ground = _apart(found.photo.photo, masks)
    return MaskedMeshes(
        found=found,
        photo=found.photo.data,
        labels={id: masks[id].label or meshes[id].label for id in meshes},
        masks=apart,
        ground=ground,
        meshes=meshes,
        focal=_focal(found, source),
        remarks=found.remarks,
    )


def _focal(found: FoundMeshes, source: ImportSource) -> float | None:
    """The focal length [px] that the user tells. EXIF stays in the photo and poses in their files: both are read later,
    each with its error."""
    assert found.photo is not None
    known = source.hints.known_focal(found.photo.photo)
    if known and found.points is not None:
        raise InputError(known.source, found="a point map, which has its own", accepted="only without a point map")
    return known.pixels if known else None


def _apart(photo: Photo, masks: Masks) -> tuple[dict[int, NDArray[np.bool_]], NDArray[np.bool_]]:
    """Masks that share no pixel, and the ground by its colours."""
    outlines = told_apart(photo, [o.mask for o in masks.values()], Selection(prompts=()))
    return dict(zip(masks, outlines.masks, strict=True)), outlines.ground


def write_masked_meshes(out: Path, given: MaskedMeshes) -> Path:
    """Write photo, masks, meshes and what is known of each; returns the full path. Raises OutputError."""
    full = Path(out).absolute().resolve()
    with IMPORTED.writing(full) as folder:
        folder.write(photo_name(given.photo), given.photo)
        for id, mask in given.masks.items():
            folder.write(f"masks/{mask_name(id, given.labels[id])}", grey(mask))
        if given.ground.sum() >= MIN_PIXELS:
            folder.write("ground.png", grey(given.ground))
        if given.found.points is not None:
            folder.write("geometry.npz", _geometry(given.found.points))
        if given.focal is not None:
            folder.write("intrinsics.json", as_json(_intrinsics(given)))
        for id, found in given.meshes.items():
            folder.write(f"assets/{id:02d}.glb", mesh_to_glb(found.mesh, name=f"{id:02d}"))
            folder.write(f"assets/{id:02d}.json", _answer(id, found, given))
        note = {
            "source": given.found.source,
            "masks": "given",
            "poses": "given, to be read by the masks" if given.has_poses else "none: found by the masks",
            "remarks": list(given.remarks),
        }
        folder.end(lambda files: as_json({**note, "files": files}))
    return full


def _answer(id: int, found: FoundMesh, given: MaskedMeshes) -> bytes:
    """What a worker would have answered."""
    pose = WorkerPose()
    if found.pose is not None and given.has_poses:
        p = found.pose
        pose = WorkerPose(convention="sam3d", rotation=p.rotation, translation=p.translation, scale=p.scale)
    answer = MeshAnswer(
        id=id, mesh=f"{id:02d}.glb", pose=pose, up=found.up, model=given.found.source[:200], licence=given.found.licence
    )
    return as_json(answer.model_dump(exclude={"seconds"}))


def _intrinsics(given: MaskedMeshes) -> dict[str, object]:
    height, width = given.ground.shape
    return {
        "width": width,
        "height": height,
        "K": [[given.focal, 0, width / 2], [0, given.focal, height / 2], [0, 0, 1]],
    }


def _geometry(points: NDArray[np.floating[Any]]) -> bytes:
    buffer = io.BytesIO()
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=-1))
    np.savez_compressed(
        buffer,
        points=np.where(known[..., None], points, 0).astype(np.float32),
        mask=known,
        coordinate_system="pytorch3d",
    )
    return buffer.getvalue()
