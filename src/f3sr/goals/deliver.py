"""A played goal on disk: plan.json, rollout.npz and verdict.json, all of them or none."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
import shutil
import tempfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from f3sr import interrupts, limited_file
from f3sr.errors import InputError, OutputError, reason
from f3sr.goals import checks, verify
from f3sr.goals import plan as plans
from f3sr.goals import rollout as rollouts
from f3sr.goals.files import FILMS, PLAN, ROLLOUT, VERDICT
from f3sr.goals.plan import Plan
from f3sr.goals.play import Played, scene_sha
from f3sr.goals.rollout import Rollout
from f3sr.limited_file import MAX_JSON_BYTES
from f3sr.package import Package, read_package
from f3sr.place import is_package

ROLLOUTS = "rollouts"
"""The one folder of a package that goals may write into."""
FILES = {PLAN, ROLLOUT, VERDICT, *FILMS}
BUILDING = ".building"
"""How the name of a folder that is being written ends, and"""
MARKER = ".f3sr-building"
"""what is in it."""


def next_folder(package: Path) -> Path:
    """The folder of the package's next rollout: one more than the highest number that is taken."""
    folder = package / ROLLOUTS
    taken = [int(p.name) for p in folder.iterdir() if p.name.isdecimal()] if folder.is_dir() else []
    return folder / str(max(taken, default=0) + 1)


def require_place(out: Path, package: Path, *, overwrite: bool = False) -> Path:
    """The full path of a folder that may be written. Raises OutputError where it is something else's."""
    try:
        out, package = out.resolve(), package.resolve()
    except RuntimeError:  # a loop of links, on Pythons below 3.13
        raise OutputError(f"{out}: is a loop of links; give another folder") from None
    if out.is_relative_to(package) and (package / ROLLOUTS) not in out.parents:
        raise OutputError(f"{out}: is inside the package; there only below {package / ROLLOUTS}")
    if package.is_relative_to(out):
        raise OutputError(f"{out}: holds the package itself; give another folder")
    _require_replaceable(out, overwrite)
    return out


def _require_replaceable(out: Path, overwrite: bool) -> None:
    for folder in out.parents:
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"{out}: cannot be made, {folder} is a file")
    if not out.exists():
        return
    if not out.is_dir():
        raise OutputError(f"{out}: is a file; give a folder")
    strangers = sorted(p.name for p in out.iterdir() if p.name not in FILES)
    if is_package(out) or strangers:
        raise OutputError(
            f"{out}: holds {strangers[0] if strangers else 'a package'}, which is no rollout's; nothing replaced"
        )
    if any(out.iterdir()) and not overwrite:
        raise OutputError(f"{out}: holds a rollout already; replaced only with --overwrite")


def write_played(played: Played, out: Path, *, overwrite: bool = False) -> Path:
    """Write plan.json, rollout.npz and verdict.json to ``out``, all or none; returns its full path.

    Raises OutputError where something else is there, or an older rollout and not ``overwrite``.
    """
    out = Path(out).resolve()
    _require_replaceable(out, overwrite)
    with _written(played, out.parent) as folder:
        _replace(folder, out)
        interrupts.wrote(out)
    return out


def write_next(played: Played, package: Path) -> Path:
    """The same as the package's next rollout: the first number that is free when all is written."""
    with _written(played, package.resolve() / ROLLOUTS) as folder:
        while True:
            out = next_folder(package.resolve())
            try:
                folder.rename(out)
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
                continue  # another process took that number
            interrupts.wrote(out)
            return out


@contextmanager
def _written(played: Played, parent: Path) -> Generator[Path]:
    """A folder in ``parent`` with all files, held for its renaming; gone afterwards unless that came about."""
    try:
        parent.mkdir(parents=True, exist_ok=True)
        with _building(parent) as folder:
            for name, data in (
                (PLAN, plans.to_json(played.plan)),
                (ROLLOUT, rollouts.to_npz(played.rollout)),
                (VERDICT, verify.to_json(played.verdict)),
            ):
                (folder / name).write_bytes(data)
            with interrupts.held():
                (folder / MARKER).unlink()
                yield folder
    except OSError as error:
        raise OutputError(f"{parent}: could not be written into ({reason(error)})") from error


def require_film_place(folder: Path) -> None:
    """Raises OutputError where no film could be written beside the rollout in a folder."""
    if taken := next((folder / name for name in FILMS if (folder / name).is_dir()), None):
        raise OutputError(f"{taken}: is a folder, where a film's file goes")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(f"{folder}: could not be written into ({reason(error)})") from error


def write_film(files: Mapping[str, bytes], folder: Path) -> None:
    """Put the files of a film beside the rollout they show, each whole or not at all; older ones are replaced."""
    require_film_place(folder)
    try:
        with _building(folder) as building:
            for name, data in files.items():
                (building / name).write_bytes(data)
            with interrupts.held():
                for name in files:
                    (building / name).replace(folder / name)
                interrupts.wrote(folder)
    except OSError as error:
        raise OutputError(f"{folder}: could not be written into ({reason(error)})") from error


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """A rollout's folder, and the package whose scene it plays."""

    plan: Plan
    rollout: Rollout
    package: Package


def read_played(folder: Path, package: Path | None = None) -> Found:
    """A rollout that was written, with its package: the one that it lies in unless one is given.

    Raises InputError where either is missing or damaged, or the rollout is of another scene.
    """
    plan = read_plan(folder / PLAN)
    rollout = rollouts.from_npz(folder / ROLLOUT)
    if package is None:
        package = folder.resolve().parent.parent
        if not is_package(package):
            accepted = "a rollout in its package's folder, or --package with the package"
            raise InputError(folder, found="no package around it", accepted=accepted)
    content = read_package(package)
    if plan.scene != scene_sha(content):
        raise InputError(folder, found=f"a rollout of another scene than {package}", accepted="one of this package")
    if fault := next(checks.faults_of(plan, content.scene), None):
        raise InputError(folder / PLAN, found=fault, accepted="a plan that this package can be played by")
    if rollout.ids.tolist() != [o.id for o in content.scene]:
        accepted = f"objects {[o.id for o in content.scene]}, as the scene has them"
        raise InputError(folder / ROLLOUT, found=f"objects {rollout.ids.tolist()[:20]}", accepted=accepted)
    if fault := next(checks.rollout_faults(rollout, plan), None):
        found, _, accepted = fault.partition("; accepted: ")
        raise InputError(folder / ROLLOUT, found=found, accepted=accepted)
    return Found(plan=plan, rollout=rollout, package=content)


def read_plan(file: Path) -> Plan:
    """A plan.json; InputError says what is wrong with it."""
    accepted = "a plan.json that f3sr wrote"
    data = limited_file.read(file, most=MAX_JSON_BYTES, accepted=accepted)
    try:
        return plans.from_json(data)
    except ValueError as error:
        raise InputError(file, found=_first_line(error), accepted=accepted) from None


def _first_line(error: ValueError) -> str:
    """What pydantic, or the JSON reader, says first."""
    details = getattr(error, "errors", None)
    if details is None:
        return str(error)
    first = details(include_url=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'the document'}: {first['msg']}"


@dataclass(frozen=True, eq=False)
class _Folder:
    """A new folder that its process holds by a lock, which the kernel ends with the process."""

    path: Path
    lock: int

    @classmethod
    def made(cls, parent: Path) -> _Folder:
        path = parent / f".{secrets.token_hex(6)}{BUILDING}"
        path.mkdir()
        lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
        with contextlib.suppress(OSError):  # file systems without locks
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        (path / MARKER).touch()
        return cls(path, lock)

    def leave(self) -> None:
        """Gone, unless it was renamed."""
        os.close(self.lock)
        shutil.rmtree(self.path, ignore_errors=True)


@contextmanager
def _building(parent: Path) -> Generator[Path]:
    """An empty folder that is gone afterwards unless it was renamed; what killed runs left is cleared away."""
    _sweep(parent)
    with interrupts.undone(lambda: _Folder.made(parent), _Folder.leave) as made:
        try:
            yield made.path
        finally:
            with interrupts.held():
                made.leave()


def _sweep(parent: Path) -> None:
    """Clear away what nobody holds any more."""
    for folder in parent.glob(f".*{BUILDING}"):
        if folder.is_symlink() or not (folder / MARKER).exists():
            continue
        with contextlib.suppress(OSError):
            lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)


def _replace(folder: Path, out: Path) -> None:
    """An old rollout steps aside first: there is always one of the two, and the old one comes back where that fails."""
    aside = out.with_name(f".{out.name}.previous")
    if out.exists():
        shutil.rmtree(aside, ignore_errors=True)
        out.rename(aside)
    try:
        folder.rename(out)
    except OSError:
        if aside.exists() and not out.exists():
            aside.rename(out)
        raise
    with contextlib.suppress(OSError):
        shutil.rmtree(aside, ignore_errors=True)
