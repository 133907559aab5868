"""What a batch shows while it goes on: a live view on a terminal, plain lines elsewhere, or JSON lines."""

from __future__ import annotations

import json as json_
import os
import sys
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from f3sr.cli.console import CURSOR_BACK
from f3sr.errors import one_line, printable
from f3sr.runtime import signals

if TYPE_CHECKING:
    from f3sr.batch.driver import Event, Tally

QUIET_S = 30.0
"""How often a full disk is told of [s]."""
WIDTH = 60
"""Characters of the line of what runs."""


class Lines:
    """One line for every job that ends, is tried again, or waits."""

    def __init__(self) -> None:
        self.count, self.ended = 0, 0
        self.stream = sys.stdout  # Ray has words of its own, which go to stderr meanwhile
        self.lock = threading.Lock()
        self.full = -QUIET_S

    def begin(self, count: int) -> None:
        self.count = count
        self.print(f"{count} jobs")

    def report(self, event: Event) -> None:
        with self.lock:
            self.ended += event.state in ("done", "known", "failed")
            if line := self.line(event):
                self.print(line)

    def line(self, event: Event) -> str:
        """What a person is told; nothing of starts and steps."""
        at = f"{self.ended}/{self.count} {printable(event.name)}"
        match event.state:
            case "done":
                return f"{at}: done, {event.wall_s:.1f} s, {event.peak_mb:.0f} MB"
            case "failed":
                return f"{at}: failed: {one_line(event.failure + ': ' + event.reason)}"
            case "again":
                return f"{printable(event.name)}: {one_line(event.failure + ': ' + event.reason)}; tried again"
            case "full" if time.monotonic() - self.full >= QUIET_S:
                self.full = time.monotonic()
                return f"no room: {one_line(event.reason)}; waiting for it"
            case _:
                return ""

    def end(self, tally: Tally, place: str) -> None:
        done, known, failed = (tally.counts[name] for name in ("done", "known", "failed"))
        self.print(
            f"{done} done, {known} done before, {failed} failed, {tally.retries} tried again; {tally.wall_s:.1f} s"
        )
        self.print(f"dataset:  {place}")

    def print(self, line: str) -> None:
        print(line, file=self.stream, flush=True)


class JsonLines(Lines):
    """Every event as one JSON object a line."""

    def begin(self, count: int) -> None:
        self._say({"event": "begin", "jobs": count})

    def report(self, event: Event) -> None:
        with self.lock:
            self._say({"event": "job", **event.plain()})

    def end(self, tally: Tally, place: str) -> None:
        self._say({"event": "end", "dataset": place, **_plain(tally)})

    def _say(self, values: dict[str, Any]) -> None:
        self.print(json_.dumps(values, allow_nan=False))


class Live(Lines):
    """The same lines above a bar with what runs now."""

    def __init__(self, bar: Any) -> None:
        super().__init__()
        self.bar, self.task = bar, bar.add_task("starting", total=None)
        self.steps: dict[str, str] = {}

    def begin(self, count: int) -> None:
        self.count = count
        self.bar.update(self.task, total=count)

    def report(self, event: Event) -> None:
        super().report(event)
        with self.lock:
            if event.state in ("started", "step"):
                self.steps[event.name] = event.step
            elif event.state in ("done", "failed", "again"):
                self.steps.pop(event.name, None)
            shown = ", ".join(f"{name} {step}".strip() for name, step in self.steps.items())
            self.bar.update(self.task, completed=self.ended, description=printable(shown)[:WIDTH])

    def print(self, line: str) -> None:
        self.bar.console.print(Text(line))


@contextmanager
def progress_shown(*, json: bool) -> Generator[Lines]:
    """What hears of a batch, as long as the block lasts."""
    if json:
        yield JsonLines()
    elif sys.stdout.isatty():
        yield from _live()
    else:
        yield Lines()


def _live() -> Generator[Lines]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        MofNCompleteColumn(), BarColumn(bar_width=20), TimeElapsedColumn(), TimeRemainingColumn(),
        TextColumn("{task.description}", markup=False),
    )  # fmt: skip
    bar = Progress(*columns, console=Console(file=sys.stdout, highlight=False), transient=True)
    with signals.undone(lambda: bar, lambda _: os.write(1, CURSOR_BACK)), bar:
        yield Live(bar)


def _plain(tally: Tally) -> dict[str, Any]:
    return {
        **{state: tally.counts[state] for state in ("done", "known", "failed")},
        "failures": dict(tally.failures),
        "retries": tally.retries,
        "wall_s": round(tally.wall_s, 3),
        "cpu_s": round(tally.cpu_s, 3),
    }
