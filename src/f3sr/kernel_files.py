"""Compiled kernels on disk: one file per kernel and signature, whole or absent, its digest checked before it is run.

numba's own cache keeps an index that two processes overwrite for each other, and unpickles whatever the disk gives: a
damaged file fails every run, or is run. Here a file that cannot be trusted is one that is not there.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numba
from numba.core.compiler import CompileResult

from f3sr.cache import PART, is_orphan, write_whole

SUFFIX = ".kernel"
DIGEST = hashlib.sha256().digest_size


class KernelFiles:
    """What a numba dispatcher asks for compiled code: one instance per kernel."""

    def __init__(self, function: Callable[..., Any], folder: Path) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._code = hashlib.sha256(function.__code__.co_code).hexdigest()
        self._folder = folder

    @property
    def cache_path(self) -> str:
        return str(self._folder)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel for a signature, None where there is none to trust."""
        target_context.refresh()
        data = read(self._path(sig, target_context.codegen()))
        return data and cast(Any, CompileResult)._rebuild(target_context, *pickle.loads(data))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel; a folder that cannot be written to keeps nothing, and that is all."""
        if not data.lifted and not data.library.has_dynamic_globals:
            code = pickle.dumps(data._reduce())
            write_whole(self._path(sig, data.codegen), hashlib.sha256(code).digest() + code)

    def flush(self) -> None:
        pass

    enable = disable = flush

    def _path(self, sig: Any, codegen: Any) -> Path:
        key = repr((numba.__version__, sys.version, str(sig), codegen.magic_tuple(), self._code))
        return self._folder / f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:16]}{SUFFIX}"


def read(file: Path) -> bytes | None:
    """What was written, None when it is not there or not whole."""
    try:
        data = file.read_bytes()
    except OSError:
        return None
    return data[DIGEST:] if hashlib.sha256(data[DIGEST:]).digest() == data[:DIGEST] else None


def discard_damaged(folder: Path) -> int:
    """Delete the files that cannot be trusted; how many there were."""
    damaged = [file for file in folder.glob(f"*{SUFFIX}") if read(file) is None]
    orphans = [file for file in folder.glob(f"*{PART}") if is_orphan(file)]
    for file in damaged + orphans:
        with contextlib.suppress(OSError):
            file.unlink()
    return len(damaged)
