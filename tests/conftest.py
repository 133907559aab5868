"""Helper modules and fixtures that several test files share."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from fixtures import browser, compiled, folder, given, shared_data, shared_folder, stages, whole  # noqa: F401
