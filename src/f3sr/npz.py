"""Arrays as .npz files, and of .npz files that come from outside: regular files, no pickles, no header that claims more
than is there."""

from __future__ import annotations

import io
import math
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

LARGEST = 2_000_000_000
"""Bytes of one array: a rollout of a thousand objects for a hundred seconds has 400 MB."""


def dump(**arrays: NDArray[Any]) -> bytes:
    """Arrays as a zip of .npy files, the same bytes for the same values."""
    with io.BytesIO() as file:
        np.savez_compressed(file, **cast(Any, arrays))
        return file.getvalue()


def load(file: Path, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """The arrays of some names. ValueError says what is wrong with the file, OSError that it cannot be read."""
    if not stat.S_ISREG(file.stat().st_mode):  # reading a pipe would wait forever
        raise ValueError("no regular file")
    try:
        with zipfile.ZipFile(file) as archive:
            return {name: _array(archive, name) for name in names}
    except (EOFError, zipfile.BadZipFile, zlib.error, struct.error, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"damaged ({error})" if str(error) else "damaged") from error


def _array(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    try:
        entry = archive.getinfo(f"{name}.npy")
    except KeyError:
        raise ValueError(f"no {name}") from None
    with archive.open(entry) as stream:
        version = np.lib.format.read_magic(stream)
        header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = header(stream)
    claimed = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or claimed > min(entry.file_size, LARGEST):
        raise ValueError(f"{name} of {claimed:,} bytes in an entry of {entry.file_size:,}")
    with archive.open(entry) as stream:
        return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
