"""What the command line shows: the steps of a run while they go on, and tables."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.table import Table
from rich.text import Text

from f3sr.report import Report
from f3sr.runtime import signals
from f3sr.runtime.progress import Progress, Step, silent

CURSOR_BACK = b"\r\x1b[K\x1b[?25h"
"""What a terminal needs when the bar ends in the middle: an empty line and its cursor."""


def say(text: str) -> None:
    print(text, flush=True)


def print_json(value: object) -> None:
    """One line of JSON, for ``--json``. Raises ValueError for what is not finite."""
    print(json.dumps(value, allow_nan=False))


def say_aside(text: str) -> None:
    """The same where the output is for another program."""
    print(text, file=sys.stderr, flush=True)


@contextmanager
def steps_shown(*, quiet: bool = False) -> Generator[Progress]:
    """Prints one line per finished step of a run and per word within one.

    On a terminal words and the running step are shown with a clock."""
    if quiet:
        yield silent
    elif sys.stdout.isatty():
        yield from _with_a_clock()
    else:
        yield _tell_ended


def _tell_ended(step: Step) -> None:
    if step.state != "started":
        say(str(step))


def _with_a_clock() -> Generator[Progress]:
    from rich.progress import Progress as Bar
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    bar = Bar(*columns, transient=True, console=_console())
    with signals.undone(lambda: bar, lambda _: os.write(1, CURSOR_BACK)), bar:
        task = bar.add_task("starting")

        def tell(step: Step) -> None:
            if step.state == "started":
                bar.reset(task, description=step.name)
            elif step.state == "told":
                bar.update(task, description=step.name)
            else:
                bar.console.print(Text(str(step)))

        yield tell


def say_fallbacks(reports: Iterable[Report]) -> None:
    """A line for every fallback of some stages."""
    for report in reports:
        for decision in report.fallbacks:
            about = f" (object {decision.about})" if decision.about is not None else ""
            say(f"fallback in {report.stage}{about}: {decision.choice}; {decision.reason}")


def print_measures(columns: Mapping[str, Mapping[str, float]]) -> None:
    """Measures by row, scenes by column."""
    names = list(next(iter(columns.values()), {}))
    rows = [(name, *(f"{column[name]:.4g}" for column in columns.values())) for name in names]
    if rows:
        print_table(rows, header=("", *(name.replace(", ", ",\n") for name in columns)), numbers=True)


def print_table(rows: Sequence[Sequence[str]], *, header: Sequence[str], numbers: bool = False) -> None:
    """Plain text in columns; with ``numbers`` all but the first are right-aligned."""
    view = Table(box=None, padding=(0, 2, 0, 0), show_header=any(header))
    for k, name in enumerate(header):
        view.add_column(Text(name), justify="right" if numbers and k else "left", overflow="fold")
    for row in rows:
        view.add_row(*map(Text, row))
    _console().print(view)


def _console() -> Console:
    """As wide as the terminal; where there is none, lines are not wrapped."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else 200)
