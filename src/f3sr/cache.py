"""Results on disk by content: a key names everything a result depends on, a value is JSON and arrays in one npz."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import io
import json
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from f3sr import interrupts, npz
from f3sr.errors import InputError
from f3sr.kernels import cache_root
from f3sr.limited_file import opened

Arrays = dict[str, NDArray[Any]]
DOCUMENT = "document.json"
DEFAULT_LIMIT_GB = 5.0
PART = ".part"
"""Suffix of a file that is being written."""


def digest(*values: Any) -> str:
    """sha256 of plain values and dataclasses turned into dicts, in order."""
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def code_version() -> str:
    """Hash of this package's sources: a result never outlives the code that made it."""
    here = Path(__file__).parent
    hashed = hashlib.sha256()
    for path in sorted(here.rglob("*.py")):
        hashed.update(path.relative_to(here).as_posix().encode() + path.read_bytes())
    return hashed.hexdigest()


def limit_bytes() -> int:
    """The most that stored results may take: ``$F3SR_CACHE_LIMIT_GB``, 5 where that is no number."""
    try:
        return max(0, int(float(os.environ["F3SR_CACHE_LIMIT_GB"]) * 1e9))
    except (KeyError, ValueError, OverflowError):
        return int(DEFAULT_LIMIT_GB * 1e9)


class Store:
    """A folder of results, each in a file of its own that appears whole or not at all.

    It takes at most ``share`` of the limit for stored results; what was used longest ago goes first.
    """

    def __init__(self, folder: Path, *, share: float = 0.9) -> None:
        self.folder, self.share = folder, share

    @classmethod
    def default(cls) -> Self:
        """Where the command line keeps its results: ``stages`` in f3sr's cache."""
        return cls(cache_root() / "stages")

    def load(self, key: str) -> tuple[Any, Arrays] | None:
        """The document and arrays stored under ``key``; None when there are none, or only damaged ones."""
        path = self._path(key)
        try:
            with opened(path) as file:
                arrays = npz.read_all(file, str(path))
            document = json.loads(arrays.pop(DOCUMENT).tobytes())
        except (InputError, KeyError, ValueError, RecursionError):  # damaged: it is made anew
            return None
        with contextlib.suppress(OSError):  # a cache that others own can be read all the same
            os.utime(path)
        return document, arrays

    def save(self, key: str, document: Any, arrays: Arrays) -> None:
        """Store a result; a folder that cannot be written to keeps nothing, and that is all."""
        text = np.frombuffer(json.dumps(document, allow_nan=True).encode(), np.uint8)
        archive = io.BytesIO()
        np.savez(archive, allow_pickle=False, **cast(Any, {DOCUMENT: text, **arrays}))
        write_whole(self._path(key), archive.getvalue())
        self._tidy()

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"

    def _tidy(self) -> None:
        """Delete what killed runs left half written, and the results used longest ago until the rest fits.

        Other processes may do the same at the same time: a file that is gone is as good as deleted.
        """
        room = self.share * limit_bytes()
        for file, status in sorted(_files(self.folder), key=lambda pair: -pair[1].st_mtime_ns):
            room -= status.st_size
            if room < 0 or (file.suffix == PART and is_orphan(file)):
                with contextlib.suppress(OSError):
                    file.unlink()


def write_whole(file: Path, data: bytes) -> None:
    """Write a cache file in one step; an unwritable folder or a full disk leaves it as it was."""
    part = None
    with interrupts.held():
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            handle, part = tempfile.mkstemp(dir=file.parent, suffix=PART)
            with os.fdopen(handle, "wb") as stream:
                with contextlib.suppress(OSError):  # a file system without locks
                    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                stream.write(data)
                stream.flush()
                Path(part).replace(file)
        except OSError:
            if part:
                with contextlib.suppress(OSError):
                    Path(part).unlink()


def is_orphan(part: Path) -> bool:
    """Whether the process that was writing the file is gone, and its lock with it."""
    try:
        with part.open("rb") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
    except OSError:
        return False


def _files(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Results in the folder, finished or not."""
    found: list[tuple[Path, os.stat_result]] = []
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith((".npz", PART)):
                with contextlib.suppress(OSError):
                    found.append((Path(entry.path), entry.stat()))
    return found
