"""What further clauses add to a request: ``so that it falls over``, ``and let it land in the bowl``."""

from __future__ import annotations

from dataclasses import replace

from f3sr.goals.plan import Kind
from f3sr.goals.refusal import refuse
from f3sr.language.grammar.clauses import Clause, refuse_several
from f3sr.language.grammar.lexicon import Family, lexicon
from f3sr.language.grammar.request import Preposition, Request, WantedOutcome, What

IT = {"", "it", "itself", "them"}
RETURNING: set[Family] = {"fall", "return", "throw", "drop"}
"""Families that say how a throw ends."""
OUTCOMES: dict[Family, What] = {
    "tip": "topple",
    "fall": "topple",
    "push": "move",
    "roll": "roll",
    "bounce": "bounce",
    "return": "return",
    "stay": "upright",
    "rest": "rest",
}
"""What a further clause's verb says of how it ends."""


def continued(r: Request, c: Clause) -> Request:
    """A request with what a further clause adds: what it hits, where it ends, what comes of it. Raises
    NotUnderstoodError where the clause is a goal of its own."""
    if (struck := _struck(c)) and r.target is None and _whose(c.subject, r) == "active":
        return _with_target(r, "onto" if r.kind in ("drop", "lift_and_drop") else "into", struck)
    if c.family == "stay" and c.object == "upright":
        c = replace(c, object="")
    if c.family == "stay" and c.subject and not c.object and _whose(c.subject, r) is None:
        return replace(r, spared=(*r.spared, c.subject))
    if _whose(c.subject, r) in ("active", "either") and _lands_on_ground(c, r):
        return _with_outcome(r, WantedOutcome(what="grounded", whose="active"))
    whose = _whose(c.subject or c.object, r)
    if set(c.directions) - {"up", "down", *r.direction}:
        refuse_several()
    if whose is None or (c.subject and c.object not in IT):
        refuse_several()
    if c.targets and r.target is None and whose == "active":
        return _ended(r, c)
    if c.family in RETURNING and r.kind in ("throw", "launch_and_return") and r.target is None:
        return _fallen_back(r, c)
    what = _outcome(c)
    if what is None or c.targets or c.tool:
        refuse_several()
    if whose == "either" and r.outcomes:
        whose = r.outcomes[-1].whose
    elif whose == "either":
        whose = "target" if what in ("topple", "move") and r.kind != "topple" else "active"
    return _with_outcome(r, WantedOutcome(what=what, whose="target" if whose == "target" else "active"))


def _with_outcome(r: Request, wanted: WantedOutcome) -> Request:
    """Outcomes add up, but nothing falls over and stays upright."""
    if any(o.whose == wanted.whose and {o.what, wanted.what} == {"topple", "upright"} for o in r.outcomes):
        refuse("contradiction", "the goal says both falls over and stays upright; accepted: one of them")
    return r if wanted in r.outcomes else replace(r, outcomes=(*r.outcomes, wanted))


def _lands_on_ground(c: Clause, r: Request) -> bool:
    """``knock it off the book so that it ends up on the table``: where it ends, of what is not thrown there."""
    landing = c.verb == "land" and not c.over and r.kind in ("topple", "slide", "push_into", "roll")
    return landing and any(way == "onto" and target in lexicon().ground for way, target in c.targets)


def _fallen_back(r: Request, c: Clause) -> Request:
    """``throw it up and let it fall``; what is thrown aside falls anyway, and can at most be asked to return."""
    if not set(r.direction) - {"up"}:
        return replace(r, kind="launch_and_return")
    return _with_outcome(r, WantedOutcome(what="return", whose="active")) if c.family == "return" else r


def _struck(c: Clause) -> str:
    """What is hit in ``so that it hits the box``, ``and bumps into the box``."""
    if c.family not in ("hit", "collide", "push"):
        return ""
    into = [words for preposition, words in c.targets if preposition in ("into", "against", "to")]
    struck = c.tool or (into or [c.object if c.family != "push" else ""])[0]
    return "" if struck in IT or (into and c.object not in IT) else struck


def _ended(r: Request, c: Clause) -> Request:
    """``and it lands in the bowl``, ``so that it bounces off the box``"""
    preposition, target = c.targets[0]
    if c.family == "bounce" and r.kind in ("throw", "launch_and_return"):
        r = replace(r, kind="bounce")
    elif c.family not in RETURNING:
        refuse_several()
    return _with_target(r, preposition, target)


def _with_target(r: Request, preposition: Preposition, target: str) -> Request:
    kinds: dict[Kind, Kind] = {"launch_and_return": "throw"}
    if preposition != "off":
        kinds["slide"] = "push_into"
    return replace(r, kind=kinds.get(r.kind, r.kind), target=target, preposition=preposition)


def _outcome(c: Clause) -> What | None:
    return "topple" if c.over else OUTCOMES.get(c.family)


def _whose(subject: str, r: Request) -> str | None:
    """Whether a clause is about the active object, the target, either, or neither (None)."""
    if subject in IT:
        return "active" if r.target is None else "either"
    words = set(subject.split())
    if r.target and words <= set(r.target.split()):
        return "target"
    return "active" if words <= set(r.active.split()) else None
