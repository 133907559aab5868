"""A small file that is replaced whole or not at all, also where the process is killed or the disk is full."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

from f3sr.errors import OutputError, reason

PART = ".part"


def write_whole(file: Path, data: bytes, *, mode: int = 0o644) -> None:
    """Put ``data`` in the place of a file. Raises OutputError; the older file is then still there."""
    part = None
    try:
        handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.", suffix=PART)
        part = Path(name)
        with os.fdopen(handle, "wb") as opened:
            opened.write(data)
            opened.flush()
            os.fsync(opened.fileno())
        part.chmod(mode)
        part.replace(file)
    except OSError as error:
        raise OutputError(f"{file}: cannot be written ({reason(error)})") from error
    finally:
        if part is not None:
            with suppress(OSError):
                part.unlink()
