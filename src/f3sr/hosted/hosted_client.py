"""Submit, poll, read and download: the one client of all services.

The key goes to the API's own host only. A request that costs money leaves once: it is not sent again after a timeout,
a broken connection or any 5xx, for the server may have taken it. A 429 is a limiter's answer before a job is made
(RFC 6585), so after its wait the request is sent again. A 503 may come from a gateway that had passed the request on,
so it counts as unknown. GET requests change nothing and are repeated within the deadline.
"""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any, NoReturn
from urllib.parse import urljoin, urlsplit

from f3sr.errors import InputError, NoAnswerError, cut
from f3sr.files import strict_json
from f3sr.hosted.hosted_service import HostedService, UnexpectedReplyError
from f3sr.hosted.job_files import MAX_MESH_BYTES
from f3sr.hosted.limited_http import (
    LOOPBACK,
    HttpReply,
    LostReplyError,
    NotSentError,
    RefusedReplyError,
    exchange,
    origin_of,
    split_url,
)
from f3sr.hosted.service_key import ServiceKey

COME_AGAIN = (429, 502, 503, 504)
"""Statuses after which a GET request is sent again."""
TOO_MANY = 429
UNTOLD = 500
"""From this status on, a server may have acted on the request."""
MAX_TEXT = 300
"""Most characters of a server's text in a message."""
GLB_MAGIC = b"glTF"
Telling = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class HostedLimits:
    """How long and how much: seconds and bytes."""

    deadline: float = 1800.0
    """Of all jobs of a photo together [s]."""
    request: float = 60.0
    """Of one request and its reply [s]."""
    download: float = 300.0
    """Of one mesh, or of a direct reply [s]."""
    first_wait: float = 2.0
    """Between a job's submission and the first poll [s]."""
    longest_wait: float = 15.0
    """Between two polls [s]."""
    longest_retry_after: float = 120.0
    """Of what a server may ask to wait [s]."""
    refusals: int = 6
    """Times that a request is sent again after a 429."""
    drops: int = 3
    """Broken connections in a row after which a GET request is given up."""
    json_bytes: int = 8_000_000
    mesh_bytes: int = MAX_MESH_BYTES


class UnknownOutcomeError(NoAnswerError):
    """A request was sent and its outcome is unknown: it may have been paid."""


class JobRefusedError(NoAnswerError):
    """The service refused the request: no job was made."""


@dataclass(frozen=True, kw_only=True)
class HostedClient:
    """Requests to one service. Every error is one line without the key."""

    service: HostedService
    key: ServiceKey
    limits: HostedLimits
    end: float
    """Of ``time.monotonic()``: nothing is begun or waited for after it."""
    job: str = ""
    """Id of the job that requests are about, for messages."""

    def __post_init__(self) -> None:
        require_address(self.service, self.key)

    # --- requests that make a job ----------------------------------------------------------------------------------

    def post_json(self, path: str, body: Mapping[str, Any]) -> Any:
        """The JSON reply to a request that makes a job. Raises JobRefusedError or UnknownOutcomeError."""
        data, seconds = json.dumps(body).encode(), self.limits.request
        return self._posted_json(self._posted(path, data, "application/json", seconds, self.limits.json_bytes))

    def post_for_mesh(self, path: str, body: Mapping[str, Any]) -> bytes:
        """The GLB that is the reply itself."""
        data, seconds = json.dumps(body).encode(), self.limits.deadline
        reply = self._posted(path, data, "application/json", seconds, self.limits.mesh_bytes)
        return self._glb(reply.body)

    def upload(self, path: str, png: bytes) -> Any:
        """The JSON reply to a picture as multipart form."""
        mark = secrets.token_hex(16)
        head = f'--{mark}\r\nContent-Disposition: form-data; name="file"; filename="object.png"\r\n'
        data = f"{head}Content-Type: image/png\r\n\r\n".encode() + png + f"\r\n--{mark}--\r\n".encode()
        kind = f"multipart/form-data; boundary={mark}"
        return self._posted_json(self._posted(path, data, kind, self.limits.request, self.limits.json_bytes))

    def _posted(self, path: str, data: bytes, kind: str, seconds: float, most: int) -> HttpReply:
        headers = self._headers() | {"Content-Type": kind}
        for _ in range(self.limits.refusals):
            reply = self._posted_once(path, data, headers, seconds, most)
            if reply.status != TOO_MANY:
                return self._accepted(reply)
            self._wait(self._asked_wait(reply, self.limits.first_wait))
        return self._accepted(self._posted_once(path, data, headers, seconds, most))

    def _posted_once(self, path: str, data: bytes, headers: Mapping[str, str], seconds: float, most: int) -> HttpReply:
        url, seconds = self._own(path), self._within(seconds)
        try:
            return exchange("POST", url, headers=headers, body=data, seconds=seconds, most=most)
        except NotSentError as error:
            raise JobRefusedError(self.line(str(error))) from None
        except (LostReplyError, RefusedReplyError) as error:
            raise UnknownOutcomeError(self.line(str(error))) from None

    def _accepted(self, reply: HttpReply) -> HttpReply:
        if 200 <= reply.status < 300:
            return reply
        # Any status but a 4xx, a redirect too, may follow after a job was made.
        said = self.line(self._said(reply))
        raise JobRefusedError(said) if 400 <= reply.status < UNTOLD else UnknownOutcomeError(said)

    def _posted_json(self, reply: HttpReply) -> Any:
        try:
            return self._json(reply)
        except NoAnswerError as error:
            raise UnknownOutcomeError(str(error)) from None

    # --- requests that change nothing ------------------------------------------------------------------------------

    def get_json(self, target: str) -> tuple[int, Any]:
        """Status and JSON of a path or URL at the API's own host; of a 4xx only the text of its error."""
        reply = self._got(self._own(target), self._headers(), self.limits.request, self.limits.json_bytes)
        if 200 <= reply.status < 300:
            return reply.status, self._json(reply)
        if 400 <= reply.status < UNTOLD:
            return reply.status, self._said(reply)
        self.fail(self._said(reply))

    def download(self, url: str) -> bytes:
        """The GLB at a URL of any host, which gets no key: https only, plain http on this machine only."""
        if self.key.is_in(url):
            self.fail("it gives a URL with the key in it")
        try:
            parts = split_url(url)
        except RefusedReplyError as error:
            self.fail(str(error))
        here = parts.hostname in LOOPBACK
        if here and urlsplit(self.service.base_url).hostname not in LOOPBACK:
            self.fail("it gives a URL of this machine")
        if parts.scheme != "https" and not here:
            self.fail("it gives a URL of plain http; accepted: https")
        reply = self._got(url, {}, self.limits.download, self.limits.mesh_bytes)
        if reply.status != 200:
            self.fail(f"download: {self._said(reply)}")
        return self._glb(reply.body)

    def wait(self, seconds: float) -> None:
        """Wait, unless the deadline comes first: then NoAnswerError."""
        self._wait(seconds)

    def _got(self, url: str, headers: Mapping[str, str], seconds: float, most: int) -> HttpReply:
        drops, pause = 0, self.limits.first_wait
        while True:
            try:
                reply = exchange("GET", url, headers=headers, body=None, seconds=self._within(seconds), most=most)
            except (NotSentError, LostReplyError) as error:
                drops += 1
                if drops >= self.limits.drops:
                    self.fail(str(error))
                asked = pause
            except RefusedReplyError as error:
                self.fail(str(error))
            else:
                if reply.status not in COME_AGAIN:
                    return reply
                drops, asked = 0, self._asked_wait(reply, pause)
            self._wait(asked)
            pause = min(1.5 * pause, self.limits.longest_wait)

    # --- parts -----------------------------------------------------------------------------------------------------

    def fail(self, what: str) -> NoReturn:
        """Raise NoAnswerError with a line about the service and its job."""
        raise NoAnswerError(self.line(what))

    def line(self, what: str) -> str:
        """A message: the service, its job and what happened, without the key."""
        job = f", job {self.job}" if self.job else ""
        return self.key.redacted(f"{self.service.name}{job}: {what}")

    def _headers(self) -> dict[str, str]:
        return {"Authorization": f"{self.service.scheme} {self.key.value}"} if self.key.value else {}

    def _own(self, target: str) -> str:
        """The URL of a path or URL, if it is at the API's own scheme, host and port."""
        if self.key.is_in(target):
            self.fail("it gives a URL with the key in it")
        base = self.service.base_url
        try:
            url = urljoin(base.rstrip("/") + "/", target)
            if origin_of(split_url(url)) != origin_of(split_url(base)):
                raise RefusedReplyError("it points to another host, which gets no key")
        except (RefusedReplyError, ValueError) as error:
            self.fail(str(error))
        return url

    def _within(self, seconds: float) -> float:
        left = self.end - time.monotonic()
        if left <= 0:
            self.fail(f"not done within {self.limits.deadline:.3g} s")
        return min(seconds, left)

    def _wait(self, seconds: float) -> None:
        time.sleep(self._within(seconds))
        self._within(0)

    def _asked_wait(self, reply: HttpReply, otherwise: float) -> float:
        """Seconds that ``Retry-After`` asks for, as a number or a date, within limits."""
        text = reply.headers.get("retry-after", "").strip()
        try:
            seconds = float(text) if text.isdigit() else _until(text)
        except (ValueError, TypeError, OverflowError):
            return otherwise
        return min(max(seconds, 0.0), self.limits.longest_retry_after)

    def _json(self, reply: HttpReply) -> Any:
        try:
            return strict_json.loads(reply.body)
        except ValueError as error:
            self.fail(f"a reply that is no valid JSON ({error})")

    def _said(self, reply: HttpReply) -> str:
        """An error's status and the beginning of its text. A redirect's address is not repeated."""
        if 300 <= reply.status < 400:
            return f"HTTP {reply.status}, a redirect, which is not followed"
        text = " ".join(self.key.redacted(reply.body.decode(errors="replace")).split())
        return f"HTTP {reply.status}{text and ': '}{text[:MAX_TEXT]}"

    def _glb(self, data: bytes) -> bytes:
        if data[:4] != GLB_MAGIC:
            self.fail("a file that is no GLB")
        return data

    def understood(self, read: Callable[[], Any]) -> Any:
        """What a description reads of a reply; NoAnswerError where the reply has another form."""
        try:
            return read()
        except UnexpectedReplyError as error:
            self.fail(f"a reply of another form than documented ({self.key.redacted(str(error))[:MAX_TEXT]})")


def require_address(service: HostedService, key: ServiceKey) -> None:
    """InputError for an address that is none, or that must not get the key."""
    where, accepted = f"address of {service.name}", "http://HOST:PORT or https://HOST; a key only over https"
    try:
        parts = split_url(service.base_url)
    except RefusedReplyError:
        found = "a URL with a user" if "@" in service.base_url else cut(repr(service.base_url.partition("?")[0]))
        raise InputError(where, found=found, accepted=accepted) from None
    if parts.query or parts.fragment:
        raise InputError(where, found="a URL with a query", accepted=accepted)
    if key.value and parts.scheme == "http" and parts.hostname not in LOOPBACK:
        raise InputError(where, found="plain http for a key", accepted=accepted)


def _until(date: str) -> float:
    when = parsedate_to_datetime(date)
    return ((when if when.tzinfo else when.replace(tzinfo=UTC)) - datetime.now(UTC)).total_seconds()
