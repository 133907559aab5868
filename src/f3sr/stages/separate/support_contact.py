"""Objects brought onto what they rest on: along their viewing rays, which no silhouette feels, and by a lift."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from f3sr.contact import polytopes
from f3sr.core.transforms import UP, pose
from f3sr.scene import GROUND, Scene
from f3sr.stages.separate.config import PICTURE_SIGMA, SeparateConfig
from f3sr.stages.separate.placement import Placement, moved, supports_first
from f3sr.vision import depth_prior

SLIDE_SIGMA = 0.25
"""Standard deviation of an object's place on another one, as a share of its size: viewing rays must not take it over
an edge."""
RAY_STEPS = 10
"""Places to either side that are tried along the viewing rays before the best is refined."""


def seat(layout: Placement, config: SeparateConfig) -> None:
    """Bring every object into contact with its support, supports first, with the supported subtree."""
    for id in supports_first(layout.scene):
        if layout.scene[id].supported_by is None:
            layout.move(layout.scene.subtree(id), max(0.0, config.clearance - layout.lowest(id)) * UP)
            continue
        if config.max_ray_scale:
            layout.along_rays(layout.scene.subtree(id), _contact_scale(layout, id, config))
        layout.move(layout.scene.subtree(id), -gap(layout.bodies[id], id, layout, config) * UP)


def gap(body: polytopes.Body, id: int, layout: Placement, config: SeparateConfig) -> float:
    """How far a body hangs over its support and the ground [m]; negative: how far it must rise to be free of them."""
    lowest = min(float(p.bounds[0, 2]) for p in body) - config.clearance
    carriers = layout.carriers(id)
    if not carriers:
        return lowest
    rise = max(polytopes.smallest_shift(body, carriers, UP, config.clearance), -lowest)
    if rise > 0:
        return -rise
    return min(polytopes.free_travel(body, carriers, -UP) - config.clearance, lowest)


def grounded(scene: Scene, config: SeparateConfig) -> Scene:
    """The scene with the ground at the height where half of the objects on it would sink in: how high the camera
    stands is one number for all, which they know better than a few points beside them.

    Everything moves vertically together, the camera too, so that no pixel and no depth changes. Where a fixed object
    stands on the ground, that tells its height. The ground moves by no more than the error of its measured height.
    """
    standing = [o for o in scene if o.supported_by == GROUND]
    if not standing or any(o.mobility == "fixed" for o in standing):
        return scene
    limit = min(config.max_ray_scale * float(scene.camera.center[2]), scene.ground.height_error)
    lowest = float(np.median([min(p.vertices[:, 2].min() for p in o.colliders_world) for o in standing]))
    T = pose(t=-float(np.clip(lowest - config.clearance, -limit, limit)) * UP)
    objects = tuple(o.moved(T, stage="separate", reason="with everything, to the height of the ground") for o in scene)
    return replace(scene, objects=objects, camera=scene.camera.moved(T @ scene.camera.T_world_camera))


def _contact_scale(layout: Placement, id: int, config: SeparateConfig) -> float:
    """The k by which the body is moved along its viewing rays before it is lifted or lowered onto its support.

    It is the most likely one: distances are known to ``depth_prior.sigma``, places in the picture to
    ``PICTURE_SIGMA``, so k has the least (log k / sigma)^2 + (loss(height(k)) / PICTURE_SIGMA)^2 within its bound. The
    loss is the IoU that the lift costs; on another object a third term holds it in place. Over the ground height(k) is
    linear.
    """
    loss = float(np.sqrt(layout.loss(id)[2, 2]))
    sigma = depth_prior.sigma(has_geometry=layout.scene.geometry is not None)
    C, body = layout.scene.camera.center, layout.bodies[id]
    on_the_ground = layout.scene[id].supported_by == GROUND
    slide = 0.0 if on_the_ground else layout.distance(id) / (SLIDE_SIGMA * layout.scene[id].size)

    def height(k: float) -> float:
        if on_the_ground:
            return float(C[2]) + k * (layout.lowest(id) - float(C[2])) - config.clearance
        return gap(moved(body, (1 - k) * C, k), id, layout, config)

    def cost(k: float) -> float:
        lifted = loss * height(k) / PICTURE_SIGMA
        return float(np.log(k) / sigma) ** 2 + (slide * (k - 1)) ** 2 + lifted**2

    low, high = layout.rays_left(id, config.max_ray_scale)
    tried = np.linspace(low, high, 2 * RAY_STEPS + 1)
    best = int(np.argmin([cost(float(k)) for k in tried]))
    return _least(cost, float(tried[max(best - 1, 0)]), float(tried[min(best + 1, len(tried) - 1)]))


def _least(cost: Callable[[float], float], a: float, b: float) -> float:
    """Where ``cost`` is least between a and b, to 1e-4 (golden section search)."""
    ratio = (np.sqrt(5) - 1) / 2
    c, d = b - ratio * (b - a), a + ratio * (b - a)
    at_c, at_d = cost(c), cost(d)
    while b - a > 1e-4:
        if at_c < at_d:
            b, d, at_d = d, c, at_c
            c = b - ratio * (b - a)
            at_c = cost(c)
        else:
            a, c, at_c = c, d, at_d
            d = a + ratio * (b - a)
            at_d = cost(d)
    return (a + b) / 2
