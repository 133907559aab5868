"""Poses of a whole photo's meshes that came without one: what hides what, what stands on what, what is doubtful."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from f3sr.backends.protocols import Axis, ProducedMesh
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, rotation_between
from f3sr.mesh_poses.pose_by_mask import STAGE, FoundPose, MaskedPhoto, PoseSearch, PoseSearchConfig, turn_between
from f3sr.mesh_poses.reading_votes import DEFAULT_VOTES, VoteConfig, surfaces_apart
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.vision.image_supports import below
from f3sr.vision.occlusion import comparable_region, occluders

AXES: Mapping[Axis, tuple[int, int, int]] = {
    "+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1),
}  # fmt: skip
USUAL_UPS: tuple[Axis, ...] = ("+y", "+z")
"""Tried where nobody tells which axis points up: glTF's, and that of most simulators."""
ROUNDS = 3
"""Steps in which an object and the place under its foot find each other."""
FOOT = 0.2
"""Share of an object's height that is its foot, and of its width that is looked at below the foot."""
ENOUGH = 0.965
"""IoU from which on an object is not sought again with what hides it known."""
DOUBT = 0.02
"""Difference in what two poses miss below which neither is better."""
ANOTHER = math.radians(20)
"""Turn from which on two poses are not the same, roughly."""
APART = 0.05
"""Mean distance of surfaces [share of the size] from which on two poses are two places: a pose that was searched may
itself be off by less."""
SHOWN = 0.75
"""IoU below which a pose does not show what the mask shows: generated meshes in their places miss less."""


def upright(mesh: Mesh, up: Axis) -> Mesh:
    """The mesh turned so that an axis of its file is +Z."""
    return mesh.with_vertices(mesh.vertices @ _upright(up).T)


def poses_by_masks(
    view: MaskedPhoto, meshes: Mapping[int, ProducedMesh], search: PoseSearchConfig
) -> Mapping[int, RankedPoses]:
    """Poses by masks, in two rounds: the second knows which objects hide which."""
    placed = {
        id: _placed(PoseSearch(mesh=meshes[id].mesh, instance=i, view=view, config=search), meshes[id])
        for id, i in view.instances.items()
    }
    scene = Scene(
        photo=view.photo,
        camera=view.camera,
        geometry=view.geometry,
        objects=tuple(p.object for p in placed.values()),
    )
    hiding = occluders(scene)
    for id, instance in view.instances.items():
        if (hiding[id].nearer or hiding[id].in_part) and placed[id].best.iou < ENOUGH:
            valid = comparable_region(scene[id], hiding[id], scene)
            again = PoseSearch(mesh=meshes[id].mesh, instance=instance, view=view, valid=valid, config=search)
            placed[id] = _placed(again, meshes[id])
    return placed if view.geometry is not None else _on_supports(view, placed)


def _on_supports(view: MaskedPhoto, placed: Mapping[int, RankedPoses]) -> Mapping[int, RankedPoses]:
    """Objects along their viewing rays onto what is below them in the picture: where nothing else tells a distance.

    Under a homothety about the camera's centre C a height z becomes C + k (z - C): k follows in closed form."""
    under = below({id: i.mask for id, i in view.instances.items()})
    standing = dict[int, RankedPoses]()

    def stand(id: int, above: frozenset[int]) -> None:
        carrier = under[id]
        if carrier in above or carrier == id:  # masks that lie below each other
            carrier = GROUND
        if carrier != GROUND and carrier not in standing:
            stand(carrier, above | {id})
        o, eye = placed[id].object, view.camera
        for _ in range(ROUNDS):
            top = 0.0 if carrier == GROUND else _top_under(o, standing[carrier].object)
            low, height = float(o.bounds_world[0, 2]), float(eye.center[2])
            k = (height - top) / (height - low) if low < height and top < height else 1.0
            o = o.moved(eye.homothety(k), scale=k, stage=STAGE, reason="")
        standing[id] = replace(placed[id], object=o)

    for id in placed:
        if id not in standing:
            stand(id, frozenset())
    return standing


def _top_under(o: SceneObject, carrier: SceneObject) -> float:
    """Height [m] of a carrier's surface under an object's foot; its highest place where nothing is under that."""
    own, theirs = o.vertices_world, carrier.vertices_world
    low, high = own.min(0), own.max(0)
    foot = own[own[:, 2] <= low[2] + FOOT * (high[2] - low[2])].mean(0)
    near = np.linalg.norm(theirs[:, :2] - foot[:2], axis=1) <= FOOT * float(np.hypot(*(high - low)[:2]))
    return float((theirs[near] if near.any() else theirs)[:, 2].max())


@dataclass(frozen=True, eq=False, kw_only=True)
class RankedPoses:
    """Poses of one object, the one to take first, and the object where it stands by that."""

    poses: tuple[FoundPose, ...]
    object: SceneObject

    @property
    def best(self) -> FoundPose:
        return self.poses[0]

    @property
    def told(self) -> str:
        """How the object got its pose."""
        best = self.best
        detail = "" if best.correlation is None else f", correlation with the photo {best.correlation:.2f}"
        side = "" if best.side == 0 else ", not upright"
        told = f"pose by its mask: IoU {best.iou:.2f}{detail}{side}"
        rival = next((p for p in self.poses[1:] if turn_between(best, p) > ANOTHER), None)
        if rival is not None and rival.missed < best.missed + DOUBT:
            told += f"; turned by {math.degrees(turn_between(best, rival)):.0f} degrees it fits as well"
        return told

    def doubt(self, votes: VoteConfig = DEFAULT_VOTES) -> str:
        """Why the pose may be wrong; empty where the picture decides it.

        As readings of given poses are: it must show what the mask shows, and no other place of its surface fits as
        well."""
        best = self.best
        if best.iou < SHOWN:
            return f"no pose shows what its mask shows (IoU {best.iou:.2f} at best)"
        fitting = (p for p in self.poses[1:] if p.missed <= best.missed + votes.margin(1))
        rival = next((p for p in fitting if surfaces_apart(best.object, p.object, votes.samples) > APART), None)
        if rival is None:
            return ""
        turn = math.degrees(turn_between(best, rival))
        return f"two poses fit alike, {turn:.0f} degrees apart (IoU {best.iou:.2f} and {rival.iou:.2f})"


def _placed(search: PoseSearch, produced: ProducedMesh) -> RankedPoses:
    """The best poses over the axes that may point up."""
    ups = (produced.up,) if produced.up else USUAL_UPS
    tried = [replace(search, mesh=upright(produced.mesh, up)).found() for up in ups]
    best = min((found[0] for found in tried), key=lambda f: f.missed)
    rest = sorted((f for found in tried for f in found if f is not best), key=lambda f: f.missed)
    return RankedPoses(poses=(best, *rest), object=best.object)


def _upright(up: Axis) -> Array:
    """The rotation (3, 3) that turns an axis of a file onto +Z; +y as glTF has it, (x, y, z) to (x, -z, y)."""
    return rotation_between(np.array(AXES[up], float), np.array([0.0, 0, 1]))
