"""The lock of a file that tells whether a process lives, taken in spite of those who have it for a moment."""

from __future__ import annotations

import fcntl
import time

WAIT_S, PAUSE_S = 1.0, 0.02
"""How long a lock is tried, and the pause after each time [s]. Who asks for its holder has it for a moment; so has a
process that a killed one was starting."""


def is_taken(descriptor: int) -> bool:
    """Whether the lock is now held by this open file, and by the processes that inherit it."""
    end = time.monotonic() + WAIT_S
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            if time.monotonic() > end:
                return False
            time.sleep(PAUSE_S)
        else:
            return True
