"""Tests of the benchmark scripts find the scripts and the makers of the tests."""

from __future__ import annotations

import sys
from pathlib import Path

BENCHMARKS = Path(__file__).parents[1]
sys.path[:0] = [str(BENCHMARKS), str(BENCHMARKS / "goals"), str(BENCHMARKS.parent / "tests")]

from fixtures import compiled, folder, given, shared_data, shared_folder, stages, whole  # noqa: E402, F401
from processor_time import pytest_runtest_setup, pytest_runtest_teardown  # noqa: E402, F401
