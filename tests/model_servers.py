"""A loopback server that speaks OpenAI's chat completions and Anthropic's messages, and says what a script wants."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from PIL import Image


@dataclass(frozen=True)
class Asked:
    """A request as it came in."""

    path: str
    headers: dict[str, str]
    body: dict[str, Any]

    @property
    def texts(self) -> list[str]:
        """All texts of the messages, in order."""
        return [part["text"] for part in self._parts() if part.get("type") == "text"]

    @property
    def images(self) -> list[Image.Image]:
        """The pictures of the messages, decoded."""
        found = list[Image.Image]()
        for part in self._parts():
            if part.get("type") == "image_url":
                found.append(_decoded(part["image_url"]["url"].partition("base64,")[2]))
            if part.get("type") == "image":
                found.append(_decoded(part["source"]["data"]))
        return found

    @property
    def mode(self) -> str:
        """How the form of the answer is asked for."""
        form = (self.body.get("response_format") or {}).get("type")
        if form is None and (self.body.get("output_config") or self.body.get("output_format")):
            form = "json_schema"
        return form or ("tool" if self.body.get("tools") else "text")

    @property
    def instructions(self) -> str:
        """The system prompt."""
        system = self.body.get("system")
        if isinstance(system, list):
            return "".join(part["text"] for part in system)
        return system or "".join(m["content"] for m in self.body["messages"] if m["role"] in ("system", "developer"))

    def _parts(self) -> Iterator[dict[str, Any]]:
        for message in self.body["messages"]:
            if message["role"] == "user":
                content = message["content"]
                yield from [{"type": "text", "text": content}] if isinstance(content, str) else content


def _decoded(data: str) -> Image.Image:
    image = Image.open(io.BytesIO(base64.b64decode(data, validate=True)))
    image.load()
    return image


@dataclass(frozen=True, kw_only=True)
class Reply:
    """What is sent back, byte by byte where ``raw`` says so."""

    text: str | None = None
    """Of the assistant; as a call of the tool where the request has one and ``tool`` is not empty."""
    tool: str = "answer"
    status: int = 200
    finish: str | None = None
    body: bytes | None = None
    """Instead of a reply of the API."""
    headers: dict[str, str] = field(default_factory=dict[str, str])
    delay: float = 0.0
    """Before anything is sent [s]."""
    drip: float = 0.0
    """Between bytes [s]."""
    drop: bool = False
    """Closes the connection without a word."""
    length: int | None = None
    """Another Content-Length than true."""
    endless: bool = False
    calls: int = 1
    """How many calls of the tool."""


Script = Sequence[Reply | str] | Callable[[Asked], Reply | str]


@dataclass
class ModelServer:
    """The server: where it is, and what it was asked."""

    url: str
    asked: list[Asked]


@contextlib.contextmanager
def model_server(script: Script) -> Iterator[ModelServer]:
    """A server on a free port; of a list, the last reply is given again and again."""
    asked = list[Asked]()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            asked.append(Asked(self.path, {k.lower(): v for k, v in self.headers.items()}, body))
            reply = script(asked[-1]) if callable(script) else script[min(len(asked), len(script)) - 1]
            with contextlib.suppress(OSError):
                self._send(Reply(text=reply) if isinstance(reply, str) else reply, asked[-1])

        do_GET = do_POST

        def _send(self, reply: Reply, request: Asked) -> None:
            time.sleep(reply.delay)
            if reply.drop:
                self.connection.close()
                return
            data = reply.body if reply.body is not None else json.dumps(_api(reply, request)).encode()
            self.send_response(reply.status)
            self.send_header("Content-Type", "application/json")
            for name, value in reply.headers.items():
                self.send_header(name, value)
            if not reply.endless:
                self.send_header("Content-Length", str(len(data) if reply.length is None else reply.length))
            self.end_headers()
            while reply.endless:
                self.wfile.write(b'{"x": "' + b"a" * 65536)
            if not reply.drip:
                self.wfile.write(data)
            for k in range(len(data) if reply.drip else 0):
                self.wfile.write(data[k : k + 1])
                self.wfile.flush()
                time.sleep(reply.drip)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    try:
        yield ModelServer(f"http://127.0.0.1:{server.server_address[1]}", asked)
    finally:
        server.shutdown()
        server.server_close()


def _api(reply: Reply, request: Asked) -> dict[str, Any]:
    """The reply in the form of the API that was asked."""
    if reply.status >= 400:
        return {"error": {"message": reply.text or "no", "type": "error"}}
    by_tool = request.mode == "tool" and bool(reply.tool) and reply.text is not None
    if "messages" in request.path and "chat" not in request.path:
        return _anthropic(reply, by_tool)
    call = {"id": "c1", "type": "function", "function": {"name": reply.tool, "arguments": reply.text}}
    message: dict[str, Any] = {"role": "assistant", "content": None if by_tool else reply.text}
    if by_tool:
        message["tool_calls"] = [call | {"id": f"c{k}"} for k in range(reply.calls)]
    finish = reply.finish or ("tool_calls" if by_tool else "stop")
    return {
        "id": "x",
        "object": "chat.completion",
        "created": 1,
        "model": request.body["model"],
        "choices": [{"index": 0, "message": message, "finish_reason": finish}],
        "usage": {"prompt_tokens": 11, "completion_tokens": 7, "total_tokens": 18},
    }


def _anthropic(reply: Reply, by_tool: bool) -> dict[str, Any]:
    try:
        values = json.loads(reply.text or "")
    except ValueError:
        values = {"not": "json"}
    call = {"type": "tool_use", "name": reply.tool, "input": values if isinstance(values, dict) else {"value": values}}
    calls = [call | {"id": f"c{k}"} for k in range(reply.calls)]
    finish = {"length": "max_tokens", "content_filter": "refusal"}.get(reply.finish or "", "end_turn")
    return {
        "id": "x",
        "type": "message",
        "role": "assistant",
        "model": "m",
        "content": calls if by_tool else [{"type": "text", "text": reply.text or ""}],
        "stop_reason": "tool_use" if by_tool else finish,
        "stop_sequence": None,
        "usage": {"input_tokens": 11, "output_tokens": 7},
    }
