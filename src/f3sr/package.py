"""The scene package on disk: written whole or not at all, and read back with every claim checked."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import JsonValue, ValidationError

import f3sr
from f3sr import strict_json
from f3sr.errors import InputError, OutputError, reason
from f3sr.export.gltf import encode_png, mesh_to_glb, scene_to_glb
from f3sr.export.mjcf import collision_files, to_mjcf
from f3sr.export.scene_json import (
    SCHEMA_FILE,
    ObjectRecord,
    SceneDocument,
    dump_json,
    mesh_path,
    scene_schema,
    to_document,
    to_json,
)
from f3sr.frames import Camera
from f3sr.images import open_image
from f3sr.mesh import ConvexPart, Mesh
from f3sr.mesh_io import load_mesh
from f3sr.physics import DEFAULT_PHYSICS, PhysicsConfig, body_of
from f3sr.report import Report
from f3sr.scene import Excluded, Ground, Motion, Photo, Relation, Scene, SceneGraph, SceneObject, Support

PHOTO = "photo.png"
PAGE = "report.html"
MASKS = "masks"
MARKER = ".f3sr-building"
"""In a folder that is being built; without it a folder of that name is somebody else's."""
TOP_LEVEL = {
    *("scene.json", SCHEMA_FILE, "scene.glb", "scene.xml", "report.json", PAGE, PHOTO),
    *(MASKS, "meshes", "collision", "visual", "pictures", "rollouts"),
}
"""Everything that a package holds."""

__all__ = ["Package", "SceneDocument", "prepare_output", "read_package", "scene_schema", "write_package"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Package:
    """A scene package in memory: the scene with objects of scale 1, the levelled input beside it where the package
    knows it, and the document itself."""

    folder: Path
    document: SceneDocument
    scene: Scene
    direct: Scene | None


def write_package(
    scene: Scene,
    out: Path,
    *,
    direct: Scene | None = None,
    metrics: Mapping[str, float | None] | None = None,
    provenance: Mapping[str, JsonValue] | None = None,
    reports: Sequence[Report] = (),
    seconds: Mapping[str, float] | None = None,
    pictures: Mapping[str, NDArray[np.uint8]] | None = None,
    page: bytes | None = None,
    physics: PhysicsConfig = DEFAULT_PHYSICS,
    overwrite: bool = False,
) -> Path:
    """Write the scene as a package to ``out`` and return the folder's full path.

    ``direct``: the levelled input with the same ids; ``metrics`` by name; ``provenance``:
    stages, hashes and the like, without paths of this machine or times;
    ``seconds`` per stage go to report.json with the ``reports``; ``pictures`` (h, w, 3) by name without
    suffix; ``page`` is report.html. ``out`` changes only after everything has been written beside it.
    Raises OutputError when something else than an f3sr package is there, or one with rollouts and not ``overwrite``.
    """
    out = prepare_output(out, overwrite=overwrite)
    building = _building(out)
    _begin(building)
    try:
        for name, data in _files(
            scene,
            direct=direct,
            metrics=metrics or {},
            provenance={"f3sr": f3sr.__version__, **(provenance or {})},
            report=_report(reports, seconds or {}),
            pictures=pictures or {},
            page=page,
            physics=physics,
        ).items():
            file = building / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)
        (building / MARKER).unlink()
        _commit(building, out)
    except OSError as error:
        raise OutputError(f"{out}: could not be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(building, ignore_errors=True)
    return out


def prepare_output(out: Path, *, inputs: Path | None = None, overwrite: bool = False) -> Path:
    """Tidy up after an interrupted run, and refuse early a place that ``write_package`` may not take.

    ``inputs`` is the folder a run reads: neither may lie inside the other. Returns the full path of ``out``.
    """
    out = Path(out).resolve()
    if inputs is not None:
        source = Path(inputs).resolve()
        if out.is_relative_to(source) or source.is_relative_to(out):
            raise OutputError(f"{out}: the output and the input folder {source} may not hold one another")
    if not out.name:
        raise OutputError(f"{out}: the root of the file system cannot be a package")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        _recover(out)
    except OSError as error:
        raise OutputError(f"{out}: cannot be prepared ({error.strerror or error})") from error
    if out.exists() and not _is_empty(out):
        if not is_package(out):
            raise OutputError(f"{out}: is {_contents(out)}; only an f3sr package or an empty folder is replaced")
        if strangers := _strangers(out):
            raise OutputError(f"{out}: holds {strangers[0]}, which f3sr did not write; move it away first")
        if _has_rollouts(out) and not overwrite:
            raise OutputError(f"{out}: holds rollouts; a package with rollouts is replaced only with --overwrite")
    return out


def is_package(folder: Path) -> bool:
    """True when the folder has a scene.json that looks like ours, of whatever version."""
    try:
        tree = json.loads((folder / "scene.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    if not isinstance(tree, dict) or tree.get("$schema") != SCHEMA_FILE:
        return False
    provenance = tree.get("provenance")
    return isinstance(provenance, dict) and "f3sr" in provenance


def read_package(folder: Path) -> Package:
    """Read a package; InputError names the file that is missing, malformed or outside the folder."""
    folder = Path(folder)
    document = _read_document(folder / "scene.json")
    size = document.camera.width, document.camera.height
    photo = Photo(rgb=_read_image(folder, PHOTO, size, "RGB"))
    ground = document.ground
    scene = Scene(
        photo=photo,
        camera=Camera(
            width=size[0],
            height=size[1],
            K=np.array(document.camera.K),
            T_world_camera=np.array(document.camera.T_world_camera),
        ),
        ground=Ground(
            normal=np.array(ground.normal),
            offset=ground.offset,
            source=ground.source,
            confidence=ground.confidence,
        ),
        objects=tuple(_read_object(folder, record, size) for record in document.objects),
        graph=SceneGraph(
            relations=tuple(Relation(**r.model_dump()) for r in document.scene_graph.relations),
            source=document.scene_graph.source,
        ),
        excluded=tuple(Excluded(mask=e.mask, reason=e.reason) for e in document.excluded),
    )
    return Package(folder=folder, document=document, scene=scene, direct=_direct(document, scene))


def _direct(document: SceneDocument, scene: Scene) -> Scene | None:
    """The levelled input, from the package's meshes."""
    if document.direct is None:
        return None
    return replace(
        scene,
        camera=scene.camera.moved(np.array(document.direct.T_world_camera)),
        objects=tuple(
            replace(scene[r.id], T_world_object=np.array(r.T_world_object), scale=r.scale, motion=())
            for r in document.direct.objects
        ),
    )


def _files(
    scene: Scene,
    *,
    direct: Scene | None,
    metrics: Mapping[str, float | None],
    provenance: Mapping[str, JsonValue],
    report: dict[str, Any],
    pictures: Mapping[str, NDArray[np.uint8]],
    page: bytes | None,
    physics: PhysicsConfig,
) -> dict[str, bytes]:
    """Every file of the package by its relative path."""
    files = {PHOTO: encode_png(scene.photo.rgb)}
    for o in scene.objects:
        mesh = o.mesh.with_vertices(o.scale * o.mesh.vertices)
        files[f"{MASKS}/{o.mask_name}"] = encode_png(255 * o.mask.astype(np.uint8))
        files[mesh_path(o.id)] = mesh_to_glb(mesh, name=f"object_{o.id:02d}")
        files |= collision_files(o.id, body_of(o, physics))
    files["scene.glb"] = scene_to_glb(scene.objects)
    files |= to_mjcf(scene.objects, scene.camera, physics)
    for name, picture in pictures.items():
        if not re.fullmatch(r"[\w-]+", name, flags=re.ASCII):
            raise ValueError(f"picture name {name!r}: only letters, digits, _ and - are accepted")
        files[f"pictures/{name}.png"] = encode_png(picture)
    files["report.json"] = dump_json(report)
    if page is not None:
        files[PAGE] = page
    files[SCHEMA_FILE] = dump_json(scene_schema())
    files["scene.json"] = to_json(to_document(scene, direct=direct, metrics=metrics, provenance=provenance))
    return files


def _report(reports: Sequence[Report], seconds: Mapping[str, float]) -> dict[str, Any]:
    """Stage reports as plain values; numbers that are not finite become null."""
    return _plain({"seconds": dict(seconds), "stages": [asdict(report) for report in reports]})


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def _building(out: Path) -> Path:
    return out.with_name(f".{out.name}.building")


def _previous(out: Path) -> Path:
    return out.with_name(f".{out.name}.previous")


def _recover(out: Path) -> None:
    """After a crash: drop what was being built, and bring back the old package unless a new one is there."""
    building, previous = _building(out), _previous(out)
    if (building / MARKER).exists():
        if _alive(building / MARKER):
            raise OutputError(f"{out}: another run is writing it right now")
        shutil.rmtree(building)
    elif is_package(building):  # complete, but killed before its rename
        _discard(building)
    elif building.exists():
        raise OutputError(f"{building}: is in the way and not f3sr's; move it away first")
    if previous.exists() and not is_package(previous):
        raise OutputError(f"{previous}: is in the way and no f3sr package; move it away first")
    if previous.exists():
        if out.exists() and not _is_empty(out):
            _discard(previous)
        else:
            _move(previous, out)


def _alive(marker: Path) -> bool:
    """Whether the process that wrote the marker still runs on this machine."""
    try:
        os.kill(int(marker.read_text()), 0)
    except (OSError, ValueError):
        return False
    return True


def _begin(building: Path) -> None:
    """Claim the place to build in; only one process can make the folder."""
    try:
        building.mkdir(parents=True)
    except FileExistsError:
        raise OutputError(f"{building}: another run is writing it right now") from None
    (building / MARKER).write_text(str(os.getpid()))


def _commit(building: Path, out: Path) -> None:
    """Put the finished folder in place; at every moment one whole package exists under one of the names."""
    previous = _previous(out)
    if out.exists() and not _is_empty(out):
        _move(out, previous)
    try:
        _move(building, out)
    except BaseException:
        if previous.exists() and not out.exists():
            _move(previous, out)
        raise
    if previous.exists():
        _discard(previous)


def _discard(folder: Path) -> None:
    """Delete a package, what tells that it is one last, so that a killed deletion can go on."""
    for path in folder.iterdir():
        if path.name != "scene.json":
            shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    shutil.rmtree(folder)


def _move(source: Path, target: Path) -> None:
    """Rename a folder; an empty folder may be in the way."""
    if target.exists():
        target.rmdir()
    source.rename(target)


def _is_empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _has_rollouts(folder: Path) -> bool:
    rollouts = folder / "rollouts"
    return rollouts.is_dir() and not _is_empty(rollouts)


def _strangers(out: Path) -> list[str]:
    """Top-level names in a package that f3sr does not write."""
    return sorted(p.name for p in out.iterdir() if p.name not in TOP_LEVEL)


def _contents(place: Path) -> str:
    """What is there, in a few words."""
    if not place.is_dir():
        return "a file"
    names = sorted(p.name for p in place.iterdir())
    return f"a folder with {len(names)} other things ({', '.join(names[:3])}{', ...' if len(names) > 3 else ''})"


def _read_document(file: Path) -> SceneDocument:
    accepted = "the scene.json of an f3sr package, schema_version 1"
    try:
        if file.exists() and not file.is_file():  # reading a pipe would wait forever
            raise InputError(file, found="no regular file", accepted=accepted)
        tree = strict_json.loads(file.read_bytes())
    except OSError as error:
        raise InputError(file, found=reason(error), accepted=accepted) from None
    except ValueError as error:
        raise InputError(file, found=f"no JSON ({error})", accepted=accepted) from None
    try:
        return SceneDocument.model_validate(tree)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "the document"
        found = f"{error.error_count()} errors, the first at {place}: {first['msg']}"
        raise InputError(file, found=found, accepted=accepted) from None


def _read_object(folder: Path, record: ObjectRecord, size: tuple[int, int]) -> SceneObject:
    return SceneObject(
        id=record.id,
        label=record.label,
        mask_name=record.mask,
        mask=_read_image(folder, f"{MASKS}/{record.mask}", size, "L") > 127,
        mesh=_read_mesh(folder, record.mesh),
        T_world_object=np.array(record.T_world_object),
        parts=tuple(_read_part(folder, path) for path in record.collision),
        mobility=record.mobility,
        density=record.density,
        friction=record.friction,
        rolling_friction=record.rolling_friction,
        restitution=record.restitution,
        material=record.material,
        supports=tuple(Support(id=s.id, share=s.share) for s in record.supports),
        supported_by=record.supported_by,
        motion=tuple(Motion(**m.model_dump()) for m in record.motion),
    )


def _read_image(folder: Path, path: str, size: tuple[int, int], mode: str) -> NDArray[np.uint8]:
    """An image of the package, (height, width) or (height, width, 3), of the camera's size."""
    image = np.asarray(open_image(_inside(folder, path)).convert(mode))
    if image.shape[1::-1] != size:
        raise InputError(
            folder / path,
            found=f"{image.shape[1]}x{image.shape[0]} pixels",
            accepted=f"the camera's {size[0]}x{size[1]}",
        )
    return image


def _inside(folder: Path, path: str) -> Path:
    file = folder / path
    try:
        inside = file.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # NUL bytes, loops of links
        raise InputError(folder, found=f"the path {path!r} that leads nowhere", accepted="files inside it") from None
    if not inside:
        raise InputError(file, found="a path that leaves the package", accepted="files inside the package")
    return file


def _read_mesh(folder: Path, path: str) -> Mesh:
    return load_mesh(_inside(folder, path))


def _read_part(folder: Path, path: str) -> ConvexPart:
    mesh = _read_mesh(folder, path)
    try:
        return ConvexPart.hull_of(mesh.vertices)
    except ValueError as error:
        raise InputError(folder / path, found=str(error), accepted="a convex part with a volume") from None
