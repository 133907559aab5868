"""Fixtures of all tests: real inputs, a tiny folder, compiled kernels, and results of stages that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from f3sr.runtime import kernels
from f3sr.runtime.result_store import Store
from folders import write_folder

os.environ["F3SR_TRACEBACK"] = "1"  # what nobody foresaw shows where it was
DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The real inputs beside the checkout."""
    if not DATA.is_dir():
        pytest.skip(f"no real data: {DATA} is absent")
    return DATA


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A valid tiny input folder."""
    write_folder(tmp_path / "input")
    return tmp_path / "input"


@pytest.fixture(scope="session")
def compiled() -> Path:
    """The folder of compiled kernels."""
    kernels.warm_up()
    folder = kernels.kernel_folder()
    assert folder
    return folder


@pytest.fixture(scope="session")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Results of stages, kept for one run of the tests: all its processes reconstruct the same scene once."""
    base = tmp_path_factory.getbasetemp()
    return Store((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "stages")
