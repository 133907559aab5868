"""Results on disk by content: a key names everything a result depends on, a value is JSON and arrays in one npz."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from f3sr.kernels import cache_root

Arrays = dict[str, NDArray[Any]]
DOCUMENT = "document.json"


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


class Store:
    """A folder of results, each in a file of its own that appears whole or not at all."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def default(cls) -> Self:
        """Where the command line keeps its results: ``stages`` in f3sr's cache."""
        return cls(cache_root() / "stages")

    def load(self, key: str) -> tuple[Any, Arrays] | None:
        """The document and arrays stored under ``key``; None when there are none, or only damaged ones."""
        try:
            with np.load(self._path(key), allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
            return json.loads(arrays.pop(DOCUMENT).tobytes()), arrays
        except Exception:  # numpy and zipfile raise many kinds for a damaged archive; it is made anew
            return None

    def save(self, key: str, document: Any, arrays: Arrays) -> None:
        """Store a result; a folder that cannot be written to keeps nothing, and that is all."""
        text = np.frombuffer(json.dumps(document, allow_nan=True).encode(), np.uint8)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, name = tempfile.mkstemp(dir=self.folder, suffix=".part")
        except OSError:
            return
        try:
            with os.fdopen(handle, "wb") as file:
                np.savez(file, allow_pickle=False, **cast(Any, {DOCUMENT: text, **arrays}))
            Path(name).replace(self._path(key))
        except OSError:
            Path(name).unlink(missing_ok=True)

    def _path(self, key: str) -> Path:
        return self.folder / f"{key}.npz"
