"""The server's end of the processes that serve projects: few, started when asked for, ended when nobody asks."""

from __future__ import annotations

import itertools
import json
import subprocess
import tempfile
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import IO, cast

from f3sr.errors import F3srError, one_line
from f3sr.mask_page.loopback_server import Reply
from f3sr.runtime.process_end import how_it_ended
from f3sr.runtime.subprocesses import started

MOST_PROCESSES = 3
"""At once: each holds a scene in memory, about half a gigabyte."""
MOST_CALLS = 12
"""Of one project that wait for an answer: all processes together leave some of the server's 40 threads free. A page
that opens makes six."""
IDLE_S = 900.0
"""After so long without a call a process ends [s]; the next call starts it again."""
CALL_S = 300.0
"""Longest call [s]: an edit of a large scene takes half a minute on a slow machine."""


class ServiceEndedError(F3srError):
    """The process of a project ended before it answered. What was saved is still there."""


class ServiceClient:
    """One project's process. Linux ends it with the thread that started it, so a thread of its own does that."""

    def __init__(self, folder: Path) -> None:
        self.used = time.monotonic()
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - it lives as long as the process
        self._lock, self._numbers = threading.Lock(), itertools.count()
        self._waiting: dict[int, Future[Reply]] = {}
        begun = Future[subprocess.Popen[bytes]]()
        threading.Thread(target=self._live, args=(folder, begun), daemon=True).start()
        self._process = begun.result()

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    @property
    def busy(self) -> bool:
        return bool(self._waiting)

    def call(self, name: str, body: bytes = b"") -> Reply:
        """The answer to a call. Raises ServiceEndedError where the process ends or does not answer, F3srError where too
        many calls wait."""
        self.used, number, answer = time.monotonic(), next(self._numbers), Future[Reply]()
        request = json.dumps({"id": number, "call": name, "size": len(body)}).encode() + b"\n" + body
        with self._lock:
            if len(self._waiting) >= MOST_CALLS:
                raise F3srError(f"the project is at work: {MOST_CALLS} questions wait already; try again in a moment")
            self._waiting[number] = answer
            with suppress(OSError):  # told by the thread that reads
                stdin = cast(IO[bytes], self._process.stdin)
                stdin.write(request)
                stdin.flush()
        if not self.alive:
            self._give_up()
        try:
            return answer.result(CALL_S)
        except TimeoutError:
            self.close()
            raise ServiceEndedError(f"no answer within {CALL_S:g} s") from None
        finally:
            self._waiting.pop(number, None)
            self.used = time.monotonic()

    def close(self) -> None:
        """End the process; calls that wait are told."""
        with suppress(OSError):
            self._process.kill()
        self._process.wait()

    def _live(self, folder: Path, begun: Future[subprocess.Popen[bytes]]) -> None:
        """Start the process, and hand every answer to the call that waits for it until the process ends."""
        pipe = subprocess.PIPE
        module = "f3sr.studio.service_process"
        try:
            process = started(module, str(folder), stdin=pipe, stdout=pipe, stderr=self._errors)
        except OSError as error:
            return begun.set_exception(F3srError(f"no process can be started: {error.strerror}"))
        begun.set_result(process)
        stdout = cast(IO[bytes], process.stdout)
        while line := stdout.readline():
            head = json.loads(line)
            body = stdout.read(head["size"])
            if answer := self._waiting.get(head["id"]):
                answer.set_result(Reply(body=body, kind=head["kind"], status=head["status"]))
        process.wait()
        self._give_up()

    def _give_up(self) -> None:
        error = ServiceEndedError(f"the project's process {self._words()}")
        for answer in list(self._waiting.values()):
            if not answer.done():
                answer.set_exception(error)

    def _words(self) -> str:
        """How it ended, with the last line that it wrote to stderr."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return how_it_ended(self._process.wait()) + (f": {one_line(lines[-1])[:300]}" if lines else "")


class ServiceClients:
    """Processes by project's folder."""

    def __init__(self) -> None:
        self._clients: dict[Path, ServiceClient] = {}
        self._lock = threading.Lock()

    def call(self, folder: Path, name: str, body: bytes = b"") -> Reply:
        """Ask a project's process, which is started where none is there."""
        return self._of(folder).call(name, body)

    def end(self, folder: Path) -> None:
        """End a project's process: its files change, or go."""
        with self._lock:
            client = self._clients.pop(folder, None)
        if client:
            client.close()

    def close(self) -> None:
        for folder in list(self._clients):
            self.end(folder)

    def _of(self, folder: Path) -> ServiceClient:
        with self._lock:
            now = time.monotonic()
            for other, client in list(self._clients.items()):
                if not client.alive or (not client.busy and now - client.used > IDLE_S):
                    self._clients.pop(other).close()
            if folder not in self._clients:
                idle = sorted((c.used, f) for f, c in self._clients.items() if not c.busy)
                if len(self._clients) >= MOST_PROCESSES:
                    if not idle:
                        raise F3srError(f"{MOST_PROCESSES} other projects are at work; try again in a moment")
                    self._clients.pop(idle[0][1]).close()
                self._clients[folder] = ServiceClient(folder)
            return self._clients[folder]
