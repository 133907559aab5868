"""Goals that a scene invites to: what its menu offers, as sentences that the rules understand."""

from __future__ import annotations

from collections.abc import Iterator

from f3sr.goals.refusal import Refusal
from f3sr.language.capabilities import Entry, menu
from f3sr.language.planner import planned
from f3sr.scene import Scene

MOST = 8
"""Suggestions on the page: they fit into two lines."""
ALONE = {"knock over": "knock over the {}", "push": "push the {} to the left", "roll": "roll the {} to the right"}
"""Verbs and sentences about one object."""


def suggestions(scene: Scene) -> tuple[str, ...]:
    """At most ``MOST`` sentences, of which every verb comes once before one comes twice."""
    found = list[str]()
    for goal in _sentences(menu(scene)):
        if goal not in found and not isinstance(planned(goal, scene), Refusal):
            found.append(goal)
        if len(found) == MOST:
            break
    return tuple(found)


def _sentences(entries: tuple[Entry, ...]) -> Iterator[str]:
    """Every kind of goal in turn, each about the next object that can do it."""
    kinds = [list(_into(entries)), *(list(_alone(entries, verb)) for verb in ALONE), list(_against(entries))]
    for k in range(max(map(len, kinds), default=0)):
        for n, kind in enumerate(kinds):
            if kind:
                yield kind[(k + n) % len(kind)]


def _alone(entries: tuple[Entry, ...], verb: str) -> Iterator[str]:
    yield from (ALONE[verb].format(e.name) for e in entries if verb in e.verbs)


def _into(entries: tuple[Entry, ...]) -> Iterator[str]:
    for target in entries:
        if target.holds_things:
            yield from (f"throw the {e.name} into the {target.name}" for e in entries if e is not target and e.verbs)


def _against(entries: tuple[Entry, ...]) -> Iterator[str]:
    movable = [e for e in entries if "push" in e.verbs]
    yield from (f"push the {a.name} into the {b.name}" for a in movable for b in entries if b is not a)
