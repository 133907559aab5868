"""separate: the smallest moves after which every object touches its support and no two overlap."""

from __future__ import annotations

from dataclasses import replace

from f3sr.report import Decision, Measure, Report
from f3sr.scene import Scene, name_of
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.overlaps import part, take_beside
from f3sr.stages.separate.placement import Placement
from f3sr.stages.separate.stability_shifts import steady
from f3sr.stages.separate.standing import stand
from f3sr.stages.separate.support_contact import grounded, seat

__all__ = ["SeparateConfig", "separate"]

PASSES = 3
"""Most times that objects are seated and then parted, which may take them off their supports again."""


def separate(scene: Scene, config: SeparateConfig | None = None) -> tuple[Scene, Report]:
    """Bring every object onto its support and part what overlaps (equations 10 and 11).

    First the ground is moved to where half of the objects on it would sink in. In forest order an object is then
    brought into contact with its support, with all that rests on it: along its viewing rays, scaled alike about the
    camera centre, which leaves the picture as it is, and by the smallest lift, or by lowering, each as far as is likely
    by what is known of distances and of the picture. Then unrelated objects that overlap are parted by one joint
    horizontal move, each with all it carries. At last a nearly flat underside gets a footing, so that physics leaves
    the object as it stands, and what has none is laid down; what would still fall, by statics, is shifted. What still
    overlaps or falls is told, never hidden.
    """
    config = config or SeparateConfig()
    scene = scene.with_objects(*(replace(o, footing=()) for o in scene if o.footing))
    came, scene = scene, grounded(scene, config) if config.ground else scene
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
    margins, told = steady(layout, config)
    decisions += told
    left = layout.collisions()
    decisions += [
        Decision(choice=f"still overlaps {name_of(b)} after separation", reason="no free place found", about=a)
        for a, b in left
    ]
    height = 1000 * float(came.camera.center[2] - scene.camera.center[2])
    measures = [Measure(name="overlapping pairs", before=before, after=len(left)), *margins]
    measures += [Measure(name="ground moved", after=height, unit="mm")]
    measures += [Measure(name="moved", after=1000 * layout.travel(o.id), unit="mm", about=o.id) for o in scene]
    measures += [
        Measure(name="scale along viewing rays", after=layout.scale[o.id], before=1.0, about=o.id) for o in scene
    ]
    return layout.moved_scene(), Report(stage="separate", measures=tuple(measures), decisions=tuple(decisions))
