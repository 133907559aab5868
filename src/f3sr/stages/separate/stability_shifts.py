"""Objects that statics says would fall, shifted by as little as the picture feels until they stand."""

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
    """Shift what would fall, with what it carries, until forces at the contacts can balance all weights, where that is
    possible within bounds. The margins [rad], before and after, are the least tilt of the whole scene that moves
    something; negative: it falls. None where ``margin`` does not ask for them and all stands."""
    scene = layout.scene
    bodies = bodies_of([layout.object(o.id) for o in scene], parts=layout.bodies)
    if not margin and stands(bodies, reach=config.contact.reach):
        return None, []
    was = stability(bodies, reach=config.contact.reach)
    unchanged = (was.margin, was.margin)
    if not was.moving:
        return unchanged, []
    found = balance(
        bodies,
        {o.id: o.supported_by if o.mobility == "dynamic" else None for o in scene},
        config.balancing,
        contact=config.contact,
        weights={o.id: weight_of(layout, o.id) for o in scene},
    )
    if len(found.unbalanced) >= len(was.moving):
        return unchanged, [_falls(id) for id in sorted(was.moving)]
    for id, shift in found.shifts.items():
        layout.move((id,), shift)
    shifted = [
        Decision(
            choice=f"shifted by {1000 * np.linalg.norm(shift):.1f} mm",
            reason="statics: it, or what touches it, would fall where the photo shows it",
            about=id,
        )
        for id, shift in sorted(found.shifts.items())
        if shift.any()
    ]
    return (was.margin, found.after), [*shifted, *(_falls(id) for id in sorted(found.unbalanced))]


def _falls(id: int) -> Decision:
    return Decision(
        choice="left to physics: by statics it moves from here",
        reason="no forces at its contacts balance its weight, and no shift within bounds helps; settle says how far",
        about=id,
    )
