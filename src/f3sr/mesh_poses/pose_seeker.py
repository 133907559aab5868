"""Where a file's readings put its object, and how well that fits: mask, detail and depth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from f3sr.core.handedness import mirrored, rotation_of
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import pose
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.pose_by_mask import FoundPose, MaskedPhoto, PoseSearch, PoseSearchConfig, unplaced
from f3sr.vision.rasterizer import NEAR


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
