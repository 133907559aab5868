"""Helper modules and fixtures that several test files share."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# Where no bytecode is written, every process that a test starts compiles all of f3sr: a third of its start. Asserts of
# tests would be rewritten in every run too.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

import hypothesis  # noqa: E402
import pytest  # noqa: E402

from f3sr.runtime import kernels  # noqa: E402

sys.path.insert(0, str(Path(__file__).parent))
# No example has a deadline in wall time: other programs run on the machine. pytest-timeout ends what hangs.
hypothesis.settings.register_profile("no_deadline", deadline=None)
hypothesis.settings.load_profile("no_deadline")

from fixtures import browser, compiled, folder, given, jobs, shared_data, shared_folder, stages, whole  # noqa: E402, F401


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the kernels before the processes of ``-n`` start: each would compile all of them."""
    if not hasattr(session.config, "workerinput") and not kernels.is_warm():
        kernels.warm_up()
