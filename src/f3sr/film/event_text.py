"""What happens in a rollout, in words that fit below a picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from f3sr.goals import plan as p
from f3sr.scene import GROUND, Scene

LONGEST_NAME = 28
"""Characters of a label that are shown where space is short."""


def named(scene: Scene, id: int) -> str:
    """An object by its label, cut where that is long."""
    if id == GROUND:
        return "the ground"
    label = " ".join(scene[id].label.split()) or f"object {id}"
    return label if len(label) <= LONGEST_NAME else label[: LONGEST_NAME - 1].rstrip() + "…"


def happened(condition: p.Condition, scene: Scene) -> str:
    """What is so once a condition is met."""
    return _WORDS[type(condition)](condition, lambda id: named(scene, id))


def told(statements: Sequence[str]) -> str:
    """Statements in one line; what one begins with like the one before it is not said again."""
    line = statements[0]
    for k, (before, statement) in enumerate(pairwise(statements), 1):
        words = statement.split(" ")
        same = next((n for n, (a, b) in enumerate(zip(before.split(" "), words, strict=False)) if a != b), 0)
        last = k + 1 == len(statements)
        line += f"{' and' if last and same else ','} {' '.join(words[same:])}"
    return line


def clock(time: float) -> str:
    """A time [s] to hundredths."""
    return f"{time:.2f} s"


def metres(length: float) -> str:
    """A length [m] in mm, cm or m, as people say it."""
    if length < 0.0995:
        return f"{1000 * length:.0f} mm"
    return f"{100 * length:.0f} cm" if length < 0.995 else f"{length:.2g} m"


Name = Callable[[int], str]


def _contact(c: p.Contact, name: Name) -> str:
    return f"{name(c.a)} touches {name(c.b)}"


def _displaced(c: p.Displaced, name: Name) -> str:
    return f"{name(c.a)} has moved {metres(c.at_least)}"


def _toppled(c: p.Toppled, name: Name) -> str:
    return f"{name(c.a)} leans {math.degrees(c.at_least):.0f}°"


def _rolled(c: p.Rolled, name: Name) -> str:
    return f"{name(c.a)} has rolled {math.degrees(c.at_least):.0f}°"


def _height(c: p.Height, name: Name) -> str:
    return f"{name(c.a)} is {metres(c.at_least)} up"


_WORDS: Mapping[type[Any], Callable[[Any, Name], str]] = {
    p.Contact: _contact,
    p.Displaced: _displaced,
    p.Toppled: _toppled,
    p.Rolled: _rolled,
    p.Height: _height,
    p.Upright: lambda c, name: f"{name(c.a)} stands",
    p.Bounced: lambda c, name: f"{name(c.a)} bounces off {name(c.b)}",
    p.Over: lambda c, name: f"{name(c.a)} is over {name(c.b)}",
    p.Off: lambda c, name: f"{name(c.a)} is off {name(c.b)}",
    p.On: lambda c, name: f"{name(c.a)} is on {name(c.b)}",
    p.Inside: lambda c, name: f"{name(c.a)} is in {name(c.b)}",
    p.AtRest: lambda c, name: f"{name(c.a)} is at rest",
    p.Returned: lambda c, name: f"{name(c.a)} is back",
}
