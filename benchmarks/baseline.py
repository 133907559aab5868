"""The comparison of measured means with ``baseline.json``: regressions, missing measures, and the update of values."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

FILE = Path(__file__).with_name("baseline.json")

Means = Mapping[str, float]
"""The mean of every measure over the scenes of one group."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What one measure was, and how much worse it may become before that counts as a regression."""

    value: float
    direction: Literal["higher", "lower"]
    """Which way is better."""
    tolerance: float
    """Absolute, in ``unit``."""
    unit: str
    why: str
    """Why this tolerance."""

    def loss(self, now: float) -> float:
        """How much worse ``now`` is than ``value``; negative when it is better."""
        return self.value - now if self.direction == "higher" else now - self.value


@dataclass(frozen=True, kw_only=True)
class Group:
    """The scenes whose means are compared, and what is expected of them."""

    scenes: tuple[str, ...]
    measures: Mapping[str, Expected]


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Every line is ready to print; ``problems`` are regressions and measures that are missing or not finite."""

    problems: tuple[str, ...]
    gains: tuple[str, ...]


def read(path: Path = FILE) -> dict[str, Group]:
    """The groups of a baseline file by name."""
    groups = json.loads(path.read_text())
    return {
        name: Group(
            scenes=tuple(group["scenes"]),
            measures={measure: Expected(**fields) for measure, fields in group["measures"].items()},
        )
        for name, group in groups.items()
    }


def write(groups: Mapping[str, Group], path: Path = FILE) -> None:
    """Write a baseline file that ``read`` gives back."""
    path.write_text(json.dumps({name: asdict(group) for name, group in groups.items()}, indent=2) + "\n")


def compare(group: Group, means: Means) -> Comparison:
    """Hold ``means`` against the group's baseline. Measures that the baseline does not list are not judged."""
    problems: list[str] = []
    gains: list[str] = []
    for name, expected in group.measures.items():
        now = _rounded(means.get(name, math.nan))
        line = f"{name} {expected.value:.4g} -> {now:.4g} {expected.unit}".rstrip()
        if not math.isfinite(now):
            problems.append(f"{name}: {'not finite' if name in means else 'missing'}, it was {expected.value:.4g}")
        elif expected.loss(now) > expected.tolerance:
            problems.append(f"{line}: worse by more than {expected.tolerance:.4g}")
        elif expected.loss(now) < -expected.tolerance:
            gains.append(f"{line}: better by more than {expected.tolerance:.4g}")
    return Comparison(problems=tuple(problems), gains=tuple(gains))


def updated(group: Group, means: Means) -> Group:
    """The group with the values of ``means``; directions, tolerances and reasons stay.

    Raises ValueError when a measure is missing or not finite: a baseline never loses a measure by itself.
    """
    if lost := [name for name in group.measures if not math.isfinite(means.get(name, math.nan))]:
        raise ValueError(f"missing or not finite: {', '.join(lost)}; measured: {', '.join(means)}")
    measures = {name: replace(old, value=_rounded(means[name])) for name, old in group.measures.items()}
    return replace(group, measures=measures)


def judged(path: Path, measured: Mapping[str, Means], *, update: bool) -> int:
    """Print what became better or worse than a baseline file, by group, or write the new one; returns the exit code."""
    groups, problems = read(path), False
    for name, means in measured.items():
        if update:
            groups[name] = updated(groups[name], means)
            continue
        comparison = compare(groups[name], means)
        for gain in comparison.gains:
            print(f"{name}: {gain} (--update keeps it)")
        for problem in comparison.problems:
            print(f"{name}: REGRESSION {problem}")
        problems |= bool(comparison.problems)
    if update:
        write(groups, path)
        print(f"new values in {path}")
    return int(problems)


def _rounded(value: float) -> float:
    """Four significant digits: more would only make noisy diffs. Both sides of a comparison are rounded alike."""
    return float(f"{value:.4g}")
