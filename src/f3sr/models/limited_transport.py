"""HTTP for models: replies end at a limit of bytes, are not compressed, and nobody is redirected."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator
from functools import cache
from typing import Any

import httpx2

SENT = {
    *("host", "authorization", "x-api-key", "accept", "content-type", "content-length", "transfer-encoding"),
    *("connection", "user-agent", "anthropic-version", "anthropic-beta"),
}
"""Headers that are sent. SDKs add others, of the machine and from environment variables, which may hold other keys."""


class ReplyTooLongError(Exception):
    """A reply beyond its limit of bytes, or one that would grow when it is unpacked."""


class _Counted(httpx2.AsyncByteStream):
    """A reply that ends with an error after so many bytes."""

    def __init__(self, stream: Any, most: int) -> None:
        self.stream, self.most = stream, most

    async def __aiter__(self) -> AsyncIterator[bytes]:
        count = 0
        async for chunk in self.stream:
            count += len(chunk)
            if count > self.most:
                raise ReplyTooLongError(f"a reply of more than {self.most:,} bytes")
            yield chunk

    async def aclose(self) -> None:
        await self.stream.aclose()


@cache
def _trusted() -> ssl.SSLContext:
    """The authorities of this machine, read once: it takes 60 ms, and every call has a client of its own."""
    return httpx2.create_ssl_context()


class LimitedTransport(httpx2.AsyncHTTPTransport):
    """Replies of at most so many bytes."""

    def __init__(self, most: int, key: str) -> None:
        super().__init__(verify=_trusted(), retries=0)
        self.most, self.key = most, key

    async def handle_async_request(self, request: httpx2.Request) -> httpx2.Response:
        for name in set(request.headers) - SENT:
            del request.headers[name]
        for name, value in (("authorization", f"Bearer {self.key}"), ("x-api-key", self.key)):
            if name in request.headers:
                request.headers[name] = value
        request.headers["accept-encoding"] = "identity"
        response = await super().handle_async_request(request)
        if response.headers.get("content-encoding", "identity").lower() != "identity":
            await response.aclose()
            raise ReplyTooLongError("a compressed reply, which was not asked for")
        response.stream = _Counted(response.stream, self.most)
        return response


def limited_client(most: int, key: str) -> httpx2.AsyncClient:
    """A client for one call."""
    return httpx2.AsyncClient(transport=LimitedTransport(most, key), follow_redirects=False, trust_env=False)
