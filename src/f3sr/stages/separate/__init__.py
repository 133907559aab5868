"""separate: the smallest moves after which every object touches its support and no two overlap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, name_of
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.overlaps import part, take_beside
from f3sr.stages.separate.placement import Placement
from f3sr.stages.separate.stability_shifts import steady
from f3sr.stages.separate.standing import stand
from f3sr.stages.separate.support_contact import grounded, seat

__all__ = ["SeparateConfig", "Separated", "separate"]

PASSES = 3
"""Most times that objects are seated and then parted, which may take them off their supports again."""


@dataclass(frozen=True, kw_only=True)
class Separated(Outcome):
    """Pairs are before and after."""

    stage: ClassVar[str] = "separate"
    overlaps: tuple[int, int] = (0, 0)
    """Pairs of objects that overlap."""
    margin: tuple[float, float] | None = None
    """Of stability [rad]; None where it was not asked for."""
    ground: float = 0.0
    """How far up the ground moved [m]."""
    travel: Mapping[int, float] = field(default_factory=dict[int, float])
    """How far every object moved [m], by id."""
    scale: Mapping[int, float] = field(default_factory=dict[int, float])
    """By which it was scaled about the camera centre, by id."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        margins = [np.degrees(self.margin)] if self.margin else []
        return (
            Measure(name="overlapping pairs", before=self.overlaps[0], after=self.overlaps[1]),
            *(Measure(name="stability margin", before=b, after=a, unit="deg") for b, a in margins),
            Measure(name="ground moved", after=1000 * self.ground, unit="mm"),
            *(Measure(name="moved", after=1000 * way, unit="mm", about=id) for id, way in self.travel.items()),
            *(Measure(name="scale along viewing rays", after=k, before=1.0, about=id) for id, k in self.scale.items()),
        )


def separate(
    scene: Scene, config: SeparateConfig | None = None, *, ground: bool = True, margin: bool = True
) -> tuple[Scene, Separated]:
    """Bring every object onto its support and part what overlaps (equations 10 and 11).

    First the ground is moved to where half of the objects on it would sink in. In forest order an object is then
    brought into contact with its support, with all that rests on it: along its viewing rays, scaled alike about the
    camera centre, which leaves the picture as it is, and by the smallest lift, or by lowering, each as far as is likely
    by what is known of distances and of the picture. Then unrelated objects that overlap are parted by one joint
    horizontal move, each with all it carries. At last a nearly flat underside gets a footing, so that physics leaves
    the object as it stands, and what has none is laid down; what would still fall, by statics, is shifted. What still
    overlaps or falls is told, never hidden.

    Without ``ground`` the ground stays. Without ``margin`` the stability margin of what stands is not measured, which
    takes ten times as long as finding out that it stands.
    """
    config = config or SeparateConfig()
    scene = scene.with_objects(*(replace(o, footing=()) for o in scene if o.footing))
    came, scene = scene, grounded(scene, config) if ground else scene
    layout = Placement(scene)
    before = len(layout.collisions())
    decisions = take_beside(layout, config)
    for _ in range(PASSES):
        seat(layout, config)
        if not part(layout, config):
            break
    else:
        seat(layout, config)
    decisions += stand(layout, config)
    margins, told = steady(layout, config, margin=margin)
    decisions += told
    left = layout.collisions()
    decisions += [
        Decision(choice=f"still overlaps {name_of(b)} after separation", reason="no free place found", about=a)
        for a, b in left
    ]
    return layout.moved_scene(), Separated(
        overlaps=(before, len(left)),
        margin=margins,
        ground=float(came.camera.center[2] - scene.camera.center[2]),
        travel={o.id: layout.travel(o.id) for o in scene},
        scale={o.id: layout.scale[o.id] for o in scene},
        decisions=tuple(decisions),
    )
