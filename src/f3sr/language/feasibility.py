"""What no launch can do, told before anything is tried: by shapes, supports and what a target is."""

from __future__ import annotations

import numpy as np

from f3sr.goals.refusal import Refusal
from f3sr.goals.scene_layout import SceneLayout
from f3sr.language.grammar.normaliser import spoken
from f3sr.language.grammar.request import Request
from f3sr.language.reference_resolution import names
from f3sr.scene import GROUND, Scene

FITS = 1.15
"""How much wider than an opening something may seem: openings are measured on a grid."""


def impossible(r: Request, active: int, target: int | None, layout: SceneLayout) -> Refusal | None:
    """The first reason why a request cannot be played; None where physics is to say."""
    scene = layout.scene
    if r.kind == "topple" and layout.is_ball(active):
        return _refused(f"{_name(active, scene)} is round; accepted: 'roll ...'")
    if target is not None and (refused := _unsuited(r, active, target, layout)):
        return refused
    if r.kind in ("drop", "lift_and_drop") and (load := scene.children(active)):
        first = _name(load[0], scene)
        message = f"{first} rests on {_name(active, scene)}, which cannot be lifted alone; accepted: to lift {first}"
        return _refused(message, names(scene)[load[0]])
    return None


def _unsuited(r: Request, active: int, target: int, layout: SceneLayout) -> Refusal | None:
    """That the target is not one for what is asked."""
    scene, way, kind = layout.scene, r.preposition, r.kind
    if target == GROUND and way in ("into", "over", "off", "away-from", "towards"):
        return _refused(f"nothing goes {spoken(way)} the ground; accepted: a thing's name, or 'onto the ground'")
    if way == "over" and kind in ("push_into", "roll", "slide"):
        return _refused(f"what is on the ground cannot go over {_name(target, scene)}; accepted: 'throw ... over ...'")
    if way in ("off", "away-from") and kind in ("drop", "lift_and_drop"):
        return _refused(
            f"what is dropped leaves {_name(target, scene)} by itself; accepted: 'push ... {spoken(way)} ...'"
        )
    below = {*scene.ancestors(active), *(s.id for s in scene[active].supports)}
    if way == "off" and kind in ("slide", "roll", "throw") and target not in below:
        return _refused(f"{_name(active, scene)} is not on {_name(target, scene)}; accepted: 'push ... away from ...'")
    return _too_large(active, target, layout) if way == "into" and kind != "push_into" else None


def _too_large(active: int, target: int, layout: SceneLayout) -> Refusal | None:
    """What lies in something passes its opening with its second largest side at most, of the smallest box around it."""
    from trimesh.bounds import oriented_bounds

    pool = layout.pool(target)
    parts = np.concatenate([q.vertices for q in layout.body(active).parts])
    side = float(sorted(oriented_bounds(parts)[1])[1])
    if pool is None or side <= FITS * 2 * pool.radius:
        return None
    scene = layout.scene
    wide = f"{_name(active, scene)}, {100 * side:.0f} cm across, does not fit into {_name(target, scene)}"
    return _refused(f"{wide}, {200 * pool.radius:.0f} cm wide; accepted: onto or at it")


def _refused(message: str, *candidates: str) -> Refusal:
    return Refusal(reason="impossible", message=message, candidates=candidates)


def _name(id: int, scene: Scene) -> str:
    """What an object is called in sentences."""
    return "the ground" if id == GROUND else f"the {names(scene)[id]}"
