"""Attempts as tasks of a Ray cluster: a task gets a job of paths and digests, its package goes to the storage.

A task runs the same attempt as a thread of this machine: a worker that is kept for the tasks after it, one process a
job. Ray itself repeats nothing: the driver tells lost machines, which are tried elsewhere, from bad inputs.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from f3sr.batch.attempt import attempt
from f3sr.batch.executors import Ended
from f3sr.batch.job import Job
from f3sr.batch.ray_address import require_cluster
from f3sr.batch.supervisor import JobLimits, Worker
from f3sr.dataset.record import from_bytes, to_bytes
from f3sr.errors import F3srError, one_line
from f3sr.runtime.extras import library

EXTRA = "ray"
AHEAD = 2
"""Tasks a processor that are submitted: the next is there when one ends, and no queue grows."""
_workers: dict[str, Worker] = {}
"""Of a process of Ray: it does one task at a time."""


class RayTasks:
    """Tasks of a cluster, so many at a time."""

    def __init__(self, ray: Any, slots: int, place: str, limits: JobLimits, work: str, *, again: bool) -> None:
        self.ray, self.slots = ray, slots
        self.running: dict[Any, Job] = {}
        self.options = {"place": place, "limits": asdict(limits), "work": work, "again": again}
        # A job that fails is an answer, not an exception; what raises is a machine or process that is gone.
        self.task = ray.remote(num_cpus=1, max_retries=0)(remote_attempt)

    def submit(self, job: Job, number: int) -> None:
        self.running[self.task.remote(asdict(job), number, **self.options)] = job

    def ended(self, seconds: float) -> Generator[Ended]:
        ready, _ = self.ray.wait(list(self.running), num_returns=1, timeout=seconds)
        for reference in ready:
            job = self.running.pop(reference)
            try:
                data, known = self.ray.get(reference)
            except self.ray.exceptions.RayTaskError as error:
                raise F3srError(f"a task of Ray failed: {one_line(str(error.cause))}") from error
            except self.ray.exceptions.RayError as error:
                yield Ended(job=job, record=None, reason=_told(error))
            else:
                yield Ended(job=job, record=from_bytes(data, job.name), known=known)


@contextmanager
def ray_tasks(
    address: str, slots: int, place: str, limits: JobLimits, work: str, *, again: bool
) -> Generator[RayTasks]:
    """Tasks of the cluster at an address (``auto``: the one of this machine), until the block ends.

    Meanwhile ``sys.stdout`` is stderr: Ray prints there that nodes are gone, which must not mix with events.
    ``slots`` 0 stands for two tasks a processor. Raises F3srError where there is no cluster.
    """
    ray = library("ray", extra=EXTRA, why="--ray")
    with contextlib.redirect_stdout(sys.stderr), _connected(ray, address):
        processors = int(ray.cluster_resources().get("CPU", 1))
        yield RayTasks(ray, slots or AHEAD * processors, place, limits, work, again=again)


@contextmanager
def _connected(ray: Any, address: str) -> Generator[None]:
    if ray.is_initialized():
        yield
        return
    require_cluster(ray, address)
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise F3srError(f"--ray: no Ray cluster at {address}: {one_line(str(error))}") from error
    try:
        yield
    finally:
        ray.shutdown()


def remote_attempt(
    job: dict[str, Any], number: int, place: str, limits: dict[str, Any], work: str, again: bool
) -> tuple[bytes, bool]:
    """The task: one attempt; its record as bytes, and whether an earlier attempt made that."""
    worker = _workers.setdefault(work, Worker(work))
    found = attempt(Job.from_plain(job), place, JobLimits(**limits), worker, _unheard, number=number, again=again)
    return to_bytes(found.record), found.known


def _unheard(said: dict[str, Any]) -> None:
    """Steps stay on their machine."""
    del said


def _told(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return one_line(f"{type(error).__name__}: {lines[0] if lines else ''}")[:300]
