"""What the tests of workers share: the command of a scripted one, and its limits."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from f3sr.workers.worker_process import WorkerLimits

LIMITS = WorkerLimits(wall_s=60, silence_s=30, folder_bytes=3_000_000_000)


def command_of(script: Path, source: Path, **options: object) -> str:
    """A scripted worker that answers with what the input folder ``source`` has."""
    words = [sys.executable, str(script), "--source", str(source)]
    for name, value in options.items():
        words += [f"--{name}", str(value)]
    return shlex.join(words)
