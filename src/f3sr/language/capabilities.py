"""What can be asked of a scene: every object with the words that select it and the verbs that make sense for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from f3sr.goals.scene_layout import SceneLayout
from f3sr.language.feasibility import can_be_pushed, is_too_large
from f3sr.language.reference_resolution import names
from f3sr.physics.restitution import LEAST
from f3sr.scene import Scene

FLAT = 0.4
"""Height over the smaller side; the menu offers no knocking over of what is flatter."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """What can be asked of one object."""

    id: int
    name: str
    """Words that select it and nothing else."""
    verbs: tuple[str, ...]
    """Empty for what is fixed."""
    holds_things: bool
    """Whether something can be thrown or dropped into it."""


def menu(scene: Scene) -> tuple[Entry, ...]:
    """What can be asked of every object of a scene, in its order."""
    layout, called = SceneLayout(scene), names(scene)
    return tuple(
        Entry(id=o.id, name=called[o.id], verbs=_verbs(o.id, layout), holds_things=layout.pool(o.id) is not None)
        for o in scene
    )


def _verbs(id: int, layout: SceneLayout) -> tuple[str, ...]:
    scene, sides = layout.scene, np.ptp(layout.span(id), axis=0)
    if scene[id].mobility == "fixed" or is_too_large(id, layout):
        return ()
    around = [np.array([np.cos(a), np.sin(a), 0.0]) for a in np.linspace(0, np.pi, 8, endpoint=False)]
    possible = {
        "push": can_be_pushed(id, layout),
        "knock over": not layout.is_ball(id) and not layout.lies(id) and sides[2] > FLAT * sides[:2].min(),
        "roll": any(layout.rolls(id, u) for u in around),
        "push off": scene[id].supported_by not in (None, -1),
        "drop": not scene.children(id),
        "lift and drop": not scene.children(id),
        "throw": True,
        "throw into the air": True,
        "bounce": scene[id].restitution > LEAST,
    }
    return tuple(verb for verb, sensible in possible.items() if sensible)
