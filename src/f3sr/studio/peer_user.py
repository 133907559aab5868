"""Whose process is at the other end of a connection on this machine, by Linux' table of sockets."""

from __future__ import annotations

import ipaddress
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
LOCAL, REMOTE, USER = 1, 2, 7
"""Columns of the tables."""


def peer_user(scope: Mapping[str, Any]) -> int | None:
    """The number of the user whose socket sent a request; None for another machine, container or system."""
    client, server = scope.get("client"), scope.get("server")
    if not client or not server:
        return None
    with suppress(OSError, ValueError):
        ends = [_written(*client), _written(*server)]
        for table in TABLES:
            for line in table.read_text().splitlines()[1:]:
                columns = line.split()
                if [columns[LOCAL], columns[REMOTE]] == ends:
                    return int(columns[USER])
    return None


def _written(host: str, port: int) -> str:
    """An address as the tables write it: words of 32 bits in the order of this processor."""
    packed = ipaddress.ip_address(host).packed
    words = (packed[k : k + 4] for k in range(0, len(packed), 4))
    step = -1 if sys.byteorder == "little" else 1
    return f"{b''.join(word[::step] for word in words).hex().upper()}:{port:04X}"
