"""Files of the cache: each appears whole or not at all, and is read only if it is ours and holds what was written."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import tempfile
from pathlib import Path

from f3sr.runtime import signals
from f3sr.runtime.cache_folder import PRIVATE, is_ours

PART = ".part"
"""Suffix of a file that is being written."""
DIGEST = hashlib.sha256().digest_size
"""Bytes of the seal at the end of a file."""


def write_sealed(file: Path, data: bytes, key: str) -> None:
    """Write a cache file that ``read_sealed`` gives back for the same key only."""
    write_whole(file, data + _seal(data, key))


def read_sealed(file: Path, key: str) -> bytes | None:
    """The bytes written under the key; None if absent, or possibly changed by the disk or another user."""
    try:
        with os.fdopen(os.open(file, os.O_RDONLY | os.O_NOFOLLOW), "rb") as stream:
            content = stream.read() if is_ours(stream.fileno()) else b""
    except OSError:
        return None
    data, seal = content[:-DIGEST], content[-DIGEST:]
    return data if seal == _seal(data, key) else None


def _seal(data: bytes, key: str) -> bytes:
    # The key's own digest has a fixed length, so that no part of the data can pass for a part of the key.
    return hashlib.sha256(hashlib.sha256(key.encode()).digest() + data).digest()


def write_whole(file: Path, data: bytes) -> None:
    """Write a cache file in one step; an unwritable folder or a full disk leaves it as it was."""
    part = None
    with signals.held():
        try:
            file.parent.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
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
