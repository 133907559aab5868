"""How long everyday things are, by label: a table of standards and of what shops sell (known_sizes.toml)."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

TABLE = Path(__file__).with_name("known_sizes.toml")

NOT_REAL = frozenset(("toy", "model", "mini", "miniature", "plush", "stuffed", "foam", "picture", "statue", "figurine"))
"""Words of labels whose thing is not as large as its name says."""


@dataclass(frozen=True, kw_only=True)
class UsualSize:
    """The longest side of the tightest box around things of a name."""

    metres: float
    spread: float
    """One standard deviation of its logarithm."""
    why: str


def usual_size(label: str) -> UsualSize | None:
    """What a label says of its object's size; None where the table has no such thing.

    The name with most words wins, then the one nearest to the label's end: English puts the thing last."""
    words = _words(label)
    if NOT_REAL.intersection(words):
        return None
    found = [(len(name), end, size) for name, size in table().items() for end in _ends(words, name)]
    return max(found, key=lambda f: f[:2])[2] if found else None


@cache
def table() -> dict[tuple[str, ...], UsualSize]:
    """Every name, as words, with its size."""
    return dict(_entries(tomllib.loads(TABLE.read_text(encoding="utf-8"))["things"]))


def _entries(things: list[dict[str, Any]]) -> Iterator[tuple[tuple[str, ...], UsualSize]]:
    for thing in things:
        size = UsualSize(metres=thing["metres"], spread=thing["spread"], why=thing["why"])
        for label in thing["labels"]:
            yield _words(label), size


def _words(label: str) -> tuple[str, ...]:
    return tuple(re.findall(r"[a-z0-9']+", label.lower()))


def _ends(words: tuple[str, ...], name: tuple[str, ...]) -> Iterator[int]:
    """Where a name ends in a label, in words."""
    n = len(name)
    yield from (k + n for k in range(len(words) - n + 1) if words[k : k + n] == name)
