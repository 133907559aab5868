"""What no launch can do, told before anything is tried: by shapes, supports and what a target is."""

from __future__ import annotations

import numpy as np

from f3sr.goals.layout import Layout
from f3sr.goals.names import names
from f3sr.goals.refusal import Refusal
from f3sr.goals.request import Request
from f3sr.goals.tokens import spoken
from f3sr.scene import GROUND, Scene

FITS = 1.15
"""How much wider than an opening something may seem: openings are measured on a grid."""


def impossible(r: Request, active: int, target: int | None, layout: Layout) -> Refusal | None:
    """What no launch can do."""
    scene = layout.scene
    if r.kind == "topple" and layout.is_ball(active):
        return Refusal(reason="impossible", message=f"{_name(active, scene)} is round; accepted: 'roll ...'")
    if target == GROUND and r.preposition in ("into", "over", "off", "away-from", "towards"):
        accepted = "a thing's name, or 'onto the ground'"
        return Refusal(
            reason="direction", message=f"nothing goes {spoken(r.preposition)} the ground; accepted: {accepted}"
        )
    if (
        target is not None
        and r.preposition == "into"
        and r.kind != "push_into"
        and (refused := _too_large(active, target, layout))
    ):
        return refused
    if r.preposition == "off" and target is not None and r.kind in ("slide", "roll"):
        below = {*scene.ancestors(active), *(s.id for s in scene[active].supports)}
        if target not in below:
            message = f"{_name(active, scene)} is not on {_name(target, scene)}; accepted: 'push ... away from ...'"
            return Refusal(reason="impossible", message=message)
    if r.kind in ("drop", "lift_and_drop") and (load := scene.children(active)):
        message = f"{_name(load[0], scene)} rests on {_name(active, scene)}, which cannot be lifted alone"
        return Refusal(
            reason="impossible",
            message=f"{message}; accepted: to lift {_name(load[0], scene)}",
            candidates=(names(scene)[load[0]],),
        )
    return None


def _too_large(active: int, target: int, layout: Layout) -> Refusal | None:
    """What lies in something passes its opening with its second largest side at most."""
    pool = layout.pool(target)
    parts = np.concatenate([q.vertices for q in layout.body(active).parts])
    side = float(sorted(np.ptp(parts, axis=0))[1])
    if pool is None or side <= FITS * 2 * pool.radius:
        return None
    scene = layout.scene
    wide = f"{_name(active, scene)}, {100 * side:.0f} cm across, does not fit into {_name(target, scene)}"
    return Refusal(reason="impossible", message=f"{wide}, {200 * pool.radius:.0f} cm wide; accepted: onto or at it")


def _name(id: int, scene: Scene) -> str:
    """What an object is called in sentences."""
    return "the ground" if id == GROUND else f"the {names(scene)[id]}"
