"""Helper modules and fixtures that several test files share."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from f3sr.runtime import kernels

sys.path.insert(0, str(Path(__file__).parent))

from fixtures import browser, compiled, folder, given, shared_data, shared_folder, stages, whole  # noqa: F401


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before the processes of ``-n`` start: each would compile all of them."""
    if not hasattr(session.config, "workerinput") and not kernels.is_warm():
        kernels.warm_up()
