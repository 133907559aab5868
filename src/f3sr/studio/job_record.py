"""A job's folder: what is asked, how it stands, and the events that its process adds.

A job lives as long as a process holds the lock of ``run.lock``. The server takes it and hands it down to the process
that it starts, so there is no moment without it. That is known after any server's end, and no other process that got
the same number is taken for it.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import secrets
import shutil
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.errors import InputError, OutputError, one_line, reason
from f3sr.files import strict_json
from f3sr.runtime.atomic_file import write_whole
from f3sr.runtime.file_lock import is_taken
from f3sr.studio.job_options import JobOptions, options_of

State = Literal["queued", "running", "done", "failed", "cancelled"]
ENDS = ("done", "failed", "cancelled")
"""States that do not change any more."""
RECORD, EVENTS, LOCK, WORDS, PICTURES = "job.json", "events.jsonl", "run.lock", "words.txt", "pictures"
SPARE, SPARE_BYTES = "spare", 16_384
"""A file that gives up its room [bytes] for the last event or the record: each takes one block of the disk or two."""
ENDED = "ended"
"""The event after which none comes."""
ID = re.compile(r"[0-9]{13}-[0-9a-f]{8}")
"""Milliseconds since 1970 and a random number: within a project, sorted by name is sorted by time asked."""
MAX_RECORD = 200_000
"""Bytes of job.json."""
MAX_EVENTS = 20_000_000
"""Bytes of events that are read: a job writes some ten thousand."""
SHOWN_STAGES = {"level": "level", "align": "align", "describe": "rest"}
"""Stages after which the scene is drawn over the photo, and what the picture is called."""
MAX_STARTS = 3
"""Times that a job is begun: one that ends its process each time is not tried for ever."""


class JobStanding(BaseModel):
    """job.json."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[1] = 1
    kind: Annotated[str, Field(max_length=40)]
    options: dict[str, Any]
    state: State = "queued"
    problem: Annotated[str, Field(max_length=2000)] = ""
    """One line, where it failed."""
    starts: Annotated[int, Field(ge=0, le=1000)] = 0
    """How often it was begun."""
    asked_to_end: bool = False
    """Cancelled while it ran: a server that starts now ends it, and does not begin it once more."""
    result: dict[str, Any] = {}


@dataclass(frozen=True)
class JobFolder:
    """One job on disk."""

    folder: Path

    @classmethod
    def new(cls, jobs: Path, options: JobOptions) -> Self:
        """A queued job. Raises OutputError where it cannot be written."""
        try:
            jobs.mkdir(exist_ok=True)
            job = cls(jobs / f"{_moment_after_all(jobs):013d}-{secrets.token_hex(4)}")
            job.pictures.mkdir(parents=True)
            job.spare.write_bytes(bytes(SPARE_BYTES))
        except OSError as error:
            raise OutputError(f"{jobs}: no job can be kept there ({reason(error)})") from error
        job.keep(JobStanding(kind=options.kind, options=options.model_dump(exclude_none=True)))
        return job

    @property
    def id(self) -> str:
        return self.folder.name

    @property
    def project(self) -> Path:
        """The folder of the project that the job belongs to."""
        return self.folder.parent.parent

    @property
    def pictures(self) -> Path:
        return self.folder / PICTURES

    @property
    def words(self) -> Path:
        """What the process printed."""
        return self.folder / WORDS

    @property
    def spare(self) -> Path:
        """Room for how the job ended, given up for it on a full disk."""
        return self.folder / SPARE

    @property
    def record(self) -> JobStanding:
        """Raises InputError for a damaged one."""
        tree = strict_json.read(self.folder / RECORD, most=MAX_RECORD, accepted="what the studio wrote there")
        try:
            return JobStanding.model_validate(tree)
        except ValidationError as error:
            found, wanted = strict_json.problem(error, ", ".join(JobStanding.model_fields))
            raise InputError(self.folder / RECORD, found=found, accepted=wanted) from None

    @property
    def options(self) -> JobOptions:
        """Checked again. Raises InputError."""
        record = self.record
        return options_of(record.kind, record.options)

    def keep(self, record: JobStanding) -> None:
        """Replace job.json. Raises OutputError; the older one is then still there."""
        data = record.model_dump_json(indent=1).encode()
        try:
            write_whole(self.folder / RECORD, data)
        except OutputError:
            if record.state not in ENDS or not self._spared():
                raise
            write_whole(self.folder / RECORD, data)

    def delete(self) -> None:
        """Take the job off the disk: first out of the list."""
        with suppress(OSError):
            (self.folder / RECORD).unlink()
            shutil.rmtree(self.folder)

    def told(self) -> dict[str, Any]:
        """For the page. A job that has told its end has ended, also where a full disk keeps that from its record."""
        record = self.record
        if record.state == "running" and (end := self.end):
            record = ended(record, end)
        return {"id": self.id, **record.model_dump(include={"kind", "options", "state", "problem", "result"})}

    # --- events ------------------------------------------------------------------------------------------------------

    def tell(self, event: str, **values: Any) -> None:
        """Add an event. A full disk loses it, and nothing else; the last one has room of its own."""
        line = json.dumps({"event": event, **values}, allow_nan=False).encode() + b"\n"
        if not self._added(line) and event == ENDED and self._spared():
            self._added(line)

    def _added(self, line: bytes) -> bool:
        with suppress(OSError), (self.folder / EVENTS).open("a+b") as opened:
            if opened.seek(0, os.SEEK_END) and opened.seek(-1, os.SEEK_END) >= 0 and opened.read(1) != b"\n":
                line = b"\n" + line  # what a full disk cut stays a line of its own
            opened.write(line)
            opened.flush()
            return True
        return False

    def _spared(self) -> bool:
        """Whether there was room to give up."""
        with suppress(OSError):
            self.spare.unlink()
            return True
        return False

    @property
    def end(self) -> dict[str, Any] | None:
        """The event with which the job ended; None where it told of none."""
        return next((event for event in reversed(self.events()) if event.get("event") == ENDED), None)

    def events(self, after: int = 0) -> list[dict[str, Any]]:
        """Events from number ``after`` on; a last line that is being written is left for the next time."""
        try:
            with (self.folder / EVENTS).open("rb") as opened:
                lines = opened.read(MAX_EVENTS).split(b"\n")[:-1]
        except FileNotFoundError:
            return []
        return [self._event(line) for line in lines[max(0, after) :]]

    @staticmethod
    def _event(line: bytes) -> dict[str, Any]:
        """A line that a full disk cut is an event without meaning: numbers stay."""
        with suppress(ValueError):
            if isinstance(tree := json.loads(line), dict):
                return tree
        return {"event": "lost"}

    # --- life --------------------------------------------------------------------------------------------------------

    @property
    def pid(self) -> int | None:
        """Of the process that does the job now; None where nobody does."""
        try:
            with (self.folder / LOCK).open("rb") as opened:
                try:
                    fcntl.flock(opened, fcntl.LOCK_SH | fcntl.LOCK_NB)
                except OSError:
                    text = opened.read(20)
                    return int(text) if text.isdigit() else 0
        except FileNotFoundError:
            pass
        return None

    @contextmanager
    def locked(self) -> Generator[int]:
        """A descriptor for the process that is to do the job. Raises OutputError where one does it already."""
        lock = os.open(self.folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            if not is_taken(lock):
                raise OutputError(f"{self.folder}: another process does this job")
            os.truncate(lock, 0)  # the number of an earlier process
            yield lock
        finally:
            os.close(lock)


def ended(record: JobStanding, end: dict[str, Any]) -> JobStanding:
    """The record of a job that told its end. What is misshapen in that is left out."""
    result, problem = end.get("result"), end.get("problem")
    return record.model_copy(
        update={
            "state": "done" if end.get("state") == "done" else "failed",
            "problem": one_line(problem) if isinstance(problem, str) else "",
            "result": result if isinstance(result, dict) else {},
        }
    )


def _moment_after_all(jobs: Path) -> int:
    """Milliseconds since 1970: now, or just after the newest job, also in its millisecond or of a clock set back."""
    moments = [int(entry.name.partition("-")[0]) for entry in os.scandir(jobs) if ID.fullmatch(entry.name)]
    return max(int(time.time() * 1000), max(moments, default=0) + 1)


def jobs_in(folder: Path) -> list[JobFolder]:
    """All jobs of a project that can be read, the oldest first."""
    with suppress(OSError):
        names = sorted(entry.name for entry in os.scandir(folder) if ID.fullmatch(entry.name))
        return [job for name in names if _is_readable(job := JobFolder(folder / name))]
    return []


def _is_readable(job: JobFolder) -> bool:
    try:
        job.options  # noqa: B018 - it raises
    except (InputError, OSError):
        return False
    return True
