"""A worker: a program of the user's, in an environment of its own, that works on one job folder.

Its process group is ended at the deadline, when it says nothing for too long, when it writes too much, and with f3sr.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from f3sr.errors import F3srError, cut, printable
from f3sr.files import strict_json
from f3sr.runtime import signals
from f3sr.runtime.process_end import how_it_ended
from f3sr.workers import worker_launcher

POLL_S = 0.2
"""How often deadline and size of the job folder are looked at [s]."""
TAIL_BYTES = 20_000
"""How much of what a worker writes on stderr is kept, from its end."""
LINE_BYTES = 10_000
"""Longest line of progress."""
SHOWN = 200
"""Most characters of a line that a user is shown."""
LOG = "worker.log"
"""File of the job folder with the end of stderr."""


class WorkerError(F3srError):
    """A worker that did not end well. What it finished stays in its job folder, and the next run goes on there."""


@dataclass(frozen=True, kw_only=True)
class WorkerLimits:
    """What one run of a worker may take."""

    wall_s: float = 6 * 3600.0
    """Wall time of all objects together [s]: a hundred objects of three minutes each."""
    silence_s: float = 1800.0
    """Longest time without a line of progress [s]: loading weights takes minutes."""
    folder_bytes: int = 8_000_000_000
    """Most bytes in its job folder: twenty objects of the largest meshes."""


@dataclass(frozen=True, kw_only=True)
class Progressed:
    """A line of progress: ``{"id": 3, "state": "done"}``."""

    id: int | None
    state: str


def run_worker(
    command: Sequence[str],
    job: Path,
    limits: WorkerLimits,
    told: Callable[[Progressed], None],
    *,
    resumable: bool = True,
) -> None:
    """Run ``COMMAND... --job JOB`` to its end. Raises WorkerError where it fails, hangs or writes too much.

    ``resumable``: whether a next run goes on in the job folder, which the error then names."""
    launched = [sys.executable, "-I", worker_launcher.__file__, str(os.getpid()), *command, "--job", str(job)]
    with signals.undone(lambda: _started(launched, job), _ended) as process:
        try:
            problem = _watched(process, job, limits, told)
        finally:
            _ended(process)
    if problem or process.returncode:
        ended = problem or f"it {how_it_ended(process.returncode)}"
        words = [ended, *_last_words(job), *([f"the next run goes on in {job}"] if resumable else [])]
        raise WorkerError(f"worker {command[0]}: {'; '.join(words)}")


def _started(command: Sequence[str], job: Path) -> subprocess.Popen[bytes]:
    try:
        return subprocess.Popen(
            command, cwd=job, process_group=0,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
    except OSError as error:
        raise WorkerError(f"worker {command[0]}: {error.strerror}") from error


def _ended(process: subprocess.Popen[bytes]) -> None:
    """End the whole group, and read nothing more of it."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for stream in (process.stdout, process.stderr):
        if stream:
            stream.close()


def _watched(
    process: subprocess.Popen[bytes], job: Path, limits: WorkerLimits, told: Callable[[Progressed], None]
) -> str:
    """Why the worker had to be ended; empty where it ended itself."""
    assert process.stdout and process.stderr
    began = spoke = time.monotonic()
    lines, tail, open_streams = b"", b"", [process.stdout, process.stderr]
    while open_streams or not _ends(process):
        for stream in _ready(open_streams):
            data = os.read(stream.fileno(), 65536)
            if not data:
                open_streams.remove(stream)
            elif stream is process.stderr:
                tail = (tail + data)[-TAIL_BYTES:]
                _write_log(job, tail)
            else:
                spoke = time.monotonic()
                *whole, lines = (lines + data).split(b"\n")
                lines = lines[:LINE_BYTES]
                for line in whole:
                    if progressed := _progress(line[:LINE_BYTES]):
                        told(progressed)
        if process.poll() is not None and not _ready(open_streams, wait=0):
            break
        now = time.monotonic()
        if now - began > limits.wall_s:
            return f"not done after {limits.wall_s:.0f} s"
        if now - spoke > limits.silence_s:
            return f"no progress for {limits.silence_s:.0f} s"
        if (size := _size(job)) > limits.folder_bytes:
            return f"{size:,} bytes in its job folder, at most {limits.folder_bytes:,} are accepted"
    return ""


def _ends(process: subprocess.Popen[bytes]) -> bool:
    """Whether a process that says nothing any more ends by the next look."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(POLL_S)
    return process.returncode is not None


def _ready(streams: Sequence[IO[bytes]], *, wait: float = POLL_S) -> Sequence[IO[bytes]]:
    return select.select(streams, [], [], wait)[0] if streams else ()


def _progress(line: bytes) -> Progressed | None:
    """What a line says; None for one that is no progress."""
    try:
        value = strict_json.loads(line)
    except ValueError:
        return None
    if not isinstance(value, dict) or not isinstance(state := value.get("state"), str):
        return None
    id = value.get("id")
    return Progressed(id=id if type(id) is int else None, state=cut(printable(state), SHOWN))


def _size(job: Path) -> int:
    """Bytes of all files in a job folder; links are not followed."""
    total = 0
    for place, _, names in os.walk(job):
        for name in names:
            with contextlib.suppress(OSError):
                total += os.lstat(os.path.join(place, name)).st_size  # noqa: PTH118 - thousands of files
    return total


def _write_log(job: Path, tail: bytes) -> None:
    with contextlib.suppress(OSError):
        (job / LOG).write_bytes(tail)


def _last_words(job: Path) -> list[str]:
    """The last line that the worker wrote on stderr, where it wrote any."""
    try:
        lines = (job / LOG).read_text(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return [f"its last words: {cut(printable(lines[-1].strip()), SHOWN)}"] if lines else []
