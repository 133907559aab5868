"""Goals that a scene invites to: what its menu offers, as sentences that the rules understand."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from f3sr.goals.cavity import cavity_of
from f3sr.goals.refusal import Refusal
from f3sr.language.capabilities import Entry, menu
from f3sr.language.planner import planned
from f3sr.scene import Scene

MOST = 8
"""Suggestions on the page: they fit into two lines."""
ALONE = {"knock over": "knock over the {}", "push": "push the {} to the left", "roll": "roll the {} to the right"}
"""Verbs and sentences about one object."""


ROOM = 0.8
"""Share of a cavity's diameter that the second longest side of what is thrown into it may have."""


def suggestions(scene: Scene) -> tuple[str, ...]:
    """At most ``MOST`` sentences, of which every verb comes once before one comes twice."""
    found = list[str]()
    for goal in _sentences(menu(scene), scene):
        if goal not in found and not isinstance(planned(goal, scene), Refusal):
            found.append(goal)
        if len(found) == MOST:
            break
    return tuple(found)


def _sentences(entries: tuple[Entry, ...], scene: Scene) -> Iterator[str]:
    """Every kind of goal in turn, each about the next object that can do it."""
    kinds = [list(_into(entries, scene)), *(list(_alone(entries, verb)) for verb in ALONE), list(_against(entries))]
    for k in range(max(map(len, kinds), default=0)):
        for n, kind in enumerate(kinds):
            if kind:
                yield kind[(k + n) % len(kind)]


def _alone(entries: tuple[Entry, ...], verb: str) -> Iterator[str]:
    yield from (ALONE[verb].format(e.name) for e in entries if verb in e.verbs)


def _into(entries: tuple[Entry, ...], scene: Scene) -> Iterator[str]:
    """What fits, the smallest first."""
    for target in (e for e in entries if e.holds_things):
        cavity = cavity_of(scene[target.id])
        widths = {e.id: float(np.sort(np.ptp(scene[e.id].bounds_world, axis=0))[1]) for e in entries}
        for e in sorted(entries, key=lambda e: widths[e.id]):
            fits = cavity is not None and widths[e.id] < ROOM * 2 * cavity.radius
            if fits and e.verbs and e is not target and scene[e.id].supported_by != target.id:
                yield f"throw the {e.name} into the {target.name}"


def _against(entries: tuple[Entry, ...]) -> Iterator[str]:
    movable = [e for e in entries if "push" in e.verbs]
    yield from (f"push the {a.name} into the {b.name}" for a in movable for b in entries if b is not a)
