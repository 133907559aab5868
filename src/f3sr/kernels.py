"""The numba decorator of the project and its on-disk kernel cache.

Kernels are compiled once per machine and version of the kernel sources. The cache folder's name holds a hash of all
kernel sources, because numba checks its cache per file and would miss a change in a kernel that another file calls.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from f3sr.progress import Progress, silent, timed

F = TypeVar("F", bound=Callable[..., Any])

KERNEL_MODULES = ("raster", "contour", "contact", "crossings", "inside")
"""Modules of this package that hold numba kernels; each has a ``warm_up()`` that calls every one of them."""


@cache
def cache_root() -> Path:
    """``$F3SR_CACHE_DIR``, else f3sr's folder in the XDG cache; a temporary one where that cannot be written to."""
    base = os.environ.get("XDG_CACHE_HOME")
    wanted = Path(base) / "f3sr" if base else Path.home() / ".cache" / "f3sr"
    if configured := os.environ.get("F3SR_CACHE_DIR"):
        wanted = Path(configured)
    return wanted if _writable(wanted) else Path(tempfile.gettempdir()) / f"f3sr-{os.getuid()}"


def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _source_hash() -> str:
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for name in ("kernels", *KERNEL_MODULES):
        digest.update((here / f"{name}.py").read_bytes())
    return digest.hexdigest()[:16]


CACHE_DIR = cache_root() / f"kernels-{_source_hash()}"


def kernel(function: F) -> F:
    """``njit`` with the project's options: GIL released, cached on disk, IEEE arithmetic for equal bytes."""
    from numba import config, njit

    setattr(config, "CACHE_DIR", str(CACHE_DIR))  # noqa: B010 - numba types it as unknown
    return cast(F, njit(cache=True, nogil=True, fastmath=False, error_model="numpy")(function))


def inline_kernel(function: F) -> F:
    """A small kernel that is inlined into the kernels that call it."""
    from numba import njit

    return cast(F, njit(inline="always", error_model="numpy")(function))


def is_warm() -> bool:
    """True when every kernel has been compiled for this version of the sources."""
    return (CACHE_DIR / "warm").exists()


def warm_up(progress: Progress = silent) -> None:
    """Compile what is not in the cache yet, half a minute once per machine; otherwise load it."""
    with timed("kernels" if is_warm() else "compiling kernels, once per machine", progress):
        for name in KERNEL_MODULES:
            importlib.import_module(f"f3sr.{name}").warm_up()
    if _writable(CACHE_DIR):
        (CACHE_DIR / "warm").touch()
