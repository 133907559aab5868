"""Processes of Python that start in 20 ms: forks of one process that has all of f3sr imported, before any thread.

``Popen`` takes the commands of Python: ``[sys.executable, "-m", MODULE, ...]``, with ``"-c", CODE`` or a file. What
it starts is a child of the caller with a pid, a process group, signals, limits, streams, a folder and an environment of
its own, and runs the module, the code or the file as ``__main__``. No kernel is compiled or loaded before. One thing is
unlike a new interpreter: modules are imported already. So tests of a start, of its hash seed or of the memory that
imports take use ``subprocess``. Linux only; elsewhere ``Popen`` is that of ``subprocess``.
"""

from __future__ import annotations

import ctypes
import fcntl
import gc
import importlib
import os
import pickle
import runpy
import socket
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from f3sr.runtime import result_store
from f3sr.runtime.machine import ONE_THREAD

PR_SET_CHILD_SUBREAPER = 36
"""From Linux' sys/prctl.h: orphans of this process's offspring become its children."""
ABOVE = 200
"""A descriptor above all that a caller names."""
LARGEST = 1 << 18
"""Of a request [bytes]: the environment is most of it."""
LOADED = (
    *("f3sr.cli.main", "f3sr.pipeline", "f3sr.delivery", "f3sr.scene_samples", "f3sr.proxies.worker"),
    *("f3sr.scene_package.package", "f3sr.report_page", "f3sr.exporters.protocol", "mujoco", "manifold3d"),
    *("fast_simplification", "scipy.optimize", "scipy.spatial", "scipy.ndimage", "scipy.special", "rich.table"),
    *("f3sr.lifting.lifted_assets", "f3sr.metrology.ground_metrology", "highspy", "trimesh", "typeguard", "jinja2"),
)
"""What runs of the command import, early or late."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """A process to start, as a pickle; its descriptors come beside it."""

    command: list[str]
    folder: str
    environment: dict[str, str]
    process_group: int
    """Of the caller, or 0 for one of its own."""
    session: bool
    """Whether it has a session of its own, and then a group."""
    descriptors: list[int]
    """Their numbers in the process: 0, 1, 2 and those that are passed."""
    first: Any
    """Called before anything else, as ``preexec_fn``; None for nothing."""


class _Forked(subprocess.Popen[Any]):
    """``subprocess.Popen`` of which the last step is done by another process. ``preexec_fn`` must be picklable."""

    def _execute_child(
        self, args: Sequence[str], executable: Any, preexec_fn: Any, close_fds: bool, pass_fds: Sequence[int], cwd: Any,
        env: Any, startupinfo: Any, creationflags: Any, shell: bool, p2cread: int, p2cwrite: int, c2pread: int,
        c2pwrite: int, errread: int, errwrite: int, *more: Any,
    ) -> None:  # fmt: skip
        assert args[0] == sys.executable and close_fds and not shell
        streams = [given if given != -1 else k for k, given in enumerate((p2cread, c2pwrite, errwrite))]
        session, process_group = more[-2:]
        request = Request(
            command=list(map(str, args[1:])),
            folder=str(cwd or Path.cwd()),
            environment=dict(env or os.environ),
            process_group=os.getpgrp() if process_group == -1 else process_group,
            session=session,
            descriptors=[0, 1, 2, *pass_fds],
            first=preexec_fn,
        )
        socket.send_fds(_server(), [pickle.dumps(request)], [*streams, *pass_fds])
        self.pid = int(_server().recv(16))
        self._child_created = True
        self._close_pipe_fds(p2cread, p2cwrite, c2pread, c2pwrite, errread, errwrite)  # type: ignore[attr-defined]


Popen = _Forked if sys.platform == "linux" else subprocess.Popen
FOR_SUBPROCESS = SimpleNamespace(Popen=Popen, DEVNULL=subprocess.DEVNULL)
"""What a module may have in the place of ``subprocess``."""


def run(command: Sequence[str], *, check: bool = False, **more: Any) -> subprocess.CompletedProcess[str]:
    """``subprocess.run`` of such a process, with what it says as text."""
    with Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more) as process:
        said, errors = process.communicate()
    done = subprocess.CompletedProcess(command, process.returncode, said, errors)
    if check:
        done.check_returncode()
    return done


def started(module: str, *arguments: str, stdin: Any, stdout: Any, stderr: Any) -> subprocess.Popen[bytes]:
    """As ``f3sr.runtime.subprocesses.started``."""
    command = [sys.executable, "-m", module, *arguments, str(os.getpid())]
    environment = {**os.environ, **ONE_THREAD}
    return Popen(command, env=environment, process_group=0, stdin=stdin, stdout=stdout, stderr=stderr)


@cache
def _server() -> socket.socket:
    """The way to the process that forks. It ends with this one."""
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with theirs:
        subprocess.Popen(
            [sys.executable, str(Path(__file__).resolve()), str(theirs.fileno())],
            env=environment, pass_fds=[theirs.fileno()], process_group=0, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    return ours


def serve(channel: socket.socket) -> Request:
    """Fork a process for every request and tell its pid. Returns in the process that is to become what was asked for.

    It is forked by a process in between, which ends: so it becomes a child of the caller, who alone waits for it."""
    while True:
        data, given, *_ = socket.recv_fds(channel, LARGEST, 64)
        if not data:
            os._exit(0)
        request = pickle.loads(data)
        assert isinstance(request, Request)
        ear, mouth = os.pipe()
        told, tell = os.pipe()
        between = os.fork()
        if not between:
            if os.fork():
                os._exit(0)
            os.setsid() if request.session else os.setpgid(0, request.process_group)
            os.write(tell, str(os.getpid()).encode())
            for unused in (mouth, told, tell, channel.detach()):
                os.close(unused)
            os.read(ear, 1)  # until it has its parent
            os.close(ear)
            _take(given, request.descriptors)
            return request
        os.waitpid(between, 0)
        pid = os.read(told, 16)
        for unused in (ear, mouth, told, tell, *given):
            os.close(unused)
        channel.send(pid)


def _take(given: Sequence[int], numbers: Sequence[int]) -> None:
    """Give the descriptors their numbers."""
    high = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, ABOVE) for descriptor in given]
    for descriptor in given:
        os.close(descriptor)
    for descriptor, number in zip(high, numbers, strict=True):
        os.dup2(descriptor, number)
        os.close(descriptor)


def become(request: Request) -> None:
    """Run what was asked for, as a new interpreter would."""
    os.chdir(request.folder)
    os.environ.clear()
    os.environ.update(request.environment)
    for number, name in enumerate(("stdin", "stdout", "stderr")):  # those of the server are of other files
        mode, buffering, errors = ("w" if number else "r"), (1 if number == 2 else -1), ("backslashreplace", "strict")
        stream = open(number, mode, buffering, "utf-8", errors[number != 2], closefd=False)  # noqa: SIM115
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)
    if request.first:
        request.first()
    kind, *arguments = request.command
    place = {"-m": request.folder, "-c": ""}.get(kind, str(Path(kind).parent))
    added = [path for path in request.environment.get("PYTHONPATH", "").split(os.pathsep) if path]
    sys.path[:] = list(dict.fromkeys([place, *added, *sys.path[1:]]))
    if kind == "-m":
        sys.argv = arguments
        runpy.run_module(arguments[0], run_name="__main__", alter_sys=True)
    elif kind == "-c":
        sys.argv = ["-c", *arguments[1:]]
        exec(compile(arguments[0], "<string>", "exec"), {"__name__": "__main__"})
    else:
        sys.argv = request.command
        runpy.run_path(kind, run_name="__main__")


if __name__ == "__main__":
    import forked  # requests are pickles of this module's class

    for name in LOADED:
        importlib.import_module(name)
    result_store.code_version()  # of what is imported, whatever is edited from here on
    gc.collect()
    gc.freeze()  # a collection in a fork would copy all pages that it shares with this process
    assert len([*Path("/proc/self/task").iterdir()]) == 1, "a thread, which a fork would not have"
    forked.become(forked.serve(socket.socket(fileno=int(sys.argv[1]))))
