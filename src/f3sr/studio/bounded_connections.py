"""HTTP connections that are few and not slow: uvicorn's protocol with a bound on both.

Strangers cannot keep the user out: where there are too many, the oldest that has shown no word makes room.
"""

from __future__ import annotations

import asyncio
from typing import Any, cast

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from f3sr.studio.access_control import LET_IN

MAX_CONNECTIONS = 64
"""Open at once: a browser opens six a page."""
HEAD_S = 5.0
"""How long a request line and its headers may take [s]."""


class BoundedConnection(H11Protocol):
    """One connection. What is one too many, or takes too long to say what it wants, is closed without a word."""

    _late: asyncio.TimerHandle | None = None
    _let_in = False
    _since = 0.0

    def since(self) -> float:
        """When it was opened [s of the loop's clock]."""
        return self._since

    @property
    def is_let_in(self) -> bool:
        """Whether a request on it has shown a word."""
        self._let_in = self._let_in or LET_IN in (self.scope or {})
        return self._let_in

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._since = self.loop.time()
        self._expect_head()
        all_open = [c for c in self.connections if isinstance(c, BoundedConnection) and not c.transport.is_closing()]
        if len(all_open) > MAX_CONNECTIONS:
            strangers = [c for c in all_open if not c.is_let_in]  # this one is among them
            min(strangers, key=BoundedConnection.since).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._head_is_here()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        before = cast("RequestResponseCycle | None", self.cycle)
        self._let_in = self.is_let_in  # of the request before
        super().data_received(data)
        if self.cycle is not before:
            self._head_is_here()
        elif not before or before.response_complete:  # a head has begun
            self._expect_head()

    def _expect_head(self) -> None:
        if self._late is None:
            self._late = self.loop.call_later(HEAD_S, self.transport.abort)

    def _head_is_here(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None
