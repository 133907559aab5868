"""A package's folder: the names in it, how it is recognised, and which paths may be written."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

from f3sr.errors import InputError, OutputError, reason, require_path
from f3sr.files import limited_file
from f3sr.files.bounds import MAX_SCENE_BYTES
from f3sr.runtime import atomic_folder
from f3sr.runtime.unchanged_folder import contents_of
from f3sr.scene_package.scene_json import SCHEMA_FILE

SCENE = "scene.json"
PHOTO = "photo.png"
PAGE, REPORT = "report.html", "report.json"
BACKGROUND, SUPPORT, KEPT = "background.png", "support.png", "kept_depth.npz"
MASKS = "masks"
PACKAGE = "an f3sr package"
"""What is accepted where a package is asked for."""
EDITS, UNEDITED = "edits.json", "unedited"
"""What a user changed in a package, and the package before that."""
ROLLOUTS = "rollouts"
"""The one folder of a package that goals may write into."""
TOP_LEVEL = {
    *(SCENE, SCHEMA_FILE, "scene.glb", "scene.xml", REPORT, PAGE, PHOTO, BACKGROUND, SUPPORT, KEPT),
    *(MASKS, "meshes", "collision", "visual", "pictures", ROLLOUTS, EDITS, UNEDITED),
}
"""Everything that a package holds."""


def require_package(folder: Path, *, accepted: str = PACKAGE) -> None:
    """Raises InputError naming the folder unless it holds a scene.json, of whatever content."""
    try:
        if not folder.is_dir():
            raise InputError(folder, found="a file" if folder.exists() else "nothing there", accepted=accepted)
        names = {p.name for p in folder.iterdir()}
    except (OSError, ValueError) as error:
        raise InputError(folder, found=reason(error), accepted=accepted) from error
    if SCENE in names:
        return
    if MASKS in names and PHOTO not in names and accepted == PACKAGE:
        made = f"{PACKAGE}, which `f3sr reconstruct FOLDER -o OUT` makes"
        raise InputError(folder, found="an input folder", accepted=made)
    raise InputError(folder, found=f"a folder without {SCENE}", accepted=accepted)


def is_package(folder: Path) -> bool:
    """True when the folder has a scene.json that looks like ours, of any version."""
    try:
        if not stat.S_ISREG((folder / SCENE).lstat().st_mode):  # a link may lead anywhere
            return False
        tree = json.loads(limited_file.read(folder / SCENE, most=MAX_SCENE_BYTES))
    except (OSError, InputError, ValueError, RecursionError):
        return False
    if not isinstance(tree, dict) or tree.get("$schema") != SCHEMA_FILE:
        return False
    provenance = tree.get("provenance")
    return isinstance(provenance, dict) and "f3sr" in provenance


def prepare_output(out: Path, *, inputs: Path | None = None, overwrite: bool = False, edits: bool = False) -> Path:
    """Tidy up after an interrupted run, and refuse early a place that a package may not take.

    ``inputs`` is the folder a run reads: neither may lie inside the other. ``edits``: whether the new package has edits
    of its own. Returns the full path of ``out``.
    Raises OutputError; makes no folder that stays.
    """
    out = placed(out)
    if inputs is not None:
        source = Path(inputs).resolve()
        if hold_one_another(out, source):
            raise OutputError(f"{out}: the output and the input folder {source} may not hold one another")
    return atomic_folder.check(out, lambda out: require_replaceable(out, overwrite=overwrite, edits=edits))


def hold_one_another(a: Path, b: Path) -> bool:
    """Whether one of two full paths is the other, or lies in it."""
    return a.is_relative_to(b) or b.is_relative_to(a)


def _is_no_folder(path: Path) -> bool:
    """Whether something else is there: at one look, as other runs take empty parents away."""
    try:
        return not stat.S_ISDIR(path.stat().st_mode)
    except (FileNotFoundError, NotADirectoryError):
        return False


def placed(out: str | Path, *, rollout: bool = False) -> Path:
    """The full path of a folder to be written, once what killed runs left there is tidied up.

    Raises OutputError for a path that leads nowhere, through a link in a package, or into a package. Inside a package
    only a ``rollout`` may be written, below ``rollouts``.
    """
    path = require_path("out", out).absolute()
    with atomic_folder.told(path):
        atomic_folder.recover(path)
        try:
            full = path.resolve()
        except (ValueError, RuntimeError):  # NUL bytes; loops of links, on Pythons below 3.13
            raise OutputError(f"{path}: leads nowhere; give another folder") from None
        for link in (p for p in (path, *path.parents) if p.is_symlink()):
            if not link.exists():
                raise OutputError(f"{link}: is a link to nothing; give another folder")
            if package := _package_around(link.parent):
                raise OutputError(f"{link}: is a link in the package {package}; nothing is written through it")
        if blocked := next(filter(_is_no_folder, full.parents), None):
            raise OutputError(f"{full}: cannot be made, {blocked} is a file")
        if full.is_mount():  # the root too
            raise OutputError(f"{full}: is a mount point, which nothing can replace; give a folder in it")
        package = _package_around(full.parent)
        if package and not (rollout and package / ROLLOUTS in full.parents):
            allowed = f"there only rollouts below {package / ROLLOUTS}"
            raise OutputError(f"{full}: is inside the package {package}; {allowed}")
    return full


def require_replaceable(out: Path, *, overwrite: bool, edits: bool = False) -> None:
    """Raises OutputError unless a package may take the place ``out``; one without ``edits`` takes no edited one's."""
    if not os.path.lexists(out) or _is_empty(out):
        return
    if not is_package(out):
        raise OutputError(f"{out}: found {contents_of(out)}; accepted: a new or empty folder, or an f3sr package")
    if strangers := sorted(p.name for p in out.iterdir() if p.name not in TOP_LEVEL):
        raise OutputError(f"{out}: holds {strangers[0]}, which f3sr did not write; move it away first")
    rollouts = out / ROLLOUTS
    if rollouts.is_dir() and not _is_empty(rollouts) and not overwrite:
        raise OutputError(f"{out}: holds rollouts; a package with rollouts is replaced only with --overwrite")
    if (out / EDITS).exists() and not overwrite and not edits:
        kept = f"--edits {out / EDITS} applies them again, --overwrite drops them"
        raise OutputError(f"{out}: holds edits; {kept}")


def _package_around(folder: Path) -> Path | None:
    """The package that a folder is, or lies in."""
    full = folder.resolve()
    return next((p for p in (full, *full.parents) if is_package(p)), None)


def _is_empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())
