"""What must come of a goal: its success conditions in causal order, as somebody would check them in a film."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.transforms import Array
from f3sr.goals import plan as p
from f3sr.goals.scene_layout import SceneLayout, way_between
from f3sr.language.grammar.request import Request, WantedOutcome, What
from f3sr.scene import GROUND

Conditions = tuple[p.Condition, ...]
Reading = tuple[Conditions, str]
"""Conditions, and what they leave to chance, in words; empty for the strictest."""

CLOSED = "nothing can lie in the target: to touch it counts"
TOO_FAR = 1.25
"""How much farther than asked for something may end, as a factor,"""
TOO_FAR_BY = 0.02
"""and in any case [m]."""
FAR_TOO_FAR = 3.0
"""The same where the distance is our own choice,"""
FAR_TOO_FAR_BY = 0.05
"""[m]."""
MOVES, MOVES_A_LITTLE = 0.2, 0.07
"""Shares of its size that something is to be moved by a blow: to be seen at once, and to be seen at all."""
LEANS_ON = math.radians(45)
"""Lean of what fell over towards something and came to lie on it [rad]."""
FELL = math.radians(150)
"""Turning that is rolling and not falling over, for what is not round [rad]."""
NEARLY = 0.9
"""Share of a height said that something falls at least: it may end on its side."""
STIRS, STIRS_BY = 0.03, 0.006
"""The same for what is too heavy to be moved so far by what runs into it, and in any case [m]."""
HOPS = 0.03
"""Share of its size that the active object rises at least when it bounces on its way."""
SEEN = 0.25
"""Share of its size that the active object moves at least."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Meant:
    """A request whose objects, direction and distance are known."""

    request: Request
    active: int
    target: int | None
    direction: Array | None
    """Unit vector (3,) in the world."""
    amount: float
    """[m]"""
    asked: bool
    """Whether the words gave the amount."""
    assumptions: tuple[str, ...]


def readings(meant: Meant, layout: SceneLayout) -> list[Reading]:
    """The success conditions of a settled request, the strictest first, each with what it leaves to chance."""
    made = _BY_KIND[meant.request.kind](meant, layout)
    outcomes = meant.request.outcomes
    if not outcomes:
        return made
    found = [(_with_outcomes(meant, layout, before, MOVES), left) for before, left in made]
    if any(outcome.what == "move" for outcome in outcomes):
        before, _ = made[-1]
        found.append((_with_outcomes(meant, layout, before, MOVES_A_LITTLE), "by how much it moves the other"))
    return found


def _with_outcomes(meant: Meant, layout: SceneLayout, before: Conditions, moves: float) -> Conditions:
    """With what the words say comes of it, in their order."""
    for outcome in meant.request.outcomes:
        before = (*before, *_outcome(meant, outcome, layout, before, moves))
    return before


def phases(conditions: Sequence[p.Condition], called: Mapping[int, str]) -> Iterator[str]:
    """The conditions as sentences, in order; ``called`` names every object."""

    def name(id: int) -> str:
        return "the ground" if id == GROUND else called[id]

    for c in conditions:
        match c:
            case p.Contact():
                yield f"{name(c.a)} touches {name(c.b)}"
            case p.Displaced():
                yield f"{name(c.a)} moves by at least {c.at_least:.3g} m"
            case p.Bounced() | p.Over() | p.Off() | p.On() | p.Inside():
                said = {"bounced": "bounces off", "over": "passes over", "off": "is off", "on": "is on"}
                yield f"{name(c.a)} {said.get(c.type, 'is inside')} {name(c.b)}"
            case _:
                said = {"toppled": "falls over", "upright": "stays upright", "at_rest": "rests", "height": "rises"}
                yield f"{name(c.a)} {said.get(c.type, c.type)}"


def _topple(m: Meant, layout: SceneLayout) -> list[Reading]:
    onto = m.target is not None and m.target != GROUND
    conditions: list[p.Condition] = [p.Toppled(a=m.active, at_least=LEANS_ON) if onto else p.Toppled(a=m.active)]
    if m.request.direction or m.target is not None:
        conditions.append(_moved(m, 0.3 * float(np.ptp(layout.span(m.active)[:, 2]))))
    return [(tuple(conditions), "")]


def _slide(m: Meant, layout: SceneLayout) -> list[Reading]:
    if m.request.preposition == "off" and m.target is not None and m.target != GROUND:
        off = p.Off(a=m.active, b=m.target)
        return [((off, p.Displaced(a=m.active, at_least=SEEN * layout.size(m.active))), "")]
    way = _moved(m, m.amount, exact=m.asked)
    if m.direction is not None and layout.rolls(m.active, m.direction):
        return [((way,), ""), ((way.model_copy(update={"at_most": None}),), "how far it rolls")]
    loose = way.model_copy(update={"at_most": None}) if not m.asked else way
    return [((way, p.Upright(a=m.active)), ""), ((loose,), "it may fall over on its way")]


def _push_into(m: Meant, layout: SceneLayout) -> list[Reading]:
    target = _target(m)
    gap = _gap(m, layout)
    if m.request.preposition == "towards":
        return [((_moved(m, min(m.amount, 0.7 * gap) if not m.asked else m.amount),), "")]
    conditions: list[p.Condition] = [p.Contact(a=m.active, b=target)]
    if gap < SEEN * layout.size(m.active):
        conditions.append(p.Displaced(a=m.active, at_least=0.5 * SEEN * layout.size(m.active)))
    return _bumped(tuple(conditions), m, layout)


def _bumped(conditions: Conditions, m: Meant, layout: SceneLayout) -> list[Reading]:
    """What something runs into is seen to move, where it can be moved."""
    target = _target(m)
    if m.request.outcomes or target == GROUND or layout.scene[target].mobility == "fixed":
        return [(conditions, "")]
    touches = next(k for k, c in enumerate(conditions) if c.type == "contact")
    little, hardly = (
        p.Displaced(a=target, at_least=max(share * layout.size(target), STIRS_BY), after=touches)
        for share in (MOVES_A_LITTLE, STIRS)
    )
    return [
        ((*conditions, little), ""),
        ((*conditions, hardly), "it may hardly move what it meets"),
        (conditions, "it may not move what it meets"),
    ]


def _roll(m: Meant, layout: SceneLayout) -> list[Reading]:
    radius = float(np.ptp(layout.span(m.active)[:, 2])) / 2

    least = math.pi / 4 if m.direction is None or layout.rolls(m.active, m.direction) else FELL

    def turned(way: float) -> p.Rolled:
        # Nothing rolls by more than its way over its radius.
        most = min(max(way / radius, math.pi / 4), 100.0)
        return p.Rolled(a=m.active, at_least=min(max(0.5 * way / radius, least), most))

    if m.request.preposition == "off" and m.target is not None:
        return [((p.Off(a=m.active, b=m.target), turned(radius)), "")]
    if m.target is None or m.request.preposition in ("towards", "away-from"):
        gap = _gap(m, layout)
        way = m.amount if m.asked or m.request.preposition != "towards" else min(m.amount, 0.8 * gap)
        return [((_moved(m, way, exact=m.asked), turned(way)), "")]
    inside = [p.Inside(a=m.active, b=m.target)] if m.request.preposition == "into" and layout.pool(m.target) else []
    touch = p.Contact(a=m.active, b=m.target)
    met: Conditions = (touch, turned(_gap(m, layout)))
    if inside:
        return [((*met, *inside), ""), (met, "it need not end inside")]
    return _bumped(met, m, layout)


def _drop(m: Meant, layout: SceneLayout) -> list[Reading]:
    target = m.target if m.target is not None else layout.support(m.active)
    touch, rest = (*_fallen(m), p.Contact(a=m.active, b=target)), p.AtRest(a=m.active)
    ends = _ends(m, target, layout)
    on: list[Reading] = [((*touch, *ends, rest), ""), ((*touch, *ends), "it may still move at the end")]
    if ends and ends[0].type == "inside":
        return on
    loose: list[Reading] = [((*touch, rest), "where it ends"), (touch, "where it ends and whether it rests")]
    return [*(on if m.target is not None else []), *loose]


def _fallen(m: Meant) -> list[p.Condition]:
    """As far as the words say."""
    if not m.asked:
        return []
    return [p.Displaced(a=m.active, at_least=NEARLY * m.amount, direction=(0.0, 0.0, -1.0))]


def _throw(m: Meant, layout: SceneLayout) -> list[Reading]:
    a, target, way = m.active, m.target, m.request.preposition
    if target is None:
        rise = p.Height(a=a, at_least=min(0.1 * m.amount, 0.5 * layout.size(a)))
        return [((rise, _moved(m, m.amount, exact=m.asked)), "")]
    touch = p.Contact(a=a, b=target)
    rise = p.Height(a=a, at_least=0.1 * layout.size(a))
    if way == "off" and target != GROUND:
        return [((rise, p.Off(a=a, b=target)), "")]
    if way == "away-from":
        return [((rise, _moved(m, m.amount, exact=m.asked)), "")]
    if way != "over" and _together(a, target, layout):
        gone = p.Displaced(a=a, at_least=SEEN * layout.size(a))
        return [((gone, p.Contact(a=a, b=target, after=0), *_ends(m, target, layout)), "")]
    if way == "over" and target != GROUND:
        beyond = _gap(m, layout) + layout.size(target) / 2
        return [((p.Over(a=a, b=target), _moved(m, beyond)), "")]
    if way == "into" and layout.pool(target) is None:
        return [((touch,), CLOSED)]
    if way in ("into", "onto") and target != GROUND:
        ends = _ends(m, target, layout)
        loose: list[Reading] = [] if ends and ends[0].type == "inside" else [((touch,), "where it ends")]
        return [((touch, *ends), ""), *loose]
    return [((touch,), "")]


def _bounce(m: Meant, layout: SceneLayout) -> list[Reading]:
    a, target, way = m.active, m.target, m.request.preposition
    seen = 0.1 * layout.size(a)
    up = p.Height(a=a, at_least=seen)
    if target is None or target == GROUND:
        below = layout.support(a) if target is None else target
        return [((up, p.Bounced(a=a, b=below, at_least=seen, after=0)), "")]
    if way in ("off", "onto", "over"):
        loose = p.Contact(a=a, b=target, after=0)
        return [((up, p.Bounced(a=a, b=target, at_least=seen, after=0)), ""), ((up, loose), "how high it bounces")]
    below = layout.floor_of(a, target)
    floor, touch = p.Contact(a=a, b=below, after=0), p.Contact(a=a, b=target, after=1, first=True)
    bounce = p.Bounced(a=a, b=below, at_least=HOPS * layout.size(a), after=0)
    if way == "into" and layout.pool(target):
        return [((up, floor, touch, p.Inside(a=a, b=target)), "")]
    return [((up, bounce, touch), ""), ((up, floor, touch), "how high it bounces")]


def _launch(m: Meant, layout: SceneLayout) -> list[Reading]:
    near, up = max(0.6 * layout.size(m.active), 0.25 * m.amount), p.Height(a=m.active, at_least=m.amount)
    back = p.Returned(a=m.active, to_within=near, stays=False, after=0)
    return [((up, p.Returned(a=m.active, to_within=near)), ""), ((up, back), "where it goes after it is back")]


def _ends(m: Meant, target: int, layout: SceneLayout) -> list[p.Condition]:
    """Where it ends: inside what holds things, else on it. On a plate is on it, however it is said."""
    pool = None if target == GROUND else layout.pool(target)
    deep = pool is not None and pool.depth > 0.4 * float(np.ptp(layout.span(m.active)[:, 2]))
    inside = pool is not None and (deep or m.request.preposition == "into")
    return [p.Inside(a=m.active, b=target) if inside else p.On(a=m.active, b=target)]


def _together(a: int, b: int, layout: SceneLayout) -> bool:
    """Whether two touch before anything happens: one carries the other, or they stand side by side."""
    carried = a != GROUND and b in {s.id for s in layout.scene[a].supports}
    return carried or (b != GROUND and a in {s.id for s in layout.scene[b].supports})


def _moved(m: Meant, far: float, *, exact: bool | None = None) -> p.Displaced:
    """Along the goal's direction; not much too far where the words say how far (exact), nor absurdly far where they do
    not."""
    d = m.direction
    most = TOO_FAR * far + TOO_FAR_BY if exact else FAR_TOO_FAR * far + FAR_TOO_FAR_BY
    return p.Displaced(
        a=m.active,
        at_least=far,
        at_most=min(most, 100.0) if exact is not None else None,
        direction=None if d is None else (float(d[0]), float(d[1]), float(d[2])),
    )


CONDITION_OF: Mapping[What, type[p.Condition]] = {
    "topple": p.Toppled,
    "roll": p.Rolled,
    "bounce": p.Bounced,
    "return": p.Returned,
    "rest": p.AtRest,
}
"""The condition that an outcome in words asks for; one of its kind is enough."""


def _outcome(
    m: Meant, outcome: WantedOutcome, layout: SceneLayout, before: Sequence[p.Condition], moves: float
) -> Sequence[p.Condition]:
    """What the words say comes of it, after the last contact of the goal itself."""
    what, id = outcome.what, m.active if outcome.whose == "active" else _target(m)
    touches = [k for k, c in enumerate(before) if c.type == "contact"]
    after = touches[-1] if touches else None
    if (same := CONDITION_OF.get(what)) and any(isinstance(c, same) and c.a == id for c in before):
        return ()
    seen = moves * layout.size(id)
    match what:
        case "topple":
            return (p.Toppled(a=id, after=after),)
        case "move":
            return (p.Displaced(a=id, at_least=seen, after=after),)
        case "roll":
            fallen = next((k for k, c in enumerate(before) if c.type == "toppled" and c.a == id), None)
            after = after if fallen is None else fallen
            return (p.Rolled(a=id, at_least=math.pi / 4, after=after, upended=fallen is not None),)
        case "bounce":
            return (p.Bounced(a=id, b=GROUND if m.target is None else m.target, at_least=0.1 * layout.size(id)),)
        case "return":
            return (p.Returned(a=id, to_within=layout.size(id)),)
        case "upright":
            return (p.Upright(a=id),)
        case "grounded":
            return (p.On(a=id, b=GROUND),)
        case "rest":
            return (p.AtRest(a=id),)


def _target(m: Meant) -> int:
    if m.target is None:
        raise ValueError("a goal without a target")
    return m.target


def _gap(m: Meant, layout: SceneLayout) -> float:
    """How far the active object is from its target along its direction [m]."""
    if m.target is None or m.target == GROUND or m.direction is None:
        return m.amount
    first, last = way_between(layout.hull(m.active), layout.hull(m.target), m.direction[:2])
    return max(first, 0.0) if first < last else m.amount


_BY_KIND = {
    "topple": _topple,
    "slide": _slide,
    "push_into": _push_into,
    "roll": _roll,
    "drop": _drop,
    "lift_and_drop": _drop,
    "throw": _throw,
    "bounce": _bounce,
    "launch_and_return": _launch,
}
