"""ComfyUI's output folder: scenes of the SAM 3D Objects nodes, and GLBs of mesh nodes with a counter or a time.

A scene is ``image.png`` and ``object_N/`` with ``mask.npy`` and ``mesh.glb``, ``textured_mesh.glb`` or, after pose
optimisation, ``aligned_mesh.glb`` with vertices in PyTorch3D camera axes. Poses lie in ``pose.pt``, a pickle that is
not read; ``pose.json`` beside it is. Other nodes write ``PREFIX_00001_.glb`` or ``PREFIX_20260101_120000.glb``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from f3sr.errors import InputError
from f3sr.files import npz
from f3sr.importing.found_meshes import FoundMesh, FoundMeshes, already_posed, read_points, read_pose, unread
from f3sr.importing.import_source import ImportSource, Masks
from f3sr.io.assets import load_asset_mesh
from f3sr.io.images import MAX_PIXELS
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import MIN_PIXELS
from f3sr.io.sam3d import AssetPose
from f3sr.segmentation.input_folder_writer import OutlinedObject

OBJECT = re.compile(r"object_([0-9]{1,6})")
SAVED = re.compile(r".*_([0-9]{5}_|[0-9]{8}_[0-9]{6})\.glb")
"""Names that ComfyUI's nodes give: a prefix with a counter, or with a time."""
ALIGNED, MESHES = "aligned_mesh.glb", ("textured_mesh.glb", "mesh.glb")
POSE, MASK, POINT_MAP = "pose.json", "mask.npy", "pointmap.npy"
MASKED = npz.Wanted(shape=("h", "w"), most=MAX_PIXELS)
HALF = 0.5
"""Value of a mask's pixel above which it belongs to the object: nodes keep floats from 0 to 1."""


def matches(source: ImportSource) -> bool:
    """Whether a folder has object_N/ with meshes, or GLBs named as nodes name them."""
    return source.path.is_dir() and bool(_objects(source.place) or _saved(source.place))


def read(source: ImportSource) -> FoundMeshes:
    """The meshes with what ComfyUI keeps of masks and poses. Raises InputError, naming the file."""
    objects = _objects(source.place)
    return _scene(source, objects) if objects else _files(source, _saved(source.place))


def _objects(place: InputFolder) -> list[str]:
    """Folders of objects that have a mesh, by number."""
    names = [n for n in place.names() if OBJECT.fullmatch(n) and (place.root / n).is_dir()]
    return sorted((n for n in names if _mesh_name(place, n)), key=_number)


def _number(name: str) -> int:
    return int(name.rpartition("_")[2])


def _mesh_name(place: InputFolder, folder: str) -> str | None:
    return next((n for n in (*MESHES, ALIGNED) if place.has(f"{folder}/{n}")), None)


def _saved(place: InputFolder) -> list[str]:
    """GLBs of nodes in the folder, or in the folders mesh/ and 3D/ that nodes write into."""
    return [
        f"{base}/{name}" if base else name
        for base in ("", "mesh", "3D")
        for name in place.names(base)
        if SAVED.fullmatch(name)
    ]


def _scene(source: ImportSource, objects: list[str]) -> FoundMeshes:
    place = source.place
    if empty := [n for n in place.names() if OBJECT.fullmatch(n) and n not in objects]:
        raise InputError(place.path(empty[0]), found="no mesh", accepted=f"{', '.join((*MESHES, ALIGNED))}")
    aligned = all(place.has(f"{name}/{ALIGNED}") for name in objects)
    poses = {} if aligned else _poses(place, objects)
    meshes = list[FoundMesh]()
    for name in objects:
        file = ALIGNED if aligned else _own_mesh(place, name)
        pose = already_posed(name) if aligned else poses.get(name)
        meshes.append(FoundMesh(name=name, mesh=load_asset_mesh(place.file(f"{name}/{file}")), up="+y", pose=pose))
    first = place.names(objects[0])
    return FoundMeshes(
        source=f"ComfyUI scene {source.path.name}",
        licence="SAM Licence",
        photo=source.required_photo(),
        meshes=tuple(meshes),
        masks=None if source.mask_reader else _masks(source, objects),
        points=read_points(place.file(POINT_MAP)) if place.has(POINT_MAP) else None,
        remarks=unread([*place.names(), *(f"{objects[0]}/{n}" for n in first)]),
    )


def _own_mesh(place: InputFolder, name: str) -> str:
    """The mesh in its own frame. Raises InputError where only some of a scene's meshes are aligned and it is lost."""
    found = next((n for n in MESHES if place.has(f"{name}/{n}")), None)
    if found is None:
        raise InputError(place.path(name), found=f"{ALIGNED} alone", accepted=f"{MESHES[-1]}, or all objects aligned")
    return found


def _poses(place: InputFolder, objects: list[str]) -> dict[str, AssetPose]:
    """Poses by object where all have pose.json; none where none has."""
    having = [name for name in objects if place.has(f"{name}/{POSE}")]
    if having and len(having) < len(objects):
        missing = next(name for name in objects if name not in having)
        raise InputError(place.path(missing), found=f"no {POSE}", accepted=f"{POSE} of all objects, or of none")
    return {name: read_pose(place.file(f"{name}/{POSE}")) for name in having}


def _masks(source: ImportSource, objects: list[str]) -> Masks | None:
    """mask.npy of every object; none where none has one."""
    place, photo = source.place, source.required_photo().photo
    if not any(place.has(f"{name}/{MASK}") for name in objects):
        return None
    masks = dict[int, OutlinedObject]()
    for name in objects:
        file = place.file(f"{name}/{MASK}")
        mask = npz.read_npy(file, "mask", MASKED) > HALF
        if mask.shape != (photo.height, photo.width):
            found = f"{mask.shape[1]}x{mask.shape[0]} pixels"
            raise InputError(file, found=found, accepted=f"the photo's {photo.width}x{photo.height}")
        if (count := int(np.count_nonzero(mask))) < MIN_PIXELS:
            raise InputError(file, found=f"{count} set pixels", accepted=f"at least {MIN_PIXELS}")
        masks[_number(name)] = OutlinedObject(label="", mask=mask)
    return masks


def _files(source: ImportSource, names: list[str]) -> FoundMeshes:
    """GLBs of nodes that keep neither mask nor pose; which axis points up depends on the node."""
    place = source.place
    return FoundMeshes(
        source=f"ComfyUI output folder {source.path.name}",
        photo=source.photo,
        meshes=tuple(FoundMesh(name=Path(n).stem, mesh=load_asset_mesh(place.file(n))) for n in names),
        remarks=unread(place.names()),
    )
