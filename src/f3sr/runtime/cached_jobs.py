"""Folders of jobs in the cache: one process at a time works in each, and together they are bounded in size."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

from f3sr.runtime.cache_folder import PRIVATE
from f3sr.runtime.result_store import limit_bytes

LOCK = "lock"
"""File of a job's folder that the process which works there holds."""


@contextmanager
def locked(job: Path, waits: Callable[[], None] | None = None) -> Generator[None]:
    """One process at a time works in the folder, which is made where it is absent; others wait, after ``waits()``."""
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(_held(job, wait=False))
        except BlockingIOError:
            if waits:
                waits()
            stack.enter_context(_held(job, wait=True))
        yield


def tidy(jobs: Path, *, depth: int, share: float, may_go: Callable[[Path], bool]) -> None:
    """Delete the least recently used jobs until all of them take at most ``share`` of the cache's size limit.

    Jobs lie ``depth`` folders below ``jobs``. One that a process works in stays, and one that ``may_go`` refuses."""
    room = share * limit_bytes()
    found = sorted(((*_used(job), job) for job in _jobs(jobs, depth)), key=lambda row: -row[0])
    for _, size, job in found:
        room -= size
        if room >= 0 or not may_go(job):
            continue
        with contextlib.suppress(BlockingIOError), _held(job, wait=False):
            shutil.rmtree(job, ignore_errors=True)


@contextmanager
def _held(job: Path, *, wait: bool) -> Generator[None]:
    """The lock of a job. BlockingIOError where another has it and ``wait`` is false."""
    try:
        job.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
        lock = os.open(job / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError:  # a file system that takes no files: who writes there tells
        yield
        return
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.utime(lock)  # used now
        except BlockingIOError:
            raise
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(lock)


def _jobs(folder: Path, depth: int) -> Iterator[Path]:
    with contextlib.suppress(OSError):
        for place in folder.iterdir():
            if not place.is_symlink() and place.is_dir():
                yield from (_jobs(place, depth - 1) if depth > 1 else (place,))


def _used(job: Path) -> tuple[float, int]:
    """When a job was used last, by its newest file, and its size [bytes]; links are not followed."""
    newest, size = 0.0, 0
    for place, _, names in os.walk(job):
        for name in names:
            with contextlib.suppress(OSError):
                status = os.lstat(os.path.join(place, name))  # noqa: PTH118 - thousands of files
                newest, size = max(newest, status.st_mtime), size + status.st_size
    return newest, size
