"""A process that does one job. It lives without the server, and adds events to the job's folder."""

from __future__ import annotations

import resource
import signal
import sys
from pathlib import Path

from f3sr.errors import F3srError, OutputError, one_line, unforeseen
from f3sr.runtime import signals
from f3sr.studio.job_record import JobFolder


def main(folder: Path, wall_s: float, memory_bytes: int) -> int:
    """Do the job of a folder within its limits; the exit code is 0 where it is done."""
    job = JobFolder(folder)
    signals.watch()
    signal.setitimer(signal.ITIMER_REAL, wall_s)  # whoever watched it may be gone: SIGALRM ends the process
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    try:
        with job.lived():
            return _done(job)
    except OutputError as error:
        print(error, file=sys.stderr)
        return 1


def _done(job: JobFolder) -> int:
    try:
        from f3sr.studio.job_work import work
        from f3sr.studio.workspace import read_project

        job.tell("ended", state="done", result=work(job, job.options, read_project(job.project)))
        return 0
    except F3srError as error:
        problem = str(error)
    except MemoryError:
        problem = "it needs more memory than a job may have"
    except Exception as error:  # the page is told of it in one line
        problem = unforeseen(error, "what was there before is unchanged")
    job.tell("ended", state="failed", problem=one_line(problem))
    return 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])))
