"""separate: the most likely small moves after which each object touches its support and no two overlap."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, name_of
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.overlaps import lift_out, take_beside
from f3sr.stages.separate.placement import Placement
from f3sr.stages.separate.stability_shifts import steady
from f3sr.stages.separate.standing import on_footings_in_place, on_own_footings, stand
from f3sr.stages.separate.support_contact import grounded
from f3sr.stages.separate.ways import bring_into_contact

__all__ = ["SeparateConfig", "Separated", "on_footings_in_place", "on_own_footings", "separate"]


@dataclass(frozen=True, kw_only=True)
class Separated(Outcome):
    """What ``separate`` did. Pairs of values are before and after."""

    stage: ClassVar[str] = "separate"
    overlaps: tuple[int, int] = (0, 0)
    """Number of overlapping pairs of objects."""
    margin: tuple[float, float] | None = None
    """Stability margin of the scene [rad]. None where it was not measured."""
    ground: float = 0.0
    """Upward shift of the ground [m]."""
    travel: Mapping[int, float] = field(default_factory=dict[int, float])
    """Distance that each object moved [m], by id."""
    scale: Mapping[int, float] = field(default_factory=dict[int, float])
    """Scale about the camera centre, by id. It moves an object along its viewing rays."""

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
    """Bring each object into contact with its support and end all overlap (equations 10 and 11).

    1. The ground moves to the median height of the objects on it, by no more than its measured error.
    2. Supports first, each object moves along its viewing rays and then vertically onto its support. What it carries
       moves with it. Motion along viewing rays scales the object about the camera centre, so its silhouette stays.
       The share of each motion is the most likely one by the errors of distances and of places in the picture.
    3. Unrelated objects that overlap move apart by one joint horizontal move. Steps 2 and 3 repeat.
    4. Groups that lost much of their masks thereby start again: they come down onto whatever is below, and all overlap
       ends by moves in space. The way that keeps more of the masks is taken.
    5. A nearly flat underside gets a footing: thin convex wedges that keep the object in its pose. An object without
       footing is tipped until its weight lies between its contacts.
    6. Objects that would still fall by statics are shifted horizontally.

    A Decision names every object that still overlaps or falls. With ``ground`` false step 1 is left out. With
    ``margin`` false the stability margin of stable scenes is not measured: it takes ten times as long as the test.

    Returns the scene with poses in the world [m], parts and footings in the asset frame, and the outcome.
    """
    config = config or SeparateConfig()
    scene = scene.with_objects(*(replace(o, footing=()) for o in scene if o.footing and o.mobility != "fixed"))
    came, scene = scene, grounded(scene, config) if ground else scene
    layout = Placement(scene)
    before = len(layout.collisions())
    decisions = take_beside(layout, config)
    decisions += bring_into_contact(layout, config)
    decisions += lift_out(layout, config)
    decisions += stand(layout, config)
    margins, told = steady(layout, config, margin=margin)
    decisions += told
    left = layout.collisions()
    decisions += [
        Decision(
            choice=f"still overlaps {name_of(b)} after separation", reason="no free place found", about=a, fallback=True
        )
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
