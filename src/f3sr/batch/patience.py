"""Waiting for room on a full disk: longer and longer, up to a limit, and not in silence."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from f3sr.errors import one_line

FIRST_S, LONGEST_S = 0.2, 10.0
"""Waits between attempts [s]: each is twice the one before."""


class Patience:
    """Waits when it is called, and says no when the time is up; ``tell`` hears of every wait."""

    def __init__(self, limit_s: float, tell: Callable[[dict[str, Any]], None]) -> None:
        self.left, self.tell, self.pause = limit_s, tell, FIRST_S

    def __call__(self, error: BaseException) -> bool:
        pause = min(self.pause, self.left)
        if pause <= 0:
            return False
        self.tell({"event": "full", "reason": one_line(str(error)), "seconds": pause})
        time.sleep(pause)
        self.left, self.pause = self.left - pause, min(2 * self.pause, LONGEST_S)
        return True
