"""How much work a search was: silhouette integrals evaluated and processor time [s], counted around a block."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from f3sr.vision import silhouette_integrals


class Work:
    """Of one block, once it has ended."""

    evaluations: int = 0
    """Silhouettes integrated with their gradients."""
    cpu: float = 0.0
    """[s] of all threads of this process."""


@contextmanager
def counted() -> Iterator[Work]:
    work, lock, integrate = Work(), threading.Lock(), silhouette_integrals.integrate

    def counting(*args: Any, **kwargs: Any) -> silhouette_integrals.Integrals:
        with lock:
            work.evaluations += 1
        return integrate(*args, **kwargs)

    silhouette_integrals.integrate = counting
    start = time.process_time()
    try:
        yield work
    finally:
        work.cpu = time.process_time() - start
        silhouette_integrals.integrate = integrate
