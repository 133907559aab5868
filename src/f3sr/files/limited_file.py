"""Files from outside: only regular ones, up to a size that the reader names."""

from __future__ import annotations

import stat
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from f3sr.errors import InputError, reason

MAX_FILE_BYTES = 2_000_000_000
"""Largest file read: points and normals of the largest photo in half precision fit."""
MAX_JSON_BYTES = 10_000_000
"""Largest JSON document: poses of a thousand objects take 400 kB."""
READABLE = "a readable file"


@contextmanager
def opened(path: Path, *, most: int = MAX_FILE_BYTES, accepted: str = READABLE) -> Generator[BinaryIO]:
    """The open file, of at most so many bytes.

    Raises InputError, also for an OSError of what is done with the file while it is open.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would wait forever, a device never end
            raise InputError(path, found=_kind(status.st_mode), accepted=accepted)
        if status.st_size > most:
            raise _too_large(path, status.st_size, most)
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise InputError(path, found=reason(error), accepted=accepted) from error
    except ValueError as error:  # a NUL byte in the path
        if "null byte" not in str(error):
            raise
        raise InputError(path, found="a name with a NUL byte", accepted=accepted) from error


def read(path: Path, *, most: int = MAX_FILE_BYTES, accepted: str = READABLE) -> bytes:
    """All of a file of at most so many bytes. Raises InputError."""
    with opened(path, most=most, accepted=accepted) as file:
        data = file.read(most + 1)
    if len(data) > most:  # some files of the system tell no size
        raise _too_large(path, len(data), most)
    return data


def _too_large(path: Path, size: int, most: int) -> InputError:
    return InputError(path, found=f"{size:,} bytes", accepted=f"at most {most:,} bytes")


def _kind(mode: int) -> str:
    """What is there instead of a regular file."""
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    return kinds.get(stat.S_IFMT(mode), "a device")
