"""Temporary files of tests lie in memory where there is room: tests that write folders take a seventh less time.

What passes leaves nothing there; of what fails everything stays until the next run. ``TMPDIR`` names another place.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

MEMORY = Path("/dev/shm")
"""Linux' file system in memory."""
ROOM = 8 << 30
"""Bytes that must be free: several times what all tests write."""
NAME = "f3sr-tests-"
"""Of the folder, before the id of the process."""


def enter() -> None:
    """Let this process and those that it starts have their temporary files in memory."""
    if "TMPDIR" in os.environ or not MEMORY.is_dir():
        return
    there = os.statvfs(MEMORY)
    if there.f_flag & os.ST_NOEXEC or there.f_bavail * there.f_frsize < ROOM:  # tests write programs and run them
        return
    for folder in MEMORY.glob(f"{NAME}*"):
        if not Path("/proc", folder.name.removeprefix(NAME)).exists():
            shutil.rmtree(folder, ignore_errors=True)
    folder = MEMORY / f"{NAME}{os.getpid()}"
    folder.mkdir(mode=0o700)
    os.environ["TMPDIR"] = str(folder)
    tempfile.tempdir = None  # found anew


def leave() -> None:
    """Delete what the process that entered has there."""
    folder = MEMORY / f"{NAME}{os.getpid()}"
    if os.environ.get("TMPDIR") == str(folder):
        shutil.rmtree(folder, ignore_errors=True)
