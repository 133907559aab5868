"""What a check of a film finds, and what the words of a check mean in a picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from seen import Film, unit

Check = Mapping[str, Any]
"""One entry of a goal's checklist in suite.toml."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """Whether a check is met, when first [s], and what was measured against what, in words."""

    check: str
    met: bool
    time: float | None = None
    measured: str = ""

    @property
    def line(self) -> str:
        at = "" if self.time is None else f" at {self.time:.2f} s"
        return f"{'met   ' if self.met else 'MISSED'} {self.check}{at}: {self.measured}"


Before = Mapping[str, Found]
"""What the checks before one found, by their names."""


def since(c: Check, before: Before, film: Film) -> int | None:
    """The last sample before the check that ``after`` names; 0 without it; None where that one never happened."""
    if "after" not in c:
        return 0
    found = before.get(c["after"])
    return None if found is None or found.time is None else before_sample(film, found.time)


def before_sample(film: Film, time: float) -> int:
    return max(0, min(int(np.searchsorted(film.time, time + 1e-9)) - 1, len(film.time) - 2))


def first(film: Film, reached: np.ndarray, start: int = 0) -> float | None:
    found = np.flatnonzero(reached)
    return float(film.time[start + found[0]]) if len(found) else None


def needed(c: Check) -> str:
    most = f" to {1000 * c['at_most']:.0f}" if "at_most" in c else ""
    return f"{1000 * c['at_least']:.0f}{most} mm"


def directions(film: Film, c: Check, id: int) -> list[np.ndarray]:
    """Unit vectors along the table, any of which the words may mean: away is along the view's axis or the line of sight
    to the object."""
    if "towards" in c:
        return [unit((film.centre(c["towards"])[0] - film.centre(id)[0]) * [1, 1, 0])]
    sight = unit((film.centre(id)[0] - film.T_world_camera[:3, 3]) * [1, 1, 0])
    ways = {"left": [-film.right], "right": [film.right], "away": [film.away, sight], "towards": [-film.away, -sight]}
    return ways[c["direction"]] if "direction" in c else []
