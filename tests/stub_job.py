"""The work of a stub job: a tiny package made from ``stub.json``, or the failure that it asks for; for tests and
benchmarks of batches. Folders without that file are real inputs."""

from __future__ import annotations

import errno
import hashlib
import importlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from f3sr.errors import InputError

STUB = "stub.json"


def preload() -> None:
    if os.environ.get("STUBS_WITH_SCENES"):
        _scenes().preload()
    if os.environ.get("COUNTED_FILES"):
        importlib.import_module("counted_files")


def work(job: Any, source: Path, folder: Path, stages: Path, *, progress: Any, patiently: Any) -> dict[str, Any]:
    if not (source / STUB).exists() and os.environ.get("STUBS_WITH_SCENES"):
        return _scenes().work(job, source, folder, stages, progress=progress, patiently=patiently)
    if not (source / STUB).exists():
        raise InputError(source, found=f"no {STUB}", accepted="one")
    asked = json.loads((source / STUB).read_text())
    time.sleep(asked.get("seconds", 0))
    _fail(asked, source, stages)
    data = hashlib.shake_256(json.dumps([asked["seed"], job.goals]).encode()).digest(asked.get("bytes", 1000))
    left = [asked.get("full", 0)]
    patiently(lambda: _write(folder / "package", data, left))
    return {
        "scene": {"n": 1, "mIoU_visible": asked["seed"] % 10 / 10, "goals": len(job.goals), "goals_met": 0},
        "objects": [{"id": 0, "label": "cube", "mass": 0.1 * asked["seed"]}],
        "goals": [{"number": k, "goal": goal, "state": "missed"} for k, goal in enumerate(job.goals, 1)],
        "stages": {"assemble": 0.001},
    }


def _scenes() -> Any:
    return importlib.import_module("f3sr.batch.scene_job")


def _fail(asked: dict[str, Any], source: Path, stages: Path) -> None:
    """``fail``: bad, crash, memory, hang; ``once`` fails on the first attempt only."""
    kind = asked.get("fail", "")
    if asked.get("once"):
        stages.mkdir(exist_ok=True)
        if (stages / "tried").exists():
            return
        (stages / "tried").touch()
    if kind == "bad":
        raise InputError(source / STUB, found="fail = bad", accepted="good stubs")
    if kind == "error":
        raise KeyError("an error that nobody foresaw")
    if kind == "crash":
        os.abort()
    if kind == "memory":
        held = []
        while True:
            held.append(os.urandom(1 << 20) * 16)
            time.sleep(0.01)
    if kind == "child memory":
        code = "import time; held = b'x' * 300_000_000; time.sleep(60)"
        subprocess.run([sys.executable, "-c", code], check=False)
    if kind == "hang":
        time.sleep(3600)


def _write(package: Path, data: bytes, full: list[int]) -> None:
    """The first so many writes find no room."""
    full[0] -= 1
    if full[0] >= 0:
        raise OSError(errno.ENOSPC, "No space left on device")
    package.mkdir(exist_ok=True)
    (package / "data.bin").write_bytes(data)
