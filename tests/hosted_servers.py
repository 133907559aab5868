"""Loopback servers that speak the services' own wire formats, and do to a request what a fault says."""

from __future__ import annotations

import contextlib
import json
import socket
import ssl
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

FOREVER = 10**9


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a server sends instead of its own reply."""

    status: int = 200
    body: bytes | None = None
    """None is the usual body."""
    headers: dict[str, str] = field(default_factory=dict)
    times: int = FOREVER
    """How many requests of the stage get it."""
    drop: bool = False
    delay: float = 0.0
    drip: float = 0.0
    """Seconds between single bytes."""
    length: int | None = None
    """Another Content-Length than true; -1 sends none."""
    endless: bool = False


@dataclass(frozen=True)
class Heard:
    """A request as it came in."""

    stage: str
    method: str
    path: str
    headers: dict[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


Stages = Callable[[str, str], str]
"""Method and path to the stage of a job that they are."""


@dataclass
class LoopbackServer:
    """A server with replies by stage; ``replies`` and ``faults`` are set anew for every test."""

    port: int
    stage_of: Stages = lambda method, path: "any"
    replies: dict[str, Callable[[int], tuple[str, bytes]]] = field(default_factory=dict)
    """By stage: number of the request, from 0, to Content-Type and body."""
    faults: dict[str, Answer] = field(default_factory=dict)
    heard: list[Heard] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def count(self, stage: str) -> int:
        return sum(h.stage == stage for h in self.heard)

    def reset(self) -> None:
        self.replies, self.faults, self.heard = {}, {}, []


@contextlib.contextmanager
def loopback_server(tls: ssl.SSLContext | None = None) -> Iterator[LoopbackServer]:
    """A server on a free port, with the certificate of ``tls`` where it is given."""

    class Handler(BaseHTTPRequestHandler):
        disable_nagle_algorithm = True

        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            with served.lock:
                stage = served.stage_of(self.command, self.path)
                number = served.count(stage)
                headers = {k.lower(): v for k, v in self.headers.items()}
                served.heard.append(Heard(stage, self.command, self.path, headers, body))
                fault = served.faults.get(stage)
                answer = fault if fault and number < fault.times else Answer()
                known = served.replies.get(stage)
                kind, usual = known(number) if known else ("text/plain", b"nothing here")
            with contextlib.suppress(OSError):
                self._send(answer, kind, usual, known is not None)

        do_GET = do_POST

        def _send(self, answer: Answer, kind: str, usual: bytes, known: bool) -> None:
            time.sleep(answer.delay)
            if answer.drop:
                self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                self.connection.close()
                return
            body = usual if answer.body is None else answer.body
            self.send_response(answer.status if known else 404)
            self.send_header("Content-Type", kind)
            for name, value in answer.headers.items():
                self.send_header(name, value)
            if answer.length != -1 and not answer.endless:
                self.send_header("Content-Length", str(len(body) if answer.length is None else answer.length))
            self.end_headers()
            while answer.endless:
                self.wfile.write(body + b" " * 65536)
            for k in range(len(body) if answer.drip else 0):
                self.wfile.write(body[k : k + 1])
                self.wfile.flush()
                time.sleep(answer.drip)
            if not answer.drip:
                self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    server.block_on_close = False
    server.handle_error = lambda request, client_address: None  # clients that go away are a part of the tests
    if tls:
        server.socket = tls.wrap_socket(server.socket, server_side=True)
    served = LoopbackServer(server.server_address[1])
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    try:
        yield served
    finally:
        server.shutdown()
        server.server_close()


# --- wire formats ---------------------------------------------------------------------------------------------------

Json = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Wire:
    """One service's replies; each function takes what the test wants to be in them."""

    name: str
    stage_of: Stages
    ticket: Callable[[str, str, str], Json]
    """Id, URL of the state and URL of the result; services without such URLs put them into the id."""
    state: Callable[[str, str | None], Json]
    """"waiting", "done", "failed" or another word; and why."""
    result: Callable[[list[Any]], Json]
    """URLs of meshes, one per object."""
    separate: bool = False
    """Whether the result is a request of its own."""
    objects: int = 1
    """Of the photo, for one job."""


API_ID = "job-7_a.1"
Q = "/fal-ai/x/requests/job-7_a.1"


def _fal_stage(method: str, path: str) -> str:
    if method == "POST":
        return "submit"
    return "poll" if path.startswith(Q + "/status") else "result" if path == Q else "unknown"


def _fal_ticket(id: str, poll: str, result: str) -> Json:
    return {"request_id": id, "status_url": poll, "response_url": result, "cancel_url": "x", "queue_position": 0}


def _fal_state(word: str, why: str | None) -> Json:
    words = {"waiting": "IN_QUEUE", "done": "COMPLETED", "failed": "COMPLETED"}
    return {"status": words.get(word, word), "queue_position": 1, "logs": None} | ({"error": why} if why else {})


def _fal_result(urls: list[Any]) -> Json:
    return {"model_glb": {"url": urls[0], "content_type": "model/gltf-binary", "file_size": 1}}


def sam3d_pose(k: int, **changed: Any) -> Json:
    half = 0.5**0.5
    pose = {"rotation": [[half, 0.0, half, 0.0]], "translation": [[0.1 * k, 0.2, 1.5]], "scale": [[0.3, 0.3, 0.3]]}
    return {"object_index": k, "camera_pose": None} | pose | changed


def _sam3d_result(urls: list[Any]) -> Json:
    return {
        "model_glb": {"url": "http://127.0.0.1:1/merged.glb"},
        "individual_glbs": [{"url": url} if url is not None else None for url in urls],
        "metadata": [sam3d_pose(k) for k in reversed(range(len(urls)))],
    }


def _tripo_stage(method: str, path: str) -> str:
    if method == "POST":
        return {"/v2/openapi/upload": "upload", "/v2/openapi/task": "submit"}.get(path, "unknown")
    return "poll" if path == f"/v2/openapi/task/{API_ID}" else "unknown"


def _replicate_state(word: str, why: str | None) -> Json:
    words = {"waiting": "processing", "done": "succeeded"}
    return {"id": API_ID, "status": words.get(word, word), "error": why, "output": None}


def _meshy_state(word: str, why: str | None) -> Json:
    words = {"waiting": "PENDING", "done": "SUCCEEDED", "failed": "FAILED"}
    return {"id": API_ID, "status": words.get(word, word), "progress": 0, "task_error": {"message": why or ""}}


def _tripo_state(word: str, why: str | None) -> Json:
    words = {"waiting": "running", "done": "success"}
    return {"code": 0, "data": {"task_id": API_ID, "status": words.get(word, word), "error_msg": why, "output": {}}}


def _id_or_url(id: str, *urls: str) -> str:
    """Services that give no URLs: a URL of the test's that is not the usual one takes the id's place."""
    return next((url for url in urls if API_ID not in url), id)


FAL = {"stage_of": _fal_stage, "ticket": _fal_ticket, "state": _fal_state, "separate": True}
WIRES = {
    w.name: w
    for w in (
        Wire(name="fal-sam3d", result=_sam3d_result, objects=2, **FAL),
        Wire(name="fal-trellis2", result=_fal_result, **FAL),
        Wire(name="fal-hunyuan", result=_fal_result, **FAL),
        Wire(
            name="replicate",
            stage_of=lambda m, p: {"POST /v1/predictions": "submit", f"GET {Q}/status": "poll"}.get(
                f"{m} {p}", "unknown"
            ),
            ticket=lambda id, poll, result: {
                "id": id,
                "status": "starting",
                "urls": {"get": poll if API_ID in result else result, "cancel": "x"},
            },
            state=_replicate_state,
            result=lambda urls: {"output": {"color_video": None, "model_file": urls[0]}},
        ),
        Wire(
            name="meshy",
            stage_of=lambda m, p: {
                "POST /openapi/v1/image-to-3d": "submit",
                f"GET /openapi/v1/image-to-3d/{API_ID}": "poll",
            }.get(f"{m} {p}", "unknown"),
            ticket=lambda id, poll, result: {"result": _id_or_url(id, poll, result)},
            state=_meshy_state,
            result=lambda urls: {"model_urls": {"glb": urls[0], "fbx": "x"}},
        ),
        Wire(
            name="tripo",
            stage_of=_tripo_stage,
            ticket=lambda id, poll, result: {"code": 0, "data": {"task_id": _id_or_url(id, poll, result)}},
            state=_tripo_state,
            result=lambda urls: {"data": {"output": {"pbr_model": urls[0]}}},
        ),
        Wire(
            name="hunyuan-server",
            stage_of=lambda m, p: "submit" if f"{m} {p}" == "POST /generate" else "unknown",
            ticket=lambda id, poll, result: {},
            state=lambda word, why: {},
            result=lambda urls: {},
        ),
    )
}


def merged(one: Json, other: Json) -> Json:
    """Both objects; inner objects likewise."""
    out = dict(one)
    for name, value in other.items():
        inner = out.get(name)
        out[name] = merged(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
    return out
