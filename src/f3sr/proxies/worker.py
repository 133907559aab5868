"""Decomposing in processes that may be killed: by limits on time, by Ctrl-C, by running out of memory.

A worker has everything imported, and forks one process a mesh. So a mesh leaves nothing behind for the next one, and a
crash or a limit ends that process alone.
"""

from __future__ import annotations

import gc
import importlib
import os
import resource
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Generator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
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
LIBRARIES = ("fast_simplification", "manifold3d", "scipy.ndimage", "scipy.sparse.csgraph", "scipy.spatial")
"""What decomposing a mesh imports where it is used."""


@dataclass(frozen=True, kw_only=True)
class WorkerResult:
    fitted: FittedParts | None = None
    reason: str = ""
    cut_short: bool = False


class ProxyWorker:
    """Splits one mesh after another, by a worker process that the first mesh starts.

    Linux ends the process with the thread that started it. Any thread may set ``cancelled``."""

    def __init__(self, config: ProxyConfig, cancelled: threading.Event | None = None) -> None:
        self.config, self.cancelled = config, cancelled or threading.Event()
        self.running: _WorkerProcess | None = None
        self.ending = ExitStack()

    def __enter__(self) -> ProxyWorker:
        return self

    def __exit__(self, *_: object) -> None:
        self.ending.close()

    def split(self, vertices: Array, faces: Faces) -> WorkerResult:
        """The parts of a normalised mesh, or why there are none. Raises CancelledError when all is called off."""
        if self.running is None or self.running.process.poll() is not None:
            self.ending.close()
            self.running = self.ending.enter_context(_running(self.config))
        with tempfile.TemporaryFile() as mesh, tempfile.TemporaryFile() as answer:
            np.savez(mesh, vertices=vertices, faces=faces)
            mesh.seek(0)
            code = self.running.exit_code(mesh, answer, self.cancelled)
            words = self.running.words()
            if code != 0:
                return explained(code, words, self.config)
            answer.seek(0)
            return WorkerResult(fitted=unpacked(npz.read_all(answer, "the worker's answer")))


@dataclass(frozen=True, eq=False, kw_only=True)
class _WorkerProcess:
    """A worker process from outside."""

    process: subprocess.Popen[bytes]
    channel: socket.socket
    errors: IO[bytes]

    def exit_code(self, mesh: IO[bytes], answer: IO[bytes], cancelled: threading.Event) -> int:
        """Of the process that reads ``mesh`` and writes ``answer``; of the worker if that is what ends."""
        with suppress(ConnectionError):
            socket.send_fds(self.channel, [b"."], [mesh.fileno(), answer.fileno()])
            if reply := self._reply(cancelled):
                return int(reply)
        return self.process.wait() or 1

    def _reply(self, cancelled: threading.Event) -> bytes:
        while not cancelled.is_set():
            with suppress(TimeoutError):
                return self.channel.recv(16)
        raise CancelledError

    def words(self) -> str:
        """What it wrote to stderr since the last call."""
        self.errors.seek(0)
        words = self.errors.read().decode(errors="replace")
        self.errors.seek(0)
        self.errors.truncate()
        return words


@contextmanager
def _running(config: ProxyConfig) -> Generator[_WorkerProcess]:
    """A worker process that ends with the block. Its files have no name: nothing is left after ``kill -9``."""
    ours, theirs = socket.socketpair()
    ours.settimeout(LOOK_UP_S)
    with tempfile.TemporaryFile() as errors, ours:

        def start() -> subprocess.Popen[bytes]:
            with theirs:
                return started(
                    "f3sr.proxies",
                    config_json(config),
                    stdin=theirs.fileno(),
                    stdout=subprocess.DEVNULL,  # for the words of the libraries
                    stderr=errors,
                )

        with signals.undone(start, _kill) as process:
            try:
                yield _WorkerProcess(process=process, channel=ours, errors=errors)
            finally:
                _kill(process)
                process.wait()


def _kill(process: subprocess.Popen[bytes]) -> None:
    """A worker and what it forked: both are in the process group that it began."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)


def explained(code: int, errors: str, config: ProxyConfig) -> WorkerResult:
    """What an exit code other than 0 means."""
    if -code in (signal.SIGXCPU, signal.SIGKILL):
        return WorkerResult(reason=f"killed after {config.cpu_limit_s:g} s of processor time", cut_short=True)
    if -code == signal.SIGALRM:
        return WorkerResult(reason=f"killed after {config.wall_limit_s:g} s", cut_short=True)
    if any(words in errors for words in NO_MEMORY):
        return WorkerResult(reason="out of memory", cut_short=True)
    if code < 0:
        return WorkerResult(reason=f"crashed with {signal.Signals(-code).name}")
    last = (errors.strip().splitlines() or ["no message"])[-1]
    return WorkerResult(reason=f"failed: {last[:200]}")


def serve(config_text: str, parent: str) -> None:
    """The life of a worker: it forks a process for every mesh and tells its exit code, until nobody asks any more."""
    die_with(int(parent))  # elsewhere than on Linux it ends as nobody asks
    config = TypeAdapter(ProxyConfig).validate_json(config_text)
    load()
    gc.collect()
    gc.freeze()  # a collection in a fork would copy all pages that it shares with this process
    own = os.getpid()
    with socket.socket(fileno=0) as channel:
        while streams := socket.recv_fds(channel, 1, 2)[1]:
            child = os.fork()
            if child == 0:
                die_with(own)
                return _work(config, *streams)
            for stream in streams:
                os.close(stream)
            _, status = os.waitpid(child, 0)
            channel.sendall(str(os.waitstatus_to_exitcode(status)).encode())


def load() -> None:
    """Import what meshes need. That starts no thread: a fork would not have it."""
    for library in LIBRARIES:
        importlib.import_module(library)


def _work(config: ProxyConfig, mesh: int, answer: int) -> None:
    """The life of a mesh's process: read it, normalised, from one descriptor, and write its parts to another."""
    seconds = max(1, round(config.cpu_limit_s))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, config.wall_limit_s)
    with open(mesh, "rb") as stream:
        given = npz.read_all(stream, "the mesh")
    fitted = parts.several(given["vertices"], given["faces"], config)
    with open(answer, "wb") as stream:
        np.savez(stream, allow_pickle=False, **packed(fitted))
