"""Decomposing in a subprocess that may be killed: by a limit on time, by Ctrl-C, by running out of memory."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import CancelledError
from dataclasses import dataclass
from typing import IO

import numpy as np
from pydantic import TypeAdapter

from f3sr.core.transforms import Array
from f3sr.files import npz
from f3sr.proxies import parts
from f3sr.proxies.config import ProxyConfig
from f3sr.proxies.parts import FittedParts
from f3sr.proxies.store import config_json, packed, unpacked
from f3sr.proxies.surface import Faces
from f3sr.runtime import signals
from f3sr.runtime.subprocesses import die_with, started

LOOK_UP_S = 0.2
"""How often a thread that waits for a worker looks whether all has been called off [s]."""
NO_MEMORY = ("MemoryError", "bad_alloc", "insufficient memory", "allocate memory", "Memory allocation")
"""Last words of Python and of libraries that get no memory: another run may get it."""


@dataclass(frozen=True, kw_only=True)
class WorkerResult:
    fitted: FittedParts | None = None
    reason: str = ""
    cut_short: bool = False


def run_worker(
    vertices: Array, faces: Faces, near: Array, config: ProxyConfig, cancelled: threading.Event | None = None
) -> WorkerResult:
    """Split a normalised mesh in a subprocess of our own, killed at its processor or wall limit."""
    with tempfile.TemporaryFile() as mesh, tempfile.TemporaryFile() as answer, tempfile.TemporaryFile() as errors:
        np.savez(mesh, vertices=vertices, faces=faces, near=near)
        mesh.seek(0)
        with signals.undone(lambda: _start(config, mesh, answer, errors), subprocess.Popen.kill) as process:
            try:
                _wait(process, config.wall_limit_s, cancelled)
            except subprocess.TimeoutExpired:
                return WorkerResult(reason=f"killed after {config.wall_limit_s:g} s", cut_short=True)
            finally:
                process.kill()
                process.wait()
        if process.returncode == 0:
            answer.seek(0)
            return WorkerResult(fitted=unpacked(npz.read_all(answer, "the worker's answer")))
        errors.seek(0)
        return explained(process.returncode, errors.read().decode(errors="replace"), config)


def _start(config: ProxyConfig, stdin: IO[bytes], stdout: IO[bytes], stderr: IO[bytes]) -> subprocess.Popen[bytes]:
    """A worker; its streams are files without a name: nothing is left after ``kill -9``.

    One thread each: the objects are what runs in parallel, and sums keep their order."""
    one_thread: dict[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    return started(
        "f3sr.proxies", config_json(config), environment=one_thread, stdin=stdin, stdout=stdout, stderr=stderr
    )


def _wait(process: subprocess.Popen[bytes], limit_s: float, cancelled: threading.Event | None) -> None:
    """Until a worker ends; TimeoutExpired at the limit, CancelledError when all is called off."""
    deadline = time.monotonic() + limit_s
    while True:
        try:
            process.wait(timeout=max(0.0, min(LOOK_UP_S, deadline - time.monotonic())))
            return
        except subprocess.TimeoutExpired:
            if cancelled is not None and cancelled.is_set():
                raise CancelledError from None
            if time.monotonic() >= deadline:
                raise


def explained(code: int, errors: str, config: ProxyConfig) -> WorkerResult:
    """What an exit code other than 0 means."""
    import signal

    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return WorkerResult(reason=f"killed after {config.cpu_limit_s:g} s of processor time", cut_short=True)
    if any(words in errors for words in NO_MEMORY):
        return WorkerResult(reason="out of memory", cut_short=True)
    if code < 0:
        return WorkerResult(reason=f"crashed with {signal.Signals(-code).name}")
    last = (errors.strip().splitlines() or ["no message"])[-1]
    return WorkerResult(reason=f"failed: {last[:200]}")


def work(config_text: str, parent: str) -> None:
    """The subprocess: read a normalised mesh, write its parts."""
    import resource

    die_with(int(parent))  # elsewhere than on Linux the limit on processor time ends it
    config = TypeAdapter(ProxyConfig).validate_json(config_text)
    seconds = max(1, round(config.cpu_limit_s))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    given = npz.read_all(io.BytesIO(sys.stdin.buffer.read()), "the mesh")
    vertices, faces = given["vertices"], given["faces"]
    answer = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # for the words of the libraries
    fitted = parts.several(vertices, faces, config, given["near"])
    with os.fdopen(answer, "wb") as stream:
        archive = io.BytesIO()
        np.savez(archive, allow_pickle=False, **packed(fitted))
        stream.write(archive.getvalue())
