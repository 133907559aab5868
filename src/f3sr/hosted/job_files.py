"""What is kept of a job in the cache: its id from the moment it is known, and the meshes that it gave.

A job file says "sent" before a request that costs money leaves, and "accepted" once the id is known. A run that is
killed in between leaves "sent": nobody knows whether it was paid, so no later run sends it again by itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.errors import NoAnswerError, reason
from f3sr.files import strict_json
from f3sr.io.sam3d import AssetPose
from f3sr.runtime import cached_jobs
from f3sr.runtime.cache_files import write_whole
from f3sr.runtime.cache_folder import is_ours, within

FOLDER = "hosted"
RECORD = "job.json"
SHARE = 1.0
"""Most that jobs take together that are done [share of the cache's size limit]."""
MAX_RECORD_BYTES = 1_000_000
MAX_MESH_BYTES = 256_000_000
"""Largest GLB that is downloaded and kept."""
FORMAT = 1
"""Of job files; another number is another job."""


class KeptMesh(BaseModel):
    """A mesh file of a job."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    file: Annotated[str, Field(pattern=r"^\d{1,4}\.glb$")]
    sha256: str
    pose: AssetPose | None = None


class JobRecord(BaseModel):
    """``job.json``; no key is in it, nor a URL of a download."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    service: str
    model: str
    state: Literal["sent", "accepted", "done"]
    sent_at: str
    id: str = ""
    poll: str = ""
    result: str = ""
    meshes: list[KeptMesh] = []


class JobFiles:
    """The folder of one job, named by the digest of all that it was asked for; None keeps nothing."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    @classmethod
    def of(cls, service: str, digest: str) -> JobFiles:
        """The job's folder in f3sr's cache."""
        cache = within(FOLDER)
        return cls(cache / service / digest if cache else None)

    @property
    def file(self) -> Path | None:
        return self.folder / RECORD if self.folder else None

    def record(self) -> JobRecord | None:
        """What is known of the job; None where nothing is.

        Raises NoAnswerError for a file that is there and cannot be trusted: it may be of a job that was paid."""
        if not self.file:
            return None
        try:
            data = self._bytes(self.file, MAX_RECORD_BYTES)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise NoAnswerError(f"{self.file}: {reason(error)}; delete it to send the request again") from error
        try:
            return JobRecord.model_validate(strict_json.loads(data))
        except (ValueError, ValidationError):
            raise NoAnswerError(f"{self.file}: no job file of f3sr; delete it to send the request again") from None

    def save(self, record: JobRecord) -> bool:
        """Write the record whole; whether it is on disk now."""
        if not self.file:
            return False
        data = record.model_dump_json(indent=1).encode()
        write_whole(self.file, data)
        with contextlib.suppress(OSError):
            return self._bytes(self.file, MAX_RECORD_BYTES) == data
        return False

    def forget(self) -> None:
        """Delete all of the job: it was refused, or has failed for good."""
        if self.folder:
            shutil.rmtree(self.folder, ignore_errors=True)

    def keep(self, name: str, data: bytes, pose: AssetPose | None) -> KeptMesh:
        """Write a mesh file whole."""
        if self.folder:
            write_whole(self.folder / name, data)
        return KeptMesh(file=name, sha256=hashlib.sha256(data).hexdigest(), pose=pose)

    def kept(self, mesh: KeptMesh) -> bytes | None:
        """The bytes of a mesh file; None where they are gone or changed."""
        if not self.folder:
            return None
        with contextlib.suppress(OSError):
            data = self._bytes(self.folder / mesh.file, MAX_MESH_BYTES)
            return data if hashlib.sha256(data).hexdigest() == mesh.sha256 else None
        return None

    def locked(self) -> AbstractContextManager[None]:
        """One process at a time asks for this job."""
        return cached_jobs.locked(self.folder) if self.folder else nullcontext()

    def _bytes(self, file: Path, most: int) -> bytes:
        with os.fdopen(os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as stream:
            if not is_ours(stream.fileno()):
                raise PermissionError(1, "other users may write to it")
            return stream.read(most + 1)[:most]


def tidy_jobs() -> None:
    """Bound the folders of jobs that are done. What was sent and is not done stays: it may have been paid."""
    if jobs := within(FOLDER):
        cached_jobs.tidy(jobs, depth=2, share=SHARE, may_go=_is_done)


def _is_done(job: Path) -> bool:
    try:
        record = JobFiles(job).record()
    except NoAnswerError:
        return False
    return record is not None and record.state == "done"


def now() -> str:
    """The time, for people who look for the job in their account."""
    return datetime.now(UTC).isoformat(timespec="seconds")
