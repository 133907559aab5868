"""All objects brought onto their supports and out of overlap by one joint move, that which the evidence allows best."""

from __future__ import annotations

import numpy as np

from f3sr.contact.joint_contact import bring_together
from f3sr.core.transforms import Array
from f3sr.stages.separate.config import PICTURE_SIGMA, SeparateConfig
from f3sr.stages.separate.overlaps import metric_of
from f3sr.stages.separate.placement import Placement

PASSES = 3
"""Most joint moves: moves along viewing rays scale bodies, so contacts change by a hundredth of the move."""
STILL = 2e-5
"""Move [m] from which on another pass changes nothing that counts."""
REACH = 0.1
"""Gap up to which parts may meet in one pass, as a share of the largest object's size."""


def place_together(layout: Placement, config: SeparateConfig) -> None:
    """Bring all objects onto what is below them and end all overlap, as near to where the scene has them as it can be.

    Near is what costs little visible IoU and depth. A move along the viewing rays scales the object about the camera
    centre, so its silhouette stays."""
    scene, camera = layout.scene, layout.scene.camera
    middles = {o.id: o.bounds_world.mean(0) for o in scene if o.mobility != "fixed"}
    reach = REACH * max((scene[id].size for id in middles), default=0.0)
    for _ in range(PASSES):
        found = bring_together(
            layout.bodies,
            {id: metric_of(layout, id) / PICTURE_SIGMA**2 for id in middles},
            wanted={id: middle - layout.place(id, middle) for id, middle in middles.items()},
            standing=[id for id in middles if scene[id].supported_by is not None],
            above=[(k, id) for id in middles for k in scene[id].carriers],
            reach=reach,
            clearance=config.clearance,
        )
        for id, shift in found.shifts.items():
            _move(layout, id, shift, layout.place(id, middles[id]) - camera.center)
        if max((float(np.linalg.norm(shift)) for shift in found.shifts.values()), default=0.0) < STILL:
            break


def _move(layout: Placement, id: int, shift: Array, ray: Array) -> None:
    """Move a body by (3,) [m]; the share of it along its ``ray`` (3,) from the camera scales the body about the
    camera."""
    k = 1 + float(shift @ ray) / float(ray @ ray)
    layout.along_rays((id,), k)
    layout.move((id,), shift - (k - 1) * ray)
