"""One object from the accepted camera: equation 9 over equation 8's freedom, then the extensions.

Every phase ends with a guard and leaves the object as it was where it did not gain.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import UP, Array, rotation_about, rotation_angle, turn_about
from f3sr.mesh_poses.mask_start import at_its_mask
from f3sr.mesh_poses.orientations import Orientation, best_in_place, best_orientations, facet_turn
from f3sr.report import Decision, keep_better
from f3sr.scene import Geometry, Scene, SceneObject, names_of
from f3sr.stages.align.config import AlignConfig
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.decimated import outlined
from f3sr.vision.depth_prior import GEOMETRY_PIXELS, GEOMETRY_REACH, GEOMETRY_SPREAD, sigma
from f3sr.vision.depth_residual import DepthEvidence
from f3sr.vision.motion_params import ObjectFreedom
from f3sr.vision.occlusion import Occluders, around, comparable_region
from f3sr.vision.photometric import Appearance, principal_axes
from f3sr.vision.silhouette import LossWeights, Mask
from f3sr.vision.silhouette_fit import EQUATION_8, EVERYTHING, SMALLEST_AREA, ObjectFit, object_fit

KEPT = "kept in its input pose"
"""What is decided of an object that cannot be compared with its mask."""
NEAR_VERTICAL = 0.9
"""Cosine to the vertical from which on an axis is taken for it."""
NOISE = 1.5
"""Spread of an object's depths, in standard deviations of the geometry, that is still its noise: a mean is exceeded."""
LEAST_IOU = 0.2
"""IoU below which a mesh and its mask do not show the same thing. After the search the object stays as it came. Before
it, the object is elsewhere: it is sought at its mask too, and says nothing of the camera."""
FAR = 0.7
"""IoU at the end below which an object may have come far from its mask. Few of those end there that did not."""
CONTESTED = 0.04
"""IoU that an object misses only because of what is believed to hide it, plus its share before what the photo shows.
From here on it is sought as if any other object might hide it. Where that helped it was .05 and more."""
MOST_BEFORE = 0.1
"""Share of an object that is before another one in the photo, from which on that does not hide it: nested bowls have up
to .07."""
TURNED = 0.06
"""Spread of an object's depths about the geometry's [size] above which it is turned wrongly. Of 490 objects that fit
their masks in 52 scenes a hundredth has .053, by errors of mesh and geometry."""
SHIFTS_AND_SCALE = [0, 1, 5]
"""Parameters of an object's freedom that may go on beyond their bounds."""
BLIND_TURN = np.radians(16)
"""The turn that a silhouette is tried at: a smaller one is hidden by what is wrong of a shape [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectEvidence:
    """What the photo shows of one object: ``valid`` (H, W) is where what is ``hiding`` it leaves it visible."""

    scene: Scene
    hiding: Occluders
    valid: Mask
    textured: Mesh
    """The object's own mesh, which the one that silhouettes are drawn from may be a lighter copy of."""

    def hidden_by_any(self, o: SceneObject, *, but: Collection[int] = ()) -> ObjectEvidence:
        """As if every other object, ``but`` some, might hide the object."""
        hiding = Occluders(nearer=[p for p in self.scene if p.id not in {o.id, *but}], in_part=[])
        return replace(self, hiding=hiding, valid=comparable_region(o, hiding, self.scene))


@dataclass(frozen=True, eq=False, kw_only=True)
class _Placed:
    """An object on its way: ``base`` moved by the parameters ``u`` (6,) of the freedom of ``fit``."""

    base: SceneObject
    fit: ObjectFit
    u: Array

    @cached_property
    def iou(self) -> float:
        return self.fit.iou(self.u)

    def at(self, u: Array, *, reason: str = "") -> SceneObject:
        T, s = self.fit.freedom.similarity(u)
        return self.base.moved(T, scale=s, stage="align", reason=reason)

    @cached_property
    def object(self) -> SceneObject:
        return self.at(self.u) if self.u.any() else self.base

    def moved(self, u: Array) -> _Placed:
        return replace(self, u=u)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Evidence:
    """What speaks of the object beside its mask; None where there is none."""

    depth: DepthEvidence | None
    appearance: Appearance | None


@dataclass(frozen=True, eq=False, kw_only=True)
class _Found:
    """Where an object came from and where it ended, and what was decided on the way."""

    came: _Placed
    placed: _Placed
    decisions: list[Decision]

    @property
    def is_doubtful(self) -> bool:
        """Whether the object may have come far from its mask."""
        return self.came.iou < LEAST_IOU or self.placed.iou < FAR


_Phase = Callable[[_Placed, _Evidence, ObjectEvidence, AlignConfig], tuple[_Placed, list[Decision]]]


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
    brought = at_its_mask(o, _surfaces_seen(view.scene), view.scene.camera, stage="align")
    also, reason = _near(brought, view, config), unseen
    if found:
        was, now = (_where_any_may_hide(f.placed, view, config) for f in (found, also))
        if now.miss > config.orientations.share * was.miss:
            return found
        reason = f"near its input pose it misses its mask: {was.told(now)}"
    decision = Decision(choice="sought at its mask, not at its input pose", reason=reason, about=o.id, fallback=True)
    return replace(also, decisions=[decision, *also.decisions])


def _where_any_may_hide(placed: _Placed, view: ObjectEvidence, config: AlignConfig) -> _Scores:
    """The scores of an object, as if any other one might hide it."""
    freely = view.hidden_by_any(placed.object)
    return _scores(_started(placed.object, freely, config), _evidence(placed.object, freely, config), freely, config)


def _near(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> _Found:
    return _hidden_by_any(o, _searched(o, view, config), view, config)


def _searched(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> _Found:
    placed = came = _started(o, view, config)
    evidence, decisions = _evidence(o, view, config), list[Decision]()
    for phase in _phases(o, evidence, config):
        placed, more = phase(placed, evidence, view, config)
        decisions += more
    return _Found(came=came, placed=placed, decisions=decisions)


def _hidden_by_any(o: SceneObject, found: _Found, view: ObjectEvidence, config: AlignConfig) -> _Found:
    """What was found, unless the object fits clearly better where it came, or where it is found if any other object may
    hide it, or any but those before which it would be seen.

    Poses that are off tell wrongly what hides what. The geometry tells it of every pose by itself: what is before the
    surface that the photo shows is not hidden. So all are compared where any other object may hide them, less what is
    before it."""
    freely, share = view.hidden_by_any(o), config.orientations.share
    evidence = _evidence(o, freely, config)
    if evidence.depth is None or freely.valid[around(o.mask)].all():
        return found

    def scores(placed: _Placed) -> _Scores:
        return _scores(_started(placed.object, freely, config), evidence, freely, config)

    def or_better(found: _Found, now: _Scores, but: Collection[int]) -> tuple[_Found, _Scores]:
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
    wrong = _seen_before(found.placed.object, evidence.depth, view.scene) if now.before > MOST_BEFORE else []
    return or_better(found, now, wrong)[0] if wrong else found


def _seen_before(o: SceneObject, depth: DepthEvidence, scene: Scene) -> list[int]:
    """Ids of the objects before which an object would be seen."""
    masks = ((p.id, sampled(p.mask, scene.camera, depth.camera, fill=False)) for p in scene if p.id != o.id)
    return [id for id, mask in masks if depth.within(mask).residual(o).before > MOST_BEFORE]


def _phases(o: SceneObject, evidence: _Evidence, config: AlignConfig) -> list[_Phase]:
    turns = not o.lifted
    wanted: list[tuple[_Phase, bool]] = [
        (_fitted, True),
        (_polished, turns and (config.tilt.enabled or evidence.appearance is not None)),
        (partial(_reoriented, o), turns and config.orientations.enabled),
        (_standing, turns and config.facets.enabled),
        (_at_its_depth, evidence.depth is not None and config.depth.enabled),
    ]
    return [phase for phase, is_on in wanted if is_on]


def _not_in_view(o: SceneObject, camera: Camera) -> str:
    """Why an object has no silhouette to compare; empty where it has one."""
    pixels, z = camera.project(o.vertices_world)
    if z.min() <= rasterizer.NEAR:
        return "it reaches behind the camera"
    if np.any(pixels.max(0) < 0) or np.any(pixels.min(0) > [camera.width, camera.height]):
        return "it lies outside of the picture"
    return ""


def _object_fit(o: SceneObject, view: ObjectEvidence, config: AlignConfig, *, resolution: int) -> ObjectFit:
    return object_fit(
        o, view.valid, view.scene.camera, _freedom(o, view, config),
        resolution=resolution, weights=LossWeights(), prior=config.search.prior,
    )  # fmt: skip


def _freedom(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> ObjectFreedom:
    low, high = o.bounds_world
    middle = (low + high) / 2
    shift = config.max_shift * o.size
    tilt = config.tilt.most if config.tilt.enabled and not o.lifted else 0.0
    in_image = config.freedom == "image"
    return ObjectFreedom(
        anchor=middle if in_image else np.array([middle[0], middle[1], low[2]]),
        basis=view.scene.camera.T_world_camera[:3, :2] if in_image else np.eye(3)[:, :2],
        reach=np.array([shift, shift, config.max_yaw, tilt, tilt, config.max_scale]),
    )


def _evidence(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> _Evidence:
    scene, camera = view.scene, view.scene.camera
    geometry = _surfaces_seen(scene)
    window = window_around(o, camera, config.appearance.resolution)
    shown = sampled(o.mask & view.valid, camera, window, fill=False)
    hidden = ~sampled(view.valid, camera, window, fill=True)
    return _Evidence(
        depth=DepthEvidence.of(geometry, camera, window, shown, hidden) if geometry else None,
        appearance=(
            Appearance.of(scene.photo, camera, window, shown)
            if config.appearance.enabled and view.textured.has_detail
            else None
        ),
    )


def _surfaces_seen(scene: Scene) -> Geometry | None:
    """The geometry, where it shows more than the ground."""
    return scene.geometry if scene.geometry and scene.geometry.source != "ground" else None


# --- phases ---------------------------------------------------------------------------------------------------------


def _fitted(placed: _Placed, _: _Evidence, view: ObjectEvidence, config: AlignConfig) -> tuple[_Placed, list[Decision]]:
    """Equations 8 and 9: the best of several seeds; of all shifts where that misses its mask; again from there where
    shift or scale end at their bounds."""
    found = _best_of_seeds(placed, config)
    if config.anywhere:
        if found.iou < config.orientations.enough:
            found = _clearly_better(found, _by_overlap(placed, found, view, config), config)
        found = _clearly_better(found, _beyond_bounds(found, view, config), config)
    kept, decision = keep_better(
        placed, found, score=_iou, step="object", measure="valid mask IoU",
        about=placed.base.id,
    )  # fmt: skip
    return kept, [decision]


def _polished(
    placed: _Placed, evidence: _Evidence, view: ObjectEvidence, config: AlignConfig
) -> tuple[_Placed, list[Decision]]:
    """All degrees of freedom together, silhouette and appearance, also from the turn that the photo's detail tells."""
    was = _scores(placed, evidence, view, config)
    best, now = placed, was
    settings = config.appearance
    for start in (placed, *_turned(placed, was.correlation, settings.near, settings.gain, evidence, view, config)):
        also = _mismatch(start, evidence, view, config)
        found = start.fit.refined(start.u, iterations=config.search.iterations, free=_free(config), also=also)
        scores = _scores(start.moved(found.x), evidence, view, config)
        if scores.total > now.total and scores.iou >= was.iou - config.appearance.loss and scores.agrees(was):
            best, now = start.moved(found.x), scores
    decision = Decision(
        choice=f"tilt and detail: {'rolled back' if best is placed else 'accepted'}", reason=was.told(now),
        about=placed.base.id,
    )  # fmt: skip
    return best, [decision]


def _turned(
    placed: _Placed,
    correlation: float,
    turns: Sequence[float],
    gain: float,
    evidence: _Evidence,
    view: ObjectEvidence,
    config: AlignConfig,
) -> list[_Placed]:
    """The object turned [rad] about the vertical, or an axis its silhouette is blind to, to where the photo's detail
    fits better by a ``gain``; none where no turn does."""
    appearance = evidence.appearance
    if appearance is None or correlation >= config.appearance.known:
        return []
    o = placed.object
    for axis in (UP, *_blind_axes(placed, view, config)):
        tried = [_about_middle(o, rotation_about(axis, turn)) for turn in turns]
        scores = [appearance.correlation(_textured(_turned_by(o, T), view)) for T in tried]
        best = int(np.argmax(scores))
        if scores[best] >= correlation + gain:
            return [_after(placed, tried[best], view, config)]
    return []


def _reoriented(
    came: SceneObject, placed: _Placed, evidence: _Evidence, view: ObjectEvidence, config: AlignConfig
) -> tuple[_Placed, list[Decision]]:
    """What misses its mask, the geometry's depths or the photo's detail, in whichever orientation fits far better.

    It is sought from where it ``came``, and by turns from where it was ``placed``."""
    search, was = config.orientations, _scores(placed, evidence, view, config)
    misses = placed.iou < search.enough or _is_turned(placed.object, was, view.scene)
    starts = _other_orientations(came, placed, was, evidence, view, config, anyhow=misses)
    if not starts:
        return placed, []
    near = [(s, first) for s, first in starts if first.shape <= was.shape + search.slack or first.miss <= was.miss]
    best, now = placed, was
    for start, _ in sorted(near, key=lambda s: s[1].miss)[: search.detailed]:
        also = _mismatch(start, evidence, view, config)
        found = start.fit.refined(start.u, iterations=config.search.iterations, free=_free(config), also=also)
        scores = _scores(start.moved(found.x), evidence, view, config)
        if scores.miss < now.miss:
            best, now = start.moved(found.x), scores
    is_kept = now.miss <= (search.share if misses else config.appearance.share) * was.miss
    decision = Decision(
        choice=f"another orientation: {'accepted' if is_kept else 'none fits better'}", reason=was.told(now),
        about=came.id,
    )  # fmt: skip
    if not is_kept:
        return placed, [decision]
    best, fitted = _fitted(_started(best.object, view, config), evidence, view, config)
    best, polished = _polished(best, evidence, view, config)
    return best, [decision, *fitted, *polished]


def _other_orientations(
    came: SceneObject,
    placed: _Placed,
    was: _Scores,
    evidence: _Evidence,
    view: ObjectEvidence,
    config: AlignConfig,
    *,
    anyhow: bool,
) -> list[tuple[_Placed, _Scores]]:
    """How else an object may be meant: turned by far, where the photo's detail says so; in any orientation, where
    detail is unlike the photo's, or ``anyhow``. What detail alone asks for is no small turn: those were tried."""
    search, detail, here = config.orientations, config.appearance, placed.object

    def scored(some: list[_Placed]) -> list[tuple[_Placed, _Scores]]:
        return [(p, _scores(p, evidence, view, config)) for p in some]

    turned = scored(_fitting_in_detail(placed, was, detail.far, evidence, view, config))
    unlike = was.has_detail and was.correlation < detail.doubted
    if not (unlike or anyhow):
        return turned
    light = _object_fit(outlined(came, search.max_faces), view, config, resolution=search.resolution)
    best = best_orientations(_textured(came, view), light, search)
    sides = scored([_turned_from(came, f, view, config) for f in best])
    light = _object_fit(outlined(here, search.max_faces), view, config, resolution=search.resolution)
    in_place = best_in_place(here, light, search, tilt=config.facets.most)
    turned += sides + scored([_turned_from(here, f, view, config) for f in in_place])
    for side, first in sides if unlike else []:
        if first.shape <= was.shape + search.slack:
            turns = [*detail.near, *detail.far]
            turned += scored(_fitting_in_detail(side, first, turns, evidence, view, config))
    return turned if anyhow else [(p, s) for p, s in turned if _angle_between(p.object, here) > detail.search]


def _fitting_in_detail(
    placed: _Placed,
    was: _Scores,
    turns: Sequence[float],
    evidence: _Evidence,
    view: ObjectEvidence,
    config: AlignConfig,
) -> list[_Placed]:
    """The object at whichever of some turns [rad] fits the photo's detail far better, then on its mask again."""
    found = _turned(placed, was.correlation, turns, config.appearance.far_gain, evidence, view, config)
    steps, free = config.orientations.iterations, _free(config)
    return [p.moved(p.fit.refined(p.u, iterations=steps, free=free).x) for p in found]


def _standing(
    placed: _Placed, evidence: _Evidence, view: ObjectEvidence, config: AlignConfig
) -> tuple[_Placed, list[Decision]]:
    """On the nearest stable facet, where that is near and the picture does not mind."""
    turn = facet_turn(_textured(placed.object, view), config.facets.most)
    if turn is None:
        return placed, []
    standing = _after(placed, _about_middle(placed.object, turn), view, config)
    also = _mismatch(standing, evidence, view, config)
    found = standing.fit.refined(standing.u, iterations=config.search.iterations // 2, also=also)
    was, now = (_scores(p, evidence, view, config) for p in (placed, standing.moved(found.x)))
    is_kept = now.total >= was.total - config.facets.loss
    decision = Decision(
        choice=f"onto a stable facet: {'accepted' if is_kept else 'rolled back'}", reason=was.told(now),
        about=placed.base.id,
    )  # fmt: skip
    return (standing.moved(found.x) if is_kept else placed), [decision]


def _at_its_depth(
    placed: _Placed, evidence: _Evidence, view: ObjectEvidence, config: AlignConfig
) -> tuple[_Placed, list[Decision]]:
    """Along its viewing rays to where the geometry sees it; no silhouette changes."""
    assert evidence.depth is not None
    camera = view.scene.camera
    was = evidence.depth.residual(placed.object)
    if was.pixels < GEOMETRY_PIXELS or was.spread > GEOMETRY_SPREAD:
        reason = f"{was.pixels} pixels in common, depths spread by {100 * was.spread:.1f} % of the distance"
        return placed, [Decision(choice="the geometry does not tell its distance", reason=reason, about=placed.base.id)]
    k = float(np.clip(np.exp(-was.median), 1 - GEOMETRY_REACH, 1 + GEOMETRY_REACH))
    T = camera.homothety(k)
    moved = _after(placed, T, view, config, scale=k)
    now = evidence.depth.residual(moved.object)
    kept, decision = keep_better(
        (placed, was), (moved, now), score=lambda c: -c[1].size, step="to the geometry's distance",
        measure="", about=placed.base.id,
    )  # fmt: skip
    bound = ", the bound" if abs(k - 1) >= GEOMETRY_REACH - 1e-9 else ""
    told = f"distance times {k:.3f}{bound}; depths {100 * was.size:.2f} -> {100 * now.size:.2f} % off"
    return kept[0], [replace(decision, reason=told)]


# --- parts of phases --------------------------------------------------------------------------------------------------


def _is_turned(o: SceneObject, scores: _Scores, scene: Scene) -> bool:
    """Whether depths tell that an object shows another side than the photo does: by more than they err, or meshes. One
    that is before what hides it is elsewhere."""
    distance = float(np.linalg.norm(o.middle - scene.camera.center))
    return max(scores.noise, TURNED * o.size / distance) < scores.spread < np.inf and scores.before <= MOST_BEFORE


def _best_of_seeds(placed: _Placed, config: AlignConfig) -> _Placed:
    search = config.search
    starts = [np.zeros(6), *map(placed.fit.seed, search.yaw_seeds)]
    return placed.moved(placed.fit.best(starts, kept=search.kept_seeds, iterations=search.iterations).x)


def _by_overlap(placed: _Placed, found: _Placed, view: ObjectEvidence, config: AlignConfig) -> _Placed:
    """The best of seeds at whichever shift covers the mask best, in each yaw and scale; what was ``found`` where no
    coarse silhouette is better than its."""
    search, coarse = config.search, config.orientations
    light = _object_fit(outlined(placed.base, coarse.max_faces), view, config, resolution=coarse.resolution)
    light = replace(light, freedom=placed.fit.freedom)
    starts = light.seeds_by_overlap(search.yaw_seeds, search.overlap_scales)
    best = light.best(starts, kept=search.kept_seeds, iterations=search.iterations).x
    if light.value(best) >= light.value(found.u):
        return found
    return placed.moved(placed.fit.refined(best, iterations=search.iterations).x)


def _clearly_better(found: _Placed, other: _Placed, config: AlignConfig) -> _Placed:
    """The other one where it misses its mask by clearly less."""
    return other if 1 - other.iou <= config.orientations.share * (1 - found.iou) else found


def _beyond_bounds(placed: _Placed, view: ObjectEvidence, config: AlignConfig) -> _Placed:
    """Searches from where the last one ended, while shift or scale are at their bounds there."""
    for _ in range(config.search.further):
        if np.abs(placed.u[SHIFTS_AND_SCALE]).max() < 1:
            break
        placed = _best_of_seeds(_started(placed.object, view, config), config)
    return placed


@dataclass(frozen=True, kw_only=True)
class _Scores:
    """IoU with the valid mask, correlation with the photo, spread of depth about the geometry's, share ``before`` what
    the photo shows; 0 where unknown."""

    iou: float
    correlation: float
    has_detail: bool
    """The mesh has detail to correlate."""
    spread: float
    before: float
    noise: float
    """Standard deviation of the geometry's depths [share of the distance]."""
    config: AlignConfig

    @property
    def total(self) -> float:
        return self.iou + self.config.appearance.weight * self.correlation

    @property
    def shape(self) -> float:
        """How far mask and depth are from those of a perfect mesh."""
        return self.config.orientations.missed(self.iou - self.before, self.spread)

    @property
    def miss(self) -> float:
        """How far all three are from a perfect mesh's."""
        correlation = self.correlation if self.has_detail else None
        return self.config.orientations.missed(self.iou - self.before, self.spread, correlation)

    def agrees(self, before: _Scores) -> bool:
        """Whether depths spread about the geometry's no more than ``before``, or no more than its noise may."""
        return self.spread <= max(before.spread, NOISE * self.noise)

    def told(self, after: _Scores) -> str:
        nearer = f", nearer than what hides it {self.before:.0%} -> {after.before:.0%}"
        return (
            f"valid mask IoU {self.iou:.4f} -> {after.iou:.4f}, correlation with the photo {self.correlation:.2f} -> "
            f"{after.correlation:.2f}, spread of depth {self.spread:.4f} -> {after.spread:.4f}"
        ) + (nearer if max(self.before, after.before) >= 0.01 else "")


def _scores(placed: _Placed, evidence: _Evidence, view: ObjectEvidence, config: AlignConfig) -> _Scores:
    o = placed.object
    depths = evidence.depth.residual(o) if evidence.depth else None
    return _Scores(
        iou=placed.iou,
        correlation=evidence.appearance.correlation(_textured(o, view)) if evidence.appearance else 0.0,
        has_detail=evidence.appearance is not None,
        spread=depths.spread if depths else 0.0,
        before=depths.before if depths else 0.0,
        noise=sigma(view.scene.geometry),
        config=config,
    )


def _iou(placed: _Placed) -> float:
    return placed.iou


def _mismatch(
    placed: _Placed, evidence: _Evidence, view: ObjectEvidence, config: AlignConfig
) -> Callable[[Array], Local] | None:
    """The appearance's term of the objective."""
    appearance, weight = evidence.appearance, config.appearance.weight
    if appearance is None or not weight:
        return None
    camera = view.scene.camera

    def local(u: Array) -> Local:
        velocities = placed.fit.freedom.velocities(u, camera)
        return appearance.mismatch(_textured(placed.at(u), view), velocities).weighted(weight)

    return local


def _after(placed: _Placed, T: Array, view: ObjectEvidence, config: AlignConfig, *, scale: float = 1.0) -> _Placed:
    """The object moved by x -> T (scale x) from where it is, a new start of its freedom."""
    base = placed.object.moved(T, scale=scale, stage="align", reason="")
    T_u, s_u = placed.fit.freedom.similarity(placed.u)
    surface = placed.fit.surface.moved(T_u, s_u).moved(T, scale)
    fit = replace(placed.fit, surface=surface, freedom=_freedom(base, view, config))
    return _Placed(base=base, fit=fit, u=np.zeros(6))


def _started(o: SceneObject, view: ObjectEvidence, config: AlignConfig) -> _Placed:
    """An object where it is, with its freedom about that and a window around it."""
    return _Placed(base=o, fit=_object_fit(o, view, config, resolution=config.resolution), u=np.zeros(6))


def _turned_from(came: SceneObject, found: Orientation, view: ObjectEvidence, config: AlignConfig) -> _Placed:
    turned = _turned_by(came, found.T)
    return _Placed(base=turned, fit=_object_fit(turned, view, config, resolution=config.resolution), u=found.u)


def _free(config: AlignConfig) -> Array:
    """(6,) what is free once detail is compared."""
    return EVERYTHING if config.tilt.enabled else EQUATION_8


def _blind_axes(placed: _Placed, view: ObjectEvidence, config: AlignConfig) -> Iterator[Array]:
    """Own axes (3,), not near the vertical, about which the silhouette does not see a turn to either side."""
    o, least = placed.object, placed.iou - config.appearance.blind
    for axis in principal_axes(_textured(o, view)):
        if abs(axis @ UP) < NEAR_VERTICAL:
            turned = (
                _after(placed, _about_middle(o, rotation_about(axis, sign * BLIND_TURN)), view, config)
                for sign in (-1, 1)
            )
            if all(t.iou >= least for t in turned):
                yield axis


def _angle_between(a: SceneObject, b: SceneObject) -> float:
    """The angle [rad] of the turn from one pose to another."""
    return rotation_angle(a.T_world_object[:3, :3] @ b.T_world_object[:3, :3].T)


def _about_middle(o: SceneObject, R: Array) -> Array:
    """The turn (4, 4) by R (3, 3) about an object's middle."""
    return turn_about(o.middle, R)


def _turned_by(o: SceneObject, T: Array) -> SceneObject:
    return o.moved(T, stage="align", reason="")


def _textured(o: SceneObject, view: ObjectEvidence) -> SceneObject:
    return o if o.mesh is view.textured else replace(o, mesh=view.textured)


def _as_one_motion(before: SceneObject, after: SceneObject, *, reason: str) -> SceneObject:
    """``before``, moved to where ``after`` is, with one note of it."""
    T, scale = before.motion_to(after)
    return before.moved(T, scale=scale, stage="align", reason=reason)
