"""A process that does one job. It lives without the server, and adds events to the job's folder."""

from __future__ import annotations

import importlib
import os
import resource
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path

from f3sr.errors import F3srError, one_line, unforeseen
from f3sr.runtime import signals
from f3sr.runtime.atomic_folder import recover_all
from f3sr.studio.job_record import JobFolder
from f3sr.studio.workspace import read_project

PATIENCE_S = 10.0
"""Time [s] beyond its limit after which a process that could not tell of it is ended all the same."""

OOM_SCORE = "500"
"""As if the process had half of the machine's memory more than it has."""


def main(folder: Path, worker: str, wall_s: float, memory_bytes: int, lock: int) -> int:
    """Do the job of a folder within its limits; the exit code is 0 where it is done.

    ``worker`` is a module whose ``work`` does jobs. Whoever started the process gave it the locked descriptor
    ``lock``: the job lives as long as it is open."""
    os.set_inheritable(lock, False)
    os.pwrite(lock, str(os.getpid()).encode(), 0)
    job = JobFolder(folder)
    signals.watch()
    _limit(job, wall_s, memory_bytes)
    return _done(job, worker)


def _limit(job: JobFolder, wall_s: float, memory_bytes: int) -> None:
    """The process ends itself: whoever watched it may be gone."""

    def late() -> None:
        job.tell("ended", state="failed", problem=f"it took longer than {wall_s:g} s")
        os.kill(os.getpid(), signal.SIGTERM)

    timer = threading.Timer(wall_s, late)
    timer.daemon = True
    timer.start()
    signal.setitimer(signal.ITIMER_REAL, wall_s + PATIENCE_S)  # compiled code may let no other thread run
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with suppress(OSError):  # where memory ends, the system is to end this process and not the server
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    limit = memory_bytes if most == resource.RLIM_INFINITY else min(memory_bytes, most)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))


def _done(job: JobFolder, worker: str) -> int:
    try:
        if job.events():
            job.tell("again")
        recover_all(job.project)  # what a killed job left half way between two states
        work = importlib.import_module(worker).work
        job.tell("ended", state="done", result=work(job, job.options, read_project(job.project)))
        return 0
    except F3srError as error:
        problem = str(error)
    except MemoryError:
        problem = "it needs more memory than a job may have"
    except Exception as error:  # the page is told of it in one line
        problem = unforeseen(error, "what was there before is unchanged")
    print(one_line(problem), file=sys.stderr)  # on a full disk the event may be lost
    job.tell("ended", state="failed", problem=one_line(problem))
    return 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]), int(sys.argv[4]), int(sys.argv[5])))
