"""What a dataset holds, in figures: jobs by status, reasons of failures, quantiles of measures, costs, goals."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from f3sr.dataset.columns import MEASURES
from f3sr.dataset.layout import Dataset
from f3sr.dataset.row_selection import scenes_with, selected

QUANTILES = {"least": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "most": 1.0}
COSTS = ("wall_s", "cpu_s", "peak_mb", "package_bytes")
REASONS = 20
"""Reasons of failures that are listed."""
SHOWN = 160
"""Characters of a reason by which failures are counted."""
NUMBER = re.compile(r"\d+(?:\.\d+)?")
"""Reasons that differ in numbers only are counted as one."""


def summary(dataset: Dataset, where: Sequence[str] = ()) -> dict[str, Any]:
    """Plain values: counts, then ``measures`` and ``costs`` with quantiles by name. ``where`` selects scenes."""
    scenes = selected(dataset, where)
    names = {job.name for job in scenes_with(dataset, where)} if where else None
    goals = _of(names, selected(dataset, (), "goal"), "state")
    labels = _of(names, selected(dataset, (), "object"), "label")
    failed = [row for row in _rows(scenes, "source", "failure", "reason") if row["failure"]]
    return {
        "scenes": scenes.num_rows,
        "status": _counts(scenes.column("status").to_pylist()),
        "failures": _counts(row["failure"] for row in failed),
        "reasons": dict(list(grouped(map(told, failed)).items())[:REASONS]),
        "objects": len(labels),
        "labels": dict(Counter(labels).most_common(REASONS)),
        "goals": _counts(goals),
        "measures": {n: q for n in MEASURES if (q := _quantiles(scenes, n))},
        "costs": {n: q for n in COSTS if (q := _quantiles(scenes, n))},
        "total": {name: _total(scenes, name) for name in ("cpu_s", "package_bytes")},
    }


def told(row: Mapping[str, Any]) -> str:
    """Kind and reason of a failure; paths are relative to the input folder. Empty for a scene without one."""
    text = (row["reason"] or "").replace(f"{row['source']}/", "").replace(row["source"] or "\0", "the input")
    return ": ".join(filter(None, (row["failure"], text)))


def grouped(reasons: Iterable[str]) -> dict[str, int]:
    """How often each reason comes, most frequent first; of those that differ in numbers only, the first stands."""
    shown: dict[str, str] = {}
    counts = Counter[str]()
    for text in reasons:
        counts[shown.setdefault(NUMBER.sub("0", text), text[:SHOWN])] += 1
    return dict(counts.most_common())


def _rows(table: Any, *names: str) -> list[dict[str, Any]]:
    return table.select(list(names)).to_pylist()


def _of(names: set[str] | None, table: Any, column: str) -> list[str]:
    """A column's texts, of the named scenes only."""
    return [str(row[column]) for row in _rows(table, "name", column) if names is None or row["name"] in names]


def _counts(values: Any) -> dict[str, int]:
    return dict(sorted(Counter(str(value) for value in values).items()))


def _quantiles(table: Any, name: str) -> dict[str, float]:
    values = np.array([v for v in table.column(name).to_pylist() if v is not None], float)
    if not len(values):
        return {}
    at = np.quantile(values, list(QUANTILES.values()))
    return {"mean": float(values.mean()), **dict(zip(QUANTILES, map(float, at), strict=True))}


def _total(table: Any, name: str) -> float:
    return float(sum(v for v in table.column(name).to_pylist() if v is not None))
