"""Laws of the benchmark's comparison: regressions show in both directions, and a baseline loses nothing by itself."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import baseline
import tables
from f3sr.metrics.measures import IMAGE_MEASURES

FOLDER = Path(__file__).parents[1]


def group(**values: tuple[float, str, float]):
    measures = {
        name: baseline.Expected(value=value, direction=direction, tolerance=tolerance, unit="u", why="because")
        for name, (value, direction, tolerance) in values.items()
    }
    return baseline.Group(scenes=("a", "b"), measures=measures)


@pytest.fixture
def expected():
    return group(mIoU=(0.9, "higher", 0.01), K_max_J=(0.002, "lower", 0.001))


def test_within_tolerance_there_is_nothing_to_say(expected) -> None:
    comparison = baseline.compare(expected, {"mIoU": 0.892, "K_max_J": 0.0029, "unlisted": 5.0})
    assert comparison == baseline.Comparison(problems=(), gains=())


@pytest.mark.parametrize(("name", "worse", "better"), [("mIoU", 0.88, 0.92), ("K_max_J", 0.0031, 0.0009)])
def test_beyond_tolerance_worse_is_a_problem_and_better_a_gain(
    expected, name: str, worse: float, better: float
) -> None:
    means = {"mIoU": 0.9, "K_max_J": 0.002}
    bad = baseline.compare(expected, {**means, name: worse})
    good = baseline.compare(expected, {**means, name: better})
    assert [line.split()[0] for line in bad.problems] == [name] and not bad.gains
    assert [line.split()[0] for line in good.gains] == [name] and not good.problems


def test_a_tolerance_of_zero_allows_the_value_itself() -> None:
    crossings = group(N_cross=(0.0, "lower", 0.0))
    assert not baseline.compare(crossings, {"N_cross": 0.0}).problems
    assert baseline.compare(crossings, {"N_cross": 0.1}).problems


def test_rounding_of_kept_values_is_no_regression() -> None:
    thirds = group(fixed=(0.0, "lower", 0.0), n=(0.0, "higher", 0.0))
    means = {"fixed": 1 / 3, "n": 20 / 3}
    assert baseline.compare(baseline.updated(thirds, means), means) == baseline.Comparison(problems=(), gains=())


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_a_missing_or_meaningless_measure_is_an_error(expected, value: float | None) -> None:
    means = {"mIoU": 0.9} if value is None else {"mIoU": 0.9, "K_max_J": value}
    (problem,) = baseline.compare(expected, means).problems
    assert problem.startswith("K_max_J: missing" if value is None else "K_max_J: not finite")
    with pytest.raises(ValueError, match="K_max_J"):
        baseline.updated(expected, means)


def test_update_changes_values_only(expected, tmp_path: Path) -> None:
    new = baseline.updated(expected, {"mIoU": 0.912345, "K_max_J": 0.5, "unlisted": 1.0})
    assert new == group(mIoU=(0.9123, "higher", 0.01), K_max_J=(0.5, "lower", 0.001))
    file = tmp_path / "baseline.json"
    baseline.write({"rendered": new}, file)
    assert baseline.read(file) == {"rendered": new}


def test_means_are_printed_for_direct_composition_with_both_cameras(capsys: pytest.CaptureFixture[str]) -> None:
    assert tables.PICTURE == IMAGE_MEASURES
    row = {
        "group": "real",
        "f3sr": {"mIoU": 0.9, "R_pen": 0.0},
        "direct composition": {"mIoU": 0.7, "R_pen": 1.0},
        "direct composition, fitted camera": {"mIoU": 0.75},
        "stages": {"align": 1.0},
    }
    tables.print_results({"a": row}, {"real": row})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["mIoU", "0.7", "0.75", "0.9"] in lines and ["R_pen", "1", "-", "0"] in lines


@pytest.mark.parametrize("file", ["baseline.json", "alignment.json"])
def test_the_committed_baselines_are_whole(file: str) -> None:
    for name, kept in baseline.read(FOLDER / file).items():
        assert kept.scenes, name
        for measure, expected in kept.measures.items():
            assert expected.direction in ("higher", "lower"), measure
            assert expected.tolerance >= 0 and math.isfinite(expected.value) and expected.why, measure
        for measure, expected in kept.measures.items():
            worse = 1.01 * expected.tolerance + 0.002 * abs(expected.value) + 1e-9  # figures are rounded to four digits
            step = -worse if expected.direction == "higher" else worse
            means = {m: e.value for m, e in kept.measures.items()} | {measure: expected.value + step}
            assert [problem.split()[0] for problem in baseline.compare(kept, means).problems] == [measure]
