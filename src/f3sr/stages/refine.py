"""refine: repeat alignment on the scene at rest, and keep the result group by group where the visible IoU rises.

Objects that touch neither each other nor each other's new places are independent. So every such group of a repeated
scene is kept or reverted by itself (docs: contact).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, Protocol

import numpy as np
from annotated_types import Interval

from f3sr.core.camera import Camera
from f3sr.core.transforms import invert_pose
from f3sr.metrics.contact_groups import SettledScene, groups_of, mean_gain
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import GROUND, Scene, SceneObject, name_of, names_of
from f3sr.settings import settings
from f3sr.uncertainty.config import UncertaintyConfig
from f3sr.vision import depth_prior

TOPPLE = math.radians(20)
"""Turn [rad] while settling from which an object has toppled; the report's instability."""
UPRIGHT = math.radians(25)
"""Largest turn [rad] onto the stable facet on which a toppled object is stood."""
GAIN = 5e-4
"""Least gain of mean mIoU_visible, over the objects that a round changes, for the round to be kept."""
RETURNS = 2
"""Most times that a group which contact moved off its masks is placed again: a third time gained
nothing in the five of thirteen scenes that had such groups. Where the first gains nothing there is no second: in none
of six such scenes it gained."""
LOST = 0.03
"""Mean visible IoU that contact costs a group, from which on it is placed again from where alignment had it, or some of
it is held. An object is re-aligned alone from there on."""
PATIENCE = 2
"""Objects that are re-aligned alone in vain, one after the other, until the others are left: in 18 scenes five objects
gained by it after one in vain, and none after two."""
HOPELESS = 0.02
"""Loss of visible IoU of a group from which on it is undone, whatever its measured depths gain. Less does not show that
an object lies elsewhere: boxes on visible boxes with depths that were 8 % off lost .006, one over a hidden box .03."""
UNMOVED = 1e-12
"""Shift [m] and turn [rad] of a camera that are rounding."""
AGAIN = 1e-2
"""Least gain of a group for another round: in 16 of 18 scenes that gained .007 at most in the mean, the next won .0006
or less, and groups of the other two had gained more. Groups that do not rest are not tried again either, as they take
all the time that settling may."""
UNSEEN = 0.2
"""Least visible IoU that a group gains, all its objects together, for each that is held as if something unseen carried
it. In piles with hidden objects they gained .2 to 1.3. Of 21 scenes without, 19 lose .19 at most by contact."""
ELSEWHERE = 6.0
"""Standard deviations of its distance from which on a user is told that an object lies elsewhere than the photo shows
it. It may be held only if its visible IoU falls by ``HOPELESS`` too: a box that fell away from the camera, by 9 of
them, kept .8 of it. Of 424 other objects in 56 made scenes none was off by more than 4; real frames, with poor depth,
have up to 12."""
STANDS = 2.0
"""Standard deviations of its distance within which an object that rests on the ground shows that it is there."""
NONE_HELD = "contact carries all, or too many would be fixed"
GAINING = 3e-3
"""Least gain of an object for it to be tried again, or alone where its group was undone."""


@settings
class RefineConfig:
    """What is tried again once everything rests, and kept where the picture gains.

    What contact moved off its masks goes to the equilibrium nearest to where alignment had it, or is placed again from
    there. What toppled elsewhere is stood on its nearest stable facet before physics. Then all are re-aligned under
    contact, at last one by one: they turn about the vertical, shift horizontally and scale about their base, and are
    separated and settled again.
    """

    rounds: Annotated[int, Interval(ge=0, le=10)] = 4
    """Most rounds of re-alignment; each tries only what gained in the one before."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Objects with its ``apart`` between them do not affect each other."""
    uncertainty: UncertaintyConfig = UncertaintyConfig()
    """Tells what moves cost in the search for an equilibrium."""


class Retries(Protocol):
    """Moves some objects of a scene at rest, ``before``, and settles what that affects (``contact_retries``).

    Where there is a ``start``, ``moving`` objects begin where they are in it; the others stay as they are."""

    def realigned(self, before: Scene, ids: Collection[int], *, balanced: frozenset[int]) -> SettledScene:
        """Objects aligned under contact; what is ``balanced`` goes to an equilibrium."""
        ...

    def stood_up(self, before: Scene, ids: Collection[int], *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """Objects on their stable facets."""
        ...

    def balanced(self, before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """Objects at their nearest equilibrium."""
        ...

    def replaced(self, before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """Objects separated and settled."""
        ...

    def held(self, before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        """Objects at their nearest equilibrium, some fixed without which there is none; as before if not at ``most``
        so many."""
        ...


@dataclass(frozen=True, kw_only=True)
class Refined(Outcome):
    stage: ClassVar[str] = "refine"
    seen: tuple[float, float] | None = None
    """mIoU_visible before and after; None where nothing was tried."""
    restless: frozenset[int] = frozenset()
    """Ids of the objects that do not rest."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return (Measure(name="mIoU_visible", before=self.seen[0], after=self.seen[1]),) if self.seen else ()


def refine(
    scene: Scene,
    config: RefineConfig,
    *,
    aligned: Scene,
    parted: Scene,
    retries: Retries,
    restless: Collection[int] = (),
) -> tuple[Scene, Refined]:
    """Seek an equilibrium for what contact moved off its masks, then align again what rests, until nothing gains.

    It is the one nearest to where ``aligned`` has it. Where the search gained nothing, what toppled since ``parted``
    (before physics) is stood up, and what is still off its masks after alignment is placed again from where ``aligned``
    has it. Then every object that is still off its mask is re-aligned alone. Where all that leaves a group
    far off its masks, some of its objects are held where the photo shows them: something that it does not show may
    carry them, a fallback.

    ``restless`` are the ids of objects that do not rest as they are.
    """
    state = SettledScene(scene=scene, restless=frozenset(restless))
    seen = SettledScene(scene=_seen_by(scene.camera, aligned), restless=frozenset())
    before = state.seen
    decisions: list[Decision] = []
    balanced = frozenset[int]()
    if lost := sorted(moved_off_masks(state, seen, config.contact)):
        step = f"moved to the nearest equilibrium: {names_of(lost)}"
        start = state.scene.with_objects(*(seen.scene[id] for id in lost))
        tried = retries.balanced(state.scene, start=start, moving=frozenset(lost))
        state, decision, undone = _better(state, tried, lost, step, config)
        decisions.append(decision)
        balanced = frozenset(lost).difference(undone)
    if toppled := [o.id for o in state.scene if o.id not in balanced and parted[o.id].angle_to(o) > TOPPLE]:
        step = f"standing up what toppled: {names_of(toppled)}"
        upright, moving = _before_the_fall(state.scene, parted, toppled, config.contact)
        fallen, tried = state, retries.stood_up(state.scene, toppled, start=upright, moving=moving)
        state, decision, _ = _better(state, tried, toppled, step, config)
        decisions.append(decision)
        balanced = balanced.difference(o.id for o in state.scene if o is not fallen.scene[o.id])
    came = state
    again = _Realigning(retries, balanced=balanced)
    state, told = _rounds(came, [o.id for o in came.scene], again, config)
    decisions += told
    lost = sorted(moved_off_masks(state, seen, config.contact).difference(balanced))
    placed, told = _placed_again(came, lost, seen, retries, config)
    decisions += told
    if placed is not came:
        placed, told = _rounds(placed, lost, again, config)
        step = f"placed again and then re-aligned {names_of(lost)}"
        state, decision, _ = _better(state, placed, lost, step, config)
        decisions += [*told, decision]
    state, told = _one_by_one(state, seen, again, config)
    decisions += told
    state, told = _on_something_unseen(state, seen, retries, config)
    decisions += told
    fell = [o.id for o in scene if parted[o.id].angle_to(o) > TOPPLE]
    decisions += _not_turned_as_seen(state.scene, seen.scene, fell)
    decisions += [_told_of_friction(scene[o.id], o) for o in state.scene if o.friction != scene[o.id].friction]
    return state.scene, Refined(seen=(before, state.seen), restless=state.restless, decisions=tuple(decisions))


def _told_of_friction(before: SceneObject, after: SceneObject) -> Decision:
    reason = "it would slide from where the photo shows it; the other value is a guess by its label, or the default"
    return Decision(choice=f"friction {before.friction:g} -> {after.friction:g}", reason=reason, about=after.id)


class _Realigning:
    """Re-alignment under contact, and what was re-aligned already: of the same scene the same objects end alike."""

    def __init__(self, retries: Retries, *, balanced: frozenset[int]) -> None:
        self._realigned = partial(retries.realigned, balanced=balanced)
        self._tried = set[tuple[Scene, tuple[int, ...]]]()

    def __call__(self, state: SettledScene, ids: Sequence[int]) -> SettledScene:
        self._tried.add((state.scene, tuple(ids)))
        return self._realigned(state.scene, ids)

    def was_tried(self, state: SettledScene, ids: Sequence[int]) -> bool:
        return (state.scene, tuple(ids)) in self._tried


def _rounds(
    state: SettledScene, ids: Sequence[int], again: _Realigning, config: RefineConfig
) -> tuple[SettledScene, list[Decision]]:
    """Some objects re-aligned, then those that gained again, until none does."""
    open, decisions = list(ids), list[Decision]()
    for _ in range(config.rounds):
        if not open:
            break
        was = state.scores
        state, told = _round(state, open, again, config)
        decisions += told
        gained = {
            id
            for g in groups_of(state.scene, state.scene, config.contact.apart)
            if not g & state.restless and mean_gain(g, was, state.scores) > AGAIN
            for id in g
        }
        open = [id for id in open if id in gained and state.scores[id] > was[id] + GAINING]
    return state, decisions


def _one_by_one(
    state: SettledScene, seen: SettledScene, again: _Realigning, config: RefineConfig
) -> tuple[SettledScene, list[Decision]]:
    """What contact keeps off its mask, re-aligned alone, what is farthest off first.

    A contact group is kept or undone as a whole: of objects that are re-aligned together, one may spoil what the others
    gain."""
    off = {id: seen.ious[id] - iou for id, iou in state.ious.items() if seen.ious[id] - iou > LOST}
    decisions, in_vain = list[Decision](), 0
    for id in sorted(off, key=lambda id: -off[id]):
        if in_vain == PATIENCE:
            break
        was = state
        if not again.was_tried(state, [id]):
            step = f"re-alignment under contact of {name_of(id)} alone"
            state, decision, _ = _better(state, again(state, [id]), [id], step, config)
            decisions.append(decision)
        in_vain = in_vain + 1 if state is was else 0
    return state, decisions


def _on_something_unseen(
    state: SettledScene, seen: SettledScene, retries: Retries, config: RefineConfig
) -> tuple[SettledScene, list[Decision]]:
    """Groups that are far off their masks wherever contact carries them, with some of their objects held.

    That needs the photo's own geometry: without, an object is only as far away as it came. No held object may reach
    below the ground, nor one of which a support or its mobility is given."""
    apart, geometry = config.contact.apart, state.scene.geometry
    if geometry is None or geometry.source == "ground":
        return state, []
    decisions, elsewhere = list[Decision](), partial(_elsewhere, seen)
    free = _most_held(state, seen) - sum(o.mobility_source == "found" for o in state.scene)
    for group in groups_of(seen.scene, state.scene, apart):
        could_gain = len(group) * mean_gain(group, state.ious, seen.ious)
        could_return = elsewhere(state) & group
        is_far_off = could_return or could_gain > max(UNSEEN, LOST * len(group))
        if not is_far_off or not any(map(state.scene.may_be_unsupported, group)):
            continue
        most = min(free, max(int(could_gain / UNSEEN), len(could_return)))
        if most < 1:
            decisions.append(_not_held(group, "none", NONE_HELD))
            continue
        start = state.scene.with_objects(*(seen.scene[id] for id in sorted(group)))
        tried = retries.held(state.scene, start=start, moving=frozenset(group), most=most)
        was = state
        state, told = _held(was, tried, group, could_return - elsewhere(tried), apart)
        free -= len(newly_fixed(was.scene, state.scene, group))
        decisions += told
    return state, decisions + _not_as_far_as_seen(state, seen)


def _not_as_far_as_seen(state: SettledScene, seen: SettledScene) -> list[Decision]:
    """What is told of objects that lie elsewhere, also where the picture does not show it: what is farther away and
    larger has the same outline."""
    moved = depth_prior.moved_along_rays(seen.scene, state.scene)
    far = {id: f"{off:.1f} standard deviations of its distance" for id, off in moved.items() if off > ELSEWHERE}
    choice = "is not as far away as the photo shows it"
    return [
        Decision(
            choice=choice,
            reason=f"{far[id]}, visible IoU {state.ious[id] - seen.ious[id]:+.2f}; contact leads it there",
            about=id,
            fallback=True,
        )
        for id in far
    ]


def _not_turned_as_seen(scene: Scene, seen: Scene, fell: Collection[int]) -> list[Decision]:
    """What is told of objects that ``fell`` over and still lie so, as the photo may show it in no outline."""
    turned = {id: turn for id in fell if (turn := seen[id].angle_to(scene[id])) > TOPPLE}
    return [
        Decision(
            choice="is not turned as the photo shows it",
            reason=f"toppled by {math.degrees(turn):.0f} degrees; what carries it may be hidden",
            about=id,
            fallback=True,
        )
        for id, turn in turned.items()
    ]


def _most_held(state: SettledScene, seen: SettledScene) -> int:
    """Most objects of a scene that may be held. Where most hang, it is the ground that is wrong, unless some stand on
    it as the photo shows them."""
    moved, count = depth_prior.moved_along_rays(seen.scene, state.scene), len(state.scene.objects)
    standing = sum(
        o.supported_by == GROUND and seen.ious[o.id] - state.ious[o.id] <= HOPELESS and moved[o.id] <= STANDS
        for o in state.scene
    )
    return max(count // 2, count - standing) if standing else count // 2


def _elsewhere(seen: SettledScene, now: SettledScene) -> frozenset[int]:
    """Ids of the objects that are not as far away as the photo shows them, where that is seen too: a depth that is
    off shows nothing by itself."""
    lost = [id for id, iou in now.ious.items() if seen.ious[id] - iou > HOPELESS]
    off = depth_prior.moved_along_rays(seen.scene, now.scene) if lost else {}
    return frozenset(id for id in lost if off[id] > ELSEWHERE)


def _held(
    state: SettledScene, tried: SettledScene, group: set[int], returned: frozenset[int], apart: float
) -> tuple[SettledScene, list[Decision]]:
    """What was tried of a group, where each object that is held wins enough, or one is ``returned`` for each."""
    kept, decisions = list[Collection[int]](), list[Decision]()
    for g in groups_of(state.scene, tried.scene, apart):
        held = newly_fixed(state.scene, tried.scene, g)
        gain = len(g) * mean_gain(g, state.ious, tried.ious)
        is_sunk = any(tried.scene[id].bounds_world[0, 2] < -apart for id in held)
        wins = gain >= UNSEEN * len(held) or (gain > HOPELESS * len(held) and len(returned & g) >= len(held))
        if not held or not wins or is_sunk or _is_worse(g, state, tried):
            continue
        kept.append(g)
        choice = "kept fixed where the photo shows it: what is seen cannot carry it there"
        reason = f"visible IoU of its group rises by {gain:.2f} in all"
        if back := returned & g:
            reason += f"; {names_of(back)} would lie elsewhere"
        reason += "; what carries it may be hidden, lack a mask, or have another shape"
        decisions += [Decision(choice=choice, reason=reason, about=id, fallback=True) for id in held]
    if not kept:
        if not newly_fixed(state.scene, tried.scene, group):
            return state, [_not_held(group, "none", NONE_HELD)]
        needed = f"; each must win {UNSEEN:g} in all or bring one back, rest and lie above the ground"
        return state, [_not_held(group, "rolled back", _told(state, tried) + needed)]
    return state.with_groups(tried, kept), decisions


def _not_held(group: Collection[int], verdict: str, reason: str) -> Decision:
    return Decision(choice=f"some of {names_of(group)} kept fixed where the photo shows them: {verdict}", reason=reason)


def newly_fixed(was: Scene, now: Scene, ids: Collection[int]) -> list[int]:
    """Those of some objects that are fixed now, and were not."""
    return [id for id in sorted(ids) if now[id].mobility != was[id].mobility]


def _is_worse(group: Collection[int], was: SettledScene, now: SettledScene) -> bool:
    """Whether something of a group does not rest, or overlaps, that did not before."""
    return bool(
        now.restless.intersection(group) - was.restless or now.overlapping.intersection(group) - was.overlapping
    )


def _placed_again(
    state: SettledScene, ids: Sequence[int], seen: SettledScene, retries: Retries, config: RefineConfig
) -> tuple[SettledScene, list[Decision]]:
    """Some objects where contact leads them from other starts near their masks: the best of all."""
    decisions: list[Decision] = []
    for k in range(RETURNS):
        if not (ids := sorted(moved_off_masks(state, seen, config.contact).intersection(ids))):
            break
        step = f"placed again {'near' if k else 'from'} where the photo shows {names_of(ids)}"
        start = _as_seen(state.scene, seen.scene, ids, attempt=k)
        was, tried = state, retries.replaced(state.scene, start=start, moving=frozenset(ids))
        state, decision, _ = _better(state, tried, ids, step, config)
        decisions.append(decision)
        if state is was:
            break
    return state, decisions


def moved_off_masks(state: SettledScene, seen: SettledScene, contact: ContactMargin) -> frozenset[int]:
    """Ids of the groups that contact moved off their masks. What fell away belongs to its group: the photo shows it
    there."""
    groups = groups_of(seen.scene, state.scene, contact.apart)
    return frozenset(id for g in groups if len(g) > 1 and mean_gain(g, seen.ious, state.ious) < -LOST for id in g)


def _as_seen(scene: Scene, aligned: Scene, ids: Collection[int], *, attempt: int) -> Scene:
    """Some objects where alignment had them, with the colliders that they have now, and without footings.

    From the second ``attempt`` on their distances are drawn anew by what is known of them."""
    sigmas = depth_prior.sigmas(aligned)
    camera = aligned.camera
    objects: list[SceneObject] = []
    for id in sorted(ids):
        o = replace(aligned[id], parts=scene[id].parts)
        if attempt:
            k = float(np.exp(sigmas[id] * np.random.default_rng([attempt, id]).normal()))
            reason = f"placed again at {k:.3f} of its distance, drawn by its standard deviation"
            o = o.moved(camera.homothety(k), scale=k, stage=Refined.stage, reason=reason)
        objects.append(o)
    return scene.with_objects(*objects)


def _seen_by(camera: Camera, scene: Scene) -> Scene:
    """A scene moved as a whole to where its camera is another one: ``separate`` moves the ground under both."""
    T = camera.T_world_camera @ invert_pose(scene.camera.T_world_camera)
    if np.allclose(T, np.eye(4), rtol=0, atol=UNMOVED):
        return scene
    objects = tuple(o.moved(T, stage=Refined.stage, reason="with everything, as the ground moved") for o in scene)
    return replace(scene, objects=objects, camera=camera)


def _before_the_fall(
    scene: Scene, parted: Scene, toppled: Collection[int], contact: ContactMargin
) -> tuple[Scene, frozenset[int]]:
    """A scene at rest with what toppled, and all that came near it, as before physics; and the ids of both."""
    groups = groups_of(scene, parted, contact.apart)
    moving = frozenset(id for g in groups if g.intersection(toppled) for id in g)
    return scene.with_objects(*(parted[id] for id in sorted(moving))), moving


def _round(
    state: SettledScene, ids: Sequence[int], again: _Realigning, config: RefineConfig
) -> tuple[SettledScene, list[Decision]]:
    """Some objects re-aligned; then, of groups that were undone, those that would gain alone."""
    step = "re-alignment under contact" + (f" of {names_of(ids)}" if len(ids) < len(state.scene.objects) else "")
    tried = again(state, ids)
    kept, decision, undone = _better(state, tried, ids, step, config)
    decisions = [decision]
    alone = _would_gain(state, tried, undone, GAINING)
    if alone and len(alone) < len(ids):
        step = f"re-alignment under contact of {names_of(alone)} alone"
        kept, decision, _ = _better(kept, again(kept, alone), alone, step, config)
        decisions.append(decision)
    return kept, decisions


def _better(
    state: SettledScene, tried: SettledScene, ids: Sequence[int], step: str, config: RefineConfig
) -> tuple[SettledScene, Decision, list[int]]:
    """``state`` with the groups of ``tried`` that agree better with the photo and its measured depth, rest and do not
    overlap, unless they did before; and which of the ``ids`` that were tried were undone.

    One group may hide another, so what each gains it may only gain together: all that gain, or all that lose little."""
    was, now = state.scores, tried.scores
    able = [
        g
        for g in groups_of(state.scene, tried.scene, config.contact.apart)
        if g.intersection(ids) and mean_gain(g, state.ious, tried.ious) >= -HOPELESS and not _is_worse(g, state, tried)
    ]
    gaining = [g for g in able if mean_gain(g, was, now) > GAIN]
    candidates = [(state.with_groups(tried, groups), groups) for groups in (gaining, able)] if gaining else []
    best, changed = max(candidates, key=lambda c: c[0].score, default=(state, []))
    if best.score <= state.score:
        reason = _told(state, tried) + _not_at_rest(tried.restless - state.restless)
        if crossing := sorted(tried.overlapping - state.overlapping):
            reason += f", overlapping: {names_of(crossing)}"
        return state, Decision(choice=f"{step}: rolled back", reason=reason), list(ids)
    undone = [id for id in ids if not any(id in g for g in changed)]
    but = f" but for {names_of(undone)}" if undone else ""
    return best, Decision(choice=f"{step}: accepted{but}", reason=_told(state, best)), undone


def _told(was: SettledScene, now: SettledScene) -> str:
    seen = f"mIoU_visible {was.seen:.4f} -> {now.seen:.4f}"
    measured = f", with the measured depth {was.score:.4f} -> {now.score:.4f}"
    return seen + (measured if was.scene.has_measured_depth else "")


def _not_at_rest(ids: Collection[int]) -> str:
    return f", not at rest: {names_of(ids)}" if ids else ""


def _would_gain(state: SettledScene, tried: SettledScene, undone: Sequence[int], gain: float) -> list[int]:
    """Objects that show more of their masks in a state that was undone, without what will not rest there and all that
    carries it or is carried by it."""
    before, after = state.scene, tried.scene
    bound = {
        k
        for id in tried.restless - state.restless
        for k in (*after.ancestors(id), *after.subtree(id), *before.ancestors(id))
    }
    return [id for id in undone if tried.scores[id] > state.scores[id] + gain and id not in bound]
