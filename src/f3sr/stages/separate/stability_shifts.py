"""Horizontal shifts of objects that would fall by statics, as small as the picture allows."""

from __future__ import annotations

import numpy as np

from f3sr.contact.stability import stability, stands
from f3sr.contact.stabilize import balance
from f3sr.contact.static_bodies import bodies_of
from f3sr.report import Decision
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.overlaps import weight_of
from f3sr.stages.separate.placement import Placement


def steady(
    layout: Placement, config: SeparateConfig, *, margin: bool
) -> tuple[tuple[float, float] | None, list[Decision]]:
    """Shift bodies that would fall, with their subtrees, until contact forces balance all weights, within bounds.

    Returns the stability margins before and after [rad] and the decisions. The margin is the least tilt of the whole
    scene that moves a body, negative where one falls. None where all bodies are stable and
    ``margin`` is false.
    """
    scene, friction = layout.scene, layout.scene.ground.friction
    bodies = bodies_of([layout.object(o.id) for o in scene], parts=layout.bodies)
    if not margin and stands(bodies, reach=config.contact.reach, ground_friction=friction):
        return None, []
    was = stability(bodies, reach=config.contact.reach, ground_friction=friction)
    unchanged = (was.margin, was.margin)
    if not was.moving:
        return unchanged, []
    found = balance(
        bodies,
        {o.id: o.supported_by if o.mobility == "dynamic" else None for o in scene},
        config.balancing,
        contact=config.contact,
        ground_friction=friction,
        weights={o.id: weight_of(layout, o.id) for o in scene},
    )
    if len(found.unbalanced) >= len(was.moving):
        return unchanged, [_falls(id) for id in sorted(was.moving)]
    for id, shift in found.shifts.items():
        layout.move((id,), shift)
    shifted = [
        Decision(
            choice=f"shifted by {1000 * np.linalg.norm(shift):.1f} mm",
            reason="by statics, it or an object that touches it would fall from its place in the photo",
            about=id,
        )
        for id, shift in sorted(found.shifts.items())
        if shift.any()
    ]
    return (was.margin, found.after), [*shifted, *(_falls(id) for id in sorted(found.unbalanced))]


def _falls(id: int) -> Decision:
    return Decision(
        choice="left to physics: unstable by statics",
        reason="no contact forces balance its weight, and no shift within bounds helps; settle reports its motion",
        about=id,
    )
