"""What stands before every route: whom the server answers, what may be sent to it, and what every answer says.

An address holds a secret word. Nobody learns it from a cookie, a referrer or another site: no page that lacks it can
send a request that counts. Requests that change something also need the page's own origin.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import threading
import time
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

from f3sr.mask_page.loopback_server import HEADERS, TOKEN_BYTES, RequestRefusedError
from f3sr.studio.peer_user import peer_user

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

BODIES = {"application/json": 2_000_000, "application/octet-stream": 64_000_000}
"""Media types of bodies, and the bytes that each may have: strokes around 500 objects take 1 MB, a photo of a hundred
megapixels 60."""
LOGIN_BODIES = {"application/json": 1000}
"""The same of who has no word yet: a password is short."""
BODY_S = 10.0
"""How long a body may take [s], beside its bytes at ``SLOWEST``."""
SLOWEST = 200_000
"""Least bytes a second of a body: a photo of 10 MB may take a minute."""
MOST_LOGINS = 10
"""Wrong passwords in ``LOGIN_S``, of all clients together, before the page waits."""
LOGIN_S = 60.0
LET_IN = "f3sr.let_in"
"""Key of a request's scope, once it has shown a word."""
MOST_SESSIONS = 50
"""Addresses that passwords opened; the oldest ends first."""
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; media-src 'self'; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
"""Of the studio's own pages. Documents that f3sr makes have a policy of their own, beside ``FRAMED``."""
FRAMED = "frame-ancestors 'self'"
FRAMES = "framed/"
"""Below it are files of packages, which may come from others: their scripts run without the studio's rights."""


@dataclass(eq=False)
class AddressSecrets:
    """The secret words of a server, and its password."""

    token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES))
    """Of the address that the terminal tells."""
    password: str = ""
    """Opens further addresses; empty where only the terminal's counts."""
    once: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES))
    """Leads its owner to the page once: a browser's command line, which every user of the machine can list, gets this
    one."""
    first: str = ""
    """The page, below the secret word, that the user sees first."""
    framed: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES))
    """Opens nothing but files of packages: a document from there can read its own address."""
    _sessions: list[str] = field(default_factory=list[str])
    _wrong: list[float] = field(default_factory=list[float])
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def opens(self, word: str) -> bool:
        """Whether an address with this word counts."""
        known = [self.token, *self._sessions]
        return any(secrets.compare_digest(word.encode(), one.encode()) for one in known)

    def frames(self, word: str) -> bool:
        """Whether an address with this word shows files of packages."""
        return secrets.compare_digest(word.encode(), self.framed.encode())

    def is_once(self, word: str) -> bool:
        """Whether this is the word that counts once, and has not done so yet."""
        return bool(self.once) and secrets.compare_digest(word.encode(), self.once.encode())

    def takes_once(self, word: str) -> bool:
        """The same; it then has counted."""
        with self._lock:
            if not self.is_once(word):
                return False
            self.once = ""
            return True

    def entered(self, password: str) -> str | None:
        """A new address for the right password, None for a wrong one. Raises RequestRefusedError after too many."""
        with self._lock:
            now = time.monotonic()
            self._wrong = [at for at in self._wrong if now - at < LOGIN_S]
            if len(self._wrong) >= MOST_LOGINS:
                raise RequestRefusedError(HTTPStatus.TOO_MANY_REQUESTS, "too many wrong passwords; wait a minute")
            if not self.password or not secrets.compare_digest(password.encode(), self.password.encode()):
                self._wrong.append(now)
                return None
            self._sessions = [*self._sessions, secrets.token_urlsafe(TOKEN_BYTES)][-MOST_SESSIONS:]
            return self._sessions[-1]


@dataclass(eq=False)
class AccessControl:
    """An ASGI application around another one, which sees only requests that hold a secret word, without that word."""

    inner: App
    secrets: AddressSecrets
    hosts: Callable[[str], bool]
    """Whether a Host header names this server."""
    login: App | None = None
    """Answers ``/`` and ``/login`` of a server with a password."""
    refused: Callable[[str], object] = lambda why: None
    """Is told why a request was refused."""
    user: Callable[[Scope], int | None] = peer_user
    """Of whom a request comes, by number; None where the system does not tell."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            return await self.inner(scope, receive, send)
        if scope["type"] != "http":  # a web socket: closed before it opens
            return await send({"type": "websocket.close"})
        send = _with_headers(send)
        try:
            app = self._admitted(scope)
            if scope["method"] == "POST":
                receive = _replayed(await _body(scope, receive, LOGIN_BODIES if app is self.login else BODIES), receive)
        except RequestRefusedError as refusal:
            self.refused(refusal.why)
            return await plain(send, refusal.status, refusal.why)
        await app(scope, receive, send)

    def _admitted(self, scope: Scope) -> App:
        """The application that answers. Others than holders of a word learn nothing, not even what was wrong."""
        nothing = RequestRefusedError(HTTPStatus.NOT_FOUND, "nothing here")
        hosts, method = _all(scope, b"host"), scope["method"]
        if method not in ("GET", "POST") or len(hosts) != 1 or not self.hosts(hosts[0]):
            raise nothing
        word, slash, rest = scope["path"].removeprefix("/").partition("/")
        is_login = self.login is not None and not slash and word in ("", "login")
        is_framed = self.secrets.frames(word) and rest.startswith(FRAMES) and method == "GET"
        if method == "GET" and not rest and self.secrets.is_once(word):
            if self.user(scope) not in (None, 0, os.geteuid()):
                self.refused("another user of this machine asked for the page that the browser was to open")
                raise nothing
            if self.secrets.takes_once(word):
                return _moved(f"/{self.secrets.token}/{self.secrets.first}")
        opened = slash and self.secrets.opens(word) and not rest.startswith(FRAMES)
        if not (is_login or is_framed or opened):
            raise nothing
        if method == "POST" and _all(scope, b"origin") != [f"{scope['scheme']}://{hosts[0]}"]:
            raise RequestRefusedError(HTTPStatus.FORBIDDEN, "not sent by the page")
        if is_login and self.login is not None:
            return self.login
        scope[LET_IN] = True
        scope["path"], scope["raw_path"] = f"/{rest}", f"/{rest}".encode()
        return self.inner


async def plain(send: Send, status: int, line: str) -> None:
    """One line as a whole answer."""
    body = f"{line}\n".encode()
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode())]
    await send({"type": "http.response.start", "status": int(status), "headers": [*headers, (b"connection", b"close")]})
    await send({"type": "http.response.body", "body": body})


def _moved(place: str) -> App:
    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        headers = [(b"location", place.encode()), (b"content-length", b"0")]
        await send({"type": "http.response.start", "status": int(HTTPStatus.SEE_OTHER), "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    return answer


def _all(scope: Scope, name: bytes) -> list[str]:
    """Every value of a header."""
    return [value.decode("latin-1") for key, value in scope["headers"] if key == name]


def _with_headers(send: Send) -> Send:
    """Adds what every answer says and, where an answer has no policy of its own, that of the studio's pages."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            given = list(message.get("headers", []))
            known = {key.lower() for key, _ in given}
            added = {**HEADERS, "X-Frame-Options": "SAMEORIGIN", "Content-Security-Policy": POLICY}
            more = [(k.lower().encode(), v.encode()) for k, v in added.items() if k.lower().encode() not in known]
            message["headers"] = [*given, *more]
        await send(message)

    return sent


async def _body(scope: Scope, receive: Receive, bounds: Mapping[str, int]) -> bytes:
    """The whole body, of a stated length within the bounds and in a bounded time."""
    lengths, kind = _all(scope, b"content-length"), (_all(scope, b"content-type") or [""])[0].partition(";")[0].strip()
    if _all(scope, b"transfer-encoding") or len(lengths) != 1 or not _is_count(lengths[0]):
        raise RequestRefusedError(HTTPStatus.LENGTH_REQUIRED, "no single Content-Length")
    if kind not in bounds:
        raise RequestRefusedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, f"accepted: {', '.join(bounds)}")
    if (size := int(lengths[0])) > bounds[kind]:
        raise RequestRefusedError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"more than {bounds[kind]:,} bytes")
    parts, end = list[bytes](), time.monotonic() + BODY_S + size / SLOWEST
    while True:
        try:
            message = await asyncio.wait_for(receive(), max(0.0, end - time.monotonic()))
        except TimeoutError:
            raise RequestRefusedError(HTTPStatus.REQUEST_TIMEOUT, "a body that took too long") from None
        if message["type"] == "http.disconnect":
            raise RequestRefusedError(HTTPStatus.BAD_REQUEST, "less than the Content-Length")
        parts.append(message.get("body", b""))
        if not message.get("more_body"):
            return b"".join(parts)


def _replayed(body: bytes, receive: Receive) -> Receive:
    """The body as one message; after it what the connection says."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def received() -> Message:
        return messages.pop() if messages else await receive()

    return received


def _is_count(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 12
