"""Objects brought onto what they rest on: along their viewing rays, which no silhouette feels, and by a lift."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from f3sr import contact
from f3sr.frames import UP
from f3sr.scene import GROUND
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.layout import Layout, moved, supports_first

RAY_STEPS = 10
"""Places to either side that are tried along the viewing rays before the best is refined."""


def seat(layout: Layout, config: SeparateConfig) -> None:
    """Bring every object into contact with its support, supports first, with the supported subtree."""
    for id in supports_first(layout.scene):
        if layout.scene[id].supported_by is None:
            layout.move(layout.scene.subtree(id), max(0.0, config.clearance - layout.lowest(id)) * UP)
            continue
        if config.max_ray_scale:
            layout.along_rays(layout.scene.subtree(id), _contact_scale(layout, id, config))
        layout.move(layout.scene.subtree(id), -gap(layout.bodies[id], id, layout, config) * UP)


def gap(body: contact.Body, id: int, layout: Layout, config: SeparateConfig) -> float:
    """How far a body hangs over its support and the ground [m]; negative: how far it must rise to be free of them."""
    lowest = min(float(p.bounds[0, 2]) for p in body) - config.clearance
    carriers = layout.carriers(id)
    if not carriers:
        return lowest
    rise = max(contact.smallest_shift(body, carriers, UP, config.clearance), -lowest)
    if rise > 0:
        return -rise
    return min(contact.free_travel(body, carriers, -UP) - config.clearance, lowest)


def common_scale(layout: Layout, config: SeparateConfig) -> float:
    """The k by which all objects together are moved along their viewing rays, so that half of those on the ground
    would have to come nearer to reach it and half go farther: how high the camera stands is one number for all."""
    scales = [_ground_scale(layout, o.id, config) for o in layout.scene if o.supported_by == GROUND]
    limit = config.max_ray_scale
    return float(np.clip(np.median(scales), 1 - limit, 1 + limit)) if scales else 1.0


def _ground_scale(layout: Layout, id: int, config: SeparateConfig) -> float:
    """The k at which a body, moved along its viewing rays, rests on the ground: C_z / (C_z - z_lowest)."""
    eye = float(layout.scene.camera.center[2])
    height = eye - layout.lowest(id)
    return (eye - config.clearance) / height if height > 1e-9 else 1.0


def _contact_scale(layout: Layout, id: int, config: SeparateConfig) -> float:
    """The k by which the body is moved along its viewing rays before it is lifted or lowered onto its support.

    It is the most likely one: distances are known to ``depth_sigma`` and places in the picture to ``picture_sigma``,
    so k has the least (log k / depth_sigma)^2 + (loss(height(k)) / picture_sigma)^2 within its bound, where loss is the
    IoU that the lift costs; on another object a third term holds it in place. Over the ground height(k) is linear.
    """
    loss = float(np.sqrt(layout.loss(id)[2, 2]))
    sigma = config.depth_sigma if layout.scene.geometry else config.unknown_depth_sigma
    C, body = layout.scene.camera.center, layout.bodies[id]
    on_the_ground = layout.scene[id].supported_by == GROUND
    slide = 0.0 if on_the_ground else layout.distance(id) / (config.slide_sigma * layout.scene[id].size)

    def height(k: float) -> float:
        if on_the_ground:
            return float(C[2]) + k * (layout.lowest(id) - float(C[2])) - config.clearance
        return gap(moved(body, (1 - k) * C, k), id, layout, config)

    def cost(k: float) -> float:
        lifted = loss * height(k) / config.picture_sigma
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
