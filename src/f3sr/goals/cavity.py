"""What of an object would hold water as it stands: the place where things can lie in it."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from f3sr.core.transforms import UP, Array, transform
from f3sr.physics import mujoco_model
from f3sr.physics.mujoco_model import engine
from f3sr.scene import SceneObject

CELLS = 25
"""Of the grid on which it rains, along each side."""
DEEP = 0.3
"""Depth of what holds things, as a share of its height."""
WIDE = 0.12
"""Its area, as a share of the bounding box's from above."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Cavity:
    center: Array
    """(2,) [m] in the world."""
    level: float
    """Height of the lowest place of the rim [m]."""
    depth: float
    """Of the deepest place below that [m]."""
    radius: float
    """Of a disc of the same area [m]."""


_KNOWN: WeakKeyDictionary[SceneObject, Cavity | None] = WeakKeyDictionary()
"""Of objects that are in use: every reading of a goal, and every role of a model, asks for all of a scene."""


def cavity_of(o: SceneObject) -> Cavity | None:
    """None where hardly any water stays."""
    if o not in _KNOWN:
        _KNOWN[o] = _cavity_of(o)
    return _KNOWN[o]


def _cavity_of(o: SceneObject) -> Cavity | None:
    surface, low, high = _surface(o)
    deep = _flooded(surface) - surface
    height = float(high[2] - low[2])
    wet = deep > 0.5 * DEEP * height
    if deep.max() < DEEP * height or wet.mean() < WIDE:
        return None
    i, j = np.nonzero(wet)
    at = low[:2] + (high - low)[:2] * (np.column_stack([i, j]) + 0.5) / CELLS
    area = float(wet.mean() * np.prod((high - low)[:2]))
    k = int(np.argmax(deep))
    return Cavity(
        center=np.average(at, axis=0, weights=deep[wet]),
        level=float(surface.flat[k] + deep.flat[k]),
        depth=float(deep.flat[k]),
        radius=float(np.sqrt(area / np.pi)),
    )


def _surface(o: SceneObject) -> tuple[Array, Array, Array]:
    """Heights (CELLS, CELLS) seen from above, what is beside it as low as its lowest point, and its bounding box."""
    mujoco = engine()
    model = mujoco_model.compiled(mujoco_model.build_spec([o]))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    corners = np.concatenate([transform(o.T_world_object, q.vertices) for q in mujoco_model.body_of(o).parts])
    low, high = corners.min(0), corners.max(0)
    surface, hit = np.full((CELLS, CELLS), low[2]), np.zeros(1, np.int32)
    x, y = (low[:2] + (high - low)[:2] * (np.arange(CELLS)[:, None] + 0.5) / CELLS).T
    start, down = np.array([0.0, 0.0, high[2] + 1.0]), -UP
    for i, j in np.ndindex(CELLS, CELLS):
        start[:2] = x[i], y[j]
        far = mujoco.mj_ray(model, data, start, down, None, 1, -1, hit)
        if far >= 0 and model.geom_bodyid[hit[0]]:
            surface[i, j] = max(start[2] - far, low[2])
    return surface, low, high


def _flooded(surface: Array) -> Array:
    """The height of water that rained on a surface and ran off its border: from the border inwards, lowest first."""
    level = np.full(surface.shape, np.inf)
    queue = [(float(z), i, j) for (i, j), z in np.ndenumerate(surface) if {i, j} & {0, CELLS - 1}]
    for z, i, j in queue:
        level[i, j] = z
    heapq.heapify(queue)
    while queue:
        z, i, j = heapq.heappop(queue)
        for k, n in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            if 0 <= k < CELLS and 0 <= n < CELLS and level[k, n] == np.inf:
                level[k, n] = max(z, float(surface[k, n]))
                heapq.heappush(queue, (float(level[k, n]), k, n))
    return level
