"""What a batch is to do: a folder of input folders, or a manifest (csv, jsonl), checked as a whole before any work."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from f3sr import settings
from f3sr.batch.job import Job
from f3sr.errors import InputError, reason, require_known
from f3sr.files import limited_file, strict_json
from f3sr.io.pose_conventions import require_asset_frame
from f3sr.options import PARTS, SKIPPABLE
from f3sr.pipeline_config import Config

MAX_BYTES = 2_000_000_000
"""Largest manifest: a row takes some hundred bytes."""
LONGEST_LINE = 100_000
"""Characters of a row."""
LONGEST_NAME, LONGEST_PATH = 200, 1000
"""Characters of the name of a job, and of the path of its input."""
MOST_GOALS, LONGEST_GOAL = 100, 2000
"""Goals of one job, and characters of one: as many as `f3sr simulate` takes."""
COLUMNS = ("path", "name", "goals", "asset-frame", "skip", "ignore")
ACCEPTED = f"{', '.join(COLUMNS)}, and settings by dotted name such as align.max_yaw"
NAME = re.compile(r"[\w.+-][\w.+ /-]*")
MANIFESTS = (".csv", ".jsonl")


def jobs_of(place: Path, common: Job, config: Config) -> tuple[int, Iterator[Job]]:
    """How many jobs there are, and each of them. All are checked before the first is given, then read again.

    Raises InputError naming file, row, what was found and what is accepted.
    """
    given = BatchInputs(place, common, config)
    count = sum(1 for _ in given.checked())
    if not count:
        raise InputError(place, found="no jobs", accepted="a folder of input folders, or a manifest with rows")
    return count, given.jobs()


class BatchInputs:
    """A folder of folders, or a manifest."""

    def __init__(self, place: Path, common: Job, config: Config) -> None:
        self.place, self.common, self.config = place, common, config

    def checked(self) -> Iterator[Job]:
        """Every job, of names that no two share."""
        names = set[str]()
        for where, job in self._rows():
            if job.name in names:
                raise InputError(where, found=f"the name {job.name!r} again", accepted="names that differ")
            names.add(job.name)
            yield job

    def jobs(self) -> Iterator[Job]:
        return (job for _, job in self._rows())

    def _rows(self) -> Iterator[tuple[str, Job]]:
        if self.place.suffix.lower() in MANIFESTS and not self.place.is_dir():
            return self._manifest()
        return self._folders()

    def _folders(self) -> Iterator[tuple[str, Job]]:
        accepted = "a folder of input folders, or a manifest: a file .csv or .jsonl"
        try:
            if not self.place.is_dir():
                found = "a file" if self.place.exists() else "nothing there"
                raise InputError(self.place, found=found, accepted=accepted)
            if (self.place / "masks").is_dir():
                raise InputError(self.place, found="one input folder", accepted="a folder that holds such folders")
            names = sorted(p.name for p in self.place.iterdir() if p.is_dir() and not p.name.startswith("."))
        except (OSError, ValueError) as error:
            raise InputError(self.place, found=reason(error), accepted=accepted) from error
        for name in names:
            yield (
                str(self.place),
                replace(self.common, name=_name(name, str(self.place)), source=str((self.place / name).absolute())),
            )

    def _manifest(self) -> Iterator[tuple[str, Job]]:
        read = _csv_rows if self.place.suffix.lower() == ".csv" else _json_rows
        for number, row in read(self.place):
            where = f"{self.place}, row {number}"
            yield where, self._job(row, where)

    def _job(self, row: Mapping[str, Any], where: str) -> Job:
        given = {name: value for name, value in row.items() if value not in (None, "")}
        dotted = {name: value for name, value in given.items() if "." in name}
        if unknown := sorted(given.keys() - dotted.keys() - set(COLUMNS)):
            raise InputError(where, found=f"the column {unknown[0]!r}", accepted=ACCEPTED)
        source = _source(_text(given, "path", where, LONGEST_PATH), self.place, where)
        job = replace(
            self.common,
            name=_name(_text(given, "name", where, LONGEST_NAME, default=source.rstrip("/").rpartition("/")[2]), where),
            source=source,
        )
        if "goals" in given:
            job = replace(job, goals=goals_of(given["goals"], where))
        if "asset-frame" in given:
            frame = _text(given, "asset-frame", where, 40)
            require_asset_frame(where, frame)
            job = replace(job, asset_frame=frame)
        for column, known in (("skip", SKIPPABLE), ("ignore", PARTS)):
            if column in given:
                job = replace(job, **{column: _words(given, column, where, known)})
        if dotted:
            config = settings.with_values(where, {n: _scalar(v, where, n) for n, v in dotted.items()}, self.config)
            job = replace(job, settings=settings.changed(config, Config()))
        return job


def goals_of(value: object, where: str) -> tuple[str, ...]:
    """Goals from a text with semicolons or lines between them, or from a list."""
    texts = re.split(r"[;\n]", value) if isinstance(value, str) else value
    if not isinstance(texts, Sequence) or not all(isinstance(text, str) for text in texts):
        raise InputError(where, found=f"goals = {value!r:.60}", accepted="texts, with semicolons between them")
    goals = tuple(text.strip() for text in texts if text.strip())
    if len(goals) > MOST_GOALS:
        raise InputError(where, found=f"{len(goals)} goals", accepted=f"at most {MOST_GOALS}")
    if long := next((goal for goal in goals if len(goal) > LONGEST_GOAL), None):
        raise InputError(where, found=f"a goal of {len(long)} characters", accepted=f"at most {LONGEST_GOAL}")
    return goals


def read_goals(file: Path) -> tuple[str, ...]:
    """Goals of a text file, one a line; empty lines and those that begin with # are left out."""
    data = limited_file.read(file, most=1_000_000, accepted="a text file with one goal a line")
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(file, found=f"not UTF-8 at byte {error.start}", accepted="a text file in UTF-8") from None
    return goals_of([line for line in lines if not line.lstrip().startswith("#")], str(file))


# --- rows --------------------------------------------------------------------------------------------------------


def _csv_rows(file: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    accepted = "a csv file in UTF-8 whose first row names its columns"
    with limited_file.opened(file, most=MAX_BYTES, accepted=accepted) as stream:
        text = io.TextIOWrapper(stream, encoding="utf-8-sig", newline="")
        try:
            rows = csv.reader(text, strict=True)
            header = [name.strip() for name in next(rows, [])]
            if "path" not in header or len(set(header)) < len(header):
                raise InputError(f"{file}, row 1", found=", ".join(header)[:200] or "nothing", accepted=ACCEPTED)
            for number, values in enumerate(rows, 2):
                if not any(value.strip() for value in values):
                    continue
                if len(values) != len(header):
                    found = f"{len(values)} values"
                    raise InputError(f"{file}, row {number}", found=found, accepted=f"{len(header)}, as in row 1")
                yield number, {n: v.strip() for n, v in zip(header, values, strict=True)}
        except csv.Error as error:
            raise InputError(file, found=f"no valid csv ({error})", accepted=accepted) from None
        except UnicodeDecodeError as error:
            raise InputError(file, found=f"not UTF-8 at byte {error.start}", accepted=accepted) from None


def _json_rows(file: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    accepted = "one JSON object a line"
    with limited_file.opened(file, most=MAX_BYTES, accepted=accepted) as stream:
        number = 0
        while line := stream.readline(LONGEST_LINE):
            number += 1
            where = f"{file}, row {number}"
            if len(line) >= LONGEST_LINE:
                raise InputError(where, found="a longer line", accepted=f"at most {LONGEST_LINE:,} bytes")
            if not line.strip():
                continue
            try:
                row = strict_json.loads(line)
            except ValueError as error:
                raise InputError(where, found=f"no valid JSON ({error})", accepted=accepted) from None
            if not isinstance(row, dict):
                raise InputError(where, found=f"{row!r:.60}", accepted=accepted)
            yield number, row


def _text(row: Mapping[str, Any], column: str, where: str, most: int, default: str | None = None) -> str:
    value = row.get(column, default)
    if value is None:
        raise InputError(where, found=f"no {column}", accepted=f"a {column}")
    if not isinstance(value, str) or len(value) > most or not value.isprintable():
        found = f"{column} = {value!r:.60}"
        raise InputError(where, found=found, accepted=f"a printable text of at most {most} characters")
    return value


def _source(path: str, manifest: Path, where: str) -> str:
    """A path as the manifest means it: relative to its own folder; a URL as it is."""
    if "://" in path:
        return path
    try:
        return str(manifest.absolute().parent / path)
    except ValueError as error:
        raise InputError(where, found=f"path = {path!r:.60}", accepted="a path or a URL") from error


def _name(name: str, where: str) -> str:
    if len(name) > LONGEST_NAME or not NAME.fullmatch(name):
        accepted = f"letters, digits, . _ + - / and spaces, at most {LONGEST_NAME}"
        raise InputError(where, found=f"the name {name!r:.60}", accepted=accepted)
    return name


def _words(row: Mapping[str, Any], column: str, where: str, known: Sequence[str]) -> tuple[str, ...]:
    """Names with commas between them, as the option of that name has them."""
    value = row[column]
    words = value.split(",") if isinstance(value, str) else value
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise InputError(where, found=f"{column} = {value!r:.60}", accepted="names with commas between them")
    found = tuple(sorted({word.strip() for word in words if word.strip()}))
    require_known(where, found, known)
    return found


def _scalar(value: object, where: str, name: str) -> Any:
    """The value of a setting; csv has texts only."""
    if not isinstance(value, str):
        return value
    try:
        found = strict_json.loads(value.encode())
    except ValueError:
        return value
    if isinstance(found, float) and not math.isfinite(found):
        raise InputError(where, found=f"{name} = {value}", accepted="a finite number")
    return found
