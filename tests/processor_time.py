"""Hooks of pytest that note the processor time of every test in the JUnit file: wall time is of the machine."""

from __future__ import annotations

import os
from collections.abc import Generator

import pytest

NAME = "processor_s"
"""Of the property; ``benchmarks/durations.py`` reads it."""
_BEGAN = pytest.StashKey[float]()


def processor_time() -> float:
    """Of this process and of those that it started and that have ended [s]."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    item.stash[_BEGAN] = processor_time()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, object, object]:
    try:
        return (yield)
    finally:
        item.user_properties.append((NAME, f"{processor_time() - item.stash[_BEGAN]:.3f}"))
