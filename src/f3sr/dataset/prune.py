"""Packages that no listed job has any more, as inputs, settings or code changed: found, counted and removed."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from f3sr.dataset.layout import FAILURES, JOBS, KEY, SCENES, UNFINISHED, Dataset, failure_of, scene_of
from f3sr.dataset.storage import Storage
from f3sr.errors import InputError, OutputError


@dataclass(frozen=True, kw_only=True)
class Pruned:
    """What no listed job has."""

    packages: int
    failures: int
    """Records of failed jobs."""
    bytes: int
    """Of these packages."""


def prune(dataset: Dataset, *, keep: Sequence[Dataset] = (), dry_run: bool = False) -> Pruned:
    """Remove packages and records whose key no job of ``dataset``, nor of a dataset in ``keep``, names.

    Each package goes whole, so that a run that is cut off leaves none in part. ``dry_run`` only counts. Raises
    OutputError while a run writes the dataset, after a run that was cut off, and for a dataset by reference.
    """
    storage = dataset.storage
    if dataset.base is not storage:
        raise OutputError(
            f"{storage.place}: is a dataset by reference, which holds no packages; give {dataset.base.place}"
        )
    with storage.claimed():
        _require_whole_list(storage)
        named = {job.key for listed in (dataset, *keep) for job in listed.listed()}
        scenes = [key for key in _keys(storage, SCENES) if key not in named]
        failures = [key for key in _keys(storage, FAILURES) if key not in named]
        size = sum(storage.size(scene_of(key)) for key in scenes)
        if not dry_run:
            _remove(storage, scenes, failures, named)
    return Pruned(packages=len(scenes), failures=len(failures), bytes=size)


def _require_whole_list(storage: Storage) -> None:
    if storage.has(UNFINISHED):
        why = "a run of it goes on or was cut off, so that its list may lack jobs"
        raise OutputError(f"{storage.place}: {why}; run the same `f3sr batch` to its end first")
    if not storage.has(JOBS):
        raise InputError(storage.place, found=f"no {JOBS}", accepted="a dataset with its list of jobs")


def _keys(storage: Storage, folder: str) -> Iterator[str]:
    """Keys that have a package, or the record of a failure."""
    for part in storage.names(folder):
        names = (name.removesuffix(".json") for name in storage.names(f"{folder}/{part}"))
        yield from (name for name in names if KEY.fullmatch(name) and name.startswith(part))


def _remove(storage: Storage, scenes: Sequence[str], failures: Sequence[str], named: set[str]) -> None:
    for key in scenes:
        storage.discard(scene_of(key))
    for key in failures:
        storage.remove(failure_of(key))
    work = storage.scratch()
    for folder in work.iterdir() if work.is_dir() else ():  # stages of jobs that nobody tries again
        if folder.name not in named:
            shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        work.rmdir()
