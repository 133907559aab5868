"""Paths and fixtures that several test files share."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))
os.environ["F3SR_TRACEBACK"] = "1"  # what nobody foresaw shows where it was

DATA = HERE.parents[1] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real inputs beside the checkout."""
    if not DATA.is_dir():
        pytest.skip(f"no real data: {DATA} is absent")
    return DATA


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A valid tiny input folder."""
    from folders import write_folder

    write_folder(tmp_path / "input")
    return tmp_path / "input"
