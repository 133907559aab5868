"""EmbodiedGen: scenes with ``layout.json``, and single assets as URDF packages.

An asset is ``NAME.urdf`` with ``mesh/NAME.glb`` beside it, metric and Y-up. The URDF's visual origin turns it into the
Z-up frame of its link. A layout has a pose of every link in a Z-up world whose floor is z = 0: x, y, z and a quaternion
xyzw. It is made from words, so it has no photo and no camera. Background, robot and Gaussians are not read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, pose, rotation_from_quaternion
from f3sr.errors import InputError
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.importing.composition import ComposedObject, Composition, LeftOut
from f3sr.importing.default_camera import view_of_all
from f3sr.importing.found_meshes import FoundMesh, FoundMeshes, unread
from f3sr.importing.import_source import ImportSource
from f3sr.importing.posed_in_camera import centred
from f3sr.importing.urdf_visual import read_urdf
from f3sr.io.assets import load_asset_mesh
from f3sr.io.input_folder import InputFolder
from f3sr.io.sam3d import UNIT

LAYOUT = "layout.json"
NOT_OBJECTS = ("background", "robot")
"""Roles of a layout's nodes that are no objects."""
LENIENT = ConfigDict(extra="ignore", allow_inf_nan=False)
Text = Annotated[str, Field(max_length=300)]
Pose7 = Annotated[list[float], Field(min_length=7, max_length=7)]
"""x, y, z [m] and a quaternion xyzw."""


class _SceneLayout(BaseModel):
    model_config = LENIENT
    assets: Annotated[dict[Text, Text], Field(min_length=1, max_length=MAX_OBJECTS)]
    position: Annotated[dict[Text, Pose7], Field(max_length=2 * MAX_OBJECTS)]
    objs_mapping: dict[Text, Text] = {}
    tree: dict[Text, list[Any]] = {}


def matches(source: ImportSource) -> bool:
    """Whether a folder has a layout, or packages of assets."""
    if not source.path.is_dir():
        return False
    return source.place.has(LAYOUT) or bool(_packages(source.place))


def read(source: ImportSource) -> Composition | FoundMeshes:
    """A layout as a composition, assets as meshes. Raises InputError, naming the file."""
    return _layout(source) if source.place.has(LAYOUT) else _assets(source)


def _layout(source: ImportSource) -> Composition:
    place = source.place
    layout = place.document(LAYOUT, _SceneLayout)
    names = [n for n in layout.assets if layout.objs_mapping.get(n) not in NOT_OBJECTS]
    if not names:
        raise InputError(place.path(LAYOUT), found="no object", accepted="assets other than background and robot")
    if source.photo is not None or source.mask_reader is not None:
        raise InputError(place.path(LAYOUT), found="a photo or masks", accepted="none: a layout is made from words")
    ids = {name: id for id, name in enumerate(names)}
    objects = tuple(_placed(place, layout, name, id) for name, id in ids.items())
    others = [n for n in layout.assets if n not in ids]
    return Composition(
        source=f"EmbodiedGen layout {source.path.name}",
        photo=None,
        camera=view_of_all([o.in_world for o in objects]),
        objects=objects,
        supports=tuple((ids[child], ids[parent]) for parent, child in _pairs(layout) if {parent, child} <= ids.keys()),
        left_out=tuple(LeftOut(label=n, reason=f"it is the {layout.objs_mapping[n]}") for n in others),
        remarks=("camera: one that sees all objects", *unread(place.names())),
    )


def _placed(place: InputFolder, layout: _SceneLayout, name: str, id: int) -> ComposedObject:
    """A link's mesh at its place in the world."""
    if name not in layout.position:
        raise InputError(place.path(LAYOUT), found=f"no position of {name}", accepted="one of every asset")
    x, y, z, *xyzw = layout.position[name]
    if abs(float(np.linalg.norm(xyzw)) - 1) > UNIT:
        found = f"a quaternion of {name} of length {float(np.linalg.norm(xyzw)):.3g}"
        raise InputError(place.path(LAYOUT), found=found, accepted="xyzw of length 1")
    T: Array = pose(rotation_from_quaternion([xyzw[3], *xyzw[:3]]), [x, y, z])
    urdf = f"{layout.assets[name]}/{name.replace(' ', '_')}.urdf"
    mesh, T_link_mesh = centred(_link_mesh(place, urdf))
    return ComposedObject(id=id, label=name.replace("_", " "), mesh=mesh, T_world_mesh=T @ T_link_mesh)


def _pairs(layout: _SceneLayout) -> list[tuple[str, str]]:
    """Parents and children of the scene's tree: a node's list has children, alone or with a relation each."""
    children = [(parent, c[0] if isinstance(c, list) and c else c) for parent, row in layout.tree.items() for c in row]
    return [(parent, child) for parent, child in children if isinstance(child, str)]


def _assets(source: ImportSource) -> FoundMeshes:
    place = source.place
    packages = _packages(place)
    return FoundMeshes(
        source=f"EmbodiedGen assets {source.path.name}",
        photo=source.photo,
        meshes=tuple(
            FoundMesh(name=name, mesh=_link_mesh(place, urdf), up="+z", label=name.replace("_", " "))
            for name, urdf in packages.items()
        ),
        remarks=unread([n for urdf in packages.values() for n in place.names(f"{Path(urdf).parent}/mesh")]),
    )


def _packages(place: InputFolder) -> dict[str, str]:
    """URDFs by their name: in the folder itself, in result/, in NAME/ or NAME/result/."""
    inside = [n for n in place.names() if (place.root / n).is_dir()]
    bases = [".", *inside, *(f"{n}/result" for n in inside if (place.root / n / "result").is_dir())]
    found = [(Path(n).stem, f"{base}/{n}") for base in bases for n in place.names(base) if n.endswith(".urdf")]
    if len({name for name, _ in found}) < len(found):
        raise InputError(place.root, found="two URDFs of one name", accepted="a URDF per asset")
    return dict(found)


def _link_mesh(place: InputFolder, urdf: str) -> Mesh:
    """The visual mesh of a package in its link's frame, Z-up [m]: the GLB beside the file that the URDF names."""
    visual = read_urdf(place.file(urdf))
    name = str(Path(visual.mesh).with_suffix(".glb"))
    return visual.in_link(load_asset_mesh(place.file(name, base=str(Path(urdf).parent))))
