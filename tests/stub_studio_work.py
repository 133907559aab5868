"""Work of the studio's jobs for tests: a job's goal is a little script, one deed after another: "step 1; write it"."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

from f3sr.errors import F3srError
from f3sr.runtime.atomic_folder import claimed
from f3sr.studio.job_options import JobOptions, PlayOptions
from f3sr.studio.job_record import JobFolder
from f3sr.studio.workspace import Project

FILES = 5
"""Of a package that a stub writes."""


def work(job: JobFolder, options: JobOptions, project: Project) -> dict[str, Any]:
    """As ``f3sr.studio.job_work.work``."""
    assert isinstance(options, PlayOptions)
    for deed in options.goal.split(";"):
        name, *said = deed.split()
        DEEDS[name](job, project, *said)
    return {"by": os.getpid()}


def _step(job: JobFolder, project: Project, seconds: str) -> None:
    job.tell("step", name="step", state="started")
    time.sleep(float(seconds))


def _write(job: JobFolder, project: Project, words: str, pause: str = "0") -> None:
    """A package of equal files, written with pauses."""
    with claimed(project.package, lambda out: None) as claim:
        for k in range(FILES):
            claim.write(f"{k}.txt", words.encode())
            job.tell("wrote", number=k)
            time.sleep(float(pause))
        claim.replace()


def _full(job: JobFolder, project: Project) -> None:
    with claimed(project.package, lambda out: None) as claim:
        claim.write("0.txt", b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _child(job: JobFolder, project: Project) -> None:
    """A process of the job's that hears no SIGTERM."""
    code = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(flush=True); time.sleep(60)"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
    assert child.stdout
    child.stdout.readline()
    job.tell("child", pid=child.pid)


def _deaf(job: JobFolder, project: Project) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    job.tell("deaf")


def _fail(job: JobFolder, project: Project, *said: str) -> None:
    raise F3srError(" ".join(said))


def _memory(job: JobFolder, project: Project) -> None:
    bytearray(10**11)


def _crash(job: JobFolder, project: Project) -> None:
    print("the last words", file=sys.stderr, flush=True)
    os.kill(os.getpid(), signal.SIGSEGV)


def _wrong(job: JobFolder, project: Project) -> None:
    raise ZeroDivisionError("nobody\nforesaw this")


DEEDS: dict[str, Callable[..., None]] = {
    "step": _step,
    "write": _write,
    "full": _full,
    "child": _child,
    "deaf": _deaf,
    "fail": _fail,
    "memory": _memory,
    "crash": _crash,
    "wrong": _wrong,
}
