"""Where a dataset lies: a local folder, or any place that fsspec reaches. Files and folders appear whole or not at all.

A local folder appears by one rename. An object store has none, so a folder's record is uploaded last: a folder without
a record is nothing, and the next attempt writes over it.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol, TypeVar

from f3sr.errors import InputError, OutputError, reason
from f3sr.runtime import signals
from f3sr.runtime.extras import library

T = TypeVar("T")

RECORD = "record.json"
"""The file that makes a folder count."""
WORK = "work"
"""Folder of what is being made; a run empties it when it ends."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
"""What a full disk, or a used-up quota, answers."""


class Storage(Protocol):
    """Files of a dataset by their path relative to it, with forward slashes."""

    place: str

    def read(self, path: str) -> bytes | None:
        """The content; None if there is no such file."""
        ...

    def write(self, path: str, data: bytes) -> None:
        """Write one file, whole or not at all."""
        ...

    def put(self, path: str, file: Path) -> None:
        """Move a local file there, whole or not at all."""
        ...

    def remove(self, path: str) -> None:
        """Delete a file that may be absent."""
        ...

    def has(self, path: str) -> bool: ...

    def names(self, path: str = "") -> list[str]:
        """Names in a folder, sorted; none where there is no such folder."""
        ...

    def commit(self, folder: Path, path: str) -> None:
        """Put a local folder with a record there. A folder that is there with its record stays."""
        ...

    def discard(self, path: str) -> None:
        """Delete a folder with a record: it counts whole, or not at all."""
        ...

    def size(self, path: str) -> int:
        """Bytes of all files of a folder."""
        ...

    def local(self, path: str) -> contextlib.AbstractContextManager[Path]:
        """A folder as local files, for as long as the block lasts."""
        ...

    def claimed(self) -> contextlib.AbstractContextManager[None]:
        """The right to write, which one run at a time has; BusyError if another has it."""
        ...

    def scratch(self) -> Path:
        """A local folder for what is being made."""
        ...


def storage_of(place: str | Path) -> Storage:
    """The storage of a path, or of a URL such as ``s3://bucket/folder``."""
    return RemoteStorage(str(place)) if "://" in str(place) else LocalStorage(Path(place))


def is_full(error: BaseException | None) -> bool:
    """Whether an error, or what it came from, says that there is no room."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in NO_ROOM:
            return True
        error = error.__cause__
    return False


class LocalStorage:
    """A folder of this machine, or one that all machines mount."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self.place = str(self.folder)

    def read(self, path: str) -> bytes | None:
        try:
            return (self.folder / path).read_bytes()
        except FileNotFoundError:
            return None

    def write(self, path: str, data: bytes) -> None:
        with self._whole(path) as part:
            part.write_bytes(data)

    def put(self, path: str, file: Path) -> None:
        with self._whole(path) as part:
            shutil.move(file, part)

    @contextmanager
    def _whole(self, path: str) -> Generator[Path]:
        """A path to write to, which then takes the place of the file."""
        file = self.folder / path
        part = file.with_name(f".{file.name}.{uuid.uuid4().hex}.part")
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            yield part
            part.replace(file)
        except BaseException:
            with contextlib.suppress(OSError):
                part.unlink()
            raise

    def remove(self, path: str) -> None:
        (self.folder / path).unlink(missing_ok=True)

    def has(self, path: str) -> bool:
        return (self.folder / path).exists()

    def names(self, path: str = "") -> list[str]:
        try:
            return sorted(os.listdir(self.folder / path))  # noqa: PTH208 - names, without an object for each
        except (FileNotFoundError, NotADirectoryError):
            return []

    def commit(self, folder: Path, path: str) -> None:
        target = self.folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if folder.stat().st_dev != target.parent.stat().st_dev:
            with self._near(folder) as near:
                return self._renamed(near, target)
        return self._renamed(folder, target)

    @contextmanager
    def _near(self, folder: Path) -> Generator[Path]:
        """A copy on the dataset's own disk, from where it can be renamed."""
        near = self.folder / WORK / f"{folder.name}.{uuid.uuid4().hex}"
        try:
            shutil.copytree(folder, near)
            yield near
        finally:
            shutil.rmtree(near, ignore_errors=True)

    def _renamed(self, folder: Path, target: Path) -> None:
        with signals.held():
            try:
                folder.rename(target)
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST) or not (target / RECORD).exists():
                    raise

    def discard(self, path: str) -> None:
        away = self.scratch() / f"{Path(path).name}.{uuid.uuid4().hex}"
        away.parent.mkdir(exist_ok=True)
        (self.folder / path).rename(away)
        shutil.rmtree(away)

    def size(self, path: str) -> int:
        return sum((self.folder / path / name).stat().st_size for name in files_of(self.folder / path))

    @contextmanager
    def local(self, path: str) -> Generator[Path]:
        yield self.folder / path

    @contextmanager
    def claimed(self) -> Generator[None]:
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            lock = os.open(self.folder / ".lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise OutputError(f"{self.folder}: could not be written ({reason(error)})") from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                raise OutputError(f"{self.folder}: another run is writing it right now") from None
            yield  # a file system without locks
            return
        try:
            yield
        finally:
            os.close(lock)

    def scratch(self) -> Path:
        return self.folder / WORK


class RemoteStorage:
    """A place that fsspec reaches. Nothing locks it: two runs must not write one dataset."""

    def __init__(self, url: str) -> None:
        fsspec = library("fsspec", extra="ray", why=f"the place {url.partition('://')[0]}://")
        self.place = url
        try:
            self.files, self.root = fsspec.core.url_to_fs(url)
        except (ValueError, ImportError) as error:
            raise InputError(url, found=str(error), accepted="a path, or a URL that fsspec reaches") from error

    def read(self, path: str) -> bytes | None:
        try:
            return self.files.cat_file(self._of(path))
        except FileNotFoundError:
            return None

    def write(self, path: str, data: bytes) -> None:
        self._make_parent(path)
        self.files.pipe_file(self._of(path), data)

    def put(self, path: str, file: Path) -> None:
        self._make_parent(path)
        self.files.put_file(str(file), self._of(path))

    def remove(self, path: str) -> None:
        with contextlib.suppress(FileNotFoundError):
            self.files.rm_file(self._of(path))

    def has(self, path: str) -> bool:
        return self.files.exists(self._of(path))

    def names(self, path: str = "") -> list[str]:
        self.files.invalidate_cache()
        try:
            return sorted(str(entry).rstrip("/").rpartition("/")[2] for entry in self.files.ls(self._of(path), False))
        except (FileNotFoundError, NotADirectoryError):
            return []

    def commit(self, folder: Path, path: str) -> None:
        if self.has(f"{path}/{RECORD}"):
            return
        names = [name for name in files_of(folder) if name != RECORD]
        targets = [self._of(f"{path}/{name}") for name in names]
        for parent in sorted({target.rpartition("/")[0] for target in targets}):
            self.files.makedirs(parent, exist_ok=True)
        self.files.put([str(folder / name) for name in names], targets)  # object stores take them side by side
        self.put(f"{path}/{RECORD}", folder / RECORD)

    def discard(self, path: str) -> None:
        self.remove(f"{path}/{RECORD}")  # without it the rest is nothing
        with contextlib.suppress(FileNotFoundError):  # an object store has no folder without files
            self.files.rm(self._of(path), recursive=True)

    def size(self, path: str) -> int:
        return int(self.files.du(self._of(path)))

    @contextmanager
    def local(self, path: str) -> Generator[Path]:
        with tempfile.TemporaryDirectory(prefix="f3sr-") as made:
            folder = Path(made, "folder")
            self.files.get(self._of(path), str(folder), recursive=True)
            yield folder

    @contextmanager
    def claimed(self) -> Generator[None]:
        yield

    def scratch(self) -> Path:
        name = hashlib.sha256(self.place.encode()).hexdigest()[:16]
        return Path(tempfile.gettempdir(), f"f3sr-batch-{os.geteuid()}-{name}")

    def _of(self, path: str) -> str:
        return f"{self.root}/{path}" if path else self.root

    def _make_parent(self, path: str) -> None:
        self.files.makedirs(self._of(path).rpartition("/")[0], exist_ok=True)


def files_of(folder: Path) -> Iterator[str]:
    """Relative paths of all files below a folder, sorted within each; links are no files of it."""
    for path, folders, names in os.walk(folder):
        folders.sort()
        files = (Path(path, name) for name in sorted(names))
        yield from (file.relative_to(folder).as_posix() for file in files if not file.is_symlink())


def patiently(action: Callable[[], T], *, wait: Callable[[BaseException], bool]) -> T:
    """What an action gives. While there is no room, ``wait`` is called, and the action again until it says no."""
    while True:
        try:
            return action()
        except Exception as error:
            if not is_full(error) or not wait(error):
                raise
