"""Contact with the support: a move along viewing rays, which changes no silhouette, and a vertical one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from f3sr.contact.compounds import Compound, free_travel, smallest_shift
from f3sr.core.transforms import UP, Array, pose
from f3sr.metrics.contact_groups import IOU_OF_GAP
from f3sr.metrics.measures import visible_ious
from f3sr.scene import GROUND, Scene
from f3sr.stages.separate.config import PICTURE_SIGMA, UNDERSIDE_SIGMA, SeparateConfig
from f3sr.stages.separate.placement import Placement

LEAST_LOSS = 1e-6
"""Least squared IoU lost per squared metre: a mask that fills the picture loses none."""
SLIDE_SIGMA = 0.25
"""Standard deviation of an object's place on another one, as a share of its size: viewing rays must not take it over
an edge."""
SURPRISE = 3.0
"""Standard deviations of a move onto a support from which on a horizontal move is tried."""
RINGS = (0.04, 0.08, 0.16, 0.3)
"""Horizontal moves that are tried then, as shares of the object's size."""
DIRECTIONS = 8
"""Of these moves."""
RAY_STEPS = 10
"""Samples to either side along the viewing rays before the best one is refined."""

Height = Callable[[Compound, int, Placement, SeparateConfig], float]
"""The height [m] of a body, of an id, above what is to carry it."""


def seat(layout: Placement, config: SeparateConfig, *, lifts: bool = True) -> None:
    """Bring each object with its subtree into contact with its support, supports first.

    Its mesh meets the support, or lacks some of its underside where a sensor's depth and the picture show that. Without
    ``lifts`` it comes down onto whatever is below it, and what overlaps anything or is fixed keeps its height."""
    height = gap if lifts else room_below
    for id in layout.scene.supports_first:
        if layout.scene[id].supported_by is None:
            layout.move(layout.scene.subtree(id), max(0.0, config.clearance - layout.lowest(id)) * UP)
            continue
        if not lifts and layout.scene[id].mobility == "fixed":
            continue
        underside = _short_underside(layout, id, config, height)
        k, unlikely = _contact_scale(layout, id, config, underside, height)
        if lifts and config.max_ray_scale and unlikely > SURPRISE**2 and layout.carriers(id):
            aside, less_so = _aside(layout, id, config)
            if less_so < unlikely:
                layout.move(layout.scene.subtree(id), np.append(aside, 0.0))
                k, _ = _contact_scale(layout, id, config, underside, height)
        _lower(layout, id, config, k, underside, height)


def _lower(layout: Placement, id: int, config: SeparateConfig, k: float, underside: float, height: Height) -> None:
    """Move a body with its subtree along its viewing rays by ``k`` and then onto its support.

    Of the height at which it hangs, it goes down by what is no lack of an ``underside`` of that variance [m2]."""
    layout.along_rays(layout.scene.subtree(id), k)
    above = height(layout.bodies[id], id, layout, config)
    layout.missing[id] = max(0.0, above) * underside / (underside + _position_variance(layout, id))
    layout.move(layout.scene.subtree(id), (layout.missing[id] - above) * UP)


def _short_underside(layout: Placement, id: int, config: SeparateConfig, height: Height) -> float:
    """Variance [m2] of the hidden underside of a body that shows to be short; 0 where it may well meet its support.

    Only a sensor knows distances better than undersides are known. The underside is short where the picture speaks for
    it: lowering the body by what it would lack loses more of its visible IoU than the gap is worth."""
    if not layout.scene.has_measured_depth:
        return 0.0
    members, start = layout.scene.subtree(id), layout.saved()
    variance = (UNDERSIDE_SIGMA * layout.scene[id].size) ** 2
    k, _ = _contact_scale(layout, id, config, variance, height)
    _lower(layout, id, config, k, variance, height)
    missing, hanging = layout.missing[id], visible_ious(layout.moved_scene())
    layout.move(members, -missing * UP)
    lowered = visible_ious(layout.moved_scene())
    layout.restore(start)
    loss = float(np.mean([hanging[k] - lowered[k] for k in members]))
    return variance if loss > IOU_OF_GAP * missing / layout.scene[id].size else 0.0


def _aside(layout: Placement, id: int, config: SeparateConfig) -> tuple[Array, float]:
    """The horizontal move (2,) [m] with which a body comes onto its support most likely, and how unlikely both are.

    What overlaps the wall of a bowl or a crate that it lies in would be lifted onto the rim; it rather moves inwards,
    and nowhere where its support is not below it.
    The measure is the square of standard deviations, as in ``_contact_scale``. A pattern search (Hooke and Jeeves,
    1961) starts from the best of some rings, as heights of contact have many minima.
    """
    body, size = layout.bodies[id], layout.scene[id].size
    metric = (layout.picture(id) + layout.depth_loss(id)) / PICTURE_SIGMA**2
    turns = np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)

    def cost(d: Array) -> float:
        moved = body.moved(pose(t=np.append(d, 0.0)))
        if np.isinf(free_travel(moved, layout.carriers(id), -UP)):
            return np.inf
        way = np.append(d, -gap(moved, id, layout, config))
        return float(way @ metric @ way)

    moves = np.concatenate([np.zeros((1, 2)), *(r * size * circle for r in RINGS)])
    costs = [cost(d) for d in moves]
    best, least, step = moves[int(np.argmin(costs))], min(costs), RINGS[0] * size / 2
    while step > config.clearance:
        around = best + step * circle
        costs = [cost(d) for d in around]
        if min(costs) < least:
            best, least = around[int(np.argmin(costs))], min(costs)
        else:
            step /= 2
    return best, least


def _position_variance(layout: Placement, id: int) -> float:
    """Variance [m2] of a body's height, known by the picture."""
    return PICTURE_SIGMA**2 / max(float(layout.picture(id)[2, 2]), LEAST_LOSS)


def gap(body: Compound, id: int, layout: Placement, config: SeparateConfig) -> float:
    """Height of a body above its support and the ground [m]. Negative: the lift that ends its overlap with them."""
    lowest = body.lowest - config.clearance
    carriers = layout.carriers(id)
    if not carriers:
        return lowest
    rise = max(smallest_shift(body, carriers, UP, config.clearance), -lowest)
    if rise > 0:
        return -rise
    return min(free_travel(body, carriers, -UP) - config.clearance, lowest)


def room_below(body: Compound, id: int, layout: Placement, config: SeparateConfig) -> float:
    """Height of a body above whatever is below it and does not rest on it [m]; 0 where it overlaps that.

    Alone on the ground it may be negative, as ``gap``."""
    lowest = body.lowest - config.clearance
    if not layout.carriers(id):
        return lowest
    return max(0.0, min(free_travel(body, layout.others(id), -UP) - config.clearance, lowest))


def grounded(scene: Scene, config: SeparateConfig) -> Scene:
    """The scene with the ground at the median height of the lowest points of objects on it.

    Camera and objects move together, so no pixel and no depth changes. Many objects estimate this one
    height better than a few points on the ground. A fixed object on the ground gives the height, so
    nothing moves. The ground moves by no more than the measured error of its height.
    """
    standing = [o for o in scene if o.supported_by == GROUND]
    if not standing or any(o.mobility == "fixed" for o in standing):
        return scene
    limit = min(config.max_ray_scale * float(scene.camera.center[2]), scene.ground.height_error)
    lowest = float(np.median([min(p.vertices[:, 2].min() for p in o.colliders_world) for o in standing]))
    T = pose(t=-float(np.clip(lowest - config.clearance, -limit, limit)) * UP)
    objects = tuple(o.moved(T, stage="separate", reason="with everything, to the height of the ground") for o in scene)
    return replace(scene, objects=objects, camera=scene.camera.moved(T @ scene.camera.T_world_camera))


def _contact_scale(
    layout: Placement, id: int, config: SeparateConfig, underside: float, height: Height
) -> tuple[float, float]:
    """The k by which the body is moved along its viewing rays before it is lifted or lowered onto its support, and how
    unlikely both are, as the square of standard deviations.

    It is the most likely one: k has the least (log k / sigma)^2 + height(k)^2 / variance within its bound. The variance
    is that of lifts by the picture. Above the support that of the ``underside`` [m2] is added. On another object a
    third term holds it in place. Over the ground height(k) is linear.
    """
    sigma, position = layout.depth_sigma[id], _position_variance(layout, id)
    C, body = layout.scene.camera.center, layout.bodies[id]
    on_the_ground = layout.scene[id].supported_by == GROUND
    slide = 0.0 if on_the_ground else layout.distance(id) / (SLIDE_SIGMA * layout.scene[id].size)

    def height_at(k: float) -> float:
        if on_the_ground:
            return float(C[2]) + k * (layout.lowest(id) - float(C[2])) - config.clearance
        return height(body.moved(pose(k * np.eye(3), (1 - k) * C)), id, layout, config)

    def cost(k: float) -> float:
        above = height_at(k)
        variance = position + (underside if above > 0 else 0.0)
        return float(np.log(k) / sigma) ** 2 + (slide * (k - 1)) ** 2 + above**2 / variance

    low, high = layout.rays_left(id, config.max_ray_scale)
    tried = np.linspace(low, high, 2 * RAY_STEPS + 1)
    best = int(np.argmin([cost(float(k)) for k in tried]))
    k = _least(cost, float(tried[max(best - 1, 0)]), float(tried[min(best + 1, len(tried) - 1)]))
    return k, cost(k)


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
