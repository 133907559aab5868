"""The folder of f3sr's cache: one that only this user can write to, because compiled kernels from it are run."""

from __future__ import annotations

import os
import stat
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

from f3sr.errors import F3srWarning

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
"""Mode bits that let another user write; an access list shows in the group's."""
PRIVATE = 0o700
"""Mode of every folder that is made for the cache."""
ROOT = 0


@cache
def cache_folder() -> Path | None:
    """``$F3SR_CACHE_DIR``, else f3sr's folder in the XDG cache, else this user's among the temporary files.

    A folder without write permission is skipped. So is one that another user could write to, with an F3srWarning.
    None if no folder remains: then nothing is kept."""
    for folder in _candidates():
        try:
            _make(folder)
            if danger := danger_of(folder):
                warnings.warn(f"{folder}: {danger}; this cache is not used", F3srWarning, stacklevel=2)
                continue
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return None


def within(name: str) -> Path | None:
    """A folder of the cache; None where there is no cache."""
    folder = cache_folder()
    return folder / name if folder else None


def danger_of(folder: Path) -> str | None:
    """Why another user could write to a folder, in words; None if only this user can. OSError if it is not there."""
    status, link = folder.stat(), folder.lstat()
    if not stat.S_ISDIR(status.st_mode):
        raise NotADirectoryError(folder)
    if link.st_uid not in (os.geteuid(), ROOT) or status.st_uid != os.geteuid():
        return "belongs to another user"
    if status.st_mode & OTHERS_WRITE:
        return f"other users may write to it (mode {stat.S_IMODE(status.st_mode):o}; chmod go-w mends that)"
    return None


def is_ours(descriptor: int) -> bool:
    """Whether an open file belongs to this user, and no other may write to it."""
    status = os.fstat(descriptor)
    return status.st_uid == os.geteuid() and not status.st_mode & OTHERS_WRITE


def _candidates() -> Iterator[Path]:
    with suppress(RuntimeError, OSError):  # neither HOME nor an entry for this user id; a working folder that is gone
        yield _wanted()
    with suppress(OSError):  # no folder for temporary files
        yield Path(tempfile.gettempdir()) / f"f3sr-{os.geteuid()}"


def _wanted() -> Path:
    if configured := os.environ.get("F3SR_CACHE_DIR"):
        return Path(configured).absolute()
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))  # which has no meaning unless it is absolute
    return base / "f3sr" if base.is_absolute() else Path.home().absolute() / ".cache" / "f3sr"


def _make(folder: Path) -> None:
    """Parents as the user's mask has it, the folder itself for this user alone."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        folder.mkdir(mode=PRIVATE)
