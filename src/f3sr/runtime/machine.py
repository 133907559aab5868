"""What this process may use of the machine: processors and memory."""

from __future__ import annotations

import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment for linear algebra in one thread, if it is there before numpy is imported. Our matrices have 6 rows a
body: with two threads they took ten times as long. And sums then do not depend on the number of processors."""


@contextmanager
def one_thread() -> Generator[None]:
    """Linear algebra in one thread, also where numpy was imported without ``ONE_THREAD``; a decorator too."""
    from threadpoolctl import threadpool_limits

    import_module("scipy.linalg")  # only libraries that are loaded can be limited, and SciPy has its own
    with threadpool_limits(1, user_api="blas"):
        yield


def usable_cores() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def usable_memory() -> float:
    """Memory [GB] of the machine, or what a container leaves of it."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 1e9
    try:
        return min(total, int(Path("/sys/fs/cgroup/memory.max").read_text()) / 1e9)
    except (OSError, ValueError):
        return total
