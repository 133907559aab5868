"""What no launch can do, refused before anything is tried: by shapes, supports and what a target is."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from f3sr.goals.launch_limits import limits_of
from f3sr.goals.refusal import refuse
from f3sr.goals.scene_layout import SceneLayout
from f3sr.language.grammar.normaliser import spoken
from f3sr.language.grammar.request import Request
from f3sr.language.reference_resolution import names
from f3sr.scene import GROUND, Scene

FITS = 1.15
"""How much wider than an opening something may seem: openings are measured on a grid."""

HARDEST = 0.95
"""Share of the largest force that may go into friction: the rest brings the object to its pace."""
LARGEST = 14.0
"""Size [m] of an object that moves: it is to go up to 7 of its sizes, and ways in plans are at most 100 m."""


def check_possible(r: Request, active: int, target: int | None, layout: SceneLayout) -> None:
    """Raises NotUnderstoodError where no launch can do what a request asks. Physics decides the rest."""
    scene = layout.scene
    if is_too_large(active, layout):
        _refuse(f"{_name(active, scene)} is {layout.size(active):.0f} m large; accepted: at most {LARGEST:.0f} m")
    if r.kind == "topple" and layout.is_ball(active):
        _refuse(f"{_name(active, scene)} is round and cannot topple; accepted: 'roll ...'")
    if r.kind in ("slide", "push_into") and not can_be_pushed(active, layout):
        weighs = f"{_name(active, scene)} weighs {layout.loaded_mass(active):.0f} kg"
        most = HARDEST * limits_of(scene).force
        _refuse(f"{weighs} and takes {layout.sliding_force(active):.0f} N to push; accepted: at most {most:.0f} N")
    if target is not None:
        _check_target(r, active, target, layout)
    if r.kind in ("drop", "lift_and_drop") and (load := scene.children(active)):
        first = _name(load[0], scene)
        message = f"{_name(active, scene)} carries {first} and cannot be lifted alone; accepted: to lift {first}"
        _refuse(message, names(scene)[load[0]])


def is_too_large(active: int, layout: SceneLayout) -> bool:
    """Whether plans have no way for an object of this size."""
    return layout.size(active) > LARGEST


def can_be_pushed(active: int, layout: SceneLayout) -> bool:
    """Whether a person's force moves an object along what carries it; what is round rolls."""
    return layout.is_ball(active) or layout.sliding_force(active) <= HARDEST * limits_of(layout.scene).force


def _check_target(r: Request, active: int, target: int, layout: SceneLayout) -> None:
    """Refuses a target that does not suit what is asked."""
    scene, way, kind = layout.scene, r.preposition, r.kind
    if target == GROUND and way in ("into", "over", "off", "away-from", "towards"):
        _refuse(f"no object goes {spoken(way)} the ground; accepted: an object's name, or 'onto the ground'")
    if way == "over" and kind in ("push_into", "roll", "slide"):
        _refuse(f"an object on the ground cannot go over {_name(target, scene)}; accepted: 'throw ... over ...'")
    if way in ("off", "away-from") and kind in ("drop", "lift_and_drop"):
        _refuse(f"a dropped object leaves {_name(target, scene)} by itself; accepted: 'push ... {spoken(way)} ...'")
    below = {*scene.ancestors(active), *(s.id for s in scene[active].supports)}
    if way == "off" and kind in ("slide", "roll", "throw") and target not in below:
        _refuse(f"{_name(active, scene)} is not on {_name(target, scene)}; accepted: 'push ... away from ...'")
    if way == "into" and kind != "push_into":
        _check_size(active, target, layout)


def _check_size(active: int, target: int, layout: SceneLayout) -> None:
    """Refuses what is too large for an opening: its second largest side, of the smallest box around it, must pass."""
    from trimesh.bounds import oriented_bounds

    pool = layout.pool(target)
    parts = np.concatenate([q.vertices for q in layout.body(active).parts])
    side = float(sorted(oriented_bounds(parts)[1])[1])
    if pool is None or side <= FITS * 2 * pool.radius:
        return
    scene = layout.scene
    wide = f"{_name(active, scene)}, {100 * side:.0f} cm across, does not fit into {_name(target, scene)}"
    _refuse(f"{wide}, {200 * pool.radius:.0f} cm wide; accepted: onto or at it")


def _refuse(message: str, *candidates: str) -> NoReturn:
    refuse("impossible", message, candidates)


def _name(id: int, scene: Scene) -> str:
    """What an object is called in sentences."""
    return "the ground" if id == GROUND else f"the {names(scene)[id]}"
