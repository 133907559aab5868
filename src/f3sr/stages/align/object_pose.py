"""One object from the accepted camera: the phases from where it came or from its mask, whatever may hide it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from f3sr.core.camera import Camera
from f3sr.mesh_poses.mask_start import at_its_mask
from f3sr.report import Decision
from f3sr.scene import SceneObject, names_of
from f3sr.stages.align.comparison import Comparison, ObjectEvidence, Placed, Scores, surfaces_seen
from f3sr.stages.align.config import AlignConfig
from f3sr.stages.align.other_orientations import MOST_BEFORE, reoriented
from f3sr.stages.align.phases import Phase, at_its_depth, fitted, polished, standing
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled
from f3sr.vision.occlusion import around
from f3sr.vision.silhouette_fit import SMALLEST_AREA

KEPT = "kept in its input pose"
"""What is decided of an object that cannot be compared with its mask."""
LEAST_IOU = 0.2
"""IoU below which a mesh and its mask do not show the same thing. After the search the object stays as it came. Before
it, the object is elsewhere: it is sought at its mask too, and says nothing of the camera."""
FAR = 0.7
"""IoU at the end below which an object may have come far from its mask. Few of those end there that did not."""
CONTESTED = 0.04
"""IoU that an object misses only because of what is believed to hide it, plus its share before what the photo shows.
From here on it is sought as if any other object might hide it. Where that helped it was .05 and more."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """Where an object came from and where it ended, and what was decided on the way."""

    came: Placed
    placed: Placed
    decisions: list[Decision]

    @property
    def is_doubtful(self) -> bool:
        """Whether the object may have come far from its mask."""
        return self.came.iou < LEAST_IOU or self.placed.iou < FAR


def align_object(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> tuple[SceneObject, list[Decision]]:
    """The object where its silhouette fits its mask best, improved by the extensions that are enabled."""

    def kept(reason: str) -> tuple[SceneObject, list[Decision]]:
        return o, [Decision(choice=KEPT, reason=reason, about=o.id, fallback=True)]

    if np.count_nonzero(o.mask & view.valid) < SMALLEST_AREA:
        return kept("nearer objects hide all of its mask")
    elsewhere = config.anywhere and not o.lifted
    unseen = _not_in_view(o, view.scene.camera)
    if unseen and not elsewhere:
        return kept(unseen)
    found = None if unseen else _near(o, view, config)
    if found is None or (elsewhere and found.is_doubtful):
        found = _from_its_mask(o, view, config, found, unseen)
    if found.placed.iou < LEAST_IOU:
        return kept(f"its mask and its mesh do not show the same thing: valid mask IoU {found.placed.iou:.2f} at best")
    if found.placed.object is o:
        return o, found.decisions
    reason = f"valid mask IoU {found.came.iou:.4f} -> {found.placed.iou:.4f}"
    return _as_one_motion(o, found.placed.object, reason=reason), found.decisions


def _from_its_mask(
    o: SceneObject, view: ObjectEvidence, config: AlignConfig, found: _Found | None, unseen: str
) -> _Found:
    """The best pose from its mask, unless what was ``found`` near its input pose misses hardly more. None was where the
    object is ``unseen`` there."""
    brought = at_its_mask(o, surfaces_seen(view.scene), view.scene.camera, stage="align")
    also, reason = _near(brought, view, config), unseen
    if found:
        was, now = (_where_any_may_hide(f.placed.object, view, config) for f in (found, also))
        if now.miss > config.orientations.share * was.miss:
            return found
        reason = f"near its input pose it misses its mask: {was.told(now)}"
    decision = Decision(choice="sought at its mask, not at its input pose", reason=reason, about=o.id, fallback=True)
    return replace(also, decisions=[decision, *also.decisions])


def _where_any_may_hide(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> Scores:
    """The scores of an object, as if any other one might hide it."""
    photo = Comparison.near(o, view.hidden_by_any(o), config)
    return photo.scores(photo.started(o))


def _near(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> _Found:
    return _hidden_by_any(o, _searched(o, view, config), view, config)


def _searched(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> _Found:
    photo = Comparison.near(o, view, config)
    placed = came = photo.started(o)
    decisions = list[Decision]()
    for phase in _phases(o, photo):
        placed, more = phase(placed, photo)
        decisions += more
    return _Found(came=came, placed=placed, decisions=decisions)


def _phases(o: SceneObject, photo: Comparison) -> list[Phase]:
    config, turns = photo.config, not o.lifted
    wanted: list[tuple[Phase, bool]] = [
        (fitted, True),
        (polished, turns and (config.tilt.enabled or photo.appearance is not None)),
        (partial(reoriented, o), turns and config.orientations.enabled),
        (standing, turns and config.facets.enabled),
        (at_its_depth, photo.depth is not None and config.depth.enabled),
    ]
    return [phase for phase, is_on in wanted if is_on]


def _hidden_by_any(o: SceneObject, found: _Found, view: ObjectEvidence, config: AlignConfig) -> _Found:
    """What was found, unless the object fits clearly better where it came, or where it is found if any other object may
    hide it, or any but those before which it would be seen.

    Poses that are off tell wrongly what hides what. The geometry tells it of every pose by itself: what is before the
    surface that the photo shows is not hidden. So all are compared where any other object may hide them, less what is
    before it."""
    freely, share = view.hidden_by_any(o), config.orientations.share
    photo = Comparison.near(o, freely, config)
    if photo.depth is None or freely.valid[around(o.mask)].all():
        return found

    def scores(placed: Placed) -> Scores:
        return photo.scores(photo.started(placed.object))

    def or_better(found: _Found, now: Scores, but: Collection[int]) -> tuple[_Found, Scores]:
        if now.iou - found.placed.iou + now.before < CONTESTED:
            return found, now
        also = _searched(o, view.hidden_by_any(o, but=but), config)
        after = scores(also.placed)
        if after.miss > share * now.miss:
            return found, now
        choice = f"compared as if any other object{f' but {names_of(but)}' if but else ''} might hide it"
        decision = Decision(choice=choice, reason=now.told(after), about=o.id)
        return replace(also, decisions=[*also.decisions, decision]), after

    came, now = scores(found.came), scores(found.placed)
    if came.miss < share * now.miss:
        decision = Decision(choice="stays, as any other object may hide it", reason=now.told(came), about=o.id)
        found, now = replace(found, placed=found.came, decisions=[decision]), came
    if (view.valid & ~freely.valid)[around(o.mask)].any():
        found, now = or_better(found, now, ())
    wrong = _seen_before(found.placed.object, photo) if now.before > MOST_BEFORE else []
    return or_better(found, now, wrong)[0] if wrong else found


def _seen_before(o: SceneObject, photo: Comparison) -> list[int]:
    """Ids of the objects before which an object would be seen."""
    scene, depth = photo.view.scene, photo.depth
    assert depth is not None
    masks = ((p.id, sampled(p.mask, scene.camera, depth.camera, fill=False)) for p in scene if p.id != o.id)
    return [id for id, mask in masks if depth.within(mask).residual(o).before > MOST_BEFORE]


def _not_in_view(o: SceneObject, camera: Camera) -> str:
    """Why an object has no silhouette to compare; empty where it has one."""
    pixels, z = camera.project(o.vertices_world)
    if z.min() <= rasterizer.NEAR:
        return "it reaches behind the camera"
    if np.any(pixels.max(0) < 0) or np.any(pixels.min(0) > [camera.width, camera.height]):
        return "it lies outside of the picture"
    return ""


def _as_one_motion(before: SceneObject, after: SceneObject, *, reason: str) -> SceneObject:
    """``before``, moved to where ``after`` is, with one note of it."""
    T, scale = before.motion_to(after)
    return before.moved(T, scale=scale, stage="align", reason=reason)
