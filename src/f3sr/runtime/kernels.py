"""The numba decorator of the project, where its compiled kernels are kept, and compiling them ahead of use.

Kernels are compiled once per machine and version of the kernel sources. The cache folder's name holds a hash of all
kernel sources: a change in a kernel changes its callers in other files. Two processes compile while the command reads
its input; whoever calls a kernel waits for that kernel only. Those of films are compiled with the first film.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import importlib
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from f3sr.runtime import signals
from f3sr.runtime.cache_folder import within
from f3sr.runtime.kernel_files import SUFFIX, KernelFiles, discard_damaged
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.runtime.subprocesses import die_with, started

HERE = Path(__file__).parents[1]
"""The folder of the package f3sr."""

F = TypeVar("F", bound=Callable[..., Any])

OPTIONS: Mapping[str, Any] = {"nogil": True, "fastmath": False, "error_model": "numpy"}
"""No fastmath: reordered sums would differ between machines. error_model "numpy": 1 / 0 is inf, not an exception."""

KEPT_VERSIONS = 4
"""Kernel folders that stay: this version's and the others used last (3.4 MB each)."""
WARM = "warm"
"""Files in such a folder, one for films, with the names of compiled kernels; their age is the time since the last
use."""
COMPILING = "compiling kernels, once per machine"
POLL_S = 0.01
"""How soon a kernel that another process compiles is found [s]."""

HAS_KERNELS = re.compile(r"^from f3sr\.runtime\.kernels import .*\bkernel\b", re.MULTILINE)
HAS_WARM_UP = re.compile(r"^def warm_up\(\)", re.MULTILINE)
"""How sources of kernels, and of their ``warm_up()``, are told from others: nothing imports them to find them."""


def kernel_sources() -> list[Path]:
    """Files of this package that hold numba kernels."""
    return _sources(HAS_KERNELS)


def _sources(what: re.Pattern[str]) -> list[Path]:
    return [file for file, text in _texts().items() if what.search(text)]


@cache
def _texts() -> dict[Path, str]:
    return {file: file.read_text(encoding="utf-8") for file in sorted(HERE.rglob("*.py"))}


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

    dispatcher = cast(Any, njit)(no_cfunc_wrapper=True, **OPTIONS)(function)
    dispatcher._cache = KernelFiles(function, kernel_folder, _await)  # where ``njit(cache=True)`` puts numba's own
    return dispatcher


def inner_kernel(function: F) -> F:
    """A kernel that only other kernels call: without the wrapper for Python, which is a third of its compile time."""
    return _without_wrappers(function, inline=False)


def inline_kernel(function: F) -> F:
    """A small kernel that only other kernels call, inlined there."""
    # By LLVM. numba's own inline="always" copies the source, so each copy is typed and lowered anew: ten times slower.
    return _without_wrappers(function, inline=True)


def _without_wrappers(function: F, *, inline: bool) -> F:
    from numba import njit

    wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = cast(Any, njit)(forceinline=inline, **wrappers, **OPTIONS)(function)
    dispatcher.__class__ = _uncallable(type(dispatcher))
    return cast(F, dispatcher)


@cache
def _uncallable(dispatcher: type) -> type:
    """The same for numba; a call from Python, without the wrapper a crash, is an error."""

    def refuse(self: Any, *_: Any) -> None:
        raise TypeError(f"{self.__name__} is for other kernels only")

    return type("Inner", (dispatcher,), {"__call__": refuse})


def is_warm(*, film: bool = True) -> bool:
    """True when every kernel, with those of films or without, was compiled for this version of the sources, and kept.

    False without a cache."""
    folder = kernel_folder()
    return folder is not None and not _cold(folder, film)


def warm_up(progress: Progress = silent, *, film: bool = True) -> None:
    """Compile what is not in the cache yet, and load everything, with the kernels of films or without.

    A damaged cache file is reported, discarded and made again. Without a cache every process compiles."""
    with compiling(film=film) as compilers:
        compilers.finish(progress)
    _call(_warm_ups(film))


@contextmanager
def compiling(*, film: bool = False) -> Generator[Compilers]:
    """Compile what is not in the cache yet beside the block, with the kernels of films or without.

    A kernel that is called in the block waits until it is there. Without a cache ``Compilers.begin`` compiles."""
    folder = kernel_folder()
    if folder is None:
        yield Compilers(step="compiling kernels for this run only, as no folder can keep them", here=_warm_ups(film))
        return
    if _compiled_by:  # a command that is a part of another one
        yield Compilers(step=COMPILING, processes=tuple(dict.fromkeys(_compiled_by.values())))
        return
    damaged = discard_damaged(folder)
    cold = _cold(folder, film)
    step = COMPILING if cold else "kernels"
    if damaged:
        step = f"compiling kernels again, as {damaged} damaged files were found and discarded"
    with contextlib.ExitStack() as stack:
        processes = [stack.enter_context(_compiler(share)) for share in _shares(cold)]
        yield Compilers(step=step, processes=processes)
        if all(process.poll() == 0 for process in processes):  # a short command does not wait for them
            _tell_warm(folder, film)
    _discard_old_versions(folder.parent)


@dataclass(frozen=True, eq=False, kw_only=True)
class Compilers:
    """Who compiles kernels beside a command."""

    step: str
    """What the command says while it waits for them."""
    processes: Sequence[subprocess.Popen[bytes]] = ()
    here: Sequence[str] = ()
    """Modules whose kernels this process compiles for itself."""

    def begin(self, progress: Progress) -> None:
        """Wait for the kernels that are needed first, those of ``FIRST``."""
        self._wait(progress, lambda module: _group(module) == FIRST)

    def finish(self, progress: Progress) -> None:
        """Wait for all."""
        self._wait(progress, lambda _: True)

    @property
    def busy(self) -> bool:
        """Whether somebody has to wait yet."""
        return bool(self.here) or any(process.poll() is None for process in self.processes)

    def _wait(self, progress: Progress, needed: Callable[[str], bool]) -> None:
        with timed(self.step, progress):
            _call(self.here)
            for process in self.processes:
                # It names each module before it compiles the kernels there: until then the last ones are not done.
                assert process.stdout
                for line in process.stdout:
                    if not needed(line.decode().strip()):
                        break
                else:
                    process.wait()


FIRST = "vision"
"""Where the kernels lie that a reconstruction calls first."""
ORDER = (FIRST, "contact", "proxies", "metrics", "background", "metrology", "rendering")
"""Folders with kernels, in the order in which a reconstruction, and then a film, comes to need them."""
FILM = "rendering"
"""The folder whose kernels films alone need: half of all."""

_compiled_by: dict[str, subprocess.Popen[bytes]] = {}
"""Who compiles the kernels of a folder beside this process."""


def _group(module: str) -> str:
    """The folder of f3sr that a module, or the file of a kernel, belongs to."""
    return module.split(".")[1]


def _warm_ups(film: bool) -> list[str]:
    """Modules with a ``warm_up()``, in ``ORDER``; together these call every kernel."""
    files = (file.relative_to(HERE).with_suffix("") for file in _sources(HAS_WARM_UP))
    modules = sorted((".".join(("f3sr", *file.parts)) for file in files), key=lambda name: ORDER.index(_group(name)))
    return [module for module in modules if film or _group(module) != FILM]


def _call(modules: Iterable[str]) -> None:
    for module in modules:
        importlib.import_module(module).warm_up()


def _cold(folder: Path, film: bool) -> list[str]:
    """Modules of which some kernel is not in the cache: all of a kind, or none."""
    kinds = {is_film for is_film in {False, film} if not _is_kept(folder, is_film)}
    return [module for module in _warm_ups(film) if (_group(module) == FILM) in kinds] if kinds else []


def _is_kept(folder: Path, film: bool) -> bool:
    try:
        names = _told(folder, film).read_text().splitlines()
    except OSError:
        return False
    return bool(names) and all((folder / name).exists() for name in names)


def _told(folder: Path, film: bool) -> Path:
    return folder / f"{WARM}-{'film' if film else 'scene'}"


def _tell_warm(folder: Path, film: bool) -> None:
    from f3sr.runtime.cache_files import write_whole

    names = sorted(file.name for file in folder.glob(f"*{SUFFIX}"))
    for is_film in {False, film}:
        kind = [name for name in names if (_group(name) == FILM) == is_film]
        write_whole(_told(folder, is_film), "\n".join(kind).encode())


def _shares(modules: Sequence[str]) -> list[list[str]]:
    """What each of two processes compiles: about equal work, and in both the folders that are needed early first."""
    groups = set(map(_group, modules))
    second = {"contact", "metrics", *({"metrology"} if FILM in groups else ())}
    shares = ([m for m in modules if (_group(m) in second) == late] for late in (False, True))
    return [share for share in shares if share]


@contextmanager
def _compiler(modules: Sequence[str]) -> Generator[subprocess.Popen[bytes]]:
    """A process that compiles the kernels of some modules; it ends with the block."""
    none, groups = subprocess.DEVNULL, set(map(_group, modules))

    def start() -> subprocess.Popen[bytes]:
        return started("f3sr.runtime.kernels", *modules, stdin=none, stdout=subprocess.PIPE, stderr=none)

    with signals.undone(start, subprocess.Popen.kill) as process:
        _compiled_by.update(dict.fromkeys(groups, process))
        try:
            yield process
        finally:
            for group in groups:
                del _compiled_by[group]
            process.kill()
            process.communicate()


def _await(file: Path) -> None:
    """Return once the file of a kernel is there, or nobody is about to make it."""
    process = _compiled_by.get(_group(file.name))
    while process and process.poll() is None and not file.exists():
        time.sleep(POLL_S)


def _discard_old_versions(cache_folder: Path) -> None:
    """Keep the folders that were warmed up last; a process that runs on a deleted one has its code in memory."""
    folders = {folder: _last_use(folder) for folder in cache_folder.glob("kernels-*")}
    for folder in sorted(folders, key=lambda f: -folders[f])[KEPT_VERSIONS:]:
        shutil.rmtree(folder, ignore_errors=True)


def _last_use(folder: Path) -> float:
    with contextlib.suppress(OSError):
        return max((file.stat().st_mtime for file in folder.glob(f"{WARM}*")), default=0.0)
    return 0.0


def _compile(modules: Iterable[str]) -> None:
    """The work of such a process: it names every module before it compiles what is there, and lives for that only."""
    gc.disable()  # a tenth of the time: a compiler makes many objects and no garbage that matters
    for module in modules:
        print(module, flush=True)
        _call([module])


if __name__ == "__main__":
    die_with(int(sys.argv[-1]))
    _compile(sys.argv[1:-1])
