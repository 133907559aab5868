"""Jobs of generators: masks and cut-outs are asked, a mesh per object is answered, with or without a pose.

Beside the photo f3sr writes ``masks/NN.png``, ``cutouts/NN.png`` and ``pointmap.npy`` where the geometry is known. For
every object the worker writes ``NN.glb`` and then ``NN.json``.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ValidationError

from f3sr.backends.protocols import Axis, GivenPose, ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.io import sam3d
from f3sr.io.assets import load_asset_mesh
from f3sr.scene import Geometry, Instance
from f3sr.workers.job_folder import (
    IMAGE,
    REQUEST,
    STRICT,
    ModelAnswer,
    Text,
    document,
    is_asked,
    large_file,
    made_folder,
    png,
    write,
    write_request,
)

POINTMAP = "pointmap.npy"
MAX_MESH_BYTES = 500_000_000
"""Largest mesh of a worker: forty times what generators write."""
PYTORCH3D_FROM_OPENCV = np.array([-1.0, -1.0, 1.0], np.float32)
"""Points in OpenCV axes times this are in PyTorch3D axes."""


class WorkerPose(BaseModel):
    """Where an object stands in the point map's camera, or that nobody tells."""

    model_config = STRICT
    convention: Literal["sam3d", "none"] = "none"
    rotation: sam3d.Quaternion | None = None
    translation: sam3d.Vector | None = None
    scale: sam3d.Scale | None = None


class MeshAnswer(ModelAnswer):
    """``NN.json``."""

    id: int | None = None
    mesh: Text
    pose: WorkerPose = WorkerPose()
    up: Axis | None = None


def write_job(job: Path, image: PromptedImage, geometry: Geometry, K: Array, *, seed: int) -> None:
    """Write what is asked into a job folder, ``request.json`` last. A folder that has one is left as it is."""
    if is_asked(job):
        return
    for folder in (job, job / "masks", job / "cutouts"):
        made_folder(folder)
    write(job / IMAGE, png(image.photo.rgb))
    for i in image.instances:
        write(job / "masks" / f"{i.id:02d}.png", png(i.mask.astype(np.uint8) * 255))
        rgba = np.dstack([image.photo.rgb, i.mask.astype(np.uint8) * 255])
        write(job / "cutouts" / f"{i.id:02d}.png", png(rgba))
    known = geometry.source != "ground"
    if known:
        points = np.where(geometry.valid[..., None], geometry.points * PYTORCH3D_FROM_OPENCV, np.float32(np.nan))
        buffer = io.BytesIO()
        np.save(buffer, points.astype(np.float32), allow_pickle=False)
        write(job / POINTMAP, buffer.getvalue())
    request: dict[str, Any] = {
        "K": K.tolist(),
        "pointmap": POINTMAP if known else None,
        "objects": [_asked(i) for i in image.instances],
    }
    write_request(job, request, seed=seed)


def is_done(job: Path, id: int) -> bool:
    """Whether an object is answered; whether the answer is any good shows when it is read."""
    return (job / f"{id:02d}.json").is_file()


def read_answer(job: Path, id: int) -> ProducedMesh:
    """The mesh of an object, checked. Raises InputError, naming the file."""
    file = job / f"{id:02d}.json"
    answer = document(file, MeshAnswer)
    if answer.id is not None and answer.id != id:
        raise InputError(file, found=f"an answer for object {answer.id}", accepted=f"one for object {id}")
    glb = large_file(file, answer.mesh, ".glb", "a GLB", most=MAX_MESH_BYTES)
    return ProducedMesh(
        mesh=load_asset_mesh(glb), up=answer.up, pose=_pose(file, answer.pose), told=answer.told, file=file
    )


def discard(job: Path, id: int) -> None:
    """Forget a bad answer, so that the next run asks again."""
    for suffix in (".json", ".glb"):
        (job / f"{id:02d}{suffix}").unlink(missing_ok=True)


def strangers(job: Path, image: PromptedImage) -> list[str]:
    """Answers for objects that nobody asked for."""
    asked = {f"{i.id:02d}.json" for i in image.instances}
    return sorted(p.name for p in job.glob("*.json") if p.name not in {REQUEST, *asked})


def _asked(i: Instance) -> Mapping[str, Any]:
    return {"id": i.id, "label": i.label, "mask": f"masks/{i.id:02d}.png", "cutout": f"cutouts/{i.id:02d}.png"}


def _pose(file: Path, pose: WorkerPose) -> GivenPose | None:
    if pose.convention == "none":
        return None
    if pose.rotation is None or pose.translation is None or pose.scale is None:
        accepted = "rotation (wxyz), translation and scale with the convention sam3d"
        raise InputError(file, found="a pose that lacks a part", accepted=accepted)
    try:
        return sam3d.AssetPose(
            mask=file.name, mesh=file.name, rotation=pose.rotation, translation=pose.translation, scale=pose.scale
        ).given
    except ValidationError as error:
        found, _ = strict_json.problem(error, "a pose")
        raise InputError(file, found=found, accepted="the pose of SAM 3D Objects") from error
