"""Helper modules and fixtures that several test files share."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from fixtures import compiled, folder, shared_data, stages  # noqa: F401
