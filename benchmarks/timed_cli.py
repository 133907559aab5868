"""Run the f3sr command line as it is and note where its time goes, in the stages and around them.

usage: timed_cli.py TIMES.json reconstruct FOLDER -o OUT --json
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

Steps = dict[str, dict[str, float]]
"""``wall`` and ``cpu`` seconds by step; cpu includes ended child processes."""

STEPS = (
    ("read", "io.inputs", "read"),
    ("stages", "pipeline", "reconstruct"),
    ("pictures", "vision.pictures", "pictures_of"),
    ("package", "scene_package.package", "write_package"),
)
"""A step's name, and the module and function of f3sr that is timed."""


def main() -> int:
    """Exit code of the command; the steps go to the file named first."""
    steps: Steps = {}
    modules = _timed(_modules, "import", steps)()
    for step, module, name in STEPS:
        setattr(modules[module], name, _timed(getattr(modules[module], name), step, steps))
    modules["pipeline"].reconstruct = _telling(modules["pipeline"].reconstruct, steps)
    code = modules["cli.main"].main(sys.argv[2:])
    Path(sys.argv[1]).write_text(json.dumps(steps))
    return code


def _modules() -> dict[str, Any]:
    return {name: importlib.import_module(f"f3sr.{name}") for name in ("cli.main", *(module for _, module, _ in STEPS))}


def _timed(work: Callable[..., Any], step: str, steps: Steps) -> Callable[..., Any]:
    def run(*args: Any, **more: Any) -> Any:
        wall, cpu = time.perf_counter(), sum(os.times()[:4])
        try:
            return work(*args, **more)
        finally:
            steps[step] = {"wall": time.perf_counter() - wall, "cpu": sum(os.times()[:4]) - cpu}

    return run


def _telling(reconstruct: Callable[..., Any], steps: Steps) -> Callable[..., Any]:
    """Notes every stage that is done, as ``progress`` is told of it."""

    def run(*args: Any, progress: Callable[[Any], None], **more: Any) -> Any:
        began = 0.0

        def told(step: Any) -> None:
            nonlocal began
            if step.state == "started":
                began = sum(os.times()[:4])
            elif step.state == "done":
                steps[step.name] = {"wall": step.seconds, "cpu": sum(os.times()[:4]) - began}
            progress(step)

        return reconstruct(*args, progress=told, **more)

    return run


if __name__ == "__main__":
    sys.exit(main())
