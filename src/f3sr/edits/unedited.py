"""The package before all edits: read from its own folder, or from where an edited package keeps it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from f3sr.edits.edit_list import Edit, read_edits
from f3sr.errors import InputError
from f3sr.files import limited_file, strict_json
from f3sr.scene_package.package import Package, inside, read_package
from f3sr.scene_package.package_folder import (
    BACKGROUND,
    EDITS,
    KEPT,
    MASKS,
    PAGE,
    PHOTO,
    REPORT,
    SCENE,
    SUPPORT,
)
from f3sr.scene_package.scene_json import dump_json

BEHIND = (BACKGROUND, SUPPORT, KEPT)
"""The photo completed behind the objects: no edit changes it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Unedited:
    """A package in memory with the bytes that it is read from: its folder may be written over while it is edited."""

    package: Package
    files: Mapping[str, bytes]
    """By relative path: without what derives from them, as scene.glb, and without rollouts."""
    report: Mapping[str, Any]
    """report.json; empty where it is none."""

    @classmethod
    def of(cls, package: Package) -> Self:
        """Raises InputError for a package whose files are gone or too large."""
        folder, document = package.folder, package.document
        names = [SCENE, PHOTO, *(f"{MASKS}/{o.mask}" for o in document.objects)]
        names += [path for o in document.objects for path in (o.mesh, *o.collision)]
        names += [name for name in (*BEHIND, REPORT, PAGE) if (folder / name).is_file()]
        files = {name: limited_file.read(inside(folder, name)) for name in dict.fromkeys(names)}
        return cls(package=package, files=files, report=_report(folder / REPORT, files.get(REPORT)))

    @property
    def digest(self) -> str:
        """Of scene.json."""
        return hashlib.sha256(self.files[SCENE]).hexdigest()


def read_edited(folder: Path) -> tuple[Package, tuple[Edit, ...]]:
    """The package of a folder before all edits, and its edits. Raises InputError."""
    return read_package(folder).unedited(), kept_edits(folder)


def kept_edits(folder: Path) -> tuple[Edit, ...]:
    """The edits of a package's folder, as far as it has any. Raises InputError."""
    return read_edits(inside(folder, EDITS)) if (folder / EDITS).exists() else ()


def _report(file: Path, data: bytes | None) -> Mapping[str, Any]:
    if data is None:
        return {}
    accepted = "the report.json of an f3sr package"
    try:
        tree = strict_json.loads(data)
        dump_json(tree)  # 1e999 is a number that cannot be written again
    except ValueError as error:
        raise InputError(file, found=f"no valid JSON ({error})", accepted=accepted) from error
    fits = isinstance(tree, dict) and isinstance(tree.get("stages", []), list)
    if not fits or not isinstance(tree.get("measures", {}), dict):
        raise InputError(file, found="other fields", accepted=accepted)
    return tree
