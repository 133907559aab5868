"""align: the camera, then every object, moved so that rendered silhouettes meet the photo's masks."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np

from f3sr.core.resampling import resample
from f3sr.metrics.measures import full_silhouette
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, SceneObject
from f3sr.stages.align.camera_pose import align_camera
from f3sr.stages.align.comparison import ObjectEvidence
from f3sr.stages.align.config import AlignConfig as AlignConfig
from f3sr.stages.align.object_pose import KEPT, LEAST_IOU, align_object
from f3sr.vision.decimated import outlined
from f3sr.vision.occlusion import around, behind_the_photo, comparable_region, occluders
from f3sr.vision.silhouette import Mask, iou, union_of

PASSES = 3
"""Most alignments of an object: the first one tells better which objects hide which."""
CHANGED = 0.1
"""Pixels near an object that are compared now and were not, or the reverse, as a share of its mask, from which on it is
aligned again."""
LEAST_HIDDEN = 0.05
"""Share of an object behind what is none, from which on the user is told."""
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

    Every step has a guard of its own. An object is compared only where what is nearer leaves it visible. Aligned
    objects tell that better, so an object for which it changes is aligned again.
    ``only`` names the objects to refine, all by default.
    """
    config = config or AlignConfig()
    full, scene = scene, scene.with_objects(*(outlined(o, config.search.max_faces) for o in scene))
    decisions: list[Decision] = []
    before = _ious(scene, config)
    if config.camera and not all(o.lifted for o in scene):
        scene, decisions = _with_camera(scene, before, config)
    if config.objects:
        ids, compared = [o.id for o in scene if only is None or o.id in only], dict[int, Mask]()
        for _ in range(PASSES):
            was = scene
            scene, told = _objects_aligned(scene, ids, compared, full, config)
            moved = {d.about for d in told}
            decisions = [d for d in decisions if d.choice != KEPT or d.about not in moved] + told
            if scene is was:
                break
    after = _ious(scene, config)
    decisions += _behind_what_is_no_object(scene)
    scene = scene.with_objects(*(replace(o, mesh=full[o.id].mesh) for o in scene))
    return scene, Aligned(before=before, after=after, decisions=tuple(decisions))


def _with_camera(scene: Scene, ious: Mapping[int, float], config: AlignConfig) -> tuple[Scene, list[Decision]]:
    """The scene before the camera that fits the objects on their masks: what is elsewhere says nothing of it."""
    known = replace(scene, objects=tuple(o for o in scene if ious[o.id] >= LEAST_IOU))
    if not known.objects:
        reason = f"no object covers its mask with an IoU of {LEAST_IOU}"
        return scene, [Decision(choice="camera: stays as it came", reason=reason, fallback=True)]
    known, decisions = align_camera(known, config, score=lambda s: _mean(_ious(s, config)))
    return replace(scene, camera=known.camera, geometry=known.geometry), decisions


def _objects_aligned(
    scene: Scene, ids: Sequence[int], compared: dict[int, Mask], full: Scene, config: AlignConfig
) -> tuple[Scene, list[Decision]]:
    """Some objects aligned, and what was decided of each; the same scene where none is compared elsewhere than before.

    ``compared`` maps ids to the pixels (h, w) in which objects were compared with their masks at last. It is changed in
    place."""
    hiding, small = occluders(scene), scene.camera.limited(config.resolution)

    def aligned(o: SceneObject) -> tuple[SceneObject, list[Decision]]:
        valid = comparable_region(o, hiding[o.id], scene)
        mask, now = (resample(m, small.width, small.height) for m in (o.mask, valid))
        before = compared.get(o.id)
        if before is not None and not _differ(now, before, mask):
            return o, []
        compared[o.id] = now
        view = ObjectEvidence(scene=scene, hiding=hiding[o.id], valid=valid, textured=full[o.id].mesh)
        found, told = align_object(o, view, config)
        if before is None:
            return found, told
        kept = any(d.choice == KEPT for d in told)
        return (o, []) if kept else (found, [replace(d, choice=f"again, {d.choice}") for d in told])

    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1)) as pool:
        results = list(pool.map(aligned, (scene[id] for id in ids)))
    if not any(told for _, told in results):
        return scene, []
    return scene.with_objects(*(o for o, _ in results)), [d for _, several in results for d in several]


def _behind_what_is_no_object(scene: Scene) -> Iterator[Decision]:
    """What is told of objects that something else hides: no other measure says why they miss their masks."""
    if scene.geometry is None:
        return
    masked = union_of((o.mask for o in scene), scene.photo.rgb.shape[:2])
    for o in scene:
        others = (p.mask for p in scene if p is not o)
        render = full_silhouette(o, scene.camera)
        hidden = render & ~masked & behind_the_photo(o.mask, others, scene.geometry, scene.camera)
        share = np.count_nonzero(hidden) / max(1, np.count_nonzero(render))
        if share >= LEAST_HIDDEN:
            yield Decision(
                choice=f"{share:.0%} of it is not compared",
                reason="what is before it is no object of the scene; visible IoU counts that as missed",
                about=o.id,
            )


def _differ(now: Mask, before: Mask, mask: Mask) -> bool:
    """Whether two regions (h, w) differ near a mask (h, w) by ``CHANGED``; not where the mask is lost at their size."""
    if not mask.any():
        return False
    return bool(np.count_nonzero((now ^ before)[around(mask)]) >= CHANGED * np.count_nonzero(mask))


def _mean(ious: Mapping[int, float]) -> float:
    return float(np.mean(list(ious.values())))


def _ious(scene: Scene, config: AlignConfig) -> dict[int, float]:
    """IoU of each object's full silhouette with its mask, at the working resolution."""
    camera = scene.camera.limited(config.resolution)
    return {o.id: iou(full_silhouette(o, camera), resample(o.mask, camera.width, camera.height)) for o in scene}
