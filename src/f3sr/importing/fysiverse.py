"""Sessions of Fysiverse-3D: ``final_scene_manifest.json``, web GLBs in the settled world, the camera of the background.

The GLBs are Y-up and hold the settled poses in their vertices; the world of the session is Blender's, Z-up, with the
ground at z = 0. The camera looks along its own -Z (Blender). Masks are not published.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, pose, rotation_from_quaternion
from f3sr.errors import InputError
from f3sr.files.bounds import MAX_OBJECTS
from f3sr.importing.composition import ComposedObject, Composition
from f3sr.importing.import_source import ImportSource
from f3sr.io.assets import load_asset_mesh
from f3sr.io.images import open_image
from f3sr.io.input_folder import InputFolder
from f3sr.io.pose_conventions import CAMERAS
from f3sr.io.sam3d import LOCAL_FROM_GLB, UNIT

MANIFEST = "results/final_scene_manifest.json"
CAMERA = "results/3dgs_bg/manifest.json"
LENIENT = ConfigDict(extra="ignore", allow_inf_nan=False)
Text = Annotated[str, Field(max_length=300)]
Rows = Annotated[list[Annotated[list[float], Field(min_length=3, max_length=3)]], Field(min_length=3, max_length=3)]
"""A matrix (3, 3)."""


class _SessionObject(BaseModel):
    model_config = LENIENT
    mask_id: int
    semantic_label: Text = ""
    web_asset_glb: Text


class _SessionSupport(BaseModel):
    model_config = LENIENT
    upper_mask_id: int
    lower_mask_id: int


class _SessionSupports(BaseModel):
    model_config = LENIENT
    scene_graph_support_relations: list[_SessionSupport] = []


class _Session(BaseModel):
    model_config = LENIENT
    objects: Annotated[list[_SessionObject], Field(min_length=1, max_length=MAX_OBJECTS)]
    support: _SessionSupports = _SessionSupports()


class _SessionCamera(BaseModel):
    model_config = LENIENT
    position: Annotated[list[float], Field(min_length=3, max_length=3)]
    quaternion_xyzw: Annotated[list[float], Field(min_length=4, max_length=4)]
    intrinsics_pixels: Rows | None = None
    intrinsics_normalized: Rows | None = None
    image_size: Annotated[list[int], Field(min_length=2, max_length=2)]


class _SessionBackground(BaseModel):
    model_config = LENIENT
    camera: _SessionCamera


def matches(source: ImportSource) -> bool:
    """Whether a folder is a session."""
    return (source.path / MANIFEST).is_file()


def read(source: ImportSource) -> Composition:
    """The settled scene of a session. Raises InputError, naming the file, for what is missing or invalid."""
    place, folder = source.place, source.path
    if source.photo_file is not None or source.mask_reader is not None:
        raise InputError(
            folder, found="a photo or masks", accepted="none: a session has its photo, and masks are drawn"
        )
    session = place.document(MANIFEST, _Session)
    ids = [o.mask_id for o in session.objects]
    if len(set(ids)) != len(ids):
        raise InputError(folder / MANIFEST, found="two objects with one mask_id", accepted="ids that differ")
    photo = place.file("input/image.png")
    camera = _camera(place, photo)
    objects = tuple(
        ComposedObject(
            id=o.mask_id,
            label=o.semantic_label.replace("_", " "),
            mesh=load_asset_mesh(place.file(_within(place, o.web_asset_glb))),
            T_world_mesh=pose(LOCAL_FROM_GLB),
        )
        for o in session.objects
    )
    return Composition(
        source=f"Fysiverse session {folder.name}",
        photo=photo.read_bytes(),
        camera=camera,
        objects=objects,
        supports=tuple(
            (r.upper_mask_id, r.lower_mask_id)
            for r in session.support.scene_graph_support_relations
            if {r.upper_mask_id, r.lower_mask_id} <= set(ids) and r.upper_mask_id != r.lower_mask_id
        ),
    )


def _within(place: InputFolder, path: str) -> str:
    """A path of the manifest, which counts from the repository, as one in the session's folder."""
    parts = Path(path).parts
    return str(Path(*parts[2:])) if parts[:1] == ("sessions",) and len(parts) > 2 else path


def _camera(place: InputFolder, photo: Path) -> Camera:
    given = place.document(CAMERA, _SessionBackground).camera
    width, height = open_image(photo).size
    if given.image_size != [width, height]:
        found = f"a camera of {given.image_size[0]}x{given.image_size[1]} pixels"
        raise InputError(place.path(CAMERA), found=found, accepted=f"the photo's {width}x{height}")
    K = _intrinsics(given)
    if not (K[0, 0] > 0 and K[1, 1] > 0 and K[2].tolist() == [0, 0, 1]):
        raise InputError(place.path(CAMERA), found="intrinsics that are no camera's", accepted="K (3, 3) in pixels")
    x, y, z, w = given.quaternion_xyzw
    if abs(math.hypot(x, y, z, w) - 1) > UNIT:
        raise InputError(place.path(CAMERA), found="a quaternion that is no rotation", accepted="xyzw of length 1")
    R = rotation_from_quaternion([w, x, y, z]) @ CAMERAS["opengl"].matrix
    return Camera(width=width, height=height, K=K, T_world_camera=pose(R, given.position))


def _intrinsics(camera: _SessionCamera) -> Array:
    """K (3, 3) in pixels; some sessions have it by width and height only."""
    if camera.intrinsics_pixels is not None:
        return np.array(camera.intrinsics_pixels, float)
    return np.diag([*camera.image_size, 1.0]) @ np.array(camera.intrinsics_normalized or np.zeros((3, 3)), float)
