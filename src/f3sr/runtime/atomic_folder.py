"""A folder that is written whole or not at all, even if the run is killed: packages, rollouts, films in a rollout.

``OUT`` is built in ``.OUT.building/new``. Then OUT is renamed to ``.OUT.building/previous`` and ``new`` to OUT. Files
for an existing folder are built there too. One rename to ``added`` commits them, then each file is moved into OUT. The
next command that reads or writes OUT reverts or finishes an interrupted run. ``.OUT.building`` always holds a marker
that its process locks. Without the marker it belongs to somebody else and is left alone (docs: durability).
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import stat
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from f3sr.errors import OutputError, reason
from f3sr.runtime import signals

MARKER, MARK = ".f3sr-building", b"f3sr: a folder being written, version 1\n"
BUILDING = ".building"
NEW, PREVIOUS, ADDED = "new", "previous", "added"
ATTEMPTS = 100
"""Times to make parents that another run, which made them and wrote nothing, takes away again."""


class BusyError(OutputError):
    """Another process is writing the folder."""


@dataclass(eq=False)
class Claim:
    """The right to write ``out``, which one process at a time has."""

    out: Path
    lock: int | None
    """Descriptor of the locked marker, until it is given back."""
    made: Sequence[Path]
    """Parents that were made for it, the deepest first."""

    def write(self, name: str, data: bytes) -> None:
        """Build one file, by its path relative to ``out``."""
        with signals.held():
            file = building_of(self.out) / NEW / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(data)

    def replace(self) -> None:
        """Put what was built in the place of ``out``."""
        building = building_of(self.out)
        with signals.held():
            if self.out.exists():
                self.out.rename(building / PREVIOUS)
            (building / NEW).rename(self.out)
            signals.wrote(self.out)

    def add(self) -> None:
        """Put the files that were built into ``out``, beside its others."""
        building = building_of(self.out)
        with signals.held():
            (building / NEW).rename(building / ADDED)
            _finish(self.out)
            signals.wrote(self.out)

    def release(self) -> None:
        """Leave nothing that is half done, and let others write. What cannot be deleted the next command deletes."""
        with signals.held(), contextlib.suppress(OSError, OutputError):
            lock, self.lock = self.lock, None
            if lock is not None:
                _end(self.out, lock)
                _remove(self.made)


@contextmanager
def claimed(out: Path, allowed: Callable[[Path], object]) -> Generator[Claim]:
    """The right to write ``out``, a full path, once what a killed run left of it is undone or finished.

    ``allowed`` looks at ``out`` and raises OutputError where it may not be written. Raises BusyError where another
    process has the right, OutputError where the file system refuses.
    """
    with told(out), signals.undone(lambda: _claim(out), Claim.release) as claim:
        try:
            allowed(out)
            yield claim
        finally:
            claim.release()


def check(out: Path, allowed: Callable[[Path], object]) -> Path:
    """The same without writing anything: ``out``, or the error that writing it would begin with."""
    with claimed(out, allowed):
        return out


@contextmanager
def told(out: Path) -> Generator[None]:
    """Errors of the file system as OutputError."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{out}: could not be written ({reason(error)})") from error


def recover(*places: Path) -> None:
    """Revert or finish what killed runs left at the paths and in their parent folders, as far as possible."""
    for place in places:
        out, *names = map(Path, place.absolute().parts)
        while names and os.path.exists(out):  # noqa: PTH110 - false, not an error, for impossible names
            out /= names.pop(0)
            with contextlib.suppress(OSError, ValueError, OutputError), signals.held():
                if os.path.lexists(building_of(out) / MARKER):
                    _end(out, _locked(out, surely=True))


def recover_all(folder: Path) -> None:
    """The same for everything in a folder."""
    recover(folder, *(folder / name for name in being_written(folder)))


def being_written(folder: Path) -> list[str]:
    """Names in a folder that a run is writing, or has been, or of which a stranger's folder says so."""
    return [p.name[1 : -len(BUILDING)] for p in folder.glob(f".*{BUILDING}")]


def building_of(out: Path) -> Path:
    return out.with_name(f".{out.name}{BUILDING}")


def _claim(out: Path) -> Claim:
    made = [p for p in out.parents if not p.exists()]
    try:
        _make(building_of(out))
        lock = _locked(out)
    except BaseException:
        _remove(made)
        raise
    claim = Claim(out, lock, made)
    try:
        _finish(out)
        os.pwrite(lock, MARK, 0)
    except BaseException:
        claim.release()
        raise
    return claim


def _make(building: Path) -> None:
    """Raises FileNotFoundError where the parents cannot be made, as in /proc."""
    for attempt in range(1, ATTEMPTS + 1):
        try:
            return building.mkdir(parents=True)
        except (FileNotFoundError, FileExistsError):  # the second also of a parent that was there and is gone
            if os.path.lexists(building):
                return None
            if attempt == ATTEMPTS:
                raise
    return None


def _locked(out: Path, *, surely: bool = False) -> int:
    """A descriptor of the marker that holds its lock. File systems without locks give one too, unless ``surely``."""
    building, busy = building_of(out), BusyError(f"{out}: another run is writing it right now")
    strange = OutputError(f"{building}: is in the way and not f3sr's; move it away first")
    try:
        if not _may_be_ours(building):
            raise strange
        lock = os.open(building / MARKER, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except FileNotFoundError:
        raise busy from None
    except OSError as error:
        raise strange if error.errno in (errno.ENOTDIR, errno.ELOOP, errno.EISDIR) else error from None
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, lock)
        if not (stat.S_ISREG(os.fstat(lock).st_mode) and MARK.startswith(os.pread(lock, len(MARK) + 1, 0))):
            raise strange
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if surely or error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise busy from None
        if not _is_open(building, lock):  # its owner finished in between
            raise busy
        stack.pop_all()
    return lock


def _may_be_ours(building: Path) -> bool:
    """Whether there is a marker, or nothing, as before the marker came."""
    if building.is_symlink() or os.path.lexists(building / MARKER):
        return not building.is_symlink()
    names = [p.name for p in building.iterdir()]
    return MARKER in names or not names


def _is_open(building: Path, lock: int) -> bool:
    """Whether the marker is still the locked one."""
    try:
        return os.path.samestat((building / MARKER).lstat(), os.fstat(lock))
    except OSError:
        return False


def _finish(out: Path) -> None:
    """Undo a replacement that stopped between its renames, finish an addition, and delete the rest but the marker."""
    building = building_of(out)
    new, previous, added = (building / name for name in (NEW, PREVIOUS, ADDED))
    # Between the two renames OUT is missing: the older state comes back, as the new one was never announced.
    if new.exists() and previous.exists():
        if os.path.lexists(out):
            raise OutputError(f"{out}: its older state is {previous}; move one of the two away")
        previous.rename(out)
    # The rename to ``added`` committed the files: moving them on can be repeated until all are there.
    if added.exists() and out.exists():
        for file in added.iterdir():
            file.replace(out / file.name)
    for path in building.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != MARKER:
            path.unlink()


def _end(out: Path, lock: int) -> None:
    """Finish, delete ``.OUT.building`` and give its lock back."""
    try:
        if _is_open(building_of(out), lock):
            _finish(out)
            (building_of(out) / MARKER).unlink(missing_ok=True)
            building_of(out).rmdir()
    finally:
        os.close(lock)


def _remove(made: Sequence[Path]) -> None:
    """Those that came about and are empty."""
    for folder in made:
        with contextlib.suppress(OSError):
            folder.rmdir()
