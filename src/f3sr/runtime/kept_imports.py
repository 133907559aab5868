"""Imports that last as long as the process: nobody looks for garbage among them, then or later."""

from __future__ import annotations

import gc
import sys
from collections.abc import Generator
from contextlib import contextmanager


@contextmanager
def kept_imports() -> Generator[None]:
    """Import in the block without garbage collection. What it brought is not looked through ever again.

    Modules are most of the objects of a command, and live until it ends: a seventh of the processor time of a small
    ``f3sr reconstruct``. Where the block imports nothing new, nothing changes."""
    known, collects = len(sys.modules), gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if len(sys.modules) > known:
            gc.freeze()
        if collects:
            gc.enable()
