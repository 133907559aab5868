"""The page of how long tests take, from the JUnit file of one run: ``make durations`` writes it anew.

usage: python benchmarks/durations.py TESTS.xml > PAGE.md
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree

SLOWEST = 30
"""Tests that the page lists."""
FILES = 15
"""Test files that the page lists."""
HEAD = """# How long the tests take

Wall time with setup and teardown, two processes at a time: `make durations` measures and writes this page.
Times of single tests grow when other programs run on the machine.

"""


def page(report: Path) -> str:
    """Markdown of a run's total, its slowest files and its slowest tests; times in seconds."""
    suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    seconds = {(str(c.get("classname")), str(c.get("name"))): float(c.get("time", 0)) for c in suite.iter("testcase")}
    files = defaultdict[str, float](float)
    for (module, _), value in seconds.items():
        files[f"`{module.replace('.', '/')}.py`"] += value
    total = f"{len(seconds)} tests in {float(suite.get('time', 0)) / 60:.1f} minutes.\n\n"
    slowest = sorted(seconds, key=lambda key: -seconds[key])[:SLOWEST]
    tests = ((f"`{module.rpartition('.')[2]}::{name}`", seconds[module, name]) for module, name in slowest)
    return (
        HEAD
        + total
        + table("file", sorted(files.items(), key=lambda row: -row[1])[:FILES])
        + "\n"
        + table("test", tests)
    )


def table(title: str, rows: Iterable[tuple[str, float]]) -> str:
    lines = (f"| {name.replace('|', ' ')} | {value:.1f} |\n" for name, value in rows)
    return f"| {title} | s |\n|---|---|\n{''.join(lines)}"


if __name__ == "__main__":
    print(page(Path(sys.argv[1])), end="")
