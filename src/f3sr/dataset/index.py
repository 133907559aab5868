"""index.parquet: one row a scene, an object and a goal, derived from records alone.

One file with a column ``kind``, not three: one rename replaces it, so that its rows always belong together. Columns of
other kinds are null, which parquet stores in next to nothing.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

from f3sr.dataset.columns import COLUMNS, Column, Type, rows_of
from f3sr.dataset.layout import INDEX, STALE, Dataset
from f3sr.errors import InputError
from f3sr.runtime.extras import library

GROUP = 2000
"""Rows that are held in memory at a time, and that a row group of the file has."""
WHY = "the index of a dataset"


def arrow(module: str = "pyarrow") -> Any:
    """A module of pyarrow."""
    return library(module, extra="dataset", why=WHY)


def schema() -> Any:
    """The Arrow schema of the index."""
    pa = arrow()
    types: dict[Type, Any] = {
        "text": pa.string(),
        "number": pa.float64(),
        "whole": pa.int64(),
        "truth": pa.bool_(),
        "texts": pa.list_(pa.string()),
        "wholes": pa.list_(pa.int64()),
    }
    return pa.schema([(column.name, types[column.type]) for column in COLUMNS])


def write_index(dataset: Dataset) -> None:
    """Derive the index from the list of jobs and their records, and put it in the old one's place."""
    pa, parquet, columns = arrow(), arrow("pyarrow.parquet"), schema()
    rows = (row for job in dataset.listed() for row in rows_of(job, dataset.record(job.key)))
    with tempfile.TemporaryDirectory(prefix="f3sr-") as folder:
        file = Path(folder, INDEX)
        with parquet.ParquetWriter(file, columns, compression="zstd") as writer:
            for group in _groups(rows):
                writer.write_table(pa.Table.from_pylist([_known(row) for row in group], schema=columns))
        dataset.storage.put(INDEX, file)
    dataset.storage.remove(STALE)


def read_index(dataset: Dataset, columns: Iterable[str] | None = None) -> Any:
    """The index as a table, derived again where a run has begun since. Raises InputError where it is damaged."""
    pa = arrow()
    if dataset.storage.has(STALE) or not dataset.storage.has(INDEX):
        write_index(dataset)
    data = dataset.storage.read(INDEX)
    try:
        names = None if columns is None else list(dict.fromkeys(columns))
        return arrow("pyarrow.parquet").read_table(
            pa.BufferReader(data), columns=names, use_threads=False, pre_buffer=False
        )
    except pa.ArrowException as error:
        place = f"{dataset.storage.place}/{INDEX}"
        raise InputError(place, found=str(error), accepted="an index of this version; delete it to derive it") from None


def _groups(rows: Iterator[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    while group := list(islice(rows, GROUP)):
        yield group


_CHECKED: dict[Type, tuple[type, ...]] = {"text": (str,), "number": (int, float), "whole": (int,), "truth": (bool,)}
_BY_NAME: dict[str, Column] = {column.name: column for column in COLUMNS}


def _known(row: dict[str, Any]) -> dict[str, Any]:
    """The values that have a column and its type: records come from outside, and later versions may have more."""
    return {
        name: value
        for name, value in row.items()
        if name in _BY_NAME and isinstance(value, _CHECKED.get(_BY_NAME[name].type, (list,)))
    }
