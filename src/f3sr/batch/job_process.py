"""Inside a worker: a process that has everything loaded, and forks one process a job.

A fork takes 15 ms where imports and kernels take 2 s. Each job still has a process of its own: it cannot leave memory
or state behind, a crash ends it alone, and the kernel counts its processor time.

Requests are JSON lines on stdin, replies JSON lines on stdout: ``ready``; of each job ``started``, ``step``, ``full``
while the disk is, ``result`` or ``failed``, and ``ended``.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import signal
import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from f3sr.batch.job import Job, inputs_digest
from f3sr.batch.patience import Patience
from f3sr.dataset.record import Failure
from f3sr.dataset.storage import is_full, patiently
from f3sr.errors import F3srError, InputError, one_line, unforeseen
from f3sr.runtime.progress import Step
from f3sr.runtime.subprocesses import die_with


@dataclass(frozen=True, kw_only=True)
class JobRequest:
    """One job for a worker."""

    job: dict[str, Any]
    source: str
    """The files of its input."""
    folder: str
    """Where the package is made."""
    stages: str
    """Where results of stages are kept until the job is done."""
    data_bytes: int
    """Most private memory that a process of the job may ask for; 0 for no limit."""
    storage_wait_s: float
    """How long a job waits for room on a full disk [s]."""


def serve(module: str, parent: int) -> None:
    """Do jobs until stdin ends; ``module`` has ``preload`` and ``work``."""
    die_with(parent)
    reply = _Reply(os.dup(1))
    os.dup2(2, 1)  # words of libraries
    made = importlib.import_module(module)
    made.preload()
    gc.collect()
    gc.freeze()  # a collection in a job would copy all pages that it shares with this process
    reply(event="ready")
    own = os.getpid()
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            _do(made, JobRequest(**json.loads(line)), reply, parent=own)
        reply(event="started", pid=pid)
        _, status, used = os.wait4(pid, 0)
        reply(
            event="ended",
            code=os.waitstatus_to_exitcode(status),
            cpu_s=used.ru_utime + used.ru_stime,
            peak_mb=used.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3),
        )


class _Reply:
    """Writes JSON lines to a descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor

    def __call__(self, **values: Any) -> None:
        data = (json.dumps(values) + "\n").encode()
        while data:
            data = data[os.write(self.descriptor, data) :]


def _do(module: Any, request: JobRequest, reply: _Reply, *, parent: int) -> NoReturn:
    """The life of a job's process."""
    try:
        die_with(parent)
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if request.data_bytes:
            resource.setrlimit(resource.RLIMIT_DATA, (request.data_bytes, request.data_bytes))
        reply(event="result", **_result(module, request, reply))
    except BaseException as error:  # whatever it is, the worker lives on and the reason is told
        failure, reason = explained(error)
        reply(event="failed", failure=failure, reason=reason)
    finally:
        os._exit(0)


def _result(module: Any, request: JobRequest, reply: _Reply) -> dict[str, Any]:
    job = Job.from_plain(request.job)

    def told(step: Step) -> None:
        if step.state != "skipped":
            reply(event="step", **asdict(step))

    waiting = Patience(request.storage_wait_s, lambda said: reply(**said))
    source = Path(request.source)
    result = module.work(
        job,
        source,
        Path(request.folder),
        Path(request.stages),
        progress=told,
        patiently=partial(patiently, wait=waiting),
    )
    if inputs_digest(source) != job.inputs:
        raise ChangedError(f"{job.source}: changed during the run; run again")
    return result


class ChangedError(F3srError):
    """The input is another one than that of the job's key."""


def explained(error: BaseException) -> tuple[Failure, str]:
    """The kind of a failure and its reason in one line."""
    if is_full(error):
        return "storage", one_line(str(error))
    if isinstance(error, InputError):
        return "bad input", str(error)
    if isinstance(error, F3srError):
        return "error", str(error)
    if isinstance(error, MemoryError):
        return "memory", "out of memory"
    if isinstance(error, Exception):
        return "crash", one_line(unforeseen(error, "the job ended"))
    return "crash", type(error).__name__


def main() -> None:
    """``python -m f3sr.batch.job_process MODULE PID``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    serve(sys.argv[1], int(sys.argv[2]))


if __name__ == "__main__":
    main()
