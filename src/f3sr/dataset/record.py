"""The record of a job: what was made of one input, measured, with its costs; the index derives from records alone."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field, JsonValue, ValidationError

from f3sr.dataset.storage import files_of
from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.files.meanings import Documented

Failure = Literal["", "bad input", "error", "crash", "time", "memory", "storage", "lost"]
"""Kinds of failures. Bad input fails again however often it is tried; all others may not."""
Row = dict[str, JsonValue]


class _DatasetRecord(Documented):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Costs(_DatasetRecord):
    """What the attempt that ended a job took."""

    wall_s: float = 0.0
    """Wall time [s]."""
    cpu_s: float = 0.0
    """Processor time [s] of its process and all that it started."""
    peak_mb: float = 0.0
    """Largest resident memory of these together [MB]."""
    stages: dict[str, float] = Field(default_factory=dict)
    """Wall time [s] of every stage."""


class Contents(_DatasetRecord):
    """The package as a whole."""

    digest: str
    """sha256 over paths and contents of all files."""
    files: int
    bytes: int


class Record(_DatasetRecord):
    """record.json: the result of a job, or its failure. It is the same for every job of that key."""

    format: Literal[1] = 1
    key: str
    """Digest of inputs, settings, goals and code."""
    inputs: str
    """Digest of the input folder."""
    code: str
    """Digest of f3sr's code and of the versions of numerical libraries."""
    status: Literal["done", "failed"]
    failure: Failure = ""
    reason: str = ""
    attempts: int = 1
    """Attempts of the run that ended the job."""
    versions: dict[str, str] = Field(default_factory=dict)
    settings: Row = Field(default_factory=dict)
    """Settings that differ from the defaults, by dotted name."""
    costs: Costs = Costs()
    package: Contents | None = None
    scene: Row = Field(default_factory=dict)
    """Measures of the scene."""
    objects: tuple[Row, ...] = ()
    goals: tuple[Row, ...] = ()


def to_bytes(record: Record) -> bytes:
    return (json.dumps(plain(record.model_dump()), indent=1, allow_nan=False) + "\n").encode()


def from_bytes(data: bytes, where: str) -> Record:
    """A record that was read. Raises InputError for anything else."""
    accepted = "a record that `f3sr batch` wrote"
    try:
        return Record.model_validate(strict_json.loads(data))
    except ValidationError as error:
        found, _ = strict_json.problem(error, ", ".join(Record.model_fields))
        raise InputError(where, found=found, accepted=accepted) from None
    except ValueError as error:
        raise InputError(where, found=f"no valid JSON ({error})", accepted=accepted) from None


def contents_of(package: Path) -> Contents:
    """Digest, count and size of a package's files."""
    hashed, count, size = hashlib.sha256(), 0, 0
    for name in sorted(files_of(package)):
        data = (package / name).read_bytes()
        hashed.update(f"{name}\0{hashlib.sha256(data).hexdigest()}\n".encode())
        count, size = count + 1, size + len(data)
    return Contents(digest=hashed.hexdigest(), files=count, bytes=size)


def plain(value: Any) -> Any:
    """A value as JSON has it; numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
