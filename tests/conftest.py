"""Helper modules and fixtures that several test files share."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Generator
from pathlib import Path

from f3sr.runtime.machine import ONE_THREAD

# Where no bytecode is written, every process that a test starts compiles all of f3sr: a third of its start. Asserts of
# tests would be rewritten in every run too.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
# As the command has it. Two processes with two threads each wait for each other: a fifth of the processor time.
os.environ.update(ONE_THREAD)
# glibc keeps what is freed, in the processes that start from here: a twentieth of the time went into pages that came
# and went.
os.environ.update({"MALLOC_TRIM_THRESHOLD_": "2000000000", "MALLOC_MMAP_THRESHOLD_": "1000000000"})

import hypothesis  # noqa: E402
import pytest  # noqa: E402

from f3sr.runtime import kernels, signals  # noqa: E402

sys.path.insert(0, str(Path(__file__).parent))
# No example has a deadline in wall time: other programs run on the machine. pytest-timeout ends what hangs.
# ``make test`` draws the same examples each time: a change fails by what it changed. ``--hypothesis-profile=search``
# looks for new ones; what it finds becomes an ``@example`` of its test.
hypothesis.settings.register_profile("same", deadline=None, derandomize=True)
hypothesis.settings.register_profile("search", deadline=None, max_examples=1000)
hypothesis.settings.load_profile("same")

from fixtures import browser, compiled, folder, given, jobs, shared_data, shared_folder, stages, tiny, whole  # noqa: E402, F401
from processor_time import pytest_runtest_setup, pytest_runtest_teardown  # noqa: E402, F401


@pytest.fixture(autouse=True)
def new_command() -> None:
    """What a process wrote and keeps is told in its errors: no test hears of another one's."""
    for told in ("_written", "_kept"):
        getattr(signals, told).clear()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow tests begin first, where they run at all: at the end of a run, one process would wait for the other's.

    Tests of networks stay together: one process imports PyTorch."""
    first = ("slow", "models")
    items.sort(key=lambda item: ([item.get_closest_marker(mark) is None for mark in first], item.path))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Generator[None, pytest.CollectReport, object]:
    """Every other process of ``-n`` begins at the end: in a fresh checkout each compiles half of the tests."""
    report = yield
    if isinstance(collector, pytest.Directory) and os.environ.get("PYTEST_XDIST_WORKER", "gw0")[-1] in "13579":
        report.result.reverse()
    return report


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without garbage collection, a sixth of the time: tests stay, and collecting them makes no garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        # A twentieth of the time went into looking for cycles after every 700 objects; arrays are in none.
        gc.set_threshold(100_000, 20, 100)
        gc.enable()


def pytest_sessionfinish() -> None:
    """Look for cycles once, without what stays: pytest does it five times."""
    gc.collect()
    gc.freeze()


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before the processes of ``-n`` start: each would compile all of them."""
    if not hasattr(session.config, "workerinput") and not kernels.is_warm():
        kernels.warm_up()
