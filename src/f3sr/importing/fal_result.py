"""A result of fal's 3-D models as saved: the reply as JSON, and the GLBs that it names beside it.

``metadata`` has a pose per object in the camera of SAM 3D's point map. Its page says that quaternions are xyzw, the
model writes wxyz: masks decide. Nothing is downloaded; the combined scene, splats and the archive are not read.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import unquote, urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.importing.found_meshes import FoundMesh, FoundMeshes, pose_of, unread
from f3sr.importing.import_source import ImportSource
from f3sr.io.assets import load_asset_mesh
from f3sr.io.input_folder import InputFolder
from f3sr.io.sam3d import AssetPose

LENIENT = ConfigDict(extra="ignore", allow_inf_nan=False)
ACCEPTED = "a reply of fal with model_glb or individual_glbs"
MESHES = ("model_glb", "individual_glbs")
PARTS = ("rotation", "translation", "scale")
Text = Annotated[str, Field(max_length=4000)]


class _FalFile(BaseModel):
    model_config = LENIENT
    url: Text = ""
    file_name: Text | None = None

    @property
    def names(self) -> list[str]:
        """What it may be called on disk: bare names only."""
        told = [self.file_name or "", unquote(urlsplit(self.url).path)]
        return [name for name in (Path(t).name for t in told) if name]


class _FalObject(BaseModel):
    model_config = LENIENT
    object_index: Annotated[int, Field(ge=0, lt=MAX_OBJECTS)]
    rotation: Any = None
    translation: Any = None
    scale: Any = None


class _FalReply(BaseModel):
    model_config = LENIENT
    model_glb: _FalFile | None = None
    individual_glbs: Annotated[list[_FalFile | None], Field(max_length=MAX_OBJECTS)] | None = None
    metadata: Annotated[list[_FalObject], Field(max_length=MAX_OBJECTS)] | None = None


def matches(source: ImportSource) -> bool:
    """Whether a folder has a reply."""
    return source.path.is_dir() and bool(_replies(source.place))


def read(source: ImportSource) -> FoundMeshes:
    """The meshes of a reply with their poses, if all have one. Raises InputError, naming the file."""
    place = source.place
    names = _replies(place)
    if len(names) != 1:
        found = " and ".join(names) or "no reply"
        raise InputError(source.path, found=found, accepted=f"one JSON file with {ACCEPTED}")
    file = place.file(names[0])
    reply = _reply(file)
    wanted = _meshes(file, reply)
    poses = _poses(file, reply, len(wanted))
    files = [_on_disk(place, mesh, k, len(wanted)) for k, mesh in enumerate(wanted)]
    if len(set(files)) < len(files):
        raise InputError(file, found="one GLB for two objects", accepted="a GLB per object")
    return FoundMeshes(
        source=f"fal result {names[0]}",
        photo=source.photo,
        meshes=tuple(
            FoundMesh(name=f"object_{k}", mesh=load_asset_mesh(place.file(name)), up="+y", pose=pose)
            for k, (name, pose) in enumerate(zip(files, poses, strict=True))
        ),
        remarks=unread(place.names()),
    )


def _replies(place: InputFolder) -> list[str]:
    """JSON files that name meshes as fal does; other JSON files are none of this reader's business."""
    return [n for n in place.names() if n.endswith(".json") and _document(place, n) is not None]


def _document(place: InputFolder, name: str) -> dict[str, Any] | None:
    try:
        return _unwrapped(strict_json.read(place.file(name)))
    except InputError:
        return None


def _unwrapped(value: Any) -> dict[str, Any] | None:
    """The part with the files: clients save the result itself, or what holds it as ``data``."""
    for part in (value, value.get("data") if isinstance(value, dict) else None):
        if isinstance(part, dict) and any(part.get(name) for name in MESHES):
            return {str(key): item for key, item in part.items()}
    return None


def _reply(file: Path) -> _FalReply:
    try:
        return _FalReply.model_validate(_unwrapped(strict_json.read(file)))
    except ValidationError as error:
        found, accepted = strict_json.problem(error, ", ".join(_FalReply.model_fields))
        raise InputError(file, found=found, accepted=accepted) from error


def _meshes(file: Path, reply: _FalReply) -> list[_FalFile]:
    """A file per object: the single mesh where there are no individual ones."""
    listed = reply.individual_glbs or [reply.model_glb]
    if missing := [k for k, mesh in enumerate(listed) if mesh is None]:
        raise InputError(file, found=f"no mesh of object {missing[0]}", accepted="a mesh for every object")
    return [mesh for mesh in listed if mesh is not None]


def _poses(file: Path, reply: _FalReply, count: int) -> list[AssetPose | None]:
    """By object; none where the reply tells no pose of any."""
    entries = reply.metadata or []
    told = [e for e in entries if any(getattr(e, part) is not None for part in PARTS)]
    if not told:
        return [None] * count
    by_index = {e.object_index: e for e in told}
    if sorted(e.object_index for e in entries) != list(range(count)) or len(by_index) != count:
        found = f"metadata of objects {sorted(e.object_index for e in told)[:8]} for {count} meshes"
        raise InputError(file, found=found, accepted=f"a pose of each of 0 to {count - 1}, or none")
    return [pose_of({part: getattr(by_index[k], part) for part in PARTS}, file) for k in range(count)]


def _on_disk(place: InputFolder, mesh: _FalFile, number: int, count: int) -> str:
    """The file of a mesh: by fal's name or its address's last part, else by its number, else the only one."""
    glbs = [n for n in place.names() if n.lower().endswith(".glb")]
    if own := [n for n in mesh.names if n in glbs]:
        return own[0]
    numbered = [n for n in glbs if re.fullmatch(rf"(.*\D)?0*{number}", Path(n).stem)]
    if len(numbered) == 1:
        return numbered[0]
    if count == 1 and len(glbs) == 1:
        return glbs[0]
    wanted = " or ".join(dict.fromkeys([*mesh.names[:2], f"object_{number}.glb"]))
    raise InputError(place.root, found=f"no {wanted} (GLBs: {', '.join(glbs[:6]) or 'none'})", accepted=wanted)
