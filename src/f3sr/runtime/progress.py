"""What a run says of itself while it goes on: one step after another, with its time, and words within a step."""

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
    state: Literal["started", "told", "done", "resumed", "skipped"]
    """``told``: no step of its own but words of the one that runs, as a service's place in a queue."""
    seconds: float = 0.0
    """Wall time [s] of a step that is done."""

    def __str__(self) -> str:
        if self.state == "told":
            return self.name
        said = {"started": "...", "done": f"{self.seconds:.1f} s", "resumed": "from the cache", "skipped": "skipped"}
        return f"{self.name}: {said[self.state]}"


Progress = Callable[[Step], None]
"""Called with every step as it starts and as it ends."""


def silent(step: Step) -> None:
    """Tell nobody."""
    del step


def words_to(progress: Progress) -> Callable[[str], None]:
    """What tells ``progress`` of words within the step that runs."""
    return lambda words: progress(Step(name=words, state="told"))


@contextmanager
def timed(name: str, progress: Progress) -> Generator[None]:
    """Tell ``progress`` when the block starts and, unless it fails, when it is done."""
    progress(Step(name=name, state="started"))
    start = time.perf_counter()
    yield
    progress(Step(name=name, state="done", seconds=time.perf_counter() - start))
