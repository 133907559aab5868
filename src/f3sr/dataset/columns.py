"""The columns of the index: what each holds, of which kind of row, and how a record becomes rows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, Literal, cast

from f3sr.dataset.layout import PACKAGE_FOLDER, Listed, scene_of
from f3sr.dataset.record import Record
from f3sr.metrics.measures import Measures
from f3sr.options import SKIPPABLE

Kind = Literal["scene", "object", "goal"]
KINDS: tuple[Kind, ...] = ("scene", "object", "goal")
Type = Literal["text", "number", "whole", "truth", "texts", "wholes"]
DIRECT = "direct_"
"""Begins the names of measures of direct composition."""
STAGES = ("assemble", *(stage for stage in SKIPPABLE if not stage.startswith("align-")))


@dataclass(frozen=True, kw_only=True)
class Column:
    name: str
    type: Type
    of: tuple[Kind, ...] = ("scene",)


def _columns() -> Iterator[Column]:
    yield from (Column(name=name, type="text", of=KINDS) for name in ("kind", "name", "key"))
    yield from (Column(name=n, type="text") for n in ("source", "status", "failure", "reason", "package"))
    yield Column(name="attempts", type="whole")
    yield from (Column(name=n, type="text") for n in ("inputs", "code", "version", "versions", "settings", "digest"))
    yield from (Column(name=n, type="whole") for n in ("package_files", "package_bytes"))
    yield from (Column(name=n, type="number") for n in ("wall_s", "cpu_s", "peak_mb"))
    yield from (Column(name=f"{stage}_s", type="number") for stage in STAGES)
    for field in fields(Measures):
        yield Column(name=field.name, type="whole" if field.type == "int" else "number")
    yield from (Column(name=f"{DIRECT}{name}", type="number") for name in ("mIoU", "mIoU_visible", "PSNR"))
    yield from (Column(name=name, type="whole") for name in ("goals", "goals_met", "fallbacks"))
    yield from (Column(name=n, type="whole", of=("object",)) for n in ("id", "parts", "footing", "supported_by"))
    yield from (Column(name=n, type="text", of=("object",)) for n in ("label", "mask", "mobility", "material"))
    for name in ("mass", "density", "friction", "restitution", "IoU", "IoU_visible", "gap_m", "below_m"):
        yield Column(name=name, type="number", of=("object",))
    yield from (Column(name=n, type="whole", of=("goal",)) for n in ("number", "rollouts"))
    for name in ("goal", "state", "goal_reason", "interpretation", "task", "folder", "film", "film_reason"):
        yield Column(name=name, type="text", of=("goal",))
    yield from (Column(name=n, type="number", of=("goal",)) for n in ("margin", "simulated_s"))


COLUMNS = tuple(_columns())
MEASURES = tuple(field.name for field in fields(Measures))


def rows_of(job: Listed, record: Record | None) -> Iterator[dict[str, Any]]:
    """The rows of one job: its scene, then its objects, then its goals; of a failure the scene alone."""
    yield _scene(job, record)
    if record is not None:
        shared = {"name": job.name, "key": job.key}
        yield from ({**row, **shared, "kind": "object"} for row in record.objects)
        yield from ({**row, **shared, "kind": "goal"} for row in record.goals)


def _scene(job: Listed, record: Record | None) -> dict[str, Any]:
    row: dict[str, Any] = {"kind": "scene", "name": job.name, "source": job.source, "key": job.key}
    if record is None:
        return row | {"status": "waiting"}
    row |= cast(dict[str, Any], record.scene)
    row |= {name: getattr(record, name) for name in ("status", "failure", "reason", "attempts", "inputs", "code")}
    row |= {name: getattr(record.costs, name) for name in ("wall_s", "cpu_s", "peak_mb")}
    row |= {f"{stage}_s": seconds for stage, seconds in record.costs.stages.items()}
    row |= {
        "version": record.versions.get("f3sr"),
        "versions": json.dumps(record.versions, sort_keys=True),
        "settings": json.dumps(record.settings, sort_keys=True),
    }
    if record.package is not None:
        row |= {
            "package": f"{scene_of(job.key)}/{PACKAGE_FOLDER}",
            "digest": record.package.digest,
            "package_files": record.package.files,
            "package_bytes": record.package.bytes,
        }
    return row
