"""Who attempts jobs: threads of this process with a worker each; ``ray_executor`` has the same for a cluster."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, Protocol

from f3sr.batch.attempt import attempt
from f3sr.batch.job import Job
from f3sr.batch.supervisor import JobLimits, Worker
from f3sr.dataset.record import Record
from f3sr.runtime import kernels, signals


@dataclass(frozen=True, eq=False, kw_only=True)
class Ended:
    """The end of an attempt. ``record`` is None where its machine was lost with it."""

    job: Job
    record: Record | None
    reason: str = ""
    known: bool = False
    """Whether the record is of an earlier attempt."""


class Executor(Protocol):
    """Attempts jobs, so many at a time: whoever submits more keeps them waiting, not the executor."""

    slots: int

    def submit(self, job: Job, number: int) -> None:
        """Begin the attempt of that number."""
        ...

    def ended(self, seconds: float) -> Generator[Ended]:
        """What ended; waits so long for the first."""
        ...


Told = Callable[[Job, dict[str, Any]], None]
"""Hears of a job's steps, in any thread."""


class Threads:
    """Workers of this machine, one in each of some threads."""

    def __init__(self, slots: int, place: str, limits: JobLimits, work: str, told: Told, *, again: bool) -> None:
        self.slots, self.place, self.limits, self.told, self.again = slots, place, limits, told, again
        self.workers = [Worker(work) for _ in range(slots)]
        self.waiting: SimpleQueue[tuple[Job, int] | None] = SimpleQueue()
        self.done: SimpleQueue[Ended | BaseException] = SimpleQueue()
        self.stopped = False

    def submit(self, job: Job, number: int) -> None:
        self.waiting.put((job, number))

    def ended(self, seconds: float) -> Generator[Ended]:
        with contextlib.suppress(Empty):
            found = self.done.get(timeout=seconds)
            if isinstance(found, BaseException):
                raise found
            yield found

    def serve(self, worker: Worker) -> None:
        """The life of a thread."""
        try:
            while (taken := self.waiting.get()) is not None:
                if self.stopped:
                    continue
                job, number = taken
                found = attempt(
                    job,
                    self.place,
                    self.limits,
                    worker,
                    lambda said, job=job: self.told(job, said),
                    number=number,
                    again=self.again,
                )
                self.done.put(Ended(job=job, record=found.record, known=found.known))
        except BaseException as error:  # raised again where ends are asked for
            self.done.put(error)
        finally:
            worker.close()


@contextmanager
def threads(slots: int, place: str, limits: JobLimits, work: str, told: Told, *, again: bool) -> Generator[Threads]:
    """Workers that end with the block, or with this process."""
    made = Threads(slots, place, limits, work, told, again=again)
    running = [Thread(target=made.serve, args=[w], daemon=True, name="f3sr-slot") for w in made.workers]
    if not kernels.is_warm():
        made.workers[0].warm()  # one compiles for all
    with signals.undone(lambda: made, _ended):
        for thread in running:
            thread.start()
        try:
            yield made
        except BaseException:
            _ended(made)
            raise
        finally:
            for _ in running:
                made.waiting.put(None)
            for thread in running:
                thread.join()


def _ended(made: Threads) -> None:
    """End what goes on, at once."""
    made.stopped = True
    for worker in made.workers:
        if worker.process is not None:
            worker.process.kill()
