"""Meshes with poses in the photo's camera and no masks, as a composition: their own silhouettes are the masks.

Gravity and the ground are not told, so the photo must tell them: the world has the axes of a level camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose, transform
from f3sr.errors import InputError
from f3sr.importing.composition import ComposedObject, Composition, LeftOut
from f3sr.importing.default_camera import lens_that_sees
from f3sr.importing.found_meshes import FoundMeshes
from f3sr.importing.import_source import ImportSource, SourcePhoto
from f3sr.io.sam3d import LOCAL_FROM_GLB

READING = "poses read as SAM 3D Objects writes them (quaternion wxyz, row vectors); masks would tell other readings"


def composed(found: FoundMeshes, source: ImportSource) -> Composition:
    """What the poses show, by the documented reading. Raises InputError where a pose or the photo is missing."""
    if missing := [m.name for m in found.meshes if m.pose is None]:
        accepted = "--masks, --label-map, --cutouts or --coco; f3sr segment outlines objects"
        raise InputError(source.path, found=f"neither masks nor a pose of {missing[0]}", accepted=accepted)
    photo = found.photo or source.required_photo()
    objects = list[ComposedObject]()
    for id, m in enumerate(found.meshes):
        assert m.pose is not None
        R, t = m.pose.camera_pose()
        T = T_UP_FROM_CAMERA @ pose(R @ LOCAL_FROM_GLB, t)
        objects.append(ComposedObject(id=id, label=m.label, mesh=m.mesh, T_world_mesh=T, scale=m.pose.uniform_scale))
    return seen_by_photo(found.source, photo, objects, source, remarks=(*found.remarks, READING))


def centred(mesh: Mesh) -> tuple[Mesh, Array]:
    """A mesh about its own middle, and the transform (4, 4) back: its file keeps single precision there."""
    middle = mesh.bounds.mean(0)
    return mesh.with_vertices(mesh.vertices - middle), pose(t=middle)


def seen_by_photo(
    name: str,
    photo: SourcePhoto,
    objects: Sequence[ComposedObject],
    source: ImportSource,
    *,
    remarks: tuple[str, ...] = (),
    left_out: tuple[LeftOut, ...] = (),
) -> Composition:
    """Objects in the world of a level camera, seen by that camera; its lens as the user or EXIF tells it.

    Else it is an ordinary lens, or a shorter one that sees all."""
    width, height = photo.photo.width, photo.photo.height
    focal = source.focal(photo)
    points = [transform(o.T_world_mesh, o.scale * o.mesh.vertices) for o in objects]
    K = lens_that_sees(transform(np.linalg.inv(T_UP_FROM_CAMERA), np.concatenate(points)), width, height)
    lens = f"focal length assumed: {K[0, 0]:.0f} px, an ordinary lens that sees all; --focal tells it"
    if focal is not None:
        K[[0, 1], [0, 1]] = focal.pixels
        lens = f"focal length {focal.pixels:.0f} px by {focal.source}"
    return Composition(
        source=name,
        photo=photo.data,
        camera=Camera(width=width, height=height, K=K, T_world_camera=T_UP_FROM_CAMERA),
        objects=tuple(objects),
        ground=None,
        upright=False,
        remarks=(lens, *remarks),
        left_out=left_out,
    )
