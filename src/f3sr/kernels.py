"""The numba decorator of the project, where its compiled kernels are kept, and compiling them ahead of use.

Kernels are compiled once per machine and version of the kernel sources. The cache folder's name holds a hash of all
kernel sources, because a change in a kernel changes those of other files that call it.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import os
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from f3sr.progress import Progress, silent, timed

F = TypeVar("F", bound=Callable[..., Any])

KEPT_VERSIONS = 4
"""Kernel folders that stay: this version's and the others used last (a megabyte each)."""

KERNEL_MODULES = (
    *("triangles", "raster", "contour", "contact", "patches", "crossings", "inside", "patchmatch"),
    *("rendering.surface_kernels", "rendering.shadow_kernels", "rendering.picture_kernels"),
    *("rendering.texture_kernels", "rendering.fit_kernels"),
)
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
    for name in ("kernels", "kernel_files", *KERNEL_MODULES):
        digest.update((here / f"{name.replace('.', '/')}.py").read_bytes())
    return digest.hexdigest()[:16]


CACHE_DIR = cache_root() / f"kernels-{_source_hash()}"
WARM = CACHE_DIR / "warm"
"""Names the files of all compiled kernels; its age tells when this version was used last."""


def kernel(function: F) -> F:
    """``njit`` with the project's options: GIL released, cached on disk, IEEE arithmetic for equal bytes."""
    from numba import njit

    from f3sr.kernel_files import KernelFiles

    dispatcher = cast(Any, njit(nogil=True, fastmath=False, error_model="numpy")(function))
    dispatcher._cache = KernelFiles(function, CACHE_DIR)  # where ``njit(cache=True)`` puts numba's own
    return dispatcher


def inline_kernel(function: F) -> F:
    """A small kernel that is inlined into the kernels that call it."""
    from numba import njit

    return cast(F, njit(inline="always", error_model="numpy")(function))


def is_warm() -> bool:
    """True when every kernel has been compiled for this version of the sources."""
    try:
        names = WARM.read_text().splitlines()
    except OSError:
        return False
    return bool(names) and all((CACHE_DIR / name).exists() for name in names)


def warm_up(progress: Progress = silent) -> None:
    """Compile what is not in the cache yet, half a minute once per machine; otherwise load it.

    A damaged file of the cache is told, discarded and made anew."""
    from f3sr.cache import write_whole
    from f3sr.kernel_files import SUFFIX, discard_damaged

    step = "kernels" if is_warm() else "compiling kernels, once per machine"
    if damaged := discard_damaged(CACHE_DIR):
        step = f"compiling kernels again, as {damaged} damaged files were found and discarded"
    with timed(step, progress):
        for name in KERNEL_MODULES:
            importlib.import_module(f"f3sr.{name}").warm_up()
    write_whole(WARM, "\n".join(sorted(file.name for file in CACHE_DIR.glob(f"*{SUFFIX}"))).encode())
    _discard_old_versions()


def _discard_old_versions() -> None:
    """Keep the folders that were warmed up last; a process that runs on a deleted one has its code in memory."""
    folders = {folder: _last_use(folder) for folder in CACHE_DIR.parent.glob("kernels-*")}
    for folder in sorted(folders, key=lambda f: -folders[f])[KEPT_VERSIONS:]:
        shutil.rmtree(folder, ignore_errors=True)


def _last_use(folder: Path) -> float:
    with contextlib.suppress(OSError):
        return (folder / WARM.name).stat().st_mtime
    return 0.0
