"""Compiled kernels on disk: one file per kernel and signature, whole or absent, its digest checked before it is run.

numba's own cache (``njit(cache=True)``) is unsuitable for three reasons. It makes its folders when a module is
imported. It keeps an index that two processes overwrite for each other. It unpickles any file, so a damaged one fails
every run, or is executed. Here an untrusted file counts as absent.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from f3sr.runtime.cache_files import PART, is_orphan, read_sealed, write_sealed

SUFFIX = ".kernel"


class KernelFiles:
    """What a numba dispatcher asks for compiled code: one instance per kernel. ``folder`` says where files are kept,
    None for nowhere; it is asked when the kernel is compiled or used first. ``wait`` returns once another process will
    not write a file any more, or has written it."""

    def __init__(
        self, function: Callable[..., Any], folder: Callable[[], Path | None], wait: Callable[[Path], None]
    ) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._code = function.__code__.co_code
        self._folder, self._wait = folder, wait

    @property
    def cache_path(self) -> str | None:
        folder = self._folder()
        return str(folder) if folder else None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled kernel for a signature, None where there is none to trust."""
        target_context.refresh()
        from numba.core.compiler import CompileResult

        file = self._file(sig, target_context.codegen())
        if file:
            self._wait(file)
        data = file and read_sealed(file, file.name)
        return data and cast(Any, CompileResult)._rebuild(target_context, *pickle.loads(data))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel; a folder that cannot be written to keeps nothing, and that is all."""
        file = self._file(sig, data.codegen)
        if file and not data.lifted and not data.library.has_dynamic_globals:
            write_sealed(file, pickle.dumps(data._reduce()), file.name)

    def flush(self) -> None:
        pass

    enable = disable = flush

    def _file(self, sig: Any, codegen: Any) -> Path | None:
        import numba

        key = repr((numba.__version__, sys.version, str(sig), codegen.magic_tuple(), self._code))
        folder = self._folder()
        return folder and folder / f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:16]}{SUFFIX}"


def discard_damaged(folder: Path) -> int:
    """Delete the files that cannot be trusted; how many there were."""
    damaged = [file for file in folder.glob(f"*{SUFFIX}") if read_sealed(file, file.name) is None]
    orphans = [file for file in folder.glob(f"*{PART}") if is_orphan(file)]
    for file in damaged + orphans:
        with contextlib.suppress(OSError):
            file.unlink()
    return len(damaged)
