"""Meshes of a generator as it left them: a file per object, with or without a pose in the photo's camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from f3sr.backends.protocols import Axis
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import quaternion_from_rotation
from f3sr.errors import InputError
from f3sr.files import npz, strict_json
from f3sr.files.limited_file import opened
from f3sr.importing.import_source import Masks, SourcePhoto
from f3sr.io.images import MAX_PIXELS
from f3sr.io.sam3d import LOCAL_FROM_GLB, AssetPose

POSE = "rotation (wxyz), translation and scale, as SAM 3D Objects gives them"
MAX_POSE_BYTES = 1_000_000
"""Of the arrays of a pose: four, three and three numbers."""
POINTS = npz.Wanted(kinds="f", shape=("h", "w", 3), most=3 * MAX_PIXELS, also=("points", "pcd"))
"""A point map, by the names that producers use."""
UNREAD = {
    ".ply": "Gaussian splats or points, not triangles with colours",
    ".pt": "a pickle can run code",
    ".pth": "a pickle can run code",
    ".pkl": "a pickle can run code",
    ".zip": "unpack it first",
}
"""Files that producers leave and that are not read, with the reason."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FoundMesh:
    """A mesh in the axes of its file."""

    name: str
    """What its file or folder is called, to find its mask by."""
    mesh: Mesh
    up: Axis | None = None
    """The axis of the file that points up, where the program has one."""
    pose: AssetPose | None = None
    """In the convention of SAM 3D Objects, as far as the program keeps to it."""
    label: str = ""


@dataclass(frozen=True, eq=False, kw_only=True)
class FoundMeshes:
    """All that a program left of one photo."""

    source: str
    """The program, and its folder."""
    licence: str = ""
    """Of what it made, where it is the same for all."""
    photo: SourcePhoto | None
    meshes: tuple[FoundMesh, ...]
    masks: Masks | None = None
    """By id, where the program keeps them."""
    points: NDArray[np.floating[Any]] | None = None
    """(h, w, 3) in PyTorch3D camera axes, NaN where unknown: the poses are in its unit."""
    remarks: tuple[str, ...] = ()
    """What was assumed, and what was not read, for the user."""


def already_posed(name: str) -> AssetPose:
    """The pose of a mesh whose vertices are in PyTorch3D camera axes: the one that changes nothing.

    Turned by A, rows times R(q) with R(q) = A give the vertices back (``io/sam3d.py``)."""
    rotation = quaternion_from_rotation(LOCAL_FROM_GLB).tolist()
    return AssetPose(mask=name, mesh=name, rotation=rotation, translation=[0.0, 0.0, 0.0], scale=[1.0] * 3)


def pose_of(given: Any, where: Path) -> AssetPose:
    """The pose in an object of a JSON document. Raises InputError, which names the file, for none."""
    if not isinstance(given, Mapping):
        raise InputError(where, found=f"{str(given)[:60]!r}", accepted=POSE)
    parts = {name: given.get(name) for name in ("rotation", "translation", "scale")}
    try:
        return AssetPose.model_validate({**parts, "mask": where.name, "mesh": where.name})
    except ValidationError as error:
        found, _ = strict_json.problem(error, POSE)
        raise InputError(where, found=found, accepted=POSE) from error


def read_pose(file: Path) -> AssetPose:
    """The pose in a JSON or npz file of its own. Raises InputError for what is no pose."""
    if file.suffix != ".npz":
        return pose_of(strict_json.read(file, accepted=POSE), file)
    with opened(file, accepted=POSE) as stream:
        arrays = npz.read_all(stream, str(file), most_bytes=MAX_POSE_BYTES)
    if strange := [name for name, a in arrays.items() if a.dtype.kind not in npz.NUMBERS]:
        raise InputError(file, found=f"{strange[0]} of text", accepted=POSE)
    return pose_of({name: np.asarray(array, float).tolist() for name, array in arrays.items()}, file)


def read_points(file: Path) -> NDArray[np.floating[Any]]:
    """A point map (h, w, 3) in PyTorch3D camera axes from an npy or npz file. Raises InputError."""
    if file.suffix == ".npy":
        return npz.read_npy(file, "pointmap", POINTS)
    return npz.read(file, {"pointmap": POINTS})["pointmap"]


def unread(names: Sequence[str]) -> tuple[str, ...]:
    """Remarks on files that are not read, a line a type."""
    kinds = {suffix: [n for n in names if Path(n).suffix.lower() == suffix] for suffix in UNREAD}
    return tuple(
        f"not read: {len(files)} {suffix} ({files[0]}{', ...' if len(files) > 1 else ''}): {UNREAD[suffix]}"
        for suffix, files in kinds.items()
        if files
    )
