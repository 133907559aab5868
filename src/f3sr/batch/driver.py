"""The driver of a batch: which jobs are missing, which run, which are tried again, and what all of them came to.

It holds what runs and nothing of what ended: records are on the storage, the list of jobs is in a file.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, Any, Literal

from f3sr.batch.attempt import known_record, with_inputs
from f3sr.batch.executors import Ended, Executor
from f3sr.batch.job import Job, code_digest, inputs_digest
from f3sr.batch.patience import Patience
from f3sr.dataset.index import write_index
from f3sr.dataset.layout import KEY, STALE, UNFINISHED, Dataset, Listed, failure_of, scene_of
from f3sr.dataset.record import Failure, Record, to_bytes
from f3sr.dataset.storage import RECORD, patiently
from f3sr.runtime.daemon_thread import ahead

CHECKPOINT_S = 30.0
"""How often the list of jobs is written during a run [s], and at most a twentieth of the time."""
LOST = 5
"""Attempts that may be lost, with their worker or machine, before a job counts as failed."""
WAKE_S = 0.5
"""How long the driver waits for an attempt to end before it looks around [s]."""

State = Literal["started", "step", "full", "again", "done", "known", "failed"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Event:
    """What happened to a job."""

    name: str
    state: State
    key: str = ""
    failure: Failure = ""
    reason: str = ""
    attempt: int = 0
    step: str = ""
    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0

    def plain(self) -> dict[str, Any]:
        """The fields that say something."""
        return {name: value for name, value in asdict(self).items() if value not in ("", 0, 0.0)}


Report = Callable[[Event], None]


@dataclass(eq=False)
class Tally:
    """What a run came to."""

    counts: Counter[str] = field(default_factory=Counter[str])
    """Jobs by state: done, known (done before), failed."""
    failures: Counter[str] = field(default_factory=Counter[str])
    """Failed jobs by kind."""
    retries: int = 0
    cpu_s: float = 0.0
    wall_s: float = 0.0

    @property
    def jobs(self) -> int:
        return self.counts.total()


@dataclass(eq=False)
class _Running:
    """An attempt that goes on, for one job or for several of the same content."""

    jobs: list[Job]
    number: int = 1
    lost: int = 0


class Driver:
    """Runs jobs into a dataset through an executor."""

    def __init__(
        self,
        dataset: Dataset,
        executor: Executor,
        *,
        retries: int,
        again: bool,
        report: Report,
        storage_wait_s: float,
    ) -> None:
        self.dataset, self.executor, self.report = dataset, executor, report
        self.retries, self.again, self.storage_wait_s = retries, again, storage_wait_s
        self.running: dict[str, _Running] = {}
        self.retry: deque[_Running] = deque()
        self.tally = Tally()
        self.listing = _Listing(dataset, self._surely)

    def run(self, jobs: Iterable[Job]) -> Tally:
        """Bring every job to its end; what is done already is not done again."""
        start = time.monotonic()
        dataset = self.dataset
        self._surely(dataset.begin)
        self._surely(lambda: dataset.storage.write(UNFINISHED, b""))
        self._surely(lambda: dataset.storage.write(STALE, b""))
        with self.listing:
            self._work(ahead(map(keyed, jobs)))
        self._surely(lambda: dataset.storage.remove(UNFINISHED))
        self._tidy()
        self.tally.wall_s = time.monotonic() - start
        return self.tally

    def index(self) -> None:
        """Derive the index."""
        self._surely(lambda: write_index(self.dataset))

    def _work(self, jobs: Iterator[Job]) -> None:
        more = True
        while more or self.running or self.retry:
            while len(self.running) < self.executor.slots and (more or self.retry):
                if self.retry:
                    self._submit(self.retry.popleft())
                elif (job := next(jobs, None)) is None:
                    more = False
                else:
                    self._begin(job)
            self.listing.checkpoint()
            if self.running:
                for ended in self.executor.ended(WAKE_S):
                    self._end(ended)

    def _begin(self, job: Job) -> None:
        """Attempt a job unless its result, or its bad input, is known; only the attempt knows it of a remote one."""
        if job.remote:
            self._submit(_Running([job]))
            return
        key = job.key
        self.listing.add(job, key)
        if key in self.running:
            self.running[key].jobs.append(job)
            return
        if self.dataset.storage.has(f"{scene_of(key)}/{RECORD}"):
            self._tell(job, "known")
        elif (record := known_record(self.dataset.storage, key, again=self.again)) is not None:
            self._known(job, record)
        else:
            self._submit(_Running([job]))

    def _known(self, job: Job, record: Record) -> None:
        """An earlier attempt made it, or found its input bad."""
        if record.status == "failed":
            self._failed(job, record, known=True)
        else:
            self._tell(job, "known", record)

    def _submit(self, running: _Running) -> None:
        job = running.jobs[0]
        self.running[_mark(job)] = running
        self.report(Event(name=job.name, state="started", key=_key(job), attempt=running.number))
        self.executor.submit(job, running.number)

    def _end(self, ended: Ended) -> None:
        running = self.running.pop(_mark(ended.job))
        if ended.record is None or ended.record.failure == "lost":
            self._lost(running, ended.record.reason if ended.record else ended.reason)
        elif ended.known:
            self._known(running.jobs[0], ended.record)
        elif ended.record.status == "done":
            record = ended.record
            self.tally.cpu_s += record.costs.cpu_s
            self._surely(lambda: self.dataset.storage.remove(failure_of(record.key)))
            for job in running.jobs:
                self._tell(job, "done", record)
        elif ended.record.failure == "bad input" or running.number > self.retries:
            self._give_up(running, ended.record)
        else:
            self._again(running, ended.record.failure, ended.record.reason)
            running.number += 1

    def _lost(self, running: _Running, reason: str) -> None:
        """Worker or machine went with the attempt, which is no fault of the job."""
        running.lost += 1
        if running.lost < LOST:
            self._again(running, "lost", reason)
            return
        job = with_inputs(running.jobs[0], reason)
        record = Record(
            key=job.key, inputs=job.inputs, code=job.code, status="failed", failure="lost", reason=reason,
            attempts=running.number + running.lost - 1,
        )  # fmt: skip
        self._give_up(running, record)

    def _again(self, running: _Running, failure: Failure, reason: str) -> None:
        self.tally.retries += 1
        job = running.jobs[0]
        self.report(
            Event(name=job.name, state="again", key=_key(job), failure=failure, reason=reason, attempt=running.number)
        )
        self.retry.append(running)

    def _give_up(self, running: _Running, record: Record) -> None:
        self.tally.cpu_s += record.costs.cpu_s
        self._surely(lambda: self.dataset.storage.write(failure_of(record.key), to_bytes(record)))
        for job in running.jobs:
            self._failed(job, record)

    def _failed(self, job: Job, record: Record, *, known: bool = False) -> None:
        self.tally.failures[record.failure] += 1
        known_as = record.model_copy(update={"reason": f"{record.reason} (known; not tried again)"})
        self._tell(job, "failed", known_as if known else record)

    def _tell(self, job: Job, state: State, record: Record | None = None) -> None:
        self.tally.counts[state] += 1
        key = job.key if record is None else record.key
        if job.remote:
            self.listing.add(job, key)
        event = Event(name=job.name, state=state, key=key)
        if record is not None and state != "known":
            costs = record.costs
            event = replace(
                event, failure=record.failure, reason=record.reason, attempt=record.attempts,
                wall_s=costs.wall_s, cpu_s=costs.cpu_s, peak_mb=costs.peak_mb,
            )  # fmt: skip
        self.report(event)

    def _surely(self, action: Callable[[], Any]) -> Any:
        """An action on the storage, again and again while that is full."""
        return patiently(action, wait=Patience(self.storage_wait_s, self._full))

    def _full(self, said: dict[str, Any]) -> None:
        self.report(Event(name="", state="full", reason=said["reason"]))

    def _tidy(self) -> None:
        """Delete what attempts left, but for stages of failed jobs that the next run tries again."""
        work = self.dataset.storage.scratch()
        for folder in work.iterdir() if work.is_dir() else ():
            if not KEY.fullmatch(folder.name) or not self.dataset.storage.has(failure_of(folder.name)):
                shutil.rmtree(folder, ignore_errors=True)
        with contextlib.suppress(OSError):
            work.rmdir()


class _Listing:
    """The jobs of a run, in a file until they are merged into the dataset's list by name."""

    def __init__(self, dataset: Dataset, surely: Callable[[Callable[[], Any]], Any]) -> None:
        self.dataset, self.surely = dataset, surely
        self.spool: IO[str] = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115 - closed at the exit
        self.new, self.last, self.took = 0, time.monotonic(), 0.0

    def __enter__(self) -> _Listing:
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            self._merge()
        self.spool.close()

    def add(self, job: Job, key: str) -> None:
        self.spool.write(json.dumps(asdict(Listed(name=job.name, source=job.source, key=key))) + "\n")
        self.new += 1

    def checkpoint(self) -> None:
        if self.new and time.monotonic() - self.last > max(CHECKPOINT_S, 20 * self.took):
            self._merge()

    def _merge(self) -> None:
        start = time.monotonic()
        self.spool.seek(0)
        merged = {job.name: job for job in self.dataset.listed()}
        merged |= {job.name: job for job in (Listed(**json.loads(line)) for line in self.spool)}
        self.surely(lambda: self.dataset.list_jobs(merged[name] for name in sorted(merged)))
        self.new, self.last = 0, time.monotonic()
        self.took = self.last - start


def keyed(job: Job) -> Job:
    """The job with the digests of the code and of its input, where that is local: others are fetched once, for the
    attempt, which is where their digest is found."""
    inputs = "" if job.remote else inputs_digest(Path(job.source))
    return replace(job, inputs=inputs, code=code_digest())


def _mark(job: Job) -> str:
    """What tells a running job from others: jobs of equal keys run as one."""
    return job.name if job.remote else job.key


def _key(job: Job) -> str:
    return "" if job.remote else job.key
