"""Hooks of pytest that note in the JUnit file the processor time of every test, as wall time is of the machine, and
which tests are slow."""

from __future__ import annotations

import os
from collections.abc import Generator

import pytest

NAME, SLOW = "processor_s", "slow"
"""Of the properties; ``benchmarks/durations.py`` reads them."""
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
        if item.get_closest_marker("slow"):
            item.user_properties.append((SLOW, "yes"))
