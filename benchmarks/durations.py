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
PROCESSOR, SLOW = "processor_s", "slow"
"""Properties of a test in the JUnit file, by ``tests/processor_time.py``: its processor time; its mark."""
LIMIT = 2.0
"""Processor time from which on a test is to be marked slow [s]."""
HEAD = """# How long the tests take

Processor time of tests and of the processes that they started, with setup and teardown. `make durations` measures it
and writes this page.
What other programs do on the machine changes it by a fifth, and wall time by any factor.

"""


def page(report: Path) -> str:
    """Markdown of a run's total, its slowest files and its slowest tests; times in seconds."""
    suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    cases = {(str(c.get("classname")), str(c.get("name"))): c for c in suite.iter("testcase")}
    seconds = {key: float(_property(c, PROCESSOR)) for key, c in cases.items()}
    marked = {key for key, c in cases.items() if _property(c, SLOW) != "0"}
    files = defaultdict[str, float](float)
    for (module, _), value in seconds.items():
        files[f"`{module.replace('.', '/')}.py`"] += value
    minutes = float(suite.get("time", 0)) / 60
    total = f"{len(seconds)} tests in {minutes:.1f} minutes, {sum(seconds.values()):.0f} s of processor time.\n"
    total += f"Of these {len(marked)} with {sum(seconds[key] for key in marked):.0f} s are slow: `make test-slow`.\n\n"
    slowest = sorted(seconds, key=lambda key: -seconds[key])[:SLOWEST]
    tests = ((_told(key, seconds[key], is_marked=key in marked), seconds[key]) for key in slowest)
    return (
        HEAD
        + total
        + table("file", sorted(files.items(), key=lambda row: -row[1])[:FILES])
        + "\n"
        + table("test", tests)
    )


def _property(case: Element, name: str) -> str:
    """Of a test; "0" where it is not known."""
    return next((p.get("value") or "0" for p in case.iter("property") if p.get("name") == name), "0")


def _told(key: tuple[str, str], seconds: float, *, is_marked: bool) -> str:
    module, name = key
    return f"`{module.rpartition('.')[2]}::{name}`" + (", to be marked" if seconds >= LIMIT and not is_marked else "")


def table(title: str, rows: Iterable[tuple[str, float]]) -> str:
    lines = (f"| {name.replace('|', ' ')} | {value:.1f} |\n" for name, value in rows)
    return f"| {title} | s |\n|---|---|\n{''.join(lines)}"


if __name__ == "__main__":
    print(page(Path(sys.argv[1])), end="")
