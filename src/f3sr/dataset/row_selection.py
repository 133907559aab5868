"""Rows of the index by conditions, and datasets by reference that list only some of another's jobs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from f3sr.dataset.columns import Kind
from f3sr.dataset.index import arrow, read_index, write_index
from f3sr.dataset.layout import Dataset, Listed
from f3sr.dataset.storage import LocalStorage
from f3sr.dataset.where import condition
from f3sr.errors import InputError


def selected(dataset: Dataset, where: Sequence[str], kind: Kind = "scene") -> Any:
    """The rows of a kind that meet every condition, as an Arrow table in order of names."""
    wanted = arrow("pyarrow.compute").field("kind") == kind
    for text in where:
        wanted = wanted & condition(text, kind)
    acero = arrow("pyarrow.acero")
    plan = [
        acero.Declaration("table_source", acero.TableSourceNodeOptions(read_index(dataset))),
        acero.Declaration("filter", acero.FilterNodeOptions(wanted)),
    ]
    return acero.Declaration.from_sequence(plan).to_table(use_threads=False)  # in order, and no thread outlives us


def scenes_with(dataset: Dataset, where: Sequence[str], kind: Kind = "scene") -> list[Listed]:
    """The jobs of which a row of that kind meets every condition, in order of names."""
    names = set(selected(dataset, where, kind).column("name").to_pylist())
    return [job for job in dataset.listed() if job.name in names]


def refer(dataset: Dataset, jobs: Sequence[Listed], out: str | Path) -> None:
    """Write a dataset that lists these jobs and refers to another's packages. Raises OutputError if anything else is
    there."""
    made = Dataset.made(out) if not _is_reference(out) else Dataset.read(out)
    with made.storage.claimed():
        made.begin(base=_way(made, dataset))
        made.list_jobs(jobs)
        write_index(Dataset.read(out))


def _is_reference(out: str | Path) -> bool:
    """Whether there is a dataset by reference, which another may replace."""
    try:
        found = Dataset.read(out)
    except InputError:
        return False
    return found.base is not found.storage


def _way(made: Dataset, dataset: Dataset) -> str:
    """Where the packages are: relative where both are local, so that the two can be moved together."""
    if isinstance(made.storage, LocalStorage) and isinstance(dataset.base, LocalStorage):
        return os.path.relpath(dataset.base.folder, made.storage.folder)
    return dataset.base.place
