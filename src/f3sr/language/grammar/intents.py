"""From a goal's clauses to the one kind of plan that they ask for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

from f3sr.goals.plan import Kind
from f3sr.goals.refusal import quoted, refuse
from f3sr.language.grammar.clauses import DIRECTIONS, DROPPED, PLACED, Clause, refuse_several
from f3sr.language.grammar.lexicon import Direction, Family, lexicon
from f3sr.language.grammar.normaliser import spoken
from f3sr.language.grammar.outcome_clauses import IT, continued
from f3sr.language.grammar.request import OPPOSITE, Preposition, Request, WantedOutcome

ALONG = "this motion goes along the ground; accepted: left, right, away from me, towards me"
HITTING: frozenset[Family] = frozenset[Family](("hit", "push", "pull", "tip", "collide"))
"""Families that may say what is hit with what."""
MOVED: frozenset[Family] = DROPPED | frozenset[Family](("push", "pull", "roll"))
"""Families that may say where to by another object's place."""


def request(clauses: Sequence[Clause], *, let: bool = False) -> Request:
    """The request that a goal's clauses make; ``let`` says that the goal began with that word. Raises
    NotUnderstoodError where an object is missing, or the clauses ask for two motions."""
    first, *rest = [_placed(c) for c in clauses]
    if first.family == "lift" and rest:
        first, *rest = _lifted(clauses[0], rest[0]), *rest[1:]
    found = _single(first, let=let)
    for c in rest:
        found = continued(found, c)
    return _checked(found)


def _lifted(lift: Clause, then: Clause) -> Clause:
    """``lift the can and drop it on the box`` is one goal of the second verb."""
    what, _, above = (lift.object or lift.subject).partition(" above ")
    before: list[tuple[Preposition, str]] = [("onto", above)] if above else [t for t in lift.targets if t[0] != "off"]
    if then.object.split()[:1] == ["it"]:
        then = replace(then, object=" ".join([what, *then.object.split()[1:]]))
    elif then.subject in IT and then.object in IT:
        then = replace(then, subject="", object=what)
    elif then.object != what:
        refuse_several()
    family: Family = "put" if then.family in ("drop", "fall", "put", "lift") else then.family
    aside: list[Direction] = [d for d in lift.directions if d not in ("up", *then.directions)]
    directions = [*aside, *then.directions]
    return replace(then, verb="lift", family=family, targets=then.targets or before, directions=directions)


def _is_lifted(c: Clause) -> bool:
    return c.verb == "lift" and c.family != "lift"


def _placed(c: Clause) -> Clause:
    """With ``on`` and ``in`` read as where to, for the families where they mean that."""
    words = (c.object or "").split()
    at = next((i for i in reversed(range(len(words))) if words[i] in PLACED), None)
    if c.targets or c.family not in DROPPED | {"roll"} or at is None or at + 1 >= len(words):
        return c
    if (words[at + 1] in lexicon().orders and at + 2 == len(words)) or (c.family == "roll" and words[at] != "in"):
        return c
    return replace(c, object=" ".join(words[:at]), targets=[(PLACED[words[at]], " ".join(words[at + 1 :]))])


def _single(c: Clause, *, let: bool) -> Request:
    """The request of one clause."""
    c = _left(_sides_of(c))
    targets = [t for t in c.targets if t[0] != "off" or c.family == "bounce"] or c.targets
    if len(targets) > 1:
        refuse("several", "the goal names two targets; accepted: one")
    c = replace(c, targets=targets)
    _check_names(c)
    _check_place(c)
    return _of_family(c, let=let)


def _left(c: Clause) -> Clause:
    """``knock the can on the box off`` leaves the box."""
    _, on, support = c.object.partition(" on ")
    return replace(c, targets=[("off", support)]) if c.off and on and not c.targets else c


def _check_names(c: Clause) -> None:
    """Refuses where something is missing: the object, a target, a name in it."""
    opening = lexicon().relations | lexicon().at
    if not c.object or c.object.split()[0] in opening:
        refuse("grammar", f"the goal does not say what to {c.verb}; accepted: '{c.verb} the red cup ...'")
    if (c.off or c.family == "collide") and not c.targets:
        _refuse_end("off" if c.off else "with")
    for preposition, words in c.targets:
        if all(w in lexicon().orders for w in words.split()) and words:
            found = f"{quoted(spoken(f'{preposition} {words}'))} names no object"
            refuse("direction", f"{found}; accepted: an object's name, or {DIRECTIONS}")
        if not words or words.split()[0] in opening:
            _refuse_end(spoken(preposition))


def _refuse_end(preposition: str) -> NoReturn:
    refuse("grammar", f"the goal names no object after {quoted(preposition)}; accepted: an object's name")


def _sides_of(c: Clause) -> Clause:
    """One pattern for ``hit Y with X``, ``X hits Y`` and ``X falls``: the object is set off."""
    over, hitting = c.over or c.family == "tip", c.family in HITTING
    if c.family == "collide" and " and " in c.object and not (c.targets or c.tool):
        first, _, second = c.object.partition(" and ")
        return _into(c, first, second)
    if c.tool and c.family == "collide":
        return _into(replace(c, subject="", tool=""), c.subject or c.object, c.tool)
    if c.tool and hitting:
        return _into(replace(c, tool="", family="hit", over=over), c.tool, c.object)
    if c.subject and c.object and hitting:
        return _into(replace(c, subject="", family="hit", over=over), c.subject, c.object)
    return c if c.object else replace(c, subject="", object=c.subject)


def _into(c: Clause, active: str, struck: str) -> Clause:
    return replace(c, object=active, targets=[("into", struck), *c.targets])


def _of_family(c: Clause, *, let: bool) -> Request:
    if c.subject or c.tool:
        refuse(
            "grammar",
            f"the goal gives {quoted(spoken(c.tool or c.subject))} nothing to do; accepted: one object, one target",
        )
    preposition = c.targets[0][0] if c.targets else None
    match c.family:
        case "tip" | "push" | "pull" | "hit" | "collide":
            return _pushed(c, preposition)
        case "roll":
            return _request("roll", c)
        case "drop" | "put" | "lift":
            return _dropped(c)
        case "throw" | "jump":
            up = c.directions == ["up"] or (c.family == "jump" and not c.directions)
            returns = up and not c.targets
            return _request("launch_and_return" if returns else "throw", c)
        case "bounce":
            return _request("bounce", c)
        case "fall":
            return _fallen(c, let=let, off=preposition == "off")
        case "stay" | "rest":
            refuse("verb", f"{quoted(c.verb)} asks for no motion; accepted: 'push the cup left and let it rest'")
        case "return":
            refuse("verb", f"{quoted(c.verb)} alone is no goal; accepted: 'throw the ball up and let it fall back'")


def _dropped(c: Clause) -> Request:
    if c.family == "lift" and not c.targets:
        refuse("grammar", "nothing can hold a lifted object; accepted: 'lift ... and drop it on ...'")
    if c.family == "put" and not _is_lifted(c) and not c.targets:
        refuse("grammar", f"the goal does not say where to {c.verb} it; accepted: on or into an object")
    if c.family == "drop":
        return _from_above(c)
    off = [t for t in c.targets if t[0] == "off"]
    return _request("lift_and_drop", replace(c, targets=[("onto", "ground")]) if off else c)


def _from_above(c: Clause) -> Request:
    """``drop it from 20 cm up`` says from where."""
    return _request("drop", replace(c, directions=[d for d in c.directions if d != "up"]))


def _pushed(c: Clause, preposition: str | None) -> Request:
    if c.directions == ["up"] and not (c.targets or c.over) and (c.family == "hit" or c.verb in lexicon().strikes):
        return _request("launch_and_return", c)
    if {"up", "down"} & set(c.directions):
        refuse("direction", ALONG)
    over = c.over or c.family == "tip"
    if c.family == "hit" and c.targets and over:
        return replace(_request("push_into", c), outcomes=(WantedOutcome(what="topple", whose="target"),))
    if preposition in ("off", "away-from"):
        return _request("slide", c)
    if over:
        return _request("topple", c)
    if preposition:
        onto = c.verb == "move" and preposition == "onto"
        return _request("lift_and_drop" if onto else "push_into", c)
    own: list[Direction] = ["towards"] if c.family == "pull" else []
    return _request("slide", replace(c, directions=c.directions or own))


def _fallen(c: Clause, *, let: bool, off: bool) -> Request:
    if c.over or not {"up", "down"}.issuperset(c.directions):
        return _request("topple", c)
    if off:
        return _request("slide", c)
    if c.targets or let:
        return _from_above(c)
    refuse("ambiguous", "'fall' may mean to fall over or to drop; accepted: 'falls over' or 'drop it'")


def _check_place(c: Clause) -> None:
    """Refuses a place beside another object where nobody can tell whether it says which one or where to."""
    relation = next((w for w in c.object.split() if w in lexicon().relations and w != "with"), None)
    if relation is None or _is_lifted(c) or c.family not in MOVED or c.targets or c.directions or c.over:
        return
    anchor = c.object.partition(f"{relation} ")[2]
    told = relation in ("under", "nearest-to", "farthest-from")
    if told or anchor in lexicon().ground or anchor in lexicon().orders:
        return
    where = PLACED.get(relation, "towards")
    found = f"{quoted(spoken(c.object))} may mean which object, or where to"
    refuse("ambiguous", f"{found}; accepted: '{where} the {spoken(anchor)}', or a direction")


def _request(kind: Kind, c: Clause) -> Request:
    preposition, target = c.targets[0] if c.targets else (None, None)
    return Request(
        kind=kind,
        active=c.object,
        target=target,
        preposition=preposition,
        direction=tuple(dict.fromkeys(c.directions)),
    )


def _checked(r: Request) -> Request:
    if any(OPPOSITE[d] in r.direction for d in r.direction):
        refuse("contradiction", f"the goal leads {' and '.join(r.direction)} at once; accepted: one of them")
    if {"up", "down"} & set(r.direction) and r.kind in ("roll", "topple", "slide", "push_into"):
        refuse("direction", ALONG)
    return r
