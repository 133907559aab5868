"""Waiting for what another thread or process is about to do, instead of for a fixed time."""

from __future__ import annotations

import time
from collections.abc import Callable


def soon(is_so: Callable[[], object], seconds: float = 30) -> bool:
    """Whether something comes to be so within the seconds."""
    end = time.monotonic() + seconds
    while not is_so():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
