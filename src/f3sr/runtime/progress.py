"""What a run says of itself while it goes on: one step after another, with its time."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Step:
    """A step of a run as it starts, or as it ends."""

    name: str
    state: Literal["started", "done", "resumed", "skipped"]
    seconds: float = 0.0
    """Wall time [s] of a step that is done."""

    def __str__(self) -> str:
        said = {"started": "...", "done": f"{self.seconds:.1f} s", "resumed": "from the cache", "skipped": "skipped"}
        return f"{self.name}: {said[self.state]}"


Progress = Callable[[Step], None]
"""Called with every step as it starts and as it ends."""


def silent(step: Step) -> None:
    """Tell nobody."""
    del step


@contextmanager
def timed(name: str, progress: Progress) -> Generator[None]:
    """Tell ``progress`` when the block starts and, unless it fails, when it is done."""
    progress(Step(name=name, state="started"))
    start = time.perf_counter()
    yield
    progress(Step(name=name, state="done", seconds=time.perf_counter() - start))
