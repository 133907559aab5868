"""The folder of a dataset: the names in it, its list of jobs, and the records behind the list.

``jobs.jsonl`` lists every job by name, with its key. ``scenes/ab/KEY`` holds a package and its record,
``failures/ab/KEY.json`` the record of a failure. A dataset by reference holds a list only and names its base.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from pydantic import TypeAdapter

from f3sr.dataset.record import Record, from_bytes
from f3sr.dataset.storage import RECORD, LocalStorage, Storage, storage_of
from f3sr.errors import InputError, OutputError
from f3sr.files import strict_json

HEAD = "dataset.json"
JOBS = "jobs.jsonl"
INDEX = "index.parquet"
SHEET = "sheet"
STALE = "index.stale"
"""Says that a run has begun since the index was written."""
UNFINISHED = "run.unfinished"
"""Says that a run goes on, or was cut off: the list may lack jobs that it has done."""
SCENES, FAILURES = "scenes", "failures"
PACKAGE_FOLDER = "package"
FORMAT = "f3sr dataset"
KEY = re.compile("[0-9a-f]{64}")
ACCEPTED = "a dataset that `f3sr batch` wrote"


@dataclass(frozen=True, kw_only=True)
class Listed:
    """A job of a dataset: its name, which no other has, its source, and the key of its result."""

    name: str
    source: str
    key: str


_LISTED = TypeAdapter(Listed)


class Dataset:
    """A dataset on its storage. Its packages and records are those of ``base``: its own, or the one it refers to."""

    def __init__(self, storage: Storage, base: Storage | None = None) -> None:
        self.storage, self.base = storage, base or storage

    @classmethod
    def read(cls, place: str | Path) -> Self:
        """A dataset that exists. Raises InputError for anything else."""
        storage = storage_of(place)
        head = _head(storage)
        base = head.get("base")
        return cls(storage, storage_of(_joined(storage, base)) if isinstance(base, str) else None)

    @classmethod
    def made(cls, place: str | Path) -> Self:
        """A dataset to write to: new, or one that exists. Raises OutputError where anything else is."""
        storage = storage_of(place)
        names = [name for name in storage.names() if name != ".lock"]
        if HEAD in names:
            if "base" in _head(storage):
                raise OutputError(f"{place}: is a dataset by reference, which holds no packages; give another folder")
        elif names:
            raise OutputError(f"{place}: found {names[0]}; accepted: a new or empty folder, or {ACCEPTED}")
        elif isinstance(storage, LocalStorage) and storage.folder.is_file():
            raise OutputError(f"{place}: found a file; accepted: a new or empty folder, or {ACCEPTED}")
        return cls(storage)

    def begin(self, base: str | None = None) -> None:
        """Write what makes the place a dataset; ``base`` is the dataset that it refers to."""
        head = {"format": FORMAT, "version": 1, **({"base": base} if base else {})}
        self.storage.write(HEAD, (json.dumps(head, indent=1) + "\n").encode())

    def listed(self) -> Iterator[Listed]:
        """Every job, in order of names."""
        data = self.storage.read(JOBS) or b""
        for number, line in enumerate(data.splitlines(), 1):
            try:
                job = _LISTED.validate_python(strict_json.loads(line))
            except ValueError as error:
                found = f"line {number}: {str(error).splitlines()[0]}"
                raise InputError(f"{self.storage.place}/{JOBS}", found=found, accepted=ACCEPTED) from None
            scene_of(job.key)
            yield job

    def list_jobs(self, jobs: Iterable[Listed]) -> None:
        """Write the list of jobs; names are sorted already."""
        with tempfile.TemporaryDirectory(prefix="f3sr-") as folder:
            file = Path(folder, JOBS)
            with file.open("w", encoding="utf-8") as stream:
                stream.writelines(json.dumps(asdict(job)) + "\n" for job in jobs)
            self.storage.put(JOBS, file)

    def record(self, key: str) -> Record | None:
        """The record of a job: that of its package, else that of its failure, else none."""
        for path in (f"{scene_of(key)}/{RECORD}", failure_of(key)):
            if (data := self.base.read(path)) is not None:
                return from_bytes(data, f"{self.base.place}/{path}")
        return None

    def package(self, key: str) -> AbstractContextManager[Path]:
        """The package of a job as local files."""
        return self.base.local(f"{scene_of(key)}/{PACKAGE_FOLDER}")


def scene_of(key: str) -> str:
    """The folder of a job's package and record: 256 folders share them. Raises InputError for what is no key."""
    if not KEY.fullmatch(str(key)):
        raise InputError("dataset", found=f"the key {key!r:.60}", accepted="64 hexadecimal digits")
    return f"{SCENES}/{key[:2]}/{key}"


def failure_of(key: str) -> str:
    return f"{FAILURES}/{key[:2]}/{key}.json"


def _head(storage: Storage) -> dict[str, Any]:
    where, data = f"{storage.place}/{HEAD}", storage.read(HEAD)
    if data is None:
        raise InputError(storage.place, found=f"no {HEAD}", accepted=ACCEPTED)
    try:
        head = strict_json.loads(data)
    except ValueError as error:
        raise InputError(where, found=f"no valid JSON ({error})", accepted=ACCEPTED) from None
    if not isinstance(head, dict) or head.get("format") != FORMAT or head.get("version") != 1:
        raise InputError(where, found="another format or version", accepted=ACCEPTED)
    return head


def _joined(storage: Storage, base: str) -> str:
    """A base is absolute, a URL, or relative to the dataset that names it."""
    if "://" in base or not isinstance(storage, LocalStorage):
        return base
    return str((storage.folder / base).resolve())
