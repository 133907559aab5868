"""Folders of SAM 3D Objects' notebooks: ``image.png``, masks ``N.png``, and meshes that the user saved as ``N.glb``.

The notebook itself saves Gaussian splats only. Its meshes are Y-up GLBs in a unit box; poses are in PyTorch3D camera
axes, in the unit of the model's point map (``io/sam3d.py``). Pickles (``.pt``) are not read.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.importing.found_meshes import (
    POSE,
    FoundMesh,
    FoundMeshes,
    already_posed,
    pose_of,
    read_points,
    read_pose,
    unread,
)
from f3sr.importing.import_source import PHOTO_NAMES, ImportSource, Masks, masks_named
from f3sr.io.assets import load_asset_mesh
from f3sr.io.input_folder import InputFolder
from f3sr.io.sam3d import AssetPose

NUMBERED_MASK, NUMBERED_MESH = re.compile(r"[0-9]{1,6}\.png"), re.compile(r"[0-9]{1,6}\.glb")
POSES = "poses.json"
POINT_MAPS = ("pointmap.npy", "pointmap.npz")
HOW = "N.glb beside N.png: the notebook saves splats only (docs: importing says how to save meshes and poses)"
OWN_BOX = 0.55
"""Largest coordinate of a mesh in the model's own frame, a unit box, with some room."""


def matches(source: ImportSource) -> bool:
    """Whether a folder has a photo and numbered masks, as the notebook's images do."""
    if not source.path.is_dir():
        return False
    return any(map(source.place.has, PHOTO_NAMES)) and bool(_mask_names(source.place)[1])


def read(source: ImportSource) -> FoundMeshes:
    """Meshes, masks, and poses where they were saved. Raises InputError, naming the file."""
    place = source.place
    folder = _mesh_folder(place)
    names = [n for n in place.names(folder) if NUMBERED_MESH.fullmatch(n)]
    poses = _poses(place, folder, names)
    meshes = {
        Path(n).stem: load_asset_mesh(place.file(n, base=folder)) for n in sorted(names, key=lambda n: int(n[:-4]))
    }
    remarks = unread([*place.names(), *(place.names(folder) if folder else [])])
    if not poses and any(abs(mesh.bounds).max() > OWN_BOX for mesh in meshes.values()):
        poses = {stem: already_posed(stem) for stem in meshes}
        remarks = (*remarks, "meshes outside the model's unit box: taken as posed in the camera")
    points = [name for name in POINT_MAPS if place.has(name)]
    return FoundMeshes(
        source=f"SAM 3D Objects notebook folder {source.path.name}",
        licence="SAM Licence",
        photo=source.required_photo(),
        meshes=tuple(FoundMesh(name=s, mesh=mesh, up="+y", pose=poses.get(s)) for s, mesh in meshes.items()),
        masks=None if source.mask_reader else _masks(source),
        points=read_points(place.file(points[0])) if points else None,
        remarks=remarks,
    )


def _mask_names(place: InputFolder) -> tuple[str, list[str]]:
    """The folder of the numbered masks, the place itself or masks/, and their names."""
    for base in ("", "masks"):
        if names := [n for n in place.names(base) if NUMBERED_MASK.fullmatch(n)]:
            return base, names
    return "", []


def _masks(source: ImportSource) -> Masks | None:
    base, names = _mask_names(source.place)
    return masks_named(source.place, names, source.required_photo(), base) if names else None


def _mesh_folder(place: InputFolder) -> str:
    """The folder with N.glb: the place itself, or the one folder in it that has them."""
    inside = [n for n in place.names() if (place.root / n).is_dir()]
    having = [f for f in ("", *inside) if any(NUMBERED_MESH.fullmatch(n) for n in place.names(f))]
    if len(having) != 1:
        found = f"{', '.join(f or 'the folder itself' for f in having)} with N.glb" if having else "no N.glb"
        raise InputError(place.root, found=found, accepted=f"one folder with {HOW}")
    return having[0]


def _poses(place: InputFolder, folder: str, names: list[str]) -> dict[str, AssetPose]:
    """Poses by the number of their mesh: of poses.json, or of N.json or N.npz beside each mesh."""
    stems = [Path(name).stem for name in names]
    base = next((b for b in dict.fromkeys((folder, "")) if place.has(f"{b}/{POSES}" if b else POSES)), None)
    if base is not None:
        file = place.file(POSES, base=base)
        return {stem: pose_of(given, file) for stem, given in _entries(file, stems).items()}
    found = dict[str, AssetPose]()
    for stem in stems:
        own = [f"{stem}{suffix}" for suffix in (".json", ".npz") if place.has(f"{folder}/{stem}{suffix}".lstrip("/"))]
        if len(own) > 1:
            raise InputError(place.path(folder), found=" and ".join(own), accepted="one file with the pose")
        if own:
            found[stem] = read_pose(place.file(own[0], base=folder))
    if found and (missing := [stem for stem in stems if stem not in found]):
        raise InputError(place.path(folder), found=f"no pose of mesh {missing[0]}", accepted=f"{POSE}, of all or none")
    return found


def _entries(file: Path, stems: list[str]) -> dict[str, Any]:
    """The entries of poses.json by mesh: a list in the order of the numbers, or an object by number."""
    value = strict_json.read(file, accepted=f"poses by number: {POSE}")
    numbers = sorted(stems, key=int)
    if isinstance(value, list) and len(value) == len(numbers):
        return dict(zip(numbers, value, strict=True))
    if isinstance(value, dict):
        by_number = {str(int(key)): entry for key, entry in value.items() if str(key).isdecimal() and len(key) < 9}
        if {str(int(stem)) for stem in stems} == by_number.keys() and len(value) == len(stems):
            return {stem: by_number[str(int(stem))] for stem in stems}
    found = f"{len(value)} entries" if isinstance(value, list | dict) else "neither a list nor an object"
    raise InputError(file, found=found, accepted=f"one entry for each of {len(stems)} meshes: {POSE}")
