"""Inside the process that serves one project: requests on stdin, answers on stdout, several at a time.

A request is one JSON line with ``id``, ``call`` and ``size``, then so many bytes of a body. An answer is one JSON line
with ``id``, ``status``, ``kind`` (media type) and ``size``, then so many bytes.
"""

from __future__ import annotations

import json
import os
import resource
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO

from f3sr.errors import F3srError, InputError, unforeseen
from f3sr.mask_page.loopback_server import Reply, json_reply
from f3sr.runtime.subprocesses import die_with
from f3sr.studio.scene_service import SceneService
from f3sr.studio.workspace import read_project

THREADS = 4
"""Calls at a time: while the ground is sought in a photo, boxes are still answered."""
MEMORY_BYTES = 8_000_000_000
"""Most private memory of the process: an edited scene of twenty objects takes one."""


def serve(folder: Path, parent: int) -> None:
    """Answer until stdin ends."""
    die_with(parent)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # words of libraries
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY_BYTES, MEMORY_BYTES))
    service, lock, requests = (
        SceneService(read_project(folder)),
        threading.Lock(),
        sys.stdin.buffer,
    )
    with ThreadPoolExecutor(THREADS) as threads:
        while line := requests.readline():
            request = json.loads(line)
            threads.submit(_answer, service, request, requests.read(request["size"]), answers, lock)


def _answer(
    service: SceneService, request: dict[str, str], body: bytes, answers: IO[bytes], lock: threading.Lock
) -> None:
    reply = _reply(service, request["call"], body)
    head = {"id": request["id"], "status": reply.status, "kind": reply.kind, "size": len(reply.body)}
    with lock:
        answers.write(json.dumps(head).encode() + b"\n" + reply.body)
        answers.flush()
    reply.sent()


def _reply(service: SceneService, call: str, body: bytes) -> Reply:
    """The answer to one call, or one line that says what is wrong."""
    try:
        return service.calls[call](body)
    except InputError as error:
        return json_reply({"problem": str(error)}, status=422)
    except F3srError as error:
        return json_reply({"problem": str(error)}, status=409)
    except Exception as error:  # the process goes on
        return json_reply({"problem": unforeseen(error, "nothing was changed")}, status=500)


if __name__ == "__main__":
    serve(Path(sys.argv[1]), int(sys.argv[-1]))
