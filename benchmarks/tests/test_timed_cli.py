"""The timed command line names functions of f3sr in strings; each must be there."""

from __future__ import annotations

import importlib

import pytest

import timed_cli


@pytest.mark.parametrize(("step", "module", "name"), timed_cli.STEPS)
def test_what_is_timed_is_there(step: str, module: str, name: str):
    assert step and callable(getattr(importlib.import_module(f"f3sr.{module}"), name))
