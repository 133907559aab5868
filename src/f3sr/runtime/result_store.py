"""Results on disk by content: a key names everything that a result depends on, a value is a document and arrays."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
from functools import cache
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from f3sr.files import npz
from f3sr.runtime.cache_files import PART, is_orphan, read_sealed, write_sealed
from f3sr.runtime.cache_folder import within

Arrays = dict[str, NDArray[Any]]
DOCUMENT = "document.json"
DEFAULT_LIMIT_GB = 5.0


def digest(*values: Any) -> str:
    """sha256 of plain values and dataclasses turned into dicts, in order."""
    text = json.dumps(values, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def code_version() -> str:
    """Hash of this package's sources: a result never outlives the code that made it."""
    here = Path(__file__).parents[1]
    hashed = hashlib.sha256()
    for path in sorted(p for p in here.rglob("*") if p.suffix in (".py", ".toml")):
        hashed.update(path.relative_to(here).as_posix().encode() + path.read_bytes())
    return hashed.hexdigest()


def limit_bytes() -> int:
    """Size limit of stored results [bytes]: ``$F3SR_CACHE_LIMIT_GB``, 5 GB if that is not a number."""
    try:
        return max(0, int(float(os.environ["F3SR_CACHE_LIMIT_GB"]) * 1e9))
    except (KeyError, ValueError, OverflowError):
        return int(DEFAULT_LIMIT_GB * 1e9)


class Store:
    """A folder of stage results, so that a repeated or interrupted run continues (docs: durability).

    Each result is one file that appears whole or not at all. The folder takes at most ``share`` of the size limit; the
    least recently used result is deleted first. Several processes may share it. ``folder`` None stores nothing.
    """

    def __init__(self, folder: Path | None, *, share: float = 0.9) -> None:
        self.folder, self.share = folder, share

    @classmethod
    def default(cls) -> Self:
        """Where the command line keeps its results: ``stages`` in f3sr's cache."""
        return cls(within("stages"))

    def load(self, key: str) -> tuple[Any, Arrays] | None:
        """The document and arrays that ``save`` stored under the key; None if absent or damaged."""
        if self.folder is None or (data := read_sealed(_file(self.folder, key), key)) is None:
            return None
        arrays = npz.read_all(io.BytesIO(data), str(_file(self.folder, key)))
        with contextlib.suppress(OSError):  # another process may have deleted it
            os.utime(_file(self.folder, key))
        return json.loads(arrays.pop(DOCUMENT).tobytes()), arrays

    def save(self, key: str, document: Any, arrays: Arrays) -> None:
        """Store a JSON-like document and named arrays. A folder without write permission stores nothing, silently."""
        if self.folder is None:
            return
        text = np.frombuffer(json.dumps(document, allow_nan=True).encode(), np.uint8)
        archive = io.BytesIO()
        np.savez(archive, allow_pickle=False, **cast(Any, {DOCUMENT: text, **arrays}))
        write_sealed(_file(self.folder, key), archive.getvalue(), key)
        self._tidy(self.folder)

    def _tidy(self, folder: Path) -> None:
        """Delete half-written files of killed runs, and the least recently used results until the rest fits.

        Other processes may do the same at the same time: a missing file counts as deleted.
        """
        # Newest first: room is used up from the most recent use on, and what no longer fits is the oldest.
        room = self.share * limit_bytes()
        for file, status in sorted(_files(folder), key=lambda pair: -pair[1].st_mtime_ns):
            room -= status.st_size
            if room < 0 or (file.endswith(PART) and is_orphan(Path(file))):
                with contextlib.suppress(OSError):
                    Path(file).unlink()


def _file(folder: Path, key: str) -> Path:
    return folder / f"{key}.npz"


def _files(folder: Path) -> list[tuple[str, os.stat_result]]:
    """Paths of results in the folder, finished or not: texts, as every ``save`` looks at thousands of them."""
    found: list[tuple[str, os.stat_result]] = []
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith((".npz", PART)):
                with contextlib.suppress(OSError):
                    found.append((entry.path, entry.stat()))
    return found
