"""Fixtures of all tests: real inputs, a tiny folder, compiled kernels, and results of stages that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from f3sr.io import inputs
from f3sr.pipeline import Reconstruction, reconstruct
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
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all processes of one run of the tests share."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def stages(shared_folder: Path) -> Store:
    """Results of stages: all processes together reconstruct the same scene once."""
    return Store(shared_folder / "stages")


@pytest.fixture(scope="session")
def given(tmp_path_factory: pytest.TempPathFactory) -> inputs.Inputs:
    """Three boxes whose assets are off by 6 %: the scene of every test that reconstructs one."""
    folder = tmp_path_factory.mktemp("given") / "input"
    write_folder(folder, perturb=0.06, seed=3)
    return inputs.read(folder)


@pytest.fixture(scope="session")
def whole(given: inputs.Inputs, stages: Store) -> Reconstruction:
    """``given`` after all stages."""
    return reconstruct(given, store=stages)
