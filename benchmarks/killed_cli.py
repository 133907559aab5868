"""Run the f3sr command line as it is, tell a harness where it is, and ``kill -9`` itself at an exact point.

usage: killed_cli.py POINT NOTES reconstruct FOLDER -o OUT. NOTES is an open file descriptor that gets ``begin STAGE``
and ``end STAGE`` lines. POINT is ``none``, ``STAGE:count`` or one of KILLS with a count: that call, of a function in
the stage or of the kind, is never made.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

STAGES = (
    *("assemble", "level", "align", "relate", "decompose", "separate", "settle", "close", "refine", "describe"),
    *("evaluate", "inpaint"),
)


def main() -> None:
    point, notes = sys.argv[1], int(sys.argv[2])
    kind, _, count = point.partition(":")
    from f3sr.runtime import signals

    signals.watch()
    pipeline = importlib.import_module("f3sr.pipeline")
    for name in STAGES:
        calls = int(count) if kind == name else 0
        setattr(pipeline, name, _noted(getattr(pipeline, name), name, notes, calls))
    if kind in KILLS:
        KILLS[kind](int(count))
    import f3sr.cli.main

    sys.argv[1:] = sys.argv[3:]
    sys.exit(f3sr.cli.main.run())


def _noted(work: Callable[..., Any], name: str, notes: int, calls: int) -> Callable[..., Any]:
    """``refine`` calls other stages: only the outermost is told. With ``calls``, the call of that number kills."""

    def run(*args: Any, **more: Any) -> Any:
        if _inside:
            return work(*args, **more)
        _inside.append(name)
        os.write(notes, f"begin {name}\n".encode())
        if calls:
            sys.setprofile(_counted(calls))
        try:
            return work(*args, **more)
        finally:
            os.write(notes, f"end {name}\n".encode())
            _inside.pop()

    return run


_inside: list[str] = []


def _counted(left: int) -> Callable[..., None]:
    def note(_frame: Any, event: str, _: Any) -> None:
        nonlocal left
        left -= event == "call"
        if left < 0:
            _die()

    return note


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _before(owner: Any, name: str, applies: Callable[..., bool], count: int) -> None:
    """Die instead of the call of that number of those that apply."""
    original, left = getattr(owner, name), [count]

    def call(*args: Any, **more: Any) -> Any:
        if applies(*args):
            left[0] -= 1
            if not left[0]:
                _die()
        return original(*args, **more)

    setattr(owner, name, call)


def _kill_storing(count: int) -> None:
    """A stage's result is half written in the store."""
    _before(Path, "replace", lambda _, target: Path(target).parent.name == "stages", count)


def _kill_stored(count: int) -> None:
    """A stage's result is in the store, and nothing has been said of it yet."""
    store = importlib.import_module("f3sr.runtime.result_store").Store
    _before(store, "_tidy", lambda self: self.folder.name == "stages", count)


def _kill_writing(count: int) -> None:
    _before(importlib.import_module("f3sr.runtime.atomic_folder").Claim, "write", lambda *_: True, count)


def _kill_first_rename(count: int) -> None:
    _before(os, "rename", lambda _, target: Path(target).name == "previous", count)


def _kill_second_rename(count: int) -> None:
    _before(os, "rename", lambda source, _: Path(source).name == "new", count)


def _kill_deletion(count: int) -> None:
    """Of the previous package: before its file of that number, 1 before anything is deleted."""
    _before(os, "unlink", lambda *_: bool(_replaced), count)
    original = os.rename

    def rename(source: Any, target: Any) -> None:
        original(source, target)
        if Path(source).name == "new":
            _replaced.append(source)

    os.rename = rename


_replaced: list[Any] = []

KILLS: dict[str, Callable[[int], None]] = {
    "storing": _kill_storing,
    "stored": _kill_stored,
    "write": _kill_writing,
    "rename1": _kill_first_rename,
    "rename2": _kill_second_rename,
    "delete": _kill_deletion,
}

if __name__ == "__main__":
    main()
