"""The day a file was written, for formats that state a date: equal files give equal exports."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

EPOCH = "SOURCE_DATE_EPOCH"
"""Environment variable that replaces every date in what is built (reproducible-builds.org): seconds since 1970."""


def date_of(file: Path) -> str:
    """YYYY-MM-DD in UTC of the file's last change, or of ``$SOURCE_DATE_EPOCH`` where that is a number."""
    given = os.environ.get(EPOCH, "")
    seconds = int(given) if given.isascii() and given.isdigit() and len(given) < 12 else file.stat().st_mtime
    return datetime.fromtimestamp(seconds, UTC).date().isoformat()
