"""The Planner by rules: words to what is to be done with what, which way, how far, and what must come of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from f3sr.core.transforms import UP, Array
from f3sr.goals.language_protocol import Planned
from f3sr.goals.launch_limits import limits_of
from f3sr.goals.plan import Kind, TaskSpec, Upright
from f3sr.goals.refusal import NotUnderstoodError, Refusal, refuse
from f3sr.goals.scene_layout import SceneLayout, base_of
from f3sr.language import success_conditions
from f3sr.language.feasibility import check_possible
from f3sr.language.grammar.lexicon import Direction
from f3sr.language.grammar.normaliser import spoken
from f3sr.language.grammar.parser import understand
from f3sr.language.grammar.quantities import Amount
from f3sr.language.grammar.request import Request, WantedOutcome, What
from f3sr.language.object_queries import world_vector
from f3sr.language.reference_resolution import Named, names, resolve_request
from f3sr.language.success_conditions import Meant
from f3sr.scene import GROUND, Scene

FAR_ENOUGH: dict[Kind, float] = {
    "slide": 0.8,
    "push_into": 0.8,
    "roll": 1.5,
    "drop": 0.8,
    "lift_and_drop": 0.6,
    "throw": 2.0,
    "bounce": 1.5,
    "launch_and_return": 1.5,
}
"""How far or how high something goes where no words say so, in its own sizes: to be seen, and to stay in the photo."""
VAGUE = {"slightly": 0.25, "far": 2.5}
MANNER = {"gently": 0.7, "hard": 1.4}
"""What such words make of that."""
LEAST = 0.3
"""Least way in the object's sizes, where the photo or a neighbour leaves less: smaller ones are hard to see."""
FARTHEST = 3.0
"""Diagonals of the scene that anything is to go at most."""
ALONG_VIEW = 0.3
"""Cost of a fall along the view, in heights by which the edge to fall over may be farther: films show it least."""
SIDES: tuple[tuple[Direction, ...], ...] = (
    ("right",),
    ("left",),
    ("away",),
    ("towards",),
    ("away", "right"),
    ("away", "left"),
    ("towards", "right"),
    ("towards", "left"),
)
ENDS: dict[What, str] = {"upright": "stays upright", "grounded": "ends on the ground"}
"""How outcomes are said that are no verbs."""
SAID: dict[Direction, str] = {
    "left": "to the left",
    "right": "to the right",
    "away": "away from the camera",
    "towards": "towards the camera",
    "up": "up",
    "down": "down",
}


def planned(goal: str, scene: Scene, phases: Sequence[Scene] = ()) -> Planned | Refusal:
    """The next phase of a goal, as the tasks that it may mean: later ones drop conditions that nobody stated.

    Words refer to ``scene``, the photo's. ``phases`` are the scenes at the ends of the phases before."""
    requests = understand(goal)
    if isinstance(requests, Refusal):
        return requests
    found = list[Named]()
    for r in requests:
        named = resolve_request(r, scene, before=found[-1] if found else None)
        if isinstance(named, Refusal):
            return named
        found.append(named)
    request, named, layout = _tipped(requests[len(phases)]), found[len(phases)], SceneLayout([scene, *phases][-1])
    request = _cleared(request, named, layout)
    try:
        check_possible(request, named.active, named.target, layout)
        meant = _meant(request, named.active, named.target, layout)
    except NotUnderstoodError as error:
        return error.refusal
    readings, called = success_conditions.readings(meant, layout), names(scene)
    stay = tuple(Upright(a=id) for id in named.spared)
    tasks = [_task(meant, (*conditions, *stay), left, layout.scene, called) for conditions, left in readings]
    return Planned(readings=tasks, last=len(phases) + 1 == len(requests))


def _tipped(r: Request) -> Request:
    """Pushed until it falls over: it is tipped, and need not slide, where no words say how far."""
    falls = WantedOutcome(what="topple", whose="active")
    is_tipped = falls in r.outcomes and r.kind == "slide" and r.target is None and r.amount is None
    return replace(r, kind="topple", outcomes=tuple(o for o in r.outcomes if o != falls)) if is_tipped else r


def _cleared(r: Request, named: Named, layout: SceneLayout) -> Request:
    """Thrown over what it lies in or on: it leaves it."""
    below = {layout.support(named.active), *(s.id for s in layout.scene[named.active].supports)}
    leaves = r.kind == "throw" and r.preposition == "over" and named.target in below
    return replace(r, preposition="off") if leaves else r


def _task(
    meant: Meant, conditions: success_conditions.Conditions, left: str, scene: Scene, called: dict[int, str]
) -> TaskSpec:
    d = meant.direction
    return TaskSpec(
        kind=meant.request.kind,
        active=meant.active,
        target=meant.target,
        passives=_taken_along(meant, scene),
        way=meant.request.preposition,
        direction=None if d is None else (float(d[0]), float(d[1]), float(d[2])),
        amount=meant.amount,
        manner=meant.request.manner,
        phases=tuple(success_conditions.phases(conditions, called)),
        conditions=conditions,
        interpretation=_interpretation(meant, called),
        assumptions=(*meant.assumptions, *([left] if left else [])),
    )


def _taken_along(meant: Meant, scene: Scene) -> tuple[int, ...]:
    """What rests on or in the active object and the target."""
    both = {meant.active, meant.target} - {None, GROUND}
    return tuple(sorted({i for id in both if id is not None for i in scene.subtree(id)} - both))


def _interpretation(meant: Meant, called: dict[int, str]) -> str:
    r = meant.request
    words = ["push" if r.kind == "push_into" else spoken(r.kind.replace("_", " ")), called[meant.active]]
    if meant.target is not None:
        words += [spoken(r.preposition or "to"), "the ground" if meant.target == GROUND else called[meant.target]]
    words += [SAID[d] for d in r.direction]
    if meant.asked:
        words.append(f"by {meant.amount:.3g} m")
    for outcome in r.outcomes:
        whose = "it" if outcome.whose == "active" else "the other"
        words.append(f"so that {whose} {ENDS.get(outcome.what, f'{outcome.what}s')}")
    return " ".join(words)


def _meant(r: Request, active: int, target: int | None, layout: SceneLayout) -> Meant:
    amount = _amount(r, active, layout)
    limit = limits_of(layout.scene).lift if r.kind in ("drop", "lift_and_drop", "launch_and_return") else None
    limit = limit or FARTHEST * layout.scene.diagonal
    if isinstance(r.amount, Amount) and amount > limit:
        refuse("amount", f"this scene has no room for {amount:.3g} m; accepted: at most {limit:.2g} m")
    meant = Meant(
        request=r,
        active=active,
        target=target,
        direction=None,
        amount=amount,
        asked=isinstance(r.amount, Amount),
        assumptions=(),
    )
    return _fitted(_directed(meant, layout), layout)


def _amount(r: Request, active: int, layout: SceneLayout) -> float:
    """Metres, as said or as usual."""
    sides = np.ptp(layout.span(active), axis=0)
    own = {"length": max(sides[:2]), "width": min(sides[:2]), "height": sides[2], "m": 1.0}
    if isinstance(r.amount, Amount):
        return float(r.amount.value * own[r.amount.unit])
    usual = FAR_ENOUGH.get(r.kind, 1.0) * layout.size(active)
    return usual * VAGUE.get(r.amount or "", 1.0) * (MANNER.get(r.manner or "", 1.0))


def _directed(meant: Meant, layout: SceneLayout) -> Meant:
    """With a direction: said, to or from the target, or where there is most room."""
    r, target = meant.request, meant.target
    flat: list[Direction] = [d for d in r.direction if d not in ("up", "down")]
    if flat:
        return replace(meant, direction=world_vector(flat, layout.scene.camera))
    if r.kind in ("drop", "lift_and_drop", "launch_and_return"):
        return meant
    if target is not None and target != GROUND and r.preposition != "off":
        way = layout.center(target) - layout.center(meant.active)
        way = way * [1, 1, 0] * (-1 if r.preposition == "away-from" else 1)
        if np.linalg.norm(way) > 1e-6:
            return replace(meant, direction=way / np.linalg.norm(way))
    if r.kind == "topple":
        return _with_direction(meant, _toppling_side(meant.active, layout), "where it falls most easily and freely")
    best = max(SIDES[:4], key=lambda side: _room(meant, world_vector(side, layout.scene.camera), layout))
    return _with_direction(meant, world_vector(best, layout.scene.camera), SAID[best[0]])


def _with_direction(meant: Meant, direction: Array, said: str) -> Meant:
    return replace(
        meant, direction=direction, assumptions=(*meant.assumptions, f"direction: {said}, since none was said")
    )


def _room(meant: Meant, direction: Array, layout: SceneLayout) -> float:
    """How much of a way an object can go, free and in the photo [m]; off something, how near its edge is."""
    a, r = meant.active, meant.request
    if r.preposition == "off" and meant.target is not None and meant.target != GROUND:
        edge = layout.over_the_edge(a, meant.target, direction)
        fall = direction * (edge + 1.5 * layout.size(a)) - UP * (layout.span(a)[0, 2])
        return -edge - 3 * layout.size(a) * (1 - layout.in_view(a, layout.corners(a) + fall))
    free = next((way for way, _ in layout.meets(a, direction)), np.inf)
    return min(meant.amount, free) + min(meant.amount, layout.room(a, direction, meant.amount))


def _toppling_side(id: int, layout: SceneLayout) -> Array:
    """Of 16 directions that over the nearest edge of its base and across the view, unless something is there, the photo
    or the support ends, or other things hide where it falls."""
    height, center = float(np.ptp(layout.span(id)[:, 2])), layout.center(id)
    corners = layout.corners(id)
    base = base_of(corners)
    view = (center - layout.scene.camera.center) * [1, 1, 0]
    view /= max(float(np.linalg.norm(view)), 1e-9)

    def cost(u: Array) -> float:
        edge = float(((base - center) @ u).max())
        free = next((way for way, _ in layout.meets(id, u)), np.inf)
        blocked = max(0.0, 1 - free / max(height, 1e-9))
        fallen = _fallen(corners, center + edge * u, u)
        unseen = 1 - layout.in_view(id, fallen)
        off = not layout.on_support(id, 0.6 * height * u)
        return edge / height + 2 * blocked + unseen + off + ALONG_VIEW * abs(float(view @ u))

    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    return min((np.array([np.cos(a), np.sin(a), 0.0]) for a in angles), key=cost)


def _fallen(corners: Array, edge: Array, u: Array) -> Array:
    """Corners (n, 3) turned by 90 degrees over an ``edge`` of the underside, a point (3,), in the direction ``u``."""
    along, up = (corners - edge) @ u, corners[:, 2] - corners[:, 2].min()
    return corners + np.outer(up - along, u) + np.outer(-along - up, UP)


def _fitted(meant: Meant, layout: SceneLayout) -> Meant:
    """An amount that nobody said kept inside the photo and before what is in the way."""
    if meant.asked or meant.request.kind == "topple":
        return meant
    a, least = meant.active, min(meant.amount, LEAST * layout.size(meant.active))
    up = meant.request.kind in ("drop", "lift_and_drop", "launch_and_return", "bounce")
    direction = UP if up else meant.direction
    if direction is None:
        return meant
    far = min(meant.amount, layout.room(a, direction, meant.amount))
    if not up and meant.target is None and meant.request.kind in ("slide", "roll"):
        far = min([far, *(0.8 * way for way, _ in layout.meets(a, direction)[:1])])
    amount = max(far, least)
    fitted = replace(meant, amount=amount)
    if not _matters(meant):
        return fitted
    said = f"{'height' if up else 'distance'}: {amount:.2g} m, since none was said"
    return replace(fitted, assumptions=(*meant.assumptions, said))


def _matters(meant: Meant) -> bool:
    """Whether the amount says how far or how high, and not the target."""
    kind, way = meant.request.kind, meant.request.preposition
    if kind in ("drop", "lift_and_drop", "launch_and_return"):
        return True
    return kind in ("slide", "roll", "throw", "bounce") and (meant.target is None or way in ("towards", "away-from"))
