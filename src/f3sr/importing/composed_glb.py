"""A single GLB with a node per object: Y-up and metric as glTF has it, or in the axes of the photo's camera.

The camera is the file's own. Without one, it is fitted to masks, or it is a camera around the scene that sees all;
then the photo is drawn too. The ground is a flat node below all others, else the lowest point of all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose
from f3sr.errors import InputError
from f3sr.importing.camera_by_masks import fitted_camera
from f3sr.importing.composition import ComposedObject, Composition, LeftOut
from f3sr.importing.default_camera import HEIGHT, WIDTH, view_of_all
from f3sr.importing.glb_nodes import GlbCamera, GlbObject, GlbScene, count_objects, read_glb_scene
from f3sr.importing.import_source import ImportSource, Masks
from f3sr.importing.mesh_matching import matched
from f3sr.importing.posed_in_camera import centred, seen_by_photo
from f3sr.io.assets import require_solidity
from f3sr.io.geometry import camera_frame
from f3sr.io.images import MIN_SIDE
from f3sr.io.pose_conventions import CAMERAS
from f3sr.io.sam3d import LOCAL_FROM_GLB
from f3sr.segmentation.ownership import bounds, disjoint, none_vanished

UP_FROM_FILE = pose(LOCAL_FROM_GLB)
"""glTF's axes, +Y up, to a world with +Z up."""
FLAT = 0.01
"""Largest height of a ground [shares of its diagonal]."""
BELOW = 0.02
"""How far a ground's top may lie above the lowest point of the rest [shares of the rest's size]."""
ASPECT = 0.02
"""Largest difference of a camera's aspect from the photo's, as a share."""


def matches(source: ImportSource) -> bool:
    """Whether this is a GLB, or a folder with one that has several objects."""
    if source.path.is_file():
        return source.path.suffix.lower() == ".glb"
    names = _glbs(source) if source.path.is_dir() else []
    try:
        return len(names) == 1 and count_objects(source.place.file(names[0])) > 1
    except InputError:
        return False


def read(source: ImportSource) -> Composition:
    """The file as a composition. Raises InputError, naming the file."""
    file = _file(source)
    scene = read_glb_scene(file)
    name = f"composed GLB {file.name}"
    if source.asset_frame != "auto":
        return _in_camera(source, file, scene, name)
    solid, left = _solid(scene.objects, file)
    turned = [GlbObject(name=o.name, mesh=o.mesh.with_vertices(o.mesh.vertices @ LOCAL_FROM_GLB.T)) for o in solid]
    flat = [GlbObject(name=o.name, mesh=o.mesh.with_vertices(o.mesh.vertices @ LOCAL_FROM_GLB.T)) for o in left]
    ground, plane = _ground(turned, flat)
    objects = _numbered([o for o in turned if o is not plane])
    masks, camera, how, photo = _seen(source, file, scene, objects)
    return Composition(
        source=name,
        photo=photo,
        camera=camera,
        objects=tuple(objects),
        ground=ground,
        masks=masks,
        left_out=tuple(_why_left(o, is_ground=o is plane) for o in (*flat, *([plane] if plane in turned else []))),
        remarks=(how, f"ground: {plane.name or 'a flat node'}" if plane else "ground: the lowest point of all objects"),
    )


def _glbs(source: ImportSource) -> list[str]:
    return [n for n in source.place.names() if n.lower().endswith(".glb")]


def _file(source: ImportSource) -> Path:
    if source.path.is_file():
        return source.path
    names = _glbs(source)
    if len(names) != 1:
        raise InputError(source.path, found=f"{len(names)} GLBs", accepted="one GLB with a node per object")
    return source.place.file(names[0])


def _numbered(objects: Sequence[GlbObject]) -> list[ComposedObject]:
    """Objects with ids in the file's order, about their own middles; labels that occur twice are numbered."""
    labels = [o.name.replace("_", " ").strip() for o in objects]
    numbered = list[ComposedObject]()
    for id, (o, label) in enumerate(zip(objects, labels, strict=True)):
        before, all_of_it = labels[:id].count(label), labels.count(label)
        own = f"{label} {before + 1}".strip() if all_of_it > 1 else label
        mesh, T = centred(o.mesh)
        numbered.append(ComposedObject(id=id, label=own, mesh=mesh, T_world_mesh=T))
    return numbered


def _solid(objects: Sequence[GlbObject], file: Path) -> tuple[list[GlbObject], list[GlbObject]]:
    """Those that can be bodies, and the flat ones. Raises InputError where none can."""
    solid, flat = list[GlbObject](), list[GlbObject]()
    for o in objects:
        (solid if _has_volume(o.mesh) else flat).append(o)
    if not solid:
        raise InputError(file, found="flat nodes only", accepted="at least one object that spans a volume")
    return solid, flat


def _has_volume(mesh: Mesh) -> bool:
    try:
        require_solidity("", mesh)
    except InputError:
        return False
    return True


def _why_left(o: GlbObject, *, is_ground: bool) -> LeftOut:
    return LeftOut(label=o.name, reason="it is the ground" if is_ground else "it is flat: it spans no volume")


def _ground(objects: Sequence[GlbObject], flat: Sequence[GlbObject]) -> tuple[float, GlbObject | None]:
    """The height of what all stand on, and the node that it is, if there is one."""
    for candidate in sorted((*flat, *objects), key=lambda o: -o.mesh.diagonal):
        rest = [o.mesh.bounds for o in objects if o is not candidate]
        if not rest:
            continue
        low, high = np.min([b[0] for b in rest], axis=0), np.max([b[1] for b in rest], axis=0)
        bottom, top = candidate.mesh.bounds
        is_flat = top[2] - bottom[2] <= FLAT * candidate.mesh.diagonal
        is_below = top[2] <= low[2] + BELOW * float(np.linalg.norm(high - low))
        reaches = bool((bottom[:2] <= low[:2]).all() and (top[:2] >= high[:2]).all())
        if is_flat and is_below and reaches:
            return float(top[2]), candidate
    return min(float(o.mesh.bounds[0, 2]) for o in objects), None


# --- the camera ---------------------------------------------------------------------------------------------------


def _seen(
    source: ImportSource, file: Path, scene: GlbScene, objects: list[ComposedObject]
) -> tuple[dict[int, NDArray[np.bool_]] | None, Camera, str, bytes | None]:
    """Masks where they are given, the camera and how it was found, and the photo where there is one."""
    photo = source.photo
    named = source.named_masks()
    masks = _masks_of(source, named, objects) if named else None
    data = photo.data if photo else None
    if scene.cameras:
        given = scene.cameras[0]
        size = (photo.photo.width, photo.photo.height) if photo else _size(given)
        camera = _camera(file, given, *size)
        rest = f"; {len(scene.cameras) - 1} more not used" if len(scene.cameras) > 1 else ""
        return masks, camera, f"camera: {given.name or 'of the file'}{rest}", data
    if photo is None:
        return None, view_of_all([o.in_world for o in objects]), "camera: one that sees all objects", None
    if masks is None:
        accepted = "--masks (the camera is fitted to them), --asset-frame if its axes are the camera's, or no photo"
        raise InputError(file, found="a photo, and no camera in the file", accepted=accepted)
    focal = source.focal(photo)
    shown = [o.in_world for o in objects if o.id in masks]
    camera, iou = fitted_camera(shown, masks, focal.pixels if focal else None, str(file))
    lens = f"focal length {camera.K[0, 0]:.0f} px{f' by {focal.source}' if focal else ''}"
    return masks, camera, f"camera: fitted to the masks, mean IoU {iou:.2f}, {lens}", data


def _masks_of(source: ImportSource, named: Masks, objects: Sequence[ComposedObject]) -> dict[int, NDArray[np.bool_]]:
    """Masks by the ids of the objects, disjoint: by number where numbers are the nodes', else by name."""
    by_name = {o.label: o.id for o in objects}
    names = matched(source.path, {id: m.label for id, m in named.items()}, list(by_name), in_order=source.in_order)
    masks = {by_name[name]: named[id].mask for id, name in names.items()}
    apart = disjoint(source.required_photo().photo.rgb, list(masks.values()), [bounds(m) for m in masks.values()])
    return dict(zip(masks, none_vanished(apart, list(masks.values())), strict=True))


def _size(camera: GlbCamera) -> tuple[int, int]:
    """Pixels of a drawn photo of a camera's aspect."""
    aspect = camera.aspect or WIDTH / HEIGHT
    longest = max(WIDTH, HEIGHT)
    return max(MIN_SIDE, round(longest * min(aspect, 1.0))), max(MIN_SIDE, round(longest / max(aspect, 1.0)))


def _camera(file: Path, given: GlbCamera, width: int, height: int) -> Camera:
    """glTF's camera over a picture of so many square pixels. Raises InputError for another aspect."""
    aspect = given.aspect
    if aspect is not None and abs(aspect * height / width - 1) > ASPECT:
        found = f"a camera of aspect {aspect:.3f}"
        raise InputError(file, found=found, accepted=f"the photo's, {width / height:.3f}")
    focal = height / 2 / math.tan(given.yfov / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    T: Array = UP_FROM_FILE @ given.T_file_camera @ pose(CAMERAS["opengl"].matrix)
    return Camera(width=width, height=height, K=K, T_world_camera=T)


def _in_camera(source: ImportSource, file: Path, scene: GlbScene, name: str) -> Composition:
    """A file in the axes of the photo's camera: nothing but the lens is to be found."""
    solid, flat = _solid(scene.objects, file)
    R = T_UP_FROM_CAMERA[:3, :3] @ camera_frame(file, source.asset_frame)
    turned = [GlbObject(name=o.name, mesh=o.mesh.with_vertices(o.mesh.vertices @ R.T)) for o in solid]
    objects = _numbered(turned)
    named = source.named_masks()
    masks = _masks_of(source, named, objects) if named else None
    left_out = tuple(_why_left(o, is_ground=False) for o in flat)
    return replace(seen_by_photo(name, source.required_photo(), objects, source, left_out=left_out), masks=masks)
