"""Folders of stub jobs, and batches of them in this process or in one of its own."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from f3sr.batch.driver import Event, Tally
from f3sr.batch.job import Job
from f3sr.batch.runs import RunPlan, run_batch
from f3sr.batch.supervisor import JobLimits
from f3sr.dataset.storage import files_of
from f3sr.pipeline_config import Config

LIMITS = JobLimits(wall_s=20.0, memory_mb=400.0, storage_wait_s=20.0)


def write_stub(folder: Path, seed: int, **asked: Any) -> Path:
    """An input folder of a stub job."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "stub.json").write_text(json.dumps({"seed": seed, **asked}))
    return folder


def write_stubs(folder: Path, count: int, **asked: Any) -> Path:
    for seed in range(count):
        write_stub(folder / f"stub-{seed:05d}", seed, **asked)
    return folder


def batch(
    inputs: Path,
    out: str | Path,
    *,
    report: Callable[[Event], None] = lambda event: None,
    goals: tuple[str, ...] = (),
    **plan: Any,
) -> Tally:
    """A batch of stub jobs."""
    made = RunPlan(**{"slots": 2, "limits": LIMITS, "retries": 1, "work": "stub_job", **plan})
    common = Job(name="", source="", goals=goals, work="stub_job")
    return run_batch(inputs, out, common, Config(), made, report)


def packages(dataset: Path) -> dict[str, str]:
    """sha256 of every file of every package, by its path in the dataset."""
    return {path: hashlib.sha256((dataset / path).read_bytes()).hexdigest() for path in _package_files(dataset)}


def _package_files(dataset: Path) -> Iterator[str]:
    for name in files_of(dataset / "scenes"):
        if "/package/" in name:
            yield f"scenes/{name}"


if __name__ == "__main__":  # INPUTS DATASET [WAIT]: for tests that kill it
    batch(Path(sys.argv[1]), sys.argv[2], report=lambda event: print(event.state, event.name, flush=True))
