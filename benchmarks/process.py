"""Run one f3sr command in a process of its own, with its wall clock, peak memory and steps.

This module and whoever starts commands with it import nothing heavy: Linux counts the memory of the process that forked
as the child's own peak.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from f3sr.runtime.machine import ONE_THREAD

HERE = Path(__file__).parent
BEFORE, AFTER = ("import", "read"), ("pictures", "package")
"""What the command does around the stages; ``timed_cli`` notes them."""
LIMIT_S = 900.0
"""A command that takes longer is killed and counts as failed."""


class RunError(Exception):
    """A command ended badly; the message holds its last words."""


@dataclass(frozen=True, kw_only=True)
class Finished:
    """What a command printed (one JSON object) and took."""

    answer: dict[str, Any]
    wall: float
    """[s] from start to end of the process."""
    cpu: float
    """Processor time [s] of the command and all processes it started and waited for."""
    peak_mb: float
    """Resident memory of the largest process among the command and those it started [MB]."""


def run(arguments: Sequence[str | Path], log: Path, *, environment: Mapping[str, str] | None = None) -> Finished:
    """Run a script of this folder with this Python; raises RunError when it crashes, hangs or prints no JSON."""
    script, *rest = map(str, arguments)
    command = [sys.executable, str(HERE / script), *rest]
    log.parent.mkdir(parents=True, exist_ok=True)
    answer = log.with_suffix(".json")
    start = time.perf_counter()
    complete = {**ONE_THREAD, **os.environ, **(environment or {})}
    with log.open("w") as errors, answer.open("w") as out:
        process = subprocess.Popen(command, stdout=out, stderr=errors, env=complete, start_new_session=True)
        status, usage = _wait(process)
    wall = time.perf_counter() - start
    if code := os.waitstatus_to_exitcode(status):
        words = " / ".join(log.read_text(errors="replace").strip().splitlines()[-3:])
        raise RunError(f"{script} {'was killed by signal' if code < 0 else 'exit code'} {abs(code)}: {words}")
    try:
        return Finished(
            answer=json.loads(answer.read_text()),
            wall=wall,
            cpu=usage.ru_utime + usage.ru_stime,
            peak_mb=usage.ru_maxrss / 1024,
        )
    except ValueError as error:
        raise RunError(f"{script} printed no JSON: {error}") from error


def reconstruct(
    folder: Path, out: Path, *, environment: Mapping[str, str], options: Sequence[str | Path] = ()
) -> Finished:
    """Run ``f3sr reconstruct``. ``answer["seconds"]`` gets the steps around the stages too, in their order, and
    ``answer["cpu"]`` the processor time [s] of all steps; that of ``decompose`` depends on a cache we keep."""
    times = out.with_suffix(".times")
    times.unlink(missing_ok=True)
    arguments = ["timed_cli.py", times, "reconstruct", folder, "-o", out, "--json", "--overwrite", *options]
    finished = run(arguments, out.with_suffix(".log"), environment=environment)
    steps, stages = json.loads(times.read_text()), finished.answer["seconds"]
    wall = {name: step["wall"] for name, step in steps.items()}
    around = {name: wall[name] for name in BEFORE + AFTER}
    finished.answer["cpu"] = {"decompose": 0.0, **{name: step["cpu"] for name, step in steps.items()}}
    finished.answer["seconds"] = {
        "process, arguments": finished.wall - wall["stages"] - sum(around.values()),
        **{name: around[name] for name in BEFORE},
        **stages,
        "storing, resuming": wall["stages"] - sum(stages.values()),
        **{name: around[name] for name in AFTER},
    }
    return finished


def _wait(process: subprocess.Popen[bytes]) -> tuple[int, Any]:
    """Exit status and resource usage; the process and all it started end by the limit or with us."""
    timer = threading.Timer(LIMIT_S, _kill, [process.pid])
    timer.start()
    try:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        return status, usage
    except BaseException:
        _kill(process.pid)
        raise
    finally:
        timer.cancel()


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)
