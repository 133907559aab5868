"""The numba decorator of the project, where its compiled kernels are kept, and compiling them ahead of use.

Kernels are compiled once per machine and version of the kernel sources. The cache folder's name holds a hash of all
kernel sources: a change in a kernel changes its callers in other files.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from f3sr.runtime import signals
from f3sr.runtime.cache_folder import within
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.runtime.subprocesses import die_with, started

HERE = Path(__file__).parents[1]
"""The folder of the package f3sr."""

F = TypeVar("F", bound=Callable[..., Any])

KEPT_VERSIONS = 4
"""Kernel folders that stay: this version's and the others used last (a megabyte each)."""
WARM = "warm"
"""File in such a folder with the names of all compiled kernels; its age is the time since the last use."""

HAS_KERNELS = re.compile(r"^from f3sr\.runtime\.kernels import .*\bkernel\b", re.MULTILINE)
HAS_WARM_UP = re.compile(r"^def warm_up\(\)", re.MULTILINE)
"""How sources of kernels, and of their ``warm_up()``, are told from others: nothing imports them to find them."""


def kernel_sources() -> list[Path]:
    """Files of this package that hold numba kernels."""
    return _sources(HAS_KERNELS)


def _sources(what: re.Pattern[str]) -> list[Path]:
    return [file for file in sorted(HERE.rglob("*.py")) if what.search(file.read_text(encoding="utf-8"))]


def _source_hash() -> str:
    own = [HERE / "runtime" / name for name in ("kernels.py", "kernel_files.py", "cache_files.py")]
    digest = hashlib.sha256()
    # One hash over all kernels: numba inlines a kernel of one file into those of another and does not notice its
    # change.
    for file in (*own, *kernel_sources()):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


@cache
def kernel_folder() -> Path | None:
    """Where this version's compiled kernels are kept; None where there is no cache."""
    return within(f"kernels-{_source_hash()}")


def kernel(function: F) -> F:
    """``njit`` with the project's options: GIL released, cached on disk, IEEE arithmetic for equal bytes."""
    from numba import njit

    from f3sr.runtime.kernel_files import KernelFiles

    # No fastmath: reordered sums would differ between machines. error_model "numpy": 1 / 0 is inf, not an exception.
    dispatcher = cast(Any, njit(nogil=True, fastmath=False, error_model="numpy")(function))
    dispatcher._cache = KernelFiles(function, kernel_folder)  # where ``njit(cache=True)`` puts numba's own
    return dispatcher


def inline_kernel(function: F) -> F:
    """A small kernel that is inlined into the kernels that call it."""
    from numba import njit

    return cast(F, njit(inline="always", error_model="numpy")(function))


def is_warm() -> bool:
    """True when every kernel has been compiled for this version of the sources, and kept."""
    folder = kernel_folder()
    try:
        names = (folder / WARM).read_text().splitlines() if folder else []
    except OSError:
        return False
    return folder is not None and bool(names) and all((folder / name).exists() for name in names)


def warm_up(progress: Progress = silent) -> None:
    """Compile what is not in the cache yet, some twenty seconds once per machine; otherwise load it.

    A damaged cache file is reported, discarded and made again. Without a cache every process compiles."""
    folder = kernel_folder()
    if folder is None:
        with timed("compiling kernels for this run only, as no folder can keep them", progress):
            _call(_warm_ups())
        return
    from f3sr.runtime.kernel_files import discard_damaged

    step = "kernels" if is_warm() else "compiling kernels, once per machine"
    if damaged := discard_damaged(folder):
        step = f"compiling kernels again, as {damaged} damaged files were found and discarded"
    with timed(step, progress):
        if not is_warm():
            _compile()
        _call(_warm_ups())
    _tell_warm(folder)
    _discard_old_versions(folder.parent)


def _warm_ups() -> list[str]:
    """Modules with a ``warm_up()``; together these call every kernel. The renderer's is first."""
    files = (file.relative_to(HERE).with_suffix("") for file in _sources(HAS_WARM_UP))
    return sorted((".".join(("f3sr", *file.parts)) for file in files), key=lambda name: "rendering" not in name)


def _call(modules: Iterable[str]) -> None:
    for module in modules:
        importlib.import_module(module).warm_up()


def _compile() -> None:
    """Fill the cache from two processes: the renderer's kernels take as long as all others together.

    What the other process does not compile, this one does afterwards."""
    first, *others = _warm_ups()
    with signals.undone(lambda: _compiler(others), subprocess.Popen.kill) as process:
        try:
            _call([first])
            process.wait()
        finally:
            process.kill()
            process.wait()


def _compiler(modules: Sequence[str]) -> subprocess.Popen[bytes]:
    none = subprocess.DEVNULL
    return started("f3sr.runtime.kernels", *modules, environment={}, stdin=none, stdout=none, stderr=none)


def _tell_warm(folder: Path) -> None:
    from f3sr.runtime.cache_files import write_whole
    from f3sr.runtime.kernel_files import SUFFIX

    write_whole(folder / WARM, "\n".join(sorted(file.name for file in folder.glob(f"*{SUFFIX}"))).encode())


def _discard_old_versions(cache_folder: Path) -> None:
    """Keep the folders that were warmed up last; a process that runs on a deleted one has its code in memory."""
    folders = {folder: _last_use(folder) for folder in cache_folder.glob("kernels-*")}
    for folder in sorted(folders, key=lambda f: -folders[f])[KEPT_VERSIONS:]:
        shutil.rmtree(folder, ignore_errors=True)


def _last_use(folder: Path) -> float:
    with contextlib.suppress(OSError):
        return (folder / WARM).stat().st_mtime
    return 0.0


if __name__ == "__main__":
    die_with(int(sys.argv[-1]))
    _call(sys.argv[1:-1])
