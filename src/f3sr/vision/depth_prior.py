"""How well the distance of an object from the camera is known before contact tells: the one prior of all stages.

Every number is a share of the distance. Standard deviations are of the distance's logarithm.
"""

from __future__ import annotations

import numpy as np

from f3sr.core.camera import Camera
from f3sr.scene import Geometry, Scene, SceneObject
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.depth_residual import DepthEvidence, DepthResidual

ASSET_SIGMA = 0.03
"""Standard deviation of a generated pose's distance. Generated assets of known scenes have .022."""
GEOMETRY_SIGMA = 0.01
"""Standard deviation where the photo has a geometry. Objects of ten known scenes have .009 after alignment."""
SUPPORT_REACH = 0.12
"""Largest move along viewing rays that ``relate`` tries, four ``ASSET_SIGMA``: what could the object rest on?"""
CONTACT_REACH = 0.1
"""Largest move along viewing rays onto a support that ``separate`` makes. Known scenes need at most .07."""
GEOMETRY_REACH = 0.2
"""Largest move along viewing rays to where the geometry sees an object: a measured depth may move it farther."""
GEOMETRY_SPREAD = 0.05
"""Largest median deviation of an object's depth ratios at which their median tells its distance."""
GEOMETRY_PIXELS = 50
"""Least number of pixels that tell an object's distance."""
EVIDENCE = 192
"""Longer side [px] of the window in which an object's surface is compared with a sensor's depth."""
SIGMA_OF_SPREAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""
FINEST_SIGMA = 1e-3
"""Least standard deviation of a sensor's distance: sensors themselves are off by a millimetre in a metre."""


def sigmas(scene: Scene) -> dict[int, float]:
    """Standard deviation of every object's distance, by id. Where a sensor measured the depth, it is the spread of that
    depth about the object's surface: the error of its shape. A noise that a user gives holds for all. What the geometry
    knows nothing of is as far as it came."""
    geometry = scene.geometry
    known = sigma(geometry)
    if geometry is None or geometry.source == "ground":
        return dict.fromkeys((o.id for o in scene), known)
    found = {o.id: known if geometry.inside(o.mask).any() else ASSET_SIGMA for o in scene}
    if geometry.noise is not None or not scene.has_measured_depth:
        return found
    return {id: min(s, _measured(scene[id], geometry, scene.camera)) for id, s in found.items()}


def depth_errors(scene: Scene) -> dict[int, float]:
    """Median distance of every object's visible surface from where a sensor saw it, along the rays [m], by id.

    0 where no sensor measured it."""
    geometry = scene.geometry
    if geometry is None or not scene.has_measured_depth:
        return dict.fromkeys((o.id for o in scene), 0.0)
    found = {o.id: _residual(o, geometry, scene.camera) for o in scene}
    return {
        o.id: found[o.id].size * float(np.linalg.norm(o.middle - scene.camera.center)) if found[o.id].pixels else 0.0
        for o in scene
    }


def moved_along_rays(seen: Scene, now: Scene) -> dict[int, float]:
    """How far the distance of every object of ``now`` is from the one that was ``seen``, by id, in standard deviations
    of that. A sensor sees no underside, so they are ``GEOMETRY_SIGMA`` at least."""
    center, known = seen.camera.center, sigmas(seen)
    before, after = ({o.id: float(np.linalg.norm(o.middle - center)) for o in s} for s in (seen, now))
    return {id: abs(float(np.log(after[id] / before[id]))) / max(known[id], GEOMETRY_SIGMA) for id in before}


def _measured(o: SceneObject, geometry: Geometry, camera: Camera) -> float:
    return max(FINEST_SIGMA, SIGMA_OF_SPREAD * _residual(o, geometry, camera).spread)


def _residual(o: SceneObject, geometry: Geometry, camera: Camera) -> DepthResidual:
    window = window_around(o, camera, EVIDENCE)
    shown = sampled(o.mask, camera, window, fill=False)
    return DepthEvidence.of(geometry, camera, window, shown).residual(o)


def sigma(geometry: Geometry | None) -> float:
    """Standard deviation of an object's distance by a geometry that no sensor measured."""
    if geometry is None or geometry.source == "ground":
        return ASSET_SIGMA
    return GEOMETRY_SIGMA if geometry.noise is None else geometry.noise
