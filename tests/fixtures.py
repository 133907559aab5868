"""Fixtures of all tests: real inputs, a tiny folder, compiled kernels, shared results of stages, and a browser."""

from __future__ import annotations

import importlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from f3sr.io import inputs
from f3sr.pipeline import Reconstruction, reconstruct
from f3sr.runtime import cache_folder, kernels
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


@pytest.fixture
def jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of all job folders, in a cache of its own."""
    monkeypatch.setenv("F3SR_CACHE_DIR", str(tmp_path / "cache"))
    cache_folder.cache_folder.cache_clear()
    yield tmp_path / "cache" / "workers"
    monkeypatch.undo()
    cache_folder.cache_folder.cache_clear()


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


@pytest.fixture(scope="session")
def tiny() -> ModuleType:
    """PyTorch as all tests of networks have it, whichever comes first."""
    return importlib.import_module("tiny_models")


CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = [
    "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-sync",
    "--disable-component-update", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
]  # fmt: skip


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install 'f3sr[browser]'")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield browser
        browser.close()
