"""A web server for one page and its user: on the loopback address only, and silent to whoever lacks its token.

Other users of the machine and pages of other sites can reach the port. They know neither the token nor may they name
another host (DNS rebinding), send forms (Origin), keep connections for long, or send much.
"""

from __future__ import annotations

import io
import json
import secrets
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

HOST = "127.0.0.1"
MAX_BODY = 2_000_000
"""Bytes of a request's body: 500 objects with fifty strokes' points each take 1 MB."""
MAX_HEAD = 64_000
"""Bytes of a request before its body: browsers send cookies of all servers on the loopback address."""
MAX_CONNECTIONS = 32
"""Open at once: a browser opens six, and an attacker's are gone after ``HEAD_S``."""
HEAD_S = 5.0
"""How long a request line and headers may take [s]."""
BODY_S = 10.0
"""How long a body may take [s]: it comes from the same machine."""
SEND_S = 30.0
"""How long an answer may take to be read [s]."""
DRAIN_S = 1.0
"""How long the rest of a refused request may come [s]."""
BEAT_S = 5.0
"""Pause between signs of life to an open page [s]."""
TOKEN_BYTES = 32
"""Of the secret in the address: nobody guesses 256 bits."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Of every answer. The document has the rest of its policy in itself, with the hashes of its script and style."""


@dataclass(frozen=True, kw_only=True)
class Reply:
    """An answer to a request."""

    body: bytes
    kind: str = "application/json"
    """Media type."""
    status: int = 200
    sent: Callable[[], object] = field(default=lambda: None)
    """Called once the answer is out."""


def json_reply(value: Mapping[str, Any], *, status: int = 200, sent: Callable[[], object] = lambda: None) -> Reply:
    body = json.dumps(value, allow_nan=False, separators=(",", ":")).encode()
    return Reply(body=body, status=status, sent=sent)


Route = Callable[[bytes], Reply]
"""From the body of a request, empty for GET, to the answer."""


class RequestRefusedError(Exception):
    """A request that gets one line for an answer."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status, self.why = status, why


class Presence:
    """How many pages are open, by their open connections: unlike timers, browsers do not slow these down."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open = 0
        self._left: float | None = None

    def enter(self) -> None:
        with self._lock:
            self._open += 1
            self._left = None

    def leave(self) -> None:
        with self._lock:
            self._open -= 1
            self._left = None if self._open else time.monotonic()

    def absent_for(self) -> float:
        """Seconds since the last page closed; 0 while one is open, or before the first one is."""
        with self._lock:
            return 0.0 if self._left is None else time.monotonic() - self._left


class LoopbackServer(ThreadingHTTPServer):
    """Serves ``routes``, by method and name, below a secret path. ``refused`` is told why a request was refused."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = 64

    def __init__(self, routes: Mapping[tuple[str, str], Route], refused: Callable[[str], object]) -> None:
        super().__init__((HOST, 0), PageRequest)
        self.routes, self.refused = routes, refused
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self.presence, self.ended = Presence(), threading.Event()
        self._slots = threading.BoundedSemaphore(MAX_CONNECTIONS)
        self._lock = threading.Lock()
        self._once: str | None = secrets.token_urlsafe(TOKEN_BYTES)
        self._once_path = f"/{self._once}/"

    @property
    def port(self) -> int:
        return int(self.server_address[1])

    @property
    def address(self) -> str:
        """Of the page; whoever has it may use it."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    @property
    def address_once(self) -> str:
        """Leads to the page once. A browser's command line, which every user of the machine can list, gets this one."""
        return f"http://{HOST}:{self.port}{self._once_path}"

    def hosts(self) -> tuple[str, str]:
        """What the Host header may say: a forwarded port keeps its number, and may be called localhost."""
        return f"{HOST}:{self.port}", f"localhost:{self.port}"

    def has_token(self, word: str) -> bool:
        return secrets.compare_digest(word.encode(), self.token.encode())

    def takes_once(self, word: str) -> bool:
        """Whether this is the word that counts once, which it then has done."""
        with self._lock:
            if self._once is None or not secrets.compare_digest(word.encode(), self._once.encode()):
                return False
            self._once = None
            return True

    def process_request(self, request: Any, client_address: Any) -> None:
        if not self._slots.acquire(blocking=False):
            self.refused(f"more than {MAX_CONNECTIONS} connections at once")
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._slots.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A connection that breaks is no news: the page asks again."""


class TimedReader(io.RawIOBase):
    """Reads a socket until a point in time, and no more than so many bytes, however slowly these come."""

    def __init__(self, connection: socket.socket, *, seconds: float, most: int) -> None:
        self._connection = connection
        self.allow(seconds, most)

    def allow(self, seconds: float, most: int) -> None:
        self._end, self._left = time.monotonic() + seconds, most

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any, /) -> int:
        seconds = self._end - time.monotonic()
        if seconds <= 0 or self._left <= 0:
            raise TimeoutError
        self._connection.settimeout(seconds)
        count = self._connection.recv_into(memoryview(buffer)[: self._left])
        self._left -= count
        return count


class PageRequest(BaseHTTPRequestHandler):
    """One request, then the connection is closed."""

    server: LoopbackServer  # pyright: ignore[reportIncompatibleVariableOverride]
    protocol_version = "HTTP/1.0"

    def setup(self) -> None:
        super().setup()
        self._reader = TimedReader(self.connection, seconds=HEAD_S, most=MAX_HEAD)
        self.rfile = io.BufferedReader(self._reader)

    def do_GET(self) -> None:
        self._answered("GET")

    def do_POST(self) -> None:
        self._answered("POST")

    def _answered(self, method: str) -> None:
        try:
            name = self._admitted()
            if (method, name) == ("GET", "alive"):
                return self._stay()
            route = self.server.routes.get((method, name))
            if route is None:
                raise RequestRefusedError(HTTPStatus.NOT_FOUND, "no such page")
            reply = route(self._body() if method == "POST" else b"")
        except RequestRefusedError as refusal:
            return self._refuse(refusal.status, refusal.why)
        self._send(reply)
        reply.sent()

    def _admitted(self) -> str:
        """What the holder of the token asks for. Others learn nothing, not even what was wrong."""
        nothing = RequestRefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        word, _, name = self.path.removeprefix("/").partition("/")
        if self.headers.get_all("Host") not in [[host] for host in self.server.hosts()]:
            self.server.refused("another host's name")
            raise nothing
        if self.command == "GET" and not name and self.server.takes_once(word):
            raise RequestRefusedError(HTTPStatus.SEE_OTHER, "this way")
        if not self.server.has_token(word):
            self.server.refused("no token")
            raise nothing
        return name

    def _body(self) -> bytes:
        """Of a request that the page itself sent."""
        if self.headers.get_all("Origin") != [f"http://{self.headers['Host']}"]:
            raise RequestRefusedError(HTTPStatus.FORBIDDEN, "not sent by the page")
        if self.headers.get_content_type() != "application/json":
            raise RequestRefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "not JSON")
        lengths = self.headers.get_all("Content-Length") or []
        if "Transfer-Encoding" in self.headers or len(lengths) != 1 or not _is_count(lengths[0]):
            raise RequestRefusedError(HTTPStatus.LENGTH_REQUIRED, "no single Content-Length")
        if (size := int(lengths[0])) > MAX_BODY:
            raise RequestRefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"more than {MAX_BODY:,} bytes")
        self._reader.allow(BODY_S, MAX_BODY)
        try:
            body = self.rfile.read(size)
        except TimeoutError:
            raise RequestRefusedError(HTTPStatus.REQUEST_TIMEOUT, f"a body that took over {BODY_S:g} s") from None
        if len(body) < size:
            raise RequestRefusedError(HTTPStatus.BAD_REQUEST, "less than the Content-Length")
        return body

    def _stay(self) -> None:
        """Keep the connection of an open page until either end goes."""
        self.connection.settimeout(BEAT_S)
        self.server.presence.enter()
        try:
            self._head(200, "text/plain", None)
            while not self.server.ended.is_set():
                self.wfile.write(b".")
                with suppress(TimeoutError):
                    self.connection.recv(1)
                    return
        finally:
            self.server.presence.leave()

    def _refuse(self, status: int, why: str) -> None:
        if status not in (HTTPStatus.NOT_FOUND, HTTPStatus.SEE_OTHER):
            self.server.refused(why)
        self._send(Reply(body=f"{why}\n".encode(), kind="text/plain; charset=utf-8", status=int(status)))
        self._drain()

    def _drain(self) -> None:
        """Let the rest of a refused request come, for a moment: closing before would reset the answer on its way."""
        with suppress(OSError):
            self.connection.shutdown(socket.SHUT_WR)
            self._reader.allow(DRAIN_S, 2 * MAX_BODY)
            while self._reader.read(MAX_HEAD):
                pass

    def _send(self, reply: Reply) -> None:
        self.connection.settimeout(SEND_S)
        self._head(reply.status, reply.kind, len(reply.body))
        self.wfile.write(reply.body)
        self.wfile.flush()

    def _head(self, status: int, kind: str, size: int | None) -> None:
        self.send_response_only(status)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        if size is not None:
            self.send_header("Content-Length", str(size))
        if status == HTTPStatus.SEE_OTHER:
            self.send_header("Location", f"/{self.server.token}/")
        self.send_header("Connection", "close")
        self.end_headers()

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """What the standard library refuses by itself: requests that are none, and other methods."""
        self.close_connection = True
        self._refuse(HTTPStatus.NOT_FOUND, "nothing here")

    def log_message(self, format: str, *args: Any) -> None:
        """Paths hold the token: nothing is logged."""


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 12
