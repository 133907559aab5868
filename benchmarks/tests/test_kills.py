"""The points of benchmarks/kills.py in small: kill -9, look, and let the next run go on."""

from __future__ import annotations

from pathlib import Path

import pytest

import forked
import kills
from folders import write_folder

SKIPPED = ("align", "refine", "coarsen", "uncertainty", "evaluate", "inpaint")
"""Stages that no point of these is in, and that later ones do without."""


@pytest.mark.slow
def test_after_kill_9_a_whole_package_or_none_and_the_next_run_goes_on(compiled: Path, tmp_path: Path):
    write_folder(tmp_path / "input", perturb=0.05, seed=2)
    harness = kills.Kills(tmp_path / "input", tmp_path / "work", [compiled], SKIPPED, forked.Popen)
    points = [kills.Point("level:20"), kills.Point("storing:3"), kills.Point("rename2:1", old=True)]
    trials = [harness.trial(point) for point in points]
    assert [trial.faults for trial in trials] == [[]] * 3, "\n".join(map(kills.show, trials))
    assert [len(trial.finished) for trial in trials] == [1, 3, 8]
    assert [trial.found for trial in trials] == ["nothing"] * 3
