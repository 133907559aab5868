"""Cache folders for single runs: a benchmark must never resume from stored stages, but may keep slow by-products."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import process


def kept(log: Path) -> tuple[Path, Path]:
    """The folders of compiled kernels (compiled now if they were not) and of collision proxies in the user's cache."""
    kernels, proxies = map(Path, process.run(["warm_up.py"], log).answer)
    proxies.mkdir(parents=True, exist_ok=True)
    return kernels, proxies


@contextmanager
def fresh(*borrowed: Path) -> Iterator[Path]:
    """An empty cache folder that borrows some folders of another, for ``F3SR_CACHE_DIR``."""
    with tempfile.TemporaryDirectory(prefix="f3sr-bench-") as name:
        for folder in borrowed:
            (Path(name) / folder.name).symlink_to(folder)
        yield Path(name)
