"""The mutable state of ``separate``: every body under the similarity it has been moved by."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from f3sr.contact.compounds import Compound, collide, overlapping_pairs, placed
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, pose, transform
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.stages.separate.config import MATCHED, PICTURE_SIGMA
from f3sr.vision import depth_prior
from f3sr.vision.iou_sensitivity import loss_matrix
from f3sr.vision.occlusion import Occluders, comparable_region, occluders
from f3sr.vision.silhouette import iou

Saved = tuple[dict[int, Any], ...]
"""A layout's state."""


class Placement:
    """Bodies on their way: polytopes in the world [m] under ``x -> scale R x + shift`` from where the stage began."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._came_with = dict[int, float]()
        self.bodies = {o.id: placed((*o.parts, *o.footing), o.T_world_asset) for o in scene}
        self.footings: dict[int, tuple[ConvexPart, ...]] = {o.id: o.footing for o in scene}
        self.parts: dict[int, tuple[ConvexPart, ...]] = {o.id: o.parts for o in scene}
        self.shift: dict[int, Array] = {o.id: np.zeros(3) for o in scene}
        self.scale: dict[int, float] = {o.id: 1.0 for o in scene}
        self.rotation: dict[int, Array] = {o.id: np.eye(3) for o in scene}
        self.missing: dict[int, float] = dict.fromkeys(self.bodies, 0.0)
        """Height [m] that the underside of each mesh lacks: its body hangs that far above its support."""

    @cached_property
    def depth_sigma(self) -> Mapping[int, float]:
        """Standard deviation of the logarithm of each object's distance; measured depths take time."""
        return depth_prior.sigmas(self.scene)

    def saved(self) -> Saved:
        """The whole state, for ``restore``."""
        state = (self.bodies, self.footings, self.parts, self.shift, self.scale, self.rotation, self.missing)
        return tuple(dict(d) for d in state)

    def saved_with(self, other: Saved, ids: Collection[int]) -> Saved:
        """The whole state, with some bodies as in another one."""
        both = zip(self.saved(), other, strict=True)
        return tuple({k: theirs[k] if k in ids else v for k, v in mine.items()} for mine, theirs in both)

    def restore(self, saved: Saved) -> None:
        self.bodies, self.footings, self.parts, self.shift, self.scale, self.rotation, self.missing = map(dict, saved)

    def move(self, ids: tuple[int, ...], t: Array, *, scale: float = 1.0) -> None:
        """Apply ``x -> scale x + t`` to bodies; fixed ones stay."""
        for id in ids:
            if self.scene[id].mobility == "fixed":
                continue
            self.bodies[id] = self.bodies[id].moved(pose(scale * np.eye(3), t))
            self.shift[id] = scale * self.shift[id] + t
            self.scale[id] *= scale

    def turn(self, ids: tuple[int, ...], T: Array) -> None:
        """Apply a rigid motion (4, 4) to bodies; fixed ones stay."""
        for id in ids:
            if self.scene[id].mobility == "fixed":
                continue
            self.bodies[id] = self.bodies[id].moved(T)
            self.shift[id] = transform(T, self.shift[id][None])[0]
            self.rotation[id] = T[:3, :3] @ self.rotation[id]

    def along_rays(self, ids: tuple[int, ...], k: float) -> None:
        """The homothety ``X -> C + k (X - C)`` about the camera centre C: no silhouette changes."""
        self.move(ids, (1 - k) * self.scene.camera.center, scale=k)

    def shift_in_view(self, id: int, d: Array) -> None:
        """Move a body by d (3,) [m]. What of it is along the viewing ray also scales the body, so it looks the same.

        What stands on the ground keeps its size, and so its height."""
        ray = self.place(id, self.scene[id].middle) - self.scene.camera.center
        away = 0.0 if self.scene[id].supported_by == GROUND else float(d @ ray) / float(ray @ ray)
        self.along_rays((id,), 1 + away)
        self.move((id,), d - away * ray)

    def object(self, id: int) -> SceneObject:
        """The scene's object in the present pose of its body, with its parts and footing."""
        o, t, k, R = self.scene[id], self.shift[id], self.scale[id], self.rotation[id]
        if t.any() or k != 1 or (np.eye(3) != R).any():
            reason = f"onto its support and out of overlap: {1000 * self.travel(id):.1f} mm, scale {k:.4f}"
            o = o.moved(pose(R, t), scale=k, stage="separate", reason=reason)
        return replace(o, parts=self.parts[id], footing=self.footings[id])

    def moved_scene(self) -> Scene:
        """The scene with all objects in their present poses."""
        return self.scene.with_objects(*(self.object(o.id) for o in self.scene))

    def carriers(self, id: int) -> Compound:
        """Everything that carries a body, without the ground."""
        return Compound.of(self.bodies[k] for k in self.scene[id].carriers if k != GROUND)

    def stand(self, id: int, parts: tuple[ConvexPart, ...], wedges: tuple[ConvexPart, ...]) -> None:
        """Give a body other ``parts`` and a footing of ``wedges`` (both in the asset frame)."""
        self.parts[id], self.footings[id] = parts, wedges
        self.bodies[id] = placed((*parts, *wedges), self.object(id).T_world_asset)

    def others(self, id: int) -> Compound:
        """Every body that a body does not carry, without itself."""
        own = set(self.scene.subtree(id))
        return Compound.of(body for k, body in self.bodies.items() if k not in own)

    def rays_left(self, id: int, limit: float) -> tuple[float, float]:
        """Least and largest scale k that keep a body within ``limit`` of its first distance [share of it]."""
        used = self.scale[id]
        return min(1.0, (1 - limit) / used), max(1.0, (1 + limit) / used)

    def distance(self, id: int) -> float:
        """Distance from the camera to the centre of a body [m]."""
        place = self.place(id, self.scene[id].middle)
        return float(np.linalg.norm(place - self.scene.camera.center))

    def travel(self, id: int) -> float:
        """Distance that the centre of a body has moved [m]."""
        middle = self.scene[id].middle
        return float(np.linalg.norm(self.place(id, middle) - middle))

    def place(self, id: int, point: Array) -> Array:
        """Present position of a point (3,) of a body."""
        return self.scale[id] * (self.rotation[id] @ point) + self.shift[id]

    def loss(self, id: int) -> Array:
        """Metric W (3, 3) [1/m2] of the picture: a shift d loses the IoU sqrt(d' W d)."""
        o = self.scene[id]
        return loss_matrix(o.mask, self.scene.camera, self.place(id, o.middle))

    def picture(self, id: int) -> Array:
        """``loss`` in the unit of PICTURE_SIGMA: less where the object misses its mask, and so is known badly.

        1 where a silhouette matches its mask, else the square of how much less it misses then (the variance of a
        least-squares estimate grows with its residual)."""
        return (MATCHED / max(MATCHED, 1 - self.came_with(id))) ** 2 * self.loss(id)

    def came_with(self, id: int) -> float:
        """IoU of an object as it came with its mask, where nothing hides it."""
        if id not in self._came_with:
            o = self.scene[id]
            region = comparable_region(o, self._hiding[id], self.scene)
            self._came_with[id] = iou(full_silhouette(o, self.scene.camera), o.mask, region)
        return self._came_with[id]

    @cached_property
    def _hiding(self) -> Mapping[int, Occluders]:
        return occluders(self.scene)

    def depth_loss(self, id: int) -> Array:
        """Metric (3, 3) of the geometry in the unit of ``picture``: rank 1, along the viewing ray."""
        ray = self.place(id, self.scene[id].middle) - self.scene.camera.center
        known = PICTURE_SIGMA / self.depth_sigma[id] / float(ray @ ray)
        return known**2 * np.outer(ray, ray)

    def lowest(self, id: int) -> float:
        return self.bodies[id].lowest

    def has_beside(self, id: int, room: float) -> bool:
        """Whether the box of an unrelated body is within ``room`` [m] of a body's box."""
        low, high = self.bodies[id].bounds
        others = set(self.bodies) - {*self.scene.subtree(id), *self.scene[id].carriers}
        boxes = [self.bodies[k].bounds for k in others]
        return any(((a < high + room) & (b > low - room)).all() for a, b in boxes)

    def collisions_of(self, id: int) -> set[int]:
        """Ids of bodies that a body overlaps."""
        return {k for k in self.bodies if k != id and collide(self.bodies[id], self.bodies[k])}

    def collisions(self) -> list[tuple[int, int]]:
        """Pairs of ids that overlap, the ground included as the second."""
        return overlapping_pairs(self.bodies) + [(id, GROUND) for id in self.bodies if self.lowest(id) < -1e-9]
