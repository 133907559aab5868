"""What every method is given of a scene: one reading of the input folder, the same for all of them.

Photo, masks, geometry and assets in their given poses, gravity along -Z and the ground at z = 0 (f3sr's ``level``),
who stands on whom (f3sr's ``relate``) and convex proxies (f3sr's ``decompose``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from f3sr.core.transforms import Array
from f3sr.io import inputs
from f3sr.scene import Geometry, Scene, SceneObject
from f3sr.stages.assemble import as_given, assemble
from f3sr.stages.decompose import decompose
from f3sr.stages.level import level
from f3sr.stages.relate import relate

STAND_INS = {
    "segmentation": "the given masks",
    "image to 3D": "the given assets",
    "monocular depth": "the given geometry",
    "view angle by a language model": "the camera that f3sr levels by the ground",
    "supports by a language model": "the supports that f3sr's relate finds in the levelled input",
    "convex decomposition": "f3sr's proxies",
}
"""What the two papers ask networks and services for, and what answers here."""


def given(folder: Path) -> Scene:
    """The levelled input with supports and proxies."""
    scene, _ = assemble(as_given(inputs.read(folder)))
    scene, _ = level(scene)
    scene, _ = relate(scene)
    return decompose(scene)[0]


def points_of(o: SceneObject, geometry: Geometry) -> Array:
    """The geometry's points (n, 3) [m] in an object's mask, in camera axes."""
    return geometry.points[geometry.inside(o.mask)].astype(float)


def depth_of(o: SceneObject, geometry: Geometry) -> float:
    """Median z-depth [m] of the geometry in an object's mask; nan where it knows nothing there."""
    z = points_of(o, geometry)[:, 2]
    return float(np.median(z)) if len(z) else np.nan
