"""The page of how long tests take, from the JUnit file of one run: ``make durations`` writes it anew.

usage: python benchmarks/durations.py TESTS.xml > PAGE.md
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

SLOWEST = 30
"""Tests that the page lists."""
FILES = 15
"""Test files that the page lists."""
PROCESSOR = "processor_s"
"""Property of a test in the JUnit file: the processor time that ``tests/conftest.py`` measured."""
HEAD = """# How long the tests take

Processor time of tests and of the processes that they started, with setup and teardown. `make durations` measures it
and writes this page.
What other programs do on the machine changes it by a fifth, and wall time by any factor.

"""


def page(report: Path) -> str:
    """Markdown of a run's total, its slowest files and its slowest tests; times in seconds."""
    suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    seconds = {(str(c.get("classname")), str(c.get("name"))): _processor_time(c) for c in suite.iter("testcase")}
    files = defaultdict[str, float](float)
    for (module, _), value in seconds.items():
        files[f"`{module.replace('.', '/')}.py`"] += value
    minutes = float(suite.get("time", 0)) / 60
    total = f"{len(seconds)} tests in {minutes:.1f} minutes, {sum(seconds.values()):.0f} s of processor time.\n\n"
    slowest = sorted(seconds, key=lambda key: -seconds[key])[:SLOWEST]
    tests = ((f"`{module.rpartition('.')[2]}::{name}`", seconds[module, name]) for module, name in slowest)
    return (
        HEAD
        + total
        + table("file", sorted(files.items(), key=lambda row: -row[1])[:FILES])
        + "\n"
        + table("test", tests)
    )


def _processor_time(case: Element) -> float:
    """Of a test [s]."""
    found = (p.get("value") for p in case.iter("property") if p.get("name") == PROCESSOR)
    return float(next(found, None) or 0)


def table(title: str, rows: Iterable[tuple[str, float]]) -> str:
    lines = (f"| {name.replace('|', ' ')} | {value:.1f} |\n" for name, value in rows)
    return f"| {title} | s |\n|---|---|\n{''.join(lines)}"


if __name__ == "__main__":
    print(page(Path(sys.argv[1])), end="")
