"""A small, seeded share of the fuzzing: benchmarks/fuzz.py runs thousands."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

import forked

CASES = 15
"""Of seed 7: two are accepted, in posed meshes and in a full folder, and take most of the time."""
FUZZ = Path(__file__).parents[1] / "fuzz.py"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="forks")
def test_mutated_folders_are_refused_in_one_line_or_give_a_valid_package(tmp_path: Path):
    arguments = [sys.executable, str(FUZZ), "--count", str(CASES), "--seed", "7", "--out", str(tmp_path)]
    done = forked.run(arguments)
    summary = json.loads(done.stdout)
    assert done.returncode == 0 and not summary["findings"], done.stderr
    assert summary["cases"] == CASES
    assert summary["verdicts"]["accepted"] >= 2 and summary["verdicts"]["rejected"] >= 8  # it tries both
