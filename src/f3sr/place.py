"""The place of a package on disk: who may write there, what may be replaced, and the step from old to new.

A package is built in ``.OUT.building`` beside its place, then OUT is renamed to ``.OUT.previous``, ``.OUT.building`` to
OUT, and the previous one deleted. At every moment one whole package, old or new, has one of these names, and the next
run brings it back to OUT. One process at a time: it holds a lock on the folder that it builds, which the kernel ends
with the process; the lock stays on the folder through its rename.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import shutil
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from f3sr import interrupts, limited_file
from f3sr.bounds import MAX_SCENE_BYTES
from f3sr.errors import InputError, OutputError
from f3sr.export.scene_json import SCHEMA_FILE

PHOTO = "photo.png"
PAGE = "report.html"
BACKGROUND, SUPPORT, KEPT = "background.png", "support.png", "kept_depth.npz"
MASKS = "masks"
MARKER = ".f3sr-building"
"""In a folder that is being built; without it a folder of that name is somebody else's."""
TOP_LEVEL = {
    *("scene.json", SCHEMA_FILE, "scene.glb", "scene.xml", "report.json", PAGE, PHOTO, BACKGROUND, SUPPORT, KEPT),
    *(MASKS, "meshes", "collision", "visual", "pictures", "rollouts"),
}
"""Everything that a package holds."""


@dataclass(eq=False)
class Claim:
    """The right to build a package; ``folder`` is where."""

    out: Path
    folder: Path
    locks: list[int] = field(default_factory=list[int])
    """Open folders: what is replaced, if there is something, and what is built."""

    def write(self, name: str, data: bytes) -> None:
        """One file of the package by its relative path."""
        with interrupts.held():
            file = self.folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)

    def commit(self) -> None:
        """Put the finished package in its place."""
        with interrupts.held():
            (self.folder / MARKER).unlink()
            _replace(self.folder, self.out)
            interrupts.wrote(self.out)
            with contextlib.suppress(OSError):  # the next run deletes it
                _discard(previous_of(self.out))

    def release(self) -> None:
        """Leave nothing that is half done, and let others write."""
        with interrupts.held():
            if self.locks and _is_open(self.folder, self.locks[-1]):  # otherwise it has been committed
                shutil.rmtree(self.folder, ignore_errors=True)
            self.unlock()

    def unlock(self) -> None:
        while self.locks:
            os.close(self.locks.pop())


def prepare_output(out: Path, *, inputs: Path | None = None, overwrite: bool = False) -> Path:
    """Tidy up after an interrupted run, and refuse early a place that a package may not take.

    ``inputs`` is the folder a run reads: neither may lie inside the other. Returns the full path of ``out``.
    Raises OutputError; makes no folder that stays.
    """
    out = Path(out).resolve()
    if inputs is not None:
        source = Path(inputs).resolve()
        if out.is_relative_to(source) or source.is_relative_to(out):
            raise OutputError(f"{out}: the output and the input folder {source} may not hold one another")
    if not out.name:
        raise OutputError(f"{out}: the root of the file system cannot be a package")
    with _told_as_output_error(out):
        if out.parent.exists():
            with claimed(out, overwrite=overwrite):
                pass
        else:
            _require_writable(next(p for p in out.parents if p.exists()), out)
    return out


@contextmanager
def claimed(out: Path, *, overwrite: bool) -> Generator[Claim]:
    """The right to replace ``out``, for one process at a time, after what a killed one left has been tidied up.

    Raises OutputError where another process has it, or what is there may not be replaced.
    """
    with _told_as_output_error(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        with interrupts.undone(lambda: _claim(out), Claim.release) as claim:
            try:
                with interrupts.held():
                    _recover(out)
                _require_replaceable(out, overwrite)
                yield claim
            finally:
                claim.release()


@contextmanager
def _told_as_output_error(out: Path) -> Generator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(f"{out}: could not be written ({error.strerror or error})") from error


def is_package(folder: Path) -> bool:
    """True when the folder has a scene.json that looks like ours, of whatever version."""
    try:
        tree = json.loads(limited_file.read(folder / "scene.json", most=MAX_SCENE_BYTES))
    except (InputError, ValueError, RecursionError):
        return False
    if not isinstance(tree, dict) or tree.get("$schema") != SCHEMA_FILE:
        return False
    provenance = tree.get("provenance")
    return isinstance(provenance, dict) and "f3sr" in provenance


def building_of(out: Path) -> Path:
    return out.with_name(f".{out.name}.building")


def previous_of(out: Path) -> Path:
    return out.with_name(f".{out.name}.previous")


# --- claiming -----------------------------------------------------------------------------------------------------


def _claim(out: Path) -> Claim:
    """An empty folder to build in, but for its marker, locked together with what it replaces."""
    claim, made = Claim(out, building_of(out)), False
    try:
        if out.is_dir():
            claim.locks.append(_locked(out, out))
        with contextlib.suppress(FileExistsError):
            claim.folder.mkdir()
            made = True
        claim.locks.append(_locked(claim.folder, out))
        _clear(claim.folder)
    except BaseException:
        if made:
            claim.release()
        claim.unlock()
        raise
    return claim


def _locked(folder: Path, out: Path) -> int:
    """A descriptor of the folder that holds its lock. File systems without locks give one all the same."""
    busy = OutputError(f"{out}: another run is writing it right now")
    if folder.is_symlink() or not folder.is_dir():
        raise OutputError(f"{folder}: is in the way and not f3sr's; move it away first")
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except FileNotFoundError:
        raise busy from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            os.close(descriptor)
            raise busy from None
    if not _is_open(folder, descriptor):  # its owner finished in between
        os.close(descriptor)
        raise busy
    return descriptor


def _is_open(folder: Path, descriptor: int) -> bool:
    """Whether the path still names the opened folder."""
    try:
        return os.path.samestat(folder.lstat(), os.fstat(descriptor))
    except OSError:
        return False


def _clear(building: Path) -> None:
    """Empty a folder that a killed run has left; one with other things in it is refused."""
    orphan = (building / MARKER).exists() or is_package(building)  # complete, but killed before its rename
    if not orphan and any(building.iterdir()):
        raise OutputError(f"{building}: is in the way and not f3sr's; move it away first")
    (building / MARKER).touch()  # first of all, so that a killed clearing can go on
    _delete(path for path in building.iterdir() if path.name != MARKER)


def _recover(out: Path) -> None:
    """After a crash: bring back the old package unless a new one is there."""
    previous = previous_of(out)
    if previous.exists() and not is_package(previous):
        raise OutputError(f"{previous}: is in the way and no f3sr package; move it away first")
    if previous.exists():
        if out.exists() and not _is_empty(out):
            _discard(previous)
        else:
            _move(previous, out)


def _require_replaceable(out: Path, overwrite: bool) -> None:
    if not out.exists() or _is_empty(out):
        return
    if not is_package(out):
        raise OutputError(f"{out}: is {_contents(out)}; only an f3sr package or an empty folder is replaced")
    if strangers := sorted(p.name for p in out.iterdir() if p.name not in TOP_LEVEL):
        raise OutputError(f"{out}: holds {strangers[0]}, which f3sr did not write; move it away first")
    rollouts = out / "rollouts"
    if rollouts.is_dir() and not _is_empty(rollouts) and not overwrite:
        raise OutputError(f"{out}: holds rollouts; a package with rollouts is replaced only with --overwrite")


def _require_writable(folder: Path, out: Path) -> None:
    if not folder.is_dir():
        raise OutputError(f"{out}: cannot be made, {folder} is a file")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{out}: cannot be made, {folder} is not writable")


# --- replacing ----------------------------------------------------------------------------------------------------


def _replace(building: Path, out: Path) -> None:
    previous = previous_of(out)
    if out.exists() and not _is_empty(out):
        _move(out, previous)
    try:
        _move(building, out)
    except BaseException:
        if previous.exists() and not out.exists():
            _move(previous, out)
        raise


def _discard(folder: Path) -> None:
    """Delete a package, what tells that it is one last, so that a killed deletion can go on."""
    _delete(path for path in folder.iterdir() if path.name != "scene.json")
    shutil.rmtree(folder, ignore_errors=True)


def _delete(paths: Iterable[Path]) -> None:
    for path in paths:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _move(source: Path, target: Path) -> None:
    """Rename a folder; an empty folder may be in the way."""
    if target.exists():
        target.rmdir()
    source.rename(target)


def _is_empty(folder: Path) -> bool:
    return folder.is_dir() and not any(folder.iterdir())


def _contents(place: Path) -> str:
    """What is there, in a few words."""
    if not place.is_dir():
        return "a file"
    names = sorted(p.name for p in place.iterdir())
    return f"a folder with {len(names)} other things ({', '.join(names[:3])}{', ...' if len(names) > 3 else ''})"
