"""Whether a Ray cluster answers at an address, found out before Ray, which waits minutes for one that does not."""

from __future__ import annotations

import os
import socket
from typing import Any

from f3sr.errors import F3srError

ANSWER_S = 4.0
"""How long a cluster may take to accept a connection, and then to answer [s]."""
HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
"""How a client of HTTP/2, which Ray speaks, begins: its preface and empty settings."""
HEADER, SETTINGS = 9, 4
"""Bytes of the header of an answer, and the type that it has at first."""


def require_cluster(ray: Any, address: str) -> None:
    """Raises F3srError, which names the address, where no cluster answers. Leaves to Ray what only Ray can tell."""
    if "://" in address:  # Ray's client, which has a time limit of its own
        return
    try:
        dialled = ray._private.services.canonicalize_bootstrap_address(address)
    except (OSError, ValueError) as error:
        raise _absent(address, str(error)) from error
    if dialled is not None:
        require_answer(dialled, given=address)


def require_answer(dialled: str, *, given: str) -> None:
    """Say hello to ``HOST:PORT``. Raises F3srError where nothing answers, or something that is no Ray."""
    host, _, port = dialled.rpartition(":")
    shown = given if given == dialled else f"{given} ({dialled})"
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_S) as connection:
            if os.environ.get("RAY_USE_TLS", "0") not in ("", "0"):
                return
            connection.settimeout(ANSWER_S)
            connection.sendall(HELLO)
            answer = connection.recv(HEADER)
    except (OSError, ValueError, OverflowError) as error:
        why = "nothing answers" if isinstance(error, TimeoutError) else getattr(error, "strerror", None) or str(error)
        raise _absent(shown, why) from error
    if len(answer) < HEADER or answer[3] != SETTINGS:
        raise _absent(shown, "what answers is no Ray; its port is 6379 unless `ray start` was told another")


def _absent(address: str, why: str) -> F3srError:
    return F3srError(f"--ray: no Ray cluster at {address}: {why}")
