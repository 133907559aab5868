"""A worker from outside: jobs are sent to it one after another, and ended where they exceed time or memory."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any, cast

from f3sr.batch.job import Job
from f3sr.batch.job_process import JobRequest
from f3sr.dataset.record import Failure
from f3sr.errors import F3srError, one_line
from f3sr.runtime.process_end import how_it_ended
from f3sr.runtime.subprocesses import started

POLL_S = 0.1
"""How often memory and time of a job are looked at [s]: a job touches at most half a gigabyte in between."""
SPARE_BYTES = 1_000_000_000
"""Private memory beyond the limit that a process may ask for, as not all of it is touched."""
START_S = 600.0
"""Longest start of a worker [s]: kernels are compiled where there are none."""
Tell = Callable[[dict[str, Any]], None]


@dataclass(frozen=True, kw_only=True)
class JobLimits:
    """What one job may use."""

    wall_s: float
    """Wall time [s], without waits for a full disk."""
    memory_mb: float
    """Resident memory [MB] of its process and all that it started, together."""
    storage_wait_s: float = 3600.0
    """How long a job waits for room on a full disk [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Answer:
    """How an attempt ended."""

    failure: Failure
    """Empty where it succeeded."""
    reason: str = ""
    result: dict[str, Any] = field(default_factory=dict[str, Any])
    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0


class Worker:
    """A worker process for one thread: Linux ends it together with the thread that started it."""

    def __init__(self, module: str) -> None:
        self.module = module
        self.process: subprocess.Popen[bytes] | None = None
        self.errors: IO[bytes] | None = None
        self.lines = _Lines(-1)

    def start(self) -> None:
        """Have a worker that is ready. Raises F3srError with its last words if it cannot start."""
        if self.process is not None and self.process.poll() is None:
            return
        self.close()
        self.errors = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        pipe = subprocess.PIPE
        self.process = started(
            "f3sr.batch.job_process",
            self.module,
            stdin=pipe,
            stdout=pipe,
            stderr=self.errors,
        )
        self.lines = _Lines(cast(IO[bytes], self.process.stdout).fileno())
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline:
            for reply in self.lines.read(POLL_S):
                if reply["event"] == "ready":
                    return
            if self.lines.ended:
                break
        words = self.words()
        self.close()
        raise F3srError(f"a worker could not start: {words}")

    def run(self, job: Job, source: Path, folder: Path, stages: Path, limits: JobLimits, tell: Tell) -> Answer:
        """One attempt at a job whose input files are in ``source``. Every end of it is an answer."""
        request = JobRequest(
            job=asdict(job),
            source=str(source),
            folder=str(folder),
            stages=str(stages),
            data_bytes=round(2e6 * limits.memory_mb) + SPARE_BYTES,
            storage_wait_s=limits.storage_wait_s,
        )
        for _ in range(2):  # a worker that died before the job was sent is no fault of the job
            self.start()
            process = cast("subprocess.Popen[bytes]", self.process)
            cast(IO[bytes], self.errors).truncate(0)
            with contextlib.suppress(OSError):
                stdin = cast(IO[bytes], process.stdin)
                stdin.write((json.dumps(asdict(request)) + "\n").encode())
                stdin.flush()
                return _Attempt(self, limits, tell).answer()
        return Answer(failure="lost", reason="the worker ended before the job began")

    def warm(self) -> None:
        """Start and end once, so that compiled kernels are kept for all workers."""
        self.start()
        self.close()

    def died(self) -> str:
        """How the worker ended, in words."""
        process = cast("subprocess.Popen[bytes]", self.process)
        code = process.wait()
        words = self.words()
        self.close()
        return f"the worker {how_it_ended(code)}" + (f": {words}" if words else "")

    def words(self) -> str:
        """The last line that the worker or a job wrote to stderr."""
        if self.errors is None:
            return ""
        self.errors.seek(0)
        lines = self.errors.read().decode(errors="replace").strip().splitlines()
        return one_line(lines[-1])[:300] if lines else ""

    def close(self) -> None:
        """End the worker and what it does."""
        if self.process is not None:
            with contextlib.suppress(OSError):
                self.process.kill()
            self.process.wait()
            for stream in (self.process.stdin, self.process.stdout):
                with contextlib.suppress(OSError):
                    cast(IO[bytes], stream).close()
            self.process = None
        if self.errors is not None:
            self.errors.close()
            self.errors = None


class _Attempt:
    """One job in a worker, followed to its end."""

    def __init__(self, worker: Worker, limits: JobLimits, tell: Tell) -> None:
        self.worker, self.limits, self.tell = worker, limits, tell
        self.pid = 0
        self.peak = 0.0
        self.failure: Failure = ""
        self.reason = ""
        self.result: dict[str, Any] | None = None
        self.start, self.waited = time.monotonic(), 0.0

    def answer(self) -> Answer:
        while True:
            for reply in self.worker.lines.read(POLL_S):
                if (ended := self._heard(reply)) is not None:
                    return ended
            if self.worker.lines.ended:
                # The worker itself only waits: who ended it meant no job.
                return Answer(failure="lost", reason=self.worker.died(), wall_s=self._wall())
            self._look()

    def _wall(self) -> float:
        return time.monotonic() - self.start - self.waited

    def _heard(self, reply: dict[str, Any]) -> Answer | None:
        match reply["event"]:
            case "started":
                self.pid = reply["pid"]
            case "result":
                self.result = reply
            case "failed":
                self.failure, self.reason = self.failure or reply["failure"], self.reason or reply["reason"]
            case "full":
                self.waited += reply["seconds"]
                self.tell(reply)
            case "step":
                self.tell(reply)
            case "ended":
                return self._ended(reply)
            case _:
                pass
        return None

    def _ended(self, reply: dict[str, Any]) -> Answer:
        self.pid = 0
        if self.result is None and not self.failure:
            words = self.worker.words()
            self.failure, self.reason = "crash", how_it_ended(reply["code"]) + (f": {words}" if words else "")
        return Answer(
            failure=self.failure,
            reason=self.reason,
            result=self.result or {},
            wall_s=self._wall(),
            cpu_s=reply["cpu_s"],
            peak_mb=max(self.peak, reply["peak_mb"]),
        )

    def _look(self) -> None:
        """End the job where it exceeds a limit; its answer then comes as of any other end."""
        if not self.pid or self.failure:
            return
        tree = list(_tree(self.pid))
        now = sum(map(_resident_mb, tree))
        self.peak = max(self.peak, now)
        if now > self.limits.memory_mb:
            self._end("memory", f"{now:.0f} MB of memory; the limit is {self.limits.memory_mb:.0f} MB", tree)
        elif (wall := self._wall()) > self.limits.wall_s:
            self._end("time", f"{wall:.0f} s; the limit is {self.limits.wall_s:g} s", tree)

    def _end(self, failure: Failure, reason: str, tree: list[int]) -> None:
        self.failure, self.reason = failure, reason
        for pid in tree:
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)


class _Lines:
    """JSON lines from a descriptor, as they come."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor, self.rest, self.ended = descriptor, b"", False

    def read(self, seconds: float) -> Iterator[dict[str, Any]]:
        """The lines that are there within so many seconds."""
        ready = select.poll()
        ready.register(self.descriptor, select.POLLIN | select.POLLHUP)
        if not ready.poll(1000 * seconds):
            return
        data = os.read(self.descriptor, 65536)
        self.ended = not data
        *lines, self.rest = (self.rest + data).split(b"\n")
        yield from map(json.loads, lines)


def _tree(pid: int) -> Iterator[int]:
    """A process and all that it started, parents first; where the system does not say, the process alone."""
    yield pid
    with contextlib.suppress(OSError):
        for file in Path(f"/proc/{pid}/task").glob("*/children"):
            for child in file.read_text().split():
                yield from _tree(int(child))


def _resident_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except (OSError, IndexError, ValueError):
        return 0.0
