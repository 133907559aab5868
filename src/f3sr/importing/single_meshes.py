"""GLBs of generators of single objects: ``sample.glb`` of TRELLIS and TRELLIS.2, or a GLB or a folder per object.

TRELLIS turns its Z-up meshes to glTF's Y-up when it exports; sizes fill a unit box. No program here keeps a pose.
"""

from __future__ import annotations

import re
from pathlib import Path

from f3sr.errors import InputError
from f3sr.importing.found_meshes import FoundMesh, FoundMeshes, unread
from f3sr.importing.import_source import ImportSource
from f3sr.io.assets import load_asset_mesh
from f3sr.io.input_folder import InputFolder

SAMPLE = re.compile(r"sample(_.{1,60})?\.glb")
"""What the examples and the demo pages of TRELLIS write."""
ONE_EACH = "a GLB per object, or a folder per object with one GLB"


def matches(source: ImportSource) -> bool:
    """Whether a folder, or a folder in it, has a GLB named as TRELLIS names it."""
    return source.path.is_dir() and any(SAMPLE.fullmatch(Path(name).name) for name in _files(source.place))


def read(source: ImportSource) -> FoundMeshes:
    """All GLBs, named by their file, or by their folder where it holds one. Raises InputError, naming the file."""
    place = source.place
    files = _files(place)
    if not files:
        raise InputError(source.path, found="no GLB", accepted=ONE_EACH)
    if len({_name(n) for n in files}) < len(files):
        twice = next(n for n in files if [_name(m) for m in files].count(_name(n)) > 1)
        raise InputError(source.path, found=f"more than one GLB in {Path(twice).parent}", accepted=ONE_EACH)
    return FoundMeshes(
        source=f"TRELLIS output {source.path.name}",
        photo=source.photo,
        meshes=tuple(FoundMesh(name=_name(n), mesh=load_asset_mesh(place.file(n)), up="+y") for n in files),
        remarks=unread([*place.names(), *(f"{Path(n).parent}/{f}" for n in files for f in _beside(place, n))]),
    )


def _files(place: InputFolder) -> list[str]:
    """GLBs of the folder itself, else those of the folders in it."""
    names = place.names()
    if own := [n for n in names if n.lower().endswith(".glb")]:
        return own
    inside = [n for n in names if (place.root / n).is_dir()]
    return [f"{folder}/{n}" for folder in inside for n in place.names(folder) if n.lower().endswith(".glb")]


def _name(file: str) -> str:
    """A sample says nothing of itself, its folder may."""
    path = Path(file)
    return path.parent.name if path.parent.name else path.stem


def _beside(place: InputFolder, file: str) -> list[str]:
    folder = str(Path(file).parent)
    return [] if folder == "." else place.names(folder)
