"""One HTTP exchange by the standard library: limits of bytes and time, no redirect, no compression, no proxy.

The environment's proxies are not asked: a key goes to the host that a description names, or nowhere.
"""

from __future__ import annotations

import os
import socket
import ssl
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from urllib.parse import SplitResult, urlsplit

from f3sr.errors import reason

MAX_ERROR_BYTES = 8_192
"""Of an error's reply: more is not read."""
CHUNK = 65_536
"""Bytes read at a time."""
LOOPBACK = ("localhost", "127.0.0.1", "::1")
"""Hosts of this machine."""


class NotSentError(Exception):
    """There was no connection, so the server has not seen the request."""


class LostReplyError(Exception):
    """The connection broke or took too long. Whether the server acted on the request is unknown."""


class RefusedReplyError(Exception):
    """A reply that is not read: too long, compressed, or not what was asked for."""


@dataclass(frozen=True, kw_only=True)
class HttpReply:
    """A whole reply of a status that may also be an error's."""

    status: int
    headers: Mapping[str, str]
    """By their names in small letters."""
    body: bytes


def split_url(url: str) -> SplitResult:
    """The parts of an http or https URL of plain ASCII, without user and password.

    Raises RefusedReplyError for any other text."""
    try:
        parts = urlsplit(url)
        wrong = parts.scheme not in ("http", "https") or not parts.hostname or parts.port == 0
    except ValueError:
        raise RefusedReplyError("it gives no URL") from None
    if not url.isascii() or not url.isprintable() or " " in url or "\\" in url or "@" in parts.netloc:
        raise RefusedReplyError("it gives a URL with a user, or with characters that no URL has")
    if wrong:
        raise RefusedReplyError(f"it gives a URL of scheme {parts.scheme[:20]!r}; accepted: https")
    return parts


def origin_of(parts: SplitResult) -> tuple[str, str, int]:
    """Scheme, host and port."""
    return parts.scheme, parts.hostname or "", parts.port or (443 if parts.scheme == "https" else 80)


def exchange(
    method: str, url: str, *, headers: Mapping[str, str], body: bytes | None, seconds: float, most: int
) -> HttpReply:
    """The reply of at most ``most`` bytes within ``seconds`` [s], headers and body together.

    Raises NotSentError, LostReplyError or RefusedReplyError. Redirects are replies like others."""
    parts = split_url(url)
    end = time.monotonic() + seconds
    connection = _connection(parts, seconds)
    with closing(connection):
        try:
            connection.connect()
        except OSError as error:
            raise NotSentError(f"no connection ({_why(error)})") from error
        with _cut_off(connection.sock, end - time.monotonic()) as is_late:
            try:
                return _exchanged(connection, method, parts, headers, body, most)
            except (OSError, HTTPException, ValueError) as error:
                late = is_late() or isinstance(error, TimeoutError)
                why = f"no whole reply within {seconds:.3g} s" if late else f"the reply broke off ({_why(error)})"
                raise LostReplyError(why) from error


def _connection(parts: SplitResult, seconds: float) -> HTTPConnection:
    scheme, host, port = origin_of(parts)
    if scheme == "https":
        return HTTPSConnection(host, port, timeout=seconds, context=ssl.create_default_context())
    return HTTPConnection(host, port, timeout=seconds)


def _exchanged(
    connection: HTTPConnection,
    method: str,
    parts: SplitResult,
    headers: Mapping[str, str],
    body: bytes | None,
    most: int,
) -> HttpReply:
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    sent = {"Accept-Encoding": "identity", "User-Agent": "f3sr", "Connection": "close", **headers}
    # A server may refuse before it has read all, and close: its answer is there to be read.
    with suppress(BrokenPipeError, ConnectionResetError):
        connection.request(method, target, body=body, headers=sent)
    with connection.getresponse() as response:
        return _read(response, most)


def _read(response: HTTPResponse, most: int) -> HttpReply:
    if response.getheader("Content-Encoding", "identity").lower() != "identity":
        raise RefusedReplyError("a compressed reply, which was not asked for")
    is_error = response.status >= 300
    announced = response.length
    if announced is not None and announced > most and not is_error:
        raise RefusedReplyError(f"a reply of {announced:,} bytes; accepted: at most {most:,}")
    limit = min(most, MAX_ERROR_BYTES) if is_error else most
    data = bytearray()
    while (announced is None or len(data) < announced) and len(data) <= limit:
        chunk = response.read1(CHUNK)
        if not chunk:
            break
        data += chunk
    if len(data) > limit and not is_error:
        raise RefusedReplyError(f"a reply of more than {most:,} bytes")
    if announced is not None and len(data) < min(announced, limit):
        raise ConnectionError(f"{len(data):,} of {announced:,} bytes")
    headers = {name.lower(): value for name, value in response.getheaders()}
    return HttpReply(status=response.status, headers=headers, body=bytes(data[:limit]))


@contextmanager
def _cut_off(connected: socket.socket, seconds: float) -> Generator[Callable[[], bool]]:
    """Shut a connection down after so many seconds; what is given tells whether that came.

    Timeouts of sockets begin anew with every byte: a server that drips would hold the run for ever."""
    late = threading.Event()
    with socket.socket(fileno=os.dup(connected.fileno())) as twin:  # TLS above it is not touched

        def shut() -> None:
            late.set()
            with suppress(OSError):
                twin.shutdown(socket.SHUT_RDWR)

        timer = threading.Timer(max(seconds, 0.001), shut)
        timer.daemon = True
        timer.start()
        try:
            yield late.is_set
        finally:
            timer.cancel()
            timer.join()


def _why(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "timed out"
    return reason(error) if isinstance(error, OSError) and error.strerror else str(error)[:200] or type(error).__name__
