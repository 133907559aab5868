"""One attempt at a job: the same code on this machine and in a Ray task. A package that is made is committed here."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import time
import uuid
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeVar

from f3sr.batch.job import Job, code_digest, fetched, inputs_digest, versions
from f3sr.batch.job_process import explained
from f3sr.batch.patience import Patience
from f3sr.batch.supervisor import Answer, JobLimits, Tell, Worker
from f3sr.dataset.layout import PACKAGE_FOLDER, Dataset, scene_of
from f3sr.dataset.record import Contents, Costs, Failure, Record, contents_of, plain, to_bytes
from f3sr.dataset.storage import RECORD, Storage, patiently, storage_of
from f3sr.errors import F3srError
from f3sr.runtime.result_store import digest

T = TypeVar("T")


class Surely(Protocol):
    """Does an action again and again while the disk is full."""

    def __call__(self, action: Callable[[], T]) -> T: ...


RESULT, STAGES, LOCK = "result", "stages", "lock"
"""In the folder of a job that goes on: what will be committed, results of stages, and the lock of who makes it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Attempted:
    """How an attempt ended; ``record`` is what was committed, or what would be written of the failure."""

    record: Record
    known: bool = False
    """Whether an earlier attempt made it: of an input behind a URL only this one could find out."""

    @property
    def failure(self) -> Failure:
        return self.record.failure


def attempt(
    job: Job, place: str, limits: JobLimits, worker: Worker, tell: Tell, *, number: int = 1, again: bool = False
) -> Attempted:
    """Try a job and commit its package to the dataset at ``place``. No failure of a job raises.

    An input behind a URL is fetched, and its digest found, here: what is known of that key is the answer, but for bad
    input with ``again``.
    """
    start = time.monotonic()

    def surely(action: Callable[[], T]) -> T:
        return patiently(action, wait=Patience(limits.storage_wait_s, tell))

    try:
        if job.code != code_digest():
            found = f"{job.code[:12]} there, {code_digest()[:12]} here"
            raise F3srError(f"another f3sr, or other libraries, than where the batch runs: {found}")
        storage = storage_of(place)
        with ExitStack() as stack:
            source = surely(lambda: stack.enter_context(fetched(job.source)))
            if job.remote:
                job = replace(job, inputs=inputs_digest(source))
                if (record := known_record(storage, job.key, again=again)) is not None:
                    return Attempted(record=record, known=True)
            return _made(job, source, storage, limits, worker, tell, number, surely)
    except (F3srError, OSError) as error:
        failure, reason = explained(error)
        answer = Answer(failure=failure, reason=reason, wall_s=time.monotonic() - start)
        return Attempted(record=record_of(with_inputs(job, reason), answer, None, number))


def known_record(storage: Storage, key: str, *, again: bool) -> Record | None:
    """The record of a key that needs no attempt: it is done, or its input is bad and not to be tried ``again``."""
    record = Dataset(storage).record(key)
    if record is None or (record.status == "failed" and (again or record.failure != "bad input")):
        return None
    return record


def with_inputs(job: Job, reason: str) -> Job:
    """A job with a key, also where its input could not be had: then the reason stands for it."""
    return job if job.inputs else replace(job, inputs=digest(reason))


def _made(
    job: Job, source: Path, storage: Storage, limits: JobLimits, worker: Worker, tell: Tell, number: int, surely: Surely
) -> Attempted:
    """The answer of a worker, and its package moved into the dataset where it made one."""
    with _locked(storage.scratch(), job.key, surely) as folder:
        result = folder / RESULT
        surely(lambda: _emptied(result))
        answer = worker.run(job, source, result, folder / STAGES, limits, tell)
        answer = replace(answer, reason=answer.reason.replace(str(source), job.source))  # not where it was fetched to
        made = None if answer.failure else contents_of(result / PACKAGE_FOLDER)
        record = record_of(job, answer, made, number)
        if made is not None:
            surely(lambda: (result / RECORD).write_bytes(to_bytes(record)))
            surely(lambda: storage.commit(result, scene_of(job.key)))
        if made is not None or answer.failure == "bad input":
            shutil.rmtree(folder, ignore_errors=True)
    return Attempted(record=record)


def record_of(job: Job, answer: Answer, package: Contents | None, number: int) -> Record:
    """The record of an attempt that ended."""
    rows = plain(answer.result)
    return Record(
        key=job.key,
        inputs=job.inputs,
        code=job.code,
        status="failed" if answer.failure else "done",
        failure=answer.failure,
        reason=answer.reason,
        attempts=number,
        versions=versions(),
        settings=plain(job.settings),
        costs=Costs(
            wall_s=round(answer.wall_s, 3),
            cpu_s=round(answer.cpu_s, 3),
            peak_mb=round(answer.peak_mb, 1),
            stages={name: round(seconds, 4) for name, seconds in rows.get("stages", {}).items()},
        ),
        package=package,
        scene=rows.get("scene", {}),
        objects=tuple(rows.get("objects", ())),
        goals=tuple(rows.get("goals", ())),
    )


@contextmanager
def _locked(work: Path, key: str, surely: Surely) -> Generator[Path]:
    """A job's folder among those being made, which one process at a time has.

    It keeps its name, so that the next attempt finds the stages of a killed one. Where a process that was thought dead
    still works in it, another folder is taken."""
    folder = work / key
    lock = surely(lambda: _opened(folder))
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        with _locked(work, f"{key}.{uuid.uuid4().hex[:8]}", surely) as other:
            yield other
        return
    except OSError:
        pass  # a file system without locks
    try:
        yield folder
    finally:
        os.close(lock)


def _opened(folder: Path) -> int:
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)


def _emptied(result: Path) -> None:
    with contextlib.suppress(FileNotFoundError):
        shutil.rmtree(result)
    result.mkdir(parents=True)
