"""export_package: a scene package in the formats of other programs, in a folder of its own."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import f3sr
from f3sr.backends.registry import Backend, BackendError
from f3sr.errors import F3srError, InputError, OutputError, require_kind, require_known, require_names
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.protocol import EXPORTERS, Exporter
from f3sr.files import limited_file
from f3sr.files.bounds import MAX_SCENE_BYTES
from f3sr.runtime.atomic_folder import check, claimed
from f3sr.runtime.file_date import date_of
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.scene_package.package import Package
from f3sr.scene_package.package_folder import SCENE, placed
from f3sr.scene_package.scene_json import dump_json

INDEX = "export.json"
"""What says which objects an export holds, under which names."""
MARK = "f3sr export"
LARGEST_INDEX = 16_000_000
"""Bytes of an index that is read."""


def export_package(
    package: Package,
    out: str | Path,
    formats: Sequence[str],
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Path:
    """Write a package in some formats, a folder in ``out`` each; returns the full path of ``out``.

    ``export.json`` beside them gives every object's id, label and name. An older export there is replaced only with
    ``overwrite``. Equal packages give equal bytes. Raises InputError for an unknown format and F3srError where a format
    needs what is not installed. Raises OutputError if ``out`` may not be written. Then nothing is written.
    """
    require_kind("package", package, Package, accepted="f3sr.read_package(...)")
    found = exporters_of(formats)
    scene_file = package.folder / SCENE
    exported = ExportedScene.of(
        package.scene,
        background=package.background(),
        mesh_files={o.id: o.mesh for o in package.document.objects},
        date=date_of(scene_file),
    )
    sha = hashlib.sha256(limited_file.read(scene_file, most=MAX_SCENE_BYTES)).hexdigest()
    place = placed(out)
    with claimed(place, lambda out: _require_replaceable(out, overwrite=overwrite)) as claim:
        for exporter in found:
            with timed(f"export {exporter.name}", progress):
                for path, data in _files(exporter, exported):
                    claim.write(f"{_folder(exporter)}/{path}", data)
        claim.write(INDEX, dump_json(_index(exported, found, sha)))
        claim.replace()
    return place


def _folder(exporter: Backend[Exporter]) -> str:
    """Where its files go: an exporter may have a ``folder`` that is not its name."""
    folder = getattr(exporter.made, "folder", exporter.name)
    if not isinstance(folder, str) or re.fullmatch(r"\w[\w.-]*", folder) is None:
        raise BackendError(f"{exporter}: has the folder {folder!r}; accepted: a plain name")
    return folder


def exporters_of(formats: Sequence[str], *, option: str = "formats") -> list[Backend[Exporter]]:
    """The exporters of some names, in alphabetical order. Raises InputError, which names the ``option``, or F3srError
    where one cannot be used."""
    require_names("formats", formats)
    if not formats:
        raise InputError(option, found="none", accepted=", ".join(EXPORTERS.names()))
    require_known(option, formats, EXPORTERS.names())
    found = [EXPORTERS.find(name) for name in sorted(set(formats))]
    for exporter in found:
        for need in exporter.needs():
            if not need.met:
                raise F3srError(f"the format {exporter.name} needs {need.what}, which is not installed: {need.remedy}")
    return found


def prepare_export(out: str | Path, *, overwrite: bool = False) -> Path:
    """The full path of ``out``, or the OutputError that exporting to it would begin with."""
    return check(placed(out), lambda out: _require_replaceable(out, overwrite=overwrite))


def beside(package: Path) -> Path:
    """Where a package is exported unless a user names a place: ``table_export`` beside ``table``."""
    whole = Path(package).absolute()
    return whole.with_name(f"{whole.name}_export")


def _files(exporter: Backend[Exporter], exported: ExportedScene) -> Iterator[tuple[str, bytes]]:
    """What an exporter yields, its paths checked: others' exporters may yield anything."""
    files = exporter.asked(lambda made: iter(made.files(exported)))
    seen = set[str]()
    while (file := exporter.asked(lambda _: next(files, None))) is not None:
        path, data = file
        pure = PurePosixPath(path)
        if pure.is_absolute() or {"..", "."} & set(path.split("/")) or not path or "\\" in path or "\0" in path:
            raise BackendError(f"{exporter}: yields the path {path!r}; accepted: one inside its folder")
        if path in seen:
            raise BackendError(f"{exporter}: yields the path {path!r} twice")
        seen.add(path)
        yield path, data


def _index(exported: ExportedScene, found: Sequence[Backend[Exporter]], sha: str) -> dict[str, Any]:
    return {
        "kind": MARK,
        "f3sr": f3sr.__version__,
        "scene_sha256": sha,
        "formats": [exporter.name for exporter in found],
        "folders": [_folder(exporter) for exporter in found],
        "objects": [
            {"id": o.id, "label": o.label, "name": o.name, "mass": o.body.mass, "fixed": o.body.fixed}
            for o in exported.objects
        ],
    }


def _require_replaceable(out: Path, *, overwrite: bool) -> None:
    """Raises OutputError unless an export may take the place ``out``."""
    if not os.path.lexists(out) or (out.is_dir() and not any(out.iterdir())):
        return
    folders = _folders_in(out)
    if folders is None:
        raise OutputError(f"{out}: is there already and no f3sr export; give a new or empty folder with -o")
    if strangers := sorted(p.name for p in out.iterdir() if p.name not in {INDEX, *folders}):
        raise OutputError(f"{out}: holds {strangers[0]}, which f3sr did not write; move it away first")
    if not overwrite:
        raise OutputError(f"{out}: holds an export; it is replaced only with --overwrite")


def _folders_in(out: Path) -> list[str] | None:
    """The folders that an export holds, None for anything else."""
    index = out / INDEX
    try:
        if index.is_symlink() or not index.is_file():
            return None
        tree = json.loads(limited_file.read(index, most=LARGEST_INDEX))
    except (OSError, InputError, ValueError, RecursionError):
        return None
    if not isinstance(tree, dict) or tree.get("kind") != MARK or not isinstance(tree.get("formats"), list):
        return None
    folders = tree.get("folders", tree["formats"])
    return [name for name in folders if isinstance(name, str)] if isinstance(folders, list) else None
