"""Which reading of given poses is meant: quaternion order, direction of the rotation, axes. The masks decide.

A producer has one convention for all objects, so all their silhouettes vote together. Where two readings show the same
silhouettes, the photo's detail and the geometry's depths vote too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from f3sr.backends.protocols import ProducedMesh
from f3sr.core.handedness import mirrored, rotation_of
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import pose
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.pose_by_mask import DEFAULT_SEARCH, FoundPose, MaskedPhoto, PoseSearch, PoseSearchConfig, unplaced
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
    read = [[next(p for p in m.poses if p.reading == name) for m in meshes.values()] for name in common]
    if not read:
        return []
    places = CandidatePlaces(
        ids=tuple(meshes),
        names=tuple(common),
        R=np.array([[p.T_camera_mesh[:3, :3] for p in row] for row in read]),
        t=np.array([[p.T_camera_mesh[:3, 3] for p in row] for row in read]),
        scale=np.array([[p.scale for p in row] for row in read]),
        own=np.tile(np.eye(3), (len(read), 1, 1)),
    )
    return judged(view, {id: m.mesh for id, m in meshes.items()}, places, search)


def judged(
    view: MaskedPhoto,
    meshes: Mapping[int, Mesh],
    places: CandidatePlaces,
    search: PoseSearchConfig = DEFAULT_SEARCH,
) -> list[JudgedReading]:
    """Readings of files as they are, best first; a tie keeps their order."""
    seekers = {id: Seeker(view=view, id=id, mesh=meshes[id], search=search) for id in places.ids}
    readings = [
        JudgedReading(reading=name, poses={id: seekers[id].found(places, k, v) for v, id in enumerate(places.ids)})
        for k, name in enumerate(places.names)
    ]
    return sorted(readings, key=lambda j: j.missed)


@dataclass(frozen=True, eq=False, kw_only=True)
class Seeker:
    """All that the readings of one file are compared with; where it is left-handed by a reading, it is mirrored."""

    view: MaskedPhoto
    id: int
    mesh: Mesh
    search: PoseSearchConfig

    def found(self, places: CandidatePlaces, k: int, v: int, *, corrected: bool = False) -> FoundPose:
        """The object, which is the ``v``-th, where reading ``k`` puts it, or where it then fits best nearby."""
        R = places.R[k, v]
        search = self._mirrored if np.linalg.det(R) < 0 else self._plain
        T = self.view.camera.T_world_camera @ pose(rotation_of(R), places.t[k, v])
        scale = float(places.scale[k, v])
        o = replace(unplaced(search.instance, search.mesh), T_world_object=T, scale=scale)
        if self.view.camera.to_camera(o.vertices_world)[:, 2].min() <= NEAR:  # behind the camera it misses everything
            missed = self.search.orientations.missed(0, 0)
            return FoundPose(object=o, side=0, iou=0.0, correlation=None, spread=0.0, missed=missed)
        return search.judged(search.corrected(o) if corrected else o)

    @cached_property
    def _plain(self) -> PoseSearch:
        return self._seen(self.mesh)

    @cached_property
    def _mirrored(self) -> PoseSearch:
        return self._seen(mirrored(self.mesh))

    def _seen(self, mesh: Mesh) -> PoseSearch:
        return PoseSearch(mesh=mesh, instance=self.view.instances[self.id], view=self.view, config=self.search)


def is_clear(judged: list[JudgedReading]) -> bool:
    """Whether the best reading shows what the masks show, and none of the others shows it as well."""
    return judged[0].iou >= USABLE and all(j.missed > judged[0].missed + CLEAR for j in judged[1:])
