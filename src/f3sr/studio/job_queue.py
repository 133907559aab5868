"""Jobs of all projects, one after another: each in a process of its own that outlives the server.

What is asked is on disk before it is answered. A server that starts again goes on with jobs that run, begins those
whose process is gone once more, and then those that wait.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Annotated, Any

from annotated_types import Interval

from f3sr.errors import F3srError, InputError, OutputError, cut, one_line
from f3sr.runtime.atomic_folder import recover_all
from f3sr.runtime.machine import ONE_THREAD
from f3sr.runtime.process_end import how_it_ended
from f3sr.settings import settings
from f3sr.studio.job_options import options_of
from f3sr.studio.job_record import ENDS, ID, MAX_STARTS, JobFolder, JobStanding, State, ended, jobs_in
from f3sr.studio.workspace import Project, Workspace

POLL_S = 0.1
"""How often the queue looks at its jobs [s]."""
GRACE_S = 1.8
"""How long a cancelled job may tidy up [s]: signals.PATIENCE_S and a little, and all is over in two seconds."""
KEPT = 50
"""Jobs of a project that have ended and stay on disk: pages show the last few."""
WORKER = "f3sr.studio.job_work"
"""The module whose ``work`` does jobs."""


@settings
class QueueConfig:
    """What jobs may use."""

    parallel: Annotated[int, Interval(ge=1, le=16)] = 1
    """Jobs at a time. One uses two cores: a scene and its convex parts."""
    waiting: Annotated[int, Interval(ge=1, le=1000)] = 20
    """Most jobs that wait: more is a page that asks again and again."""
    wall_s: Annotated[float, Interval(ge=1, le=86_400)] = 3600.0
    """Longest job [s]. A scene of twenty objects takes two minutes, an engine that compiles ten."""
    memory_gb: Annotated[float, Interval(ge=1, le=1000)] = 12.0
    """Private memory of one process of a job [GB]: twenty objects of 200,000 triangles take four."""


@dataclass(eq=False)
class _Followed:
    """A job that is being done. ``process`` is None where an earlier server started it."""

    job: JobFolder
    process: subprocess.Popen[bytes] | None
    asked_to_end: float | None = field(default=None)
    """When it was cancelled [s of the monotonic clock]."""
    signalled: bool = False

    def signal(self, number: signal.Signals) -> None:
        """To the process and all that it started. One that an earlier server started may not have its number yet."""
        if pid := self.process.pid if self.process else self.job.pid:
            self.signalled = True
            with suppress(OSError):
                os.killpg(pid, number)


class JobQueue:
    """Starts jobs and follows them, in a thread of its own."""

    def __init__(self, workspace: Workspace, config: QueueConfig | None = None, *, worker: str = WORKER) -> None:
        """``worker`` is the module that does jobs, in their processes."""
        self.config, self.worker = config or QueueConfig(), worker
        self._lock, self._ended = threading.RLock(), threading.Event()
        self._waiting = list[JobFolder]()
        self._running = dict[str, _Followed]()
        self._unkept = dict[str, tuple[JobFolder, JobStanding]]()
        """How jobs ended, as long as a full disk keeps it from their records."""
        for project in workspace.listed():
            recover_all(project.folder)
            for job in jobs_in(project.jobs):
                self._taken_over(job)
        self._waiting.sort(key=lambda job: job.id)
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Follow no longer. Jobs that run go on."""
        self._ended.set()
        self._thread.join()

    def submit(self, project: Project, kind: str, options: dict[str, Any]) -> JobFolder:
        """Have a job done. Raises InputError for options that no page gives, F3srError where too many wait."""
        checked = options_of(kind, options)
        with self._lock:
            if len(self._waiting) >= self.config.waiting:
                raise F3srError(f"{len(self._waiting)} jobs wait already; try again when one is done")
            for old in [job for job in jobs_in(project.jobs) if job.record.state in ENDS][:-KEPT]:
                old.delete()
            job = JobFolder.new(project.jobs, checked)
            self._waiting.append(job)
            return job

    def jobs(self, project: Project) -> list[JobFolder]:
        """All jobs of a project, the oldest first."""
        return jobs_in(project.jobs)

    def going(self, project: Project) -> list[JobFolder]:
        """The jobs of a project that run or wait, those that run first."""
        with self._lock:
            jobs = [*(running.job for running in self._running.values()), *self._waiting]
        return [job for job in jobs if job.project == project.folder]

    def job(self, project: Project, id: str) -> JobFolder:
        """Raises InputError where the project has no such job."""
        job = JobFolder(project.jobs / id) if ID.fullmatch(id) else None
        if job is None or not job.folder.is_dir():
            raise InputError("the job", found=cut(repr(id[:60])), accepted="one of the project's")
        return job

    def cancel(self, job: JobFolder) -> None:
        """End a job that waits or runs; what was there before it stays. One that has ended is left as it is."""
        with self._lock:
            if any(one.id == job.id for one in self._waiting):
                self._waiting = [one for one in self._waiting if one.id != job.id]
                self._end(job, "cancelled")
            elif (running := self._running.get(job.id)) and running.asked_to_end is None:
                running.asked_to_end = time.monotonic()
                with suppress(OutputError, InputError):
                    job.keep(job.record.model_copy(update={"asked_to_end": True}))
                running.signal(signal.SIGTERM)

    def cancel_all(self, project: Project) -> None:
        """End all jobs of a project, and wait until no process of theirs is left."""
        jobs = self.jobs(project)
        for job in jobs:
            self.cancel(job)
        deadline = time.monotonic() + 2 * GRACE_S
        while time.monotonic() < deadline and any(job.id in self._running for job in jobs):
            time.sleep(POLL_S)

    # --- the thread --------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        while not self._ended.wait(POLL_S):
            with self._lock:
                for job, record in list(self._unkept.values()):
                    self._keep(job, record)
                for running in list(self._running.values()):
                    with suppress(OSError):  # too many open files, a server of files that is away: looked at again
                        self._look_at(running)
                while job := self._next():
                    self._waiting.remove(job)
                    self._start(job)

    def _next(self) -> JobFolder | None:
        """The first job that may begin. Of a project one runs at a time: they read and write the same files."""
        busy = {running.job.project for running in self._running.values()}
        if len(self._running) >= self.config.parallel:
            return None
        return next((job for job in self._waiting if job.project not in busy), None)

    def _taken_over(self, job: JobFolder) -> None:
        """A job as an earlier server left it."""
        record = job.record
        running = _Followed(job, None, time.monotonic() if record.asked_to_end else None)
        if record.state == "queued":
            self._waiting.append(job)
        elif record.state == "running" and job.pid is not None:
            self._running[job.id] = running
        elif record.state == "running":
            self._finish(running, None)

    def _start(self, job: JobFolder) -> None:
        try:
            record = job.record
            if record.starts >= MAX_STARTS:
                return self._end(job, "failed", f"its process ended {MAX_STARTS} times")
            job.keep(record.model_copy(update={"state": "running", "starts": record.starts + 1}))
            process = self._process(job)
        except (OSError, InputError, OutputError) as error:
            return self._end(job, "failed", f"it could not be started: {error}")
        self._running[job.id] = _Followed(job, process)

    def _process(self, job: JobFolder) -> subprocess.Popen[bytes]:
        """In a session of its own: neither the server's end nor Ctrl-C in its terminal reaches it."""
        limits = [str(self.config.wall_s), str(int(self.config.memory_gb * 1e9))]
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        with job.locked() as lock, job.words.open("wb") as words:
            return subprocess.Popen(
                [sys.executable, "-m", "f3sr.studio.job_run", str(job.folder), self.worker, *limits, str(lock)],
                env=environment,
                pass_fds=[lock],
                start_new_session=True,
                stdin=subprocess.DEVNULL,
                stdout=words,
                stderr=words,
            )

    def _look_at(self, running: _Followed) -> None:
        """Whether a job has ended, or must."""
        if running.process:
            flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
            was_waited_for = running.process.returncode is not None
            is_over = was_waited_for or os.waitid(os.P_PID, running.process.pid, flags) is not None
        else:
            is_over = running.job.pid is None
        if is_over:
            if running.process and running.process.returncode is None:
                running.signal(signal.SIGKILL)  # not waited for yet, so its number is its group's: what it started ends
            self._finish(running, running.process.wait() if running.process else None)
            del self._running[running.job.id]
        elif running.asked_to_end is not None:
            if time.monotonic() - running.asked_to_end > GRACE_S:
                running.signal(signal.SIGKILL)
            elif not running.signalled:
                running.signal(signal.SIGTERM)

    def _finish(self, running: _Followed, code: int | None) -> None:
        """The state of a job whose process is gone."""
        job = running.job
        recover_all(job.project)
        if (end := job.end) is not None:
            with suppress(InputError):
                self._keep(job, ended(job.record, end))
        elif running.asked_to_end is not None:
            self._end(job, "cancelled")
        elif code is None:  # nobody knows why: an earlier server's
            self._waiting.append(job)
        else:
            self._end(job, "failed", self._why(job, code))

    def _why(self, job: JobFolder, code: int) -> str:
        words = ""
        with suppress(OSError):
            lines = job.words.read_bytes()[-4000:].decode(errors="replace").strip().splitlines()
            words = f": {one_line(lines[-1])[:300]}" if lines else ""
        return f"its process {how_it_ended(code)}{words}"

    def _end(self, job: JobFolder, state: State, problem: str = "") -> None:
        with suppress(InputError):  # a damaged record keeps no state, and is not listed
            self._keep(job, job.record.model_copy(update={"state": state, "problem": one_line(problem)}))

    def _keep(self, job: JobFolder, record: JobStanding) -> None:
        """How a job ended. On a full disk it is tried again until there is room, or the job is gone."""
        self._unkept.pop(job.id, None)
        try:
            job.keep(record)
        except OutputError:
            if job.folder.is_dir():
                self._unkept[job.id] = job, record
