"""The job folder of a certificate, seen from the client: what is asked, and what is answered. Standard library only.

These scripts are started by file and run in the environment of an engine or a validator, which need not have f3sr.

    job = ClientJob.from_arguments()
    engine = job.library("engine")            # or the answer is that it is missing
    ...
    job.answer_release(...)
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import sys
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any, NoReturn

PROTOCOL = 1
REQUEST, ANSWER = "request.json", "answer.json"


class ClientJob:
    """A job folder: ``request`` as read, the answer by the methods."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.request: dict[str, Any] = json.loads((folder / REQUEST).read_text())
        if self.request.get("protocol") != PROTOCOL:
            raise SystemExit(f"protocol {self.request.get('protocol')!r}; this client speaks {PROTOCOL}")
        self.file: str = self.request["file"]
        """What is released or validated; of several files the first."""
        self.files: list[str] = self.request.get("files", [self.file])
        self.names: list[str] = self.request.get("names", [])
        """Of the objects, in the order of their ids."""
        self.seconds: float = float(self.request.get("seconds", 0.0))
        self.interval: float = float(self.request.get("interval", 0.1))
        """Time between two samples of a release [s]."""

    @classmethod
    def from_arguments(cls) -> ClientJob:
        parser = argparse.ArgumentParser()
        parser.add_argument("--job", type=Path, required=True)
        return cls(parser.parse_args().job)

    def library(self, module: str) -> Any:
        """A module of the environment. Without it the answer says so, and the process ends well."""
        try:
            return importlib.import_module(module)
        except ImportError as error:
            self.end_without(str(error))

    def end_without(self, reason: str) -> NoReturn:
        """Answer what the environment lacks; the process ends well."""
        self._write({"missing": reason[:200]})
        raise SystemExit(0)

    def say(self, state: str) -> None:
        """Progress, for the user."""
        print(json.dumps({"state": state}), flush=True)

    def answer_release(
        self,
        *,
        packages: Sequence[str],
        settings: str,
        timestep: float,
        bodies: Mapping[str, Mapping[str, Any]],
        samples: Sequence[Mapping[str, Sequence[float]]],
        penetrations: Mapping[str, float] | None = None,
        notes: Sequence[str] = (),
    ) -> None:
        """Say what the engine did.

        ``bodies``: of what moves, its ``mass`` [kg], ``center`` (3,) [m] and ``inertia`` (3, 3) [kg m2] about it in the
        object frame, as the engine has them. ``samples``: at time 0 and after every interval, position [m] and
        quaternion (w, x, y, z) of every object. ``penetrations``: the largest overlap of every object [m], where the
        engine tells. Numbers that are not finite are answered as null.
        """
        answer = {
            "versions": versions(packages),
            "settings": settings,
            "timestep": timestep,
            "bodies": {name: dict(body) for name, body in bodies.items()},
            "samples": [{name: list(state) for name, state in sample.items()} for sample in samples],
            "penetrations": None if penetrations is None else dict(penetrations),
            "notes": list(notes),
        }
        self._write(_finite(answer))

    def answer_findings(self, *, packages: Sequence[str], findings: Sequence[Mapping[str, str]], checked: int) -> None:
        """Say what the validator found: ``severity`` (error, warning or note), ``file`` and ``text``."""
        self._write({"versions": versions(packages), "findings": [dict(f) for f in findings], "checked": checked})

    def _write(self, answer: Mapping[str, Any]) -> None:
        file = self.folder / ANSWER
        part = file.with_suffix(".part")
        part.write_text(json.dumps(answer, allow_nan=False))
        part.replace(file)


def versions(packages: Sequence[str]) -> dict[str, str]:
    """Versions of installed packages, and of Python."""
    found = {"python": sys.version.split()[0]}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def _finite(value: Any) -> Any:
    """JSON has no NaN: what blew up is null, which no verdict accepts."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    number = float(value)
    return number if math.isfinite(number) else None
