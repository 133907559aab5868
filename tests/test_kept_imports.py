"""Imports that last: nothing is collected meanwhile, what is new is never looked through again."""

from __future__ import annotations

import gc
import importlib
import sys
from pathlib import Path

import pytest

from f3sr.runtime.kept_imports import kept_imports


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a module that nobody has imported."""
    (tmp_path / "never_seen.py").write_text(
        "import gc\nCOLLECTS = gc.isenabled()\nHELD = [[k] for k in range(10_000)]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "never_seen", raising=False)
    return "never_seen"


def test_what_is_new_is_kept_out_of_collections(module: str) -> None:
    before = gc.get_freeze_count()
    with kept_imports():
        made = importlib.import_module(module)
    assert not made.COLLECTS and gc.isenabled()
    assert gc.get_freeze_count() >= before + len(made.HELD)


def test_what_is_known_changes_nothing(module: str) -> None:
    importlib.import_module(module)
    before = gc.get_freeze_count()
    with kept_imports():
        importlib.import_module(module)
    assert gc.get_freeze_count() == before and gc.isenabled()


def test_an_import_that_fails_leaves_collections_on() -> None:
    with pytest.raises(ModuleNotFoundError), kept_imports(), kept_imports():
        importlib.import_module("no_module_of_this_name")
    assert gc.isenabled()
