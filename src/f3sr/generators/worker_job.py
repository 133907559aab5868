"""The job folder that f3sr shares with a worker (docs: workers): what is asked, what is answered, what is done already.

f3sr writes ``image.png``, ``masks/NN.png``, ``cutouts/NN.png``, ``pointmap.npy`` where the geometry is known, and
``request.json`` last. For every object the worker writes ``NN.glb`` and then ``NN.json``. An object with both is done.
Nothing of an answer is trusted: names are bare, sizes limited, numbers checked.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.backends.protocols import Axis, ProducedMesh, PromptedImage, ReadPose
from f3sr.core.transforms import Array
from f3sr.errors import InputError, printable
from f3sr.files import limited_file, strict_json
from f3sr.io import sam3d
from f3sr.io.mesh_files import load_mesh
from f3sr.runtime.cache_files import write_whole
from f3sr.runtime.cache_folder import PRIVATE
from f3sr.scene import Geometry, Instance

PROTOCOL = 1
REQUEST, IMAGE, POINTMAP = "request.json", "image.png", "pointmap.npy"
MAX_MESH_BYTES = 500_000_000
"""Largest mesh of a worker: forty times what generators write."""
MAX_ANSWER_BYTES = 100_000
"""Largest NN.json."""
PYTORCH3D_FROM_OPENCV = np.array([-1.0, -1.0, 1.0], np.float32)
"""Points in OpenCV axes times this are in PyTorch3D axes."""
STRICT = ConfigDict(strict=True, allow_inf_nan=False, extra="ignore", frozen=True)
Text = Annotated[str, Field(max_length=200)]


class WorkerPose(BaseModel):
    """Where an object stands in the point map's camera, or that nobody tells."""

    model_config = STRICT
    convention: Literal["sam3d", "none"] = "none"
    rotation: sam3d.Quaternion | None = None
    translation: sam3d.Vector | None = None
    scale: sam3d.Scale | None = None


class WorkerAnswer(BaseModel):
    """``NN.json``."""

    model_config = STRICT
    id: int | None = None
    mesh: Text
    pose: WorkerPose = WorkerPose()
    up: Axis | None = None
    model: Text = ""
    weights: Text = ""
    licence: Text = ""
    seconds: float = Field(default=0.0, ge=0)

    @property
    def told(self) -> str:
        """Model, revision and licence, for the report."""
        parts = (self.model, self.weights and f"weights {self.weights}", self.licence and f"licence {self.licence}")
        return printable(", ".join(filter(None, parts)))


def write_job(job: Path, image: PromptedImage, geometry: Geometry, K: Array, *, seed: int) -> None:
    """Write what is asked into a job folder, ``request.json`` last. A folder that has one is left as it is."""
    if (job / REQUEST).exists():
        return
    for folder in (job, job / "masks", job / "cutouts"):
        folder.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
    _write(job / IMAGE, _png(image.photo.rgb))
    for i in image.instances:
        _write(job / "masks" / f"{i.id:02d}.png", _png(i.mask.astype(np.uint8) * 255))
        rgba = np.dstack([image.photo.rgb, i.mask.astype(np.uint8) * 255])
        _write(job / "cutouts" / f"{i.id:02d}.png", _png(rgba))
    known = geometry.source != "ground"
    if known:
        points = np.where(geometry.valid[..., None], geometry.points * PYTORCH3D_FROM_OPENCV, np.float32(np.nan))
        buffer = io.BytesIO()
        np.save(buffer, points.astype(np.float32), allow_pickle=False)
        _write(job / POINTMAP, buffer.getvalue())
    request: dict[str, Any] = {
        "protocol": PROTOCOL,
        "seed": seed,
        "image": IMAGE,
        "K": K.tolist(),
        "pointmap": POINTMAP if known else None,
        "objects": [_asked(i) for i in image.instances],
    }
    _write(job / REQUEST, json.dumps(request, indent=1).encode())


def is_done(job: Path, id: int) -> bool:
    """Whether an object is answered; whether the answer is any good shows when it is read."""
    return (job / f"{id:02d}.json").is_file()


def read_answer(job: Path, id: int) -> ProducedMesh:
    """The mesh of an object, checked. Raises InputError, naming the file."""
    file = job / f"{id:02d}.json"
    answer = _document(file)
    if answer.id is not None and answer.id != id:
        raise InputError(file, found=f"an answer for object {answer.id}", accepted=f"one for object {id}")
    mesh = job / answer.mesh
    if Path(answer.mesh).name != answer.mesh or not answer.mesh.lower().endswith(".glb") or mesh.is_symlink():
        raise InputError(file, found=f"the mesh {answer.mesh!r}", accepted="the bare name of a GLB in the job folder")
    with limited_file.opened(mesh, most=MAX_MESH_BYTES):
        pass
    return ProducedMesh(mesh=load_mesh(mesh), up=answer.up, poses=_poses(file, answer.pose), told=answer.told)


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


def _document(file: Path) -> WorkerAnswer:
    value = strict_json.read(file, most=MAX_ANSWER_BYTES)
    try:
        return WorkerAnswer.model_validate(value)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, ", ".join(WorkerAnswer.model_fields))
        raise InputError(file, found=found, accepted=accepted) from error


def _poses(file: Path, pose: WorkerPose) -> tuple[ReadPose, ...]:
    if pose.convention == "none":
        return ()
    if pose.rotation is None or pose.translation is None or pose.scale is None:
        accepted = "rotation (wxyz), translation and scale with the convention sam3d"
        raise InputError(file, found="a pose that lacks a part", accepted=accepted)
    try:
        return sam3d.readings(pose.rotation, pose.translation, pose.scale)
    except ValueError as error:
        raise InputError(file, found=str(error), accepted="the pose of SAM 3D Objects") from error


def _write(file: Path, data: bytes) -> None:
    write_whole(file, data)
    if not file.exists():
        raise InputError(file, found="a place that cannot be written", accepted="a cache folder with room")


def _png(pixels: Any) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return buffer.getvalue()
