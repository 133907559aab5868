"""Libraries of optional extras: imported where they are used, or one line that says how to install them."""

from __future__ import annotations

import importlib
from typing import Any

from f3sr.errors import F3srError


def library(module: str, *, extra: str, why: str) -> Any:
    """The module. Raises F3srError naming the extra where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = module.partition(".")[0]
        raise F3srError(f"{why} needs {missing}, which is not installed: pip install 'f3sr[{extra}]'") from error
