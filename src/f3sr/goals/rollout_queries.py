"""What a rollout shows of a scene: ways of centres, leans, outlines, touches, distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, quaternion_from_rotation, transform
from f3sr.goals.rollout import Rollout
from f3sr.goals.scene_layout import outline
from f3sr.physics import mujoco_model
from f3sr.scene import GROUND, Scene, SceneObject

LAST = 0.2
"""What counts as the end of a rollout [s]."""


class Seen:
    """A rollout with its scene: ways of centres, turns and distances."""

    def __init__(self, rollout: Rollout, scene: Scene) -> None:
        self.rollout, self.scene, self.time = rollout, scene, rollout.time

    def of(self, id: int) -> SceneObject:
        return self.scene[id]

    def way(self, id: int) -> Array:
        """(T, 3) of a centre of mass [m]."""
        T, center = self.rollout.poses(id), mujoco_model.body_of(self.scene[id]).center
        return T[:, :3, :3] @ center + T[:, :3, 3]

    def lean(self, id: int) -> Array:
        """(T,): how far what was up at the start leans from up [rad]."""
        R = self.rollout.poses(id)[:, :3, :3]
        return np.arccos(np.clip((R @ R[0].T)[:, 2, 2], -1, 1))

    def since(self, start: float) -> NDArray[np.bool_]:
        """(T,): samples from a time on."""
        return self.time >= start - 1e-9

    @property
    def at_the_end(self) -> NDArray[np.bool_]:
        return self.time >= self.time[-1] - LAST - 1e-9

    def touching(self, a: int, b: int) -> bool:
        """Whether two touch at the end."""
        return bool((self.rollout.touches(a, b)["time"] >= self.time[-1] - LAST).any())

    def name(self, id: int) -> str:
        return "the ground" if id == GROUND else self.scene[id].label or f"object {id}"

    def gap(self, a: int, b: int, start: float) -> tuple[float, float]:
        """The least distance [m] of two objects, or of one and the ground, over samples from a time on, and its
        time."""
        samples = np.flatnonzero(self.since(start))
        if b == GROUND:
            heights = [self.lowest(a, int(k)) for k in samples]
            least = int(np.argmin(heights))
            return max(0.0, heights[least]), float(self.time[samples[least]])
        return _nearest(self, a, b, samples)

    def corners(self, id: int, sample: int = 0) -> Array:
        """(n, 3): corners of an object's parts in the world [m]."""
        return transform(self.rollout.poses(id)[sample], np.concatenate([q.vertices for q in parts_of(self.scene[id])]))

    def lowest(self, id: int, sample: int) -> float:
        """Height of the lowest point of an object's parts [m]."""
        T = self.rollout.poses(id)[sample]
        return min(float((q.vertices @ T[2, :3]).min()) for q in parts_of(self.scene[id])) + float(T[2, 3])


def parts_of(o: SceneObject) -> Sequence[ConvexPart]:
    """In the object's frame, metres."""
    return mujoco_model.body_of(o).parts


def outside(points: Array, corners: Array) -> Array:
    """(n,) how far horizontal points (n, 2) are outside, or, negative, inside the outline of corners (m, 3) seen from
    above: by the outline's sides."""
    return np.max(points @ (planes := outline(corners[:, :2]))[:, :2].T + planes[:, 2], axis=1)


def _nearest(seen: Seen, a: int, b: int, samples: NDArray[np.int64]) -> tuple[float, float]:
    """The least distance [m] of two objects at some samples, and when [s], by MuJoCo's own distances of parts.

    Samples whose bounding spheres are farther apart than the least so far are left out."""
    mujoco = mujoco_model.engine()
    objects = [seen.of(a), seen.of(b)]
    model = mujoco_model.compiled(mujoco_model.build_spec([replace(o, mobility="dynamic") for o in objects]))
    data = mujoco.MjData(model)
    radii = [max(float(np.linalg.norm(q.vertices, axis=1).max()) for q in parts_of(o)) for o in objects]
    poses = [seen.rollout.poses(id) for id in (a, b)]
    apart = np.linalg.norm(poses[0][samples, :3, 3] - poses[1][samples, :3, 3], axis=1) - sum(radii)
    least, when = np.inf, float(seen.time[-1])
    for k in np.argsort(apart):
        if apart[k] > least:
            break
        for joint, T in enumerate(poses):
            data.qpos[7 * joint : 7 * joint + 7] = _qpos(T[samples[k]])
        mujoco.mj_kinematics(model, data)
        distance = _distance(model, data)
        if distance < least:
            least, when = distance, float(seen.time[samples[k]])
    return max(0.0, least), when


def _distance(model: Any, data: Any) -> float:
    """Between the geoms of the first and the second body [m]."""
    mujoco = mujoco_model.engine()
    first, second = (np.flatnonzero(model.geom_bodyid == body).tolist() for body in (1, 2))
    between, least = np.zeros(6), 1e3
    for g in first:
        for h in second:
            near = np.linalg.norm(data.geom_xpos[g] - data.geom_xpos[h]) - model.geom_rbound[g] - model.geom_rbound[h]
            if near < least:
                least = min(least, mujoco.mj_geomDistance(model, data, g, h, least, between))
    return least


def _qpos(T: Array) -> Array:
    return np.r_[T[:3, 3], quaternion_from_rotation(T[:3, :3])]
