"""Processes of f3sr that work for another one and end with it."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import IO

from f3sr.runtime.machine import ONE_THREAD

PR_SET_PDEATHSIG = 1
"""From Linux' sys/prctl.h."""

Stream = IO[bytes] | int


def started(module: str, *arguments: str, stdin: Stream, stdout: Stream, stderr: Stream) -> subprocess.Popen[bytes]:
    """``python -m MODULE ARGUMENT ... PID`` with these streams; PID is this process, for ``die_with``.

    It has a process group of its own: f3sr, not the terminal, ends it on Ctrl-C. One thread each: processes are what
    runs in parallel, and sums keep their order."""
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-m", module, *arguments, str(os.getpid())]
    return subprocess.Popen(command, env=environment, process_group=0, stdin=stdin, stdout=stdout, stderr=stderr)


def die_with(parent: int) -> None:
    """Let the operating system kill this process when its parent is gone, be it by ``kill -9``: on Linux only."""
    import ctypes
    import signal

    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        raise SystemExit("the parent is gone")
