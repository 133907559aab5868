"""What is imported by the tests that use it: PyTorch takes seconds in each process that collects tests."""

from __future__ import annotations

import importlib
import importlib.util
import os
from typing import Any

import pytest

os.environ["HF_HUB_OFFLINE"] = "1"
os.environ["HF_HUB_DISABLE_TELEMETRY"] = "1"
TORCHVISION = importlib.util.find_spec("torchvision") is not None
"""The oracle of processors that need it; back ends never do."""
WITH_MODELS = [
    pytest.mark.models,
    pytest.mark.usefixtures("tiny"),
    pytest.mark.skipif(
        any(importlib.util.find_spec(name) is None for name in ("torch", "transformers")),
        reason="pip install 'f3sr[models]'",
    ),
]
"""Marks of test files that need PyTorch."""


class Lazily:
    """A module that its first use imports."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("_"):  # pytest looks whether it is a test
            raise AttributeError(attribute)
        return getattr(importlib.import_module(self._name), attribute)
