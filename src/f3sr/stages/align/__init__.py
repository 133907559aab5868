"""align: the camera, then every object, moved so that rendered silhouettes meet the photo's masks."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from f3sr.core.resampling import resample
from f3sr.metrics.measures import full_silhouette
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, SceneObject
from f3sr.stages.align.camera_pose import align_camera
from f3sr.stages.align.config import AlignConfig as AlignConfig
from f3sr.stages.align.object_pose import ObjectEvidence, align_object
from f3sr.vision.decimated import outlined
from f3sr.vision.occlusion import comparable_region, nearer_objects
from f3sr.vision.silhouette import iou

MOST_THREADS = 8
"""Objects that are searched at the same time, each in a thread of its own: the kernels release the GIL."""


@dataclass(frozen=True, kw_only=True)
class Aligned(Outcome):
    """IoUs of full silhouettes with their masks by object id, at the working resolution."""

    stage: ClassVar[str] = "align"
    before: Mapping[int, float] = field(default_factory=dict[int, float])
    after: Mapping[int, float] = field(default_factory=dict[int, float])

    @property
    def measures(self) -> tuple[Measure, ...]:
        if not self.after:
            return ()
        return (
            Measure(name="mean mask IoU", before=_mean(self.before), after=_mean(self.after)),
            *(Measure(name="mask IoU", before=self.before[id], after=a, about=id) for id, a in self.after.items()),
        )


def align(
    scene: Scene, config: AlignConfig | None = None, *, only: Collection[int] | None = None
) -> tuple[Scene, Aligned]:
    """Refine the camera against the union of masks (equation 7), then each object from that camera (8, 9).

    Every step has a guard of its own. An object is compared only where nearer objects leave it visible.
    ``only`` names the objects to refine, all by default.
    """
    config = config or AlignConfig()
    full, scene = scene, scene.with_objects(*(outlined(o, config.search.max_faces) for o in scene))
    decisions: list[Decision] = []
    before = _ious(scene, config)
    if config.camera and not all(o.lifted for o in scene):
        scene, decisions = align_camera(scene, config, score=lambda s: _mean(_ious(s, config)))
    if config.objects:
        nearer = nearer_objects(scene)

        def aligned(o: SceneObject) -> tuple[SceneObject, list[Decision]]:
            valid = comparable_region(o, nearer[o.id], scene)
            view = ObjectEvidence(scene=scene, valid=valid, textured=full[o.id].mesh)
            return align_object(o, view, config)

        with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
            results = list(pool.map(aligned, (o for o in scene if only is None or o.id in only)))
        scene = scene.with_objects(*(o for o, _ in results))
        decisions += [d for _, several in results for d in several]
    after = _ious(scene, config)
    scene = scene.with_objects(*(replace(o, mesh=full[o.id].mesh) for o in scene))
    return scene, Aligned(before=before, after=after, decisions=tuple(decisions))


def _mean(ious: Mapping[int, float]) -> float:
    return float(np.mean(list(ious.values())))


def _ious(scene: Scene, config: AlignConfig) -> dict[int, float]:
    """IoU of each object's full silhouette with its mask, at the working resolution."""
    camera = scene.camera.limited(config.resolution)
    return {o.id: iou(full_silhouette(o, camera), resample(o.mask, camera.width, camera.height)) for o in scene}
