"""Which reading of given poses is meant: quaternion order, direction of the rotation, axes. The masks decide.

A producer has one convention for all objects, so all their silhouettes vote together. Where two readings show the same
silhouettes, the photo's detail and the geometry's depths vote too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from f3sr.backends.protocols import ProducedMesh, ReadPose
from f3sr.core.mesh import Mesh
from f3sr.mesh_poses.pose_by_mask import DEFAULT_SEARCH, FoundPose, MaskedPhoto, PoseSearch, PoseSearchConfig, unplaced
from f3sr.scene import SceneObject
from f3sr.vision.rasterizer import NEAR

USABLE = 0.5
"""Mean IoU below which no reading of the poses shows what the masks show."""
CLEAR = 0.03
"""Mean gain in what is missed from which on one reading is better than another."""


@dataclass(frozen=True, eq=False, kw_only=True)
class JudgedReading:
    """One reading of all poses: how it is called, and where objects are then, by id."""

    reading: str
    poses: Mapping[int, FoundPose]

    @property
    def iou(self) -> float:
        """Mean over objects with their masks."""
        return float(np.mean([p.iou for p in self.poses.values()]))

    @property
    def missed(self) -> float:
        """Mean over objects of what they miss of mask, detail and depth."""
        return float(np.mean([p.missed for p in self.poses.values()]))


def judged_readings(
    view: MaskedPhoto, meshes: Mapping[int, ProducedMesh], search: PoseSearchConfig = DEFAULT_SEARCH
) -> list[JudgedReading]:
    """All readings that every mesh has a pose in, best first; a tie keeps their order."""
    names = [p.reading for p in next(iter(meshes.values())).poses]
    common = [n for n in names if all(any(p.reading == n for p in m.poses) for m in meshes.values())]
    judged = [
        JudgedReading(reading=name, poses={id: _judged(view, id, mesh, name, search) for id, mesh in meshes.items()})
        for name in common
    ]
    return sorted(judged, key=lambda j: j.missed)


def is_clear(judged: list[JudgedReading]) -> bool:
    """Whether the best reading shows what the masks show, and none of the others shows it as well."""
    return judged[0].iou >= USABLE and all(j.missed > judged[0].missed + CLEAR for j in judged[1:])


def _judged(view: MaskedPhoto, id: int, produced: ProducedMesh, name: str, search: PoseSearchConfig) -> FoundPose:
    """An object where a reading puts it; one behind the camera misses everything."""
    read = next(p for p in produced.poses if p.reading == name)
    o = at(view, id, produced.mesh, read)
    if view.camera.to_camera(o.vertices_world)[:, 2].min() <= NEAR:
        return FoundPose(
            object=o, side=0, iou=0.0, correlation=None, spread=0.0, missed=search.orientations.missed(0, 0)
        )
    return PoseSearch(mesh=produced.mesh, instance=view.instances[id], view=view, config=search).judged(o)


def at(view: MaskedPhoto, id: int, mesh: Mesh, read: ReadPose) -> SceneObject:
    """An object in the world of the photo where a reading of its pose puts it."""
    T = view.camera.T_world_camera @ read.T_camera_mesh
    return replace(unplaced(view.instances[id], mesh), T_world_object=T, scale=read.scale)
