"""coarsen: few convex parts for the scene at rest, as every part costs time in every later simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, ClassVar, Protocol

import numpy as np
from annotated_types import Interval

from f3sr.contact.undersides import FootingConfig
from f3sr.core.transforms import Array, invert_pose
from f3sr.metrics.contact_groups import SettledScene, groups_of, mean_gain
from f3sr.metrics.measures import visible_ious
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.physics.soft_contacts import soft_release
from f3sr.proxies import Join
from f3sr.proxies.few_parts import PartLimits, with_few_parts
from f3sr.proxies.known_parts import KnownParts
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, SceneObject
from f3sr.settings import settings

LOSS = 2e-3
"""Largest mean loss of visible IoU of a group by new parts: where something tips or slides, it is more."""
LOSS_TO_REST = 2e-2
"""The same of a group that did not rest before and does now."""
LOSS_TO_LIMIT = 3e-2
"""The same of a group with parts over the limits. What loses more keeps its parts: it would be another scene."""
KEPT, KEPT_MOVED = 0.25, 0.75
"""Share of the vertices that is kept around contacts, of an object that rests so and of one that moved with fewer."""
TRIES = 3
"""Most attempts: with the parts wanted, with finer ones of what moves, at last with still finer ones of the group. One
more follows where parts are over the limits."""
ROUNDS = 2
"""Most rounds of settling: what takes more moves with its new parts."""
FINER = 0.1
"""What a part fewer is worth of an object that moved, as a share of before."""
LOSS_TO_WITHSTAND = 0.05
"""Largest mean loss of visible IoU of a group for a place where it rests on soft contacts too: what loses more would
miss its mask. Nor may it lose more, by ``LOSS``, than where it falls or slides to on soft contacts. A marker that falls
into an organizer costs its group .04, fruit that slides off its heap .09, a lemon that slides down the wall of a bowl
.23."""
SOFT_TRAVEL = 8e-3
"""Travel on soft contacts [m] from which on an object falls or slides: what stays creeps by up to 6 mm in 20 scenes."""


class Rebalanced(Protocol):
    """Moves objects, by id, to their nearest equilibrium; ``finished`` gives a scene there its last parts."""

    def __call__(
        self, scene: Scene, moving: frozenset[int], /, *, finished: Callable[[Scene], Scene]
    ) -> SettledScene: ...


@settings
class CoarsenConfig:
    """How few parts are delivered. Parts keep their shape at contacts."""

    worth: Annotated[float, Interval(ge=0, le=1)] = 0.02
    """Loss that a part fewer is worth. .02 is a stand-off of 2 % of the size over 2 % of the surface."""
    max_parts: Annotated[int, Interval(ge=1, le=256)] = 32
    """Convex parts of one object, with footing, above which they are joined at any loss."""
    max_vertices: Annotated[int, Interval(ge=16, le=1000)] = 64
    """Most vertices of a part. PhysX takes 64, some engines on a GPU 32."""
    stand_off: Annotated[float, Interval(gt=0, le=1)] = 0.0135
    """Mean distance [size] of the parts' surface from the mesh, above which joins are refused."""
    footing: FootingConfig = FootingConfig()
    """That of ``separate``: footings are made anew on few parts."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Parts come no nearer to another body than they were, or than its ``reach``."""

    def limits(self, moved: int = 0) -> PartLimits:
        """Those of an object that ``moved`` so many times with fewer parts."""
        return PartLimits(
            worth=FINER**moved * self.worth,
            parts=self.max_parts,
            vertices=self.max_vertices,
            stand_off=self.stand_off,
            kept=KEPT if moved == 0 else KEPT_MOVED,
            apart=self.contact.apart,
            reach=self.contact.reach,
        )

    def is_met_by(self, o: SceneObject) -> bool:
        """Whether an object has no more parts, and these no more vertices, than it may."""
        most = max((len(part.vertices) for part in o.colliders), default=0)
        return len(o.colliders) <= self.max_parts and most <= self.max_vertices


@dataclass(frozen=True, kw_only=True)
class Coarsened(Outcome):
    stage: ClassVar[str] = "coarsen"
    parts: Mapping[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])
    """Number of convex parts, with footing, before and after, by object id."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return tuple(
            Measure(name="convex parts", before=was, after=now, about=id) for id, (was, now) in self.parts.items()
        )


def coarsen(
    scene: Scene,
    config: CoarsenConfig,
    *,
    made: Scene,
    joins: Mapping[int, Sequence[Join]],
    settled: Callable[[Scene], SettledScene],
    balanced: Rebalanced,
    restless: Collection[int] = (),
) -> tuple[Scene, Coarsened]:
    """Give objects at rest few convex parts, where contact does not feel it (docs: proxies).

    ``made`` is the scene as decomposed, ``joins`` (by object id) tell how its parts may be joined. ``settled`` runs
    physics, ``balanced`` moves some objects to their nearest equilibrium. A group of touching objects keeps its
    new parts if it rests as before, or does so in an equilibrium. Otherwise what moves gets finer parts, then all of
    the group, but for what others keep from joining within the limits: that keeps its parts. After ``TRIES`` a group
    within the limits keeps its parts. Of another, only what is over them gets fewer.
    If it moves then too, it takes the attempt in which it rests and loses least, unless that shows another scene: then
    it keeps its parts, a fallback. Objects that were ``restless`` may stay so.
    At last groups that rest on stiff contacts only take a place where they rest on soft ones too, a Decision. Where
    that is another scene, they stay, a fallback.
    """
    known = dict[int, KnownParts]()
    footing, clearance = config.footing, config.contact.clearance
    few = partial(with_few_parts, made=made, joins=joins, footing=footing, clearance=clearance, known=known)
    run = _Coarsening(scene, config, few, settled, balanced, frozenset(restless))
    while run.left - run.stuck and len(run.tries) < TRIES:
        run.attempt(run.left, run.left - run.stuck)
    if run.over:
        run.keep_limits()
    run.withstand_soft_contacts()
    return run.scene, Coarsened(
        parts={o.id: (len(scene[o.id].colliders), len(o.colliders)) for o in run.scene}, decisions=run.decisions
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class _Effect:
    """What new parts do to a group of touching objects."""

    losses: Mapping[int, float]
    """Of visible IoU, by object id."""
    restless: frozenset[int]
    """Objects that do not rest now, but did before."""
    comes_to_rest: bool
    """Whether some did not rest before, and all do now."""

    @property
    def loss(self) -> float:
        return float(np.mean([*self.losses.values()]))

    @property
    def is_bad(self) -> bool:
        return bool(self.restless) or self.loss > (LOSS_TO_REST if self.comes_to_rest else LOSS)

    @property
    def moving(self) -> frozenset[int]:
        return frozenset(id for id, loss in self.losses.items() if id in self.restless or loss > LOSS)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Try:
    """The scene after an attempt, and its effect on every group of ids."""

    fewer: frozenset[int]
    """Objects that got fewer parts."""
    scene: Scene
    effects: Mapping[frozenset[int], _Effect]

    @property
    def spoilt(self) -> tuple[frozenset[int], ...]:
        return tuple(ids for ids, effect in self.effects.items() if effect.is_bad)


class _Coarsening:
    """The scene so far. Objects ``left`` still have all their parts."""

    def __init__(
        self,
        scene: Scene,
        config: CoarsenConfig,
        few: Callable[..., Scene],
        settled: Callable[[Scene], SettledScene],
        balanced: Rebalanced,
        restless: frozenset[int],
    ) -> None:
        self.scene, self.tries = scene, list[_Try]()
        self.left = frozenset(o.id for o in scene if o.parts)
        self.stuck = frozenset[int]()
        """Objects that moved and have too many parts however they join, as what is near forbids it."""
        self._config, self._few, self._settled, self._balanced = config, few, settled, balanced
        self._restless = restless
        self._balanced_once = frozenset[int]()
        """Objects whose equilibrium was sought. Finer parts had no better one in nested bowls, for a minute each."""
        self._moved = Counter[int]()
        self._told = list[Decision]()

    @property
    def over(self) -> frozenset[int]:
        """Objects left that are over the limits."""
        return frozenset(id for id in self.left if not self._config.is_met_by(self.scene[id]))

    @property
    def decisions(self) -> tuple[Decision, ...]:
        kept = (
            Decision(
                choice=f"keeps all its {len(self.scene[id].colliders)} convex parts",
                reason="moves with fewer" + (", which the limits ask for" if id in self.over else ""),
                about=id,
                fallback=id in self.over,
            )
            for id in self.left
        )
        crowded = (
            Decision(
                choice=f"has {len(self.scene[id].colliders)} convex parts",
                reason="what is near it forbids to join more of them, which the limits ask for",
                about=id,
                fallback=True,
            )
            for id in self.stuck - self.left
        )
        return tuple(sorted((*self._told, *kept, *crowded), key=lambda d: d.about or 0))

    def attempt(self, among: frozenset[int], fewer: frozenset[int]) -> None:
        """Give some objects fewer parts and let those ``among`` which they are settle; groups that rest keep them.

        One that does not rest as before goes to its nearest equilibrium, unless it did so with other parts."""
        limits = {id: self._config.limits(self._moved[id]) for id in fewer}
        new = self._few(self.scene, limits=limits)
        rested = self._settled(replace(new, objects=tuple(o for o in new if o.id in among)))
        there = SettledScene(scene=new.with_objects(*rested.scene), restless=rested.restless)
        now = self._tried(there, among, fewer)
        if moving := (among & frozenset[int]().union(*now.spoilt)) - self._balanced_once:
            now = self._tried(self._or_balanced(there, new, moving, limits), among, fewer)
            self._balanced_once |= moving
        self.tries.append(now)
        for ids, effect in now.effects.items():
            if effect.is_bad:
                self._moved.update(effect.moving)
                self.stuck |= {id for id in ids & fewer if len(new[id].colliders) > self._config.max_parts}
            else:
                self._take(now, ids, among, reason="this group did not rest before")
        if len(self.tries) == TRIES - 1:
            self._moved.update(self.left)

    def keep_limits(self) -> None:
        """Give fewer parts only to what is over the limits, unless the last attempt did just that; where that moves,
        those with which its group lost least."""
        groups = [ids for ids in self.tries[-1].spoilt if ids & self.over]
        among = self.left.intersection(frozenset[int]().union(*groups))
        fewer = among & self.over - self.stuck
        if fewer and fewer != among & self.tries[-1].fewer:
            self.attempt(among, fewer)
        for ids in (ids for ids in self.tries[-1].spoilt if ids & among):
            able = [
                one
                for one in self.tries
                if ids in one.effects and not one.effects[ids].restless and one.effects[ids].loss <= LOSS_TO_LIMIT
            ]
            if able:
                best = min(able, key=lambda one: round(one.effects[ids].loss / LOSS))
                self._take(best, ids, among, reason="the limits ask this group for fewer parts or vertices")

    def withstand_soft_contacts(self) -> None:
        """Let groups in which an object falls on soft contacts rest where that ends, if it ends.

        Objects that creep or sink by millimetres may come to rest far from there. Then the photo speaks against it."""
        fallen = self._falling(self.scene)
        if not fallen:
            return
        rested = self._settled(self.scene.with_objects(*fallen.values()))
        scene, restless = rested.scene, rested.restless - self._restless
        if fallen.keys() - restless:
            restless |= self._falling(scene).keys()
        was, there = visible_ious(self.scene), visible_ious(self.scene.with_objects(*fallen.values()))
        for ids, effect in self._effects(scene, frozenset(fallen), restless).items():
            most = min(LOSS_TO_WITHSTAND, LOSS - mean_gain(ids, was, there))
            stays = bool(effect.restless) or effect.loss > most
            for id in sorted(ids & fallen.keys()):
                travel = f"{1000 * np.linalg.norm(self.scene[id].way_to(scene[id])):.0f} mm"
                self._told.append(_on_soft_contacts(id, travel, effect, stays=stays))
            if not stays:
                self.scene = self.scene.with_objects(*(_noted(self.scene[id], scene[id]) for id in ids))

    def _tried(self, after: SettledScene, among: frozenset[int], fewer: frozenset[int]) -> _Try:
        return _Try(fewer=fewer, scene=after.scene, effects=self._effects(after.scene, among, after.restless))

    def _or_balanced(
        self, settled: SettledScene, new: Scene, moving: frozenset[int], limits: Mapping[int, PartLimits]
    ) -> SettledScene:
        """The settled scene with those groups of objects ``moving`` at their equilibrium nearest to the ``new`` scene
        that are better there; all else stays settled. Footings are other ones there: they join parts within limits."""
        footed = {id: limits[id] for id in moving & limits.keys()}
        start = settled.scene.with_objects(*(new[id] for id in sorted(moving)))
        found = self._balanced(start, moving, finished=partial(self._refooted, limits=footed))
        found = replace(found, restless=found.restless | settled.restless - moving)
        return settled.or_better(found, self._config.contact.apart)

    def _refooted(self, scene: Scene, limits: Mapping[int, PartLimits]) -> Scene:
        """A scene in which objects with other footings have few parts again."""
        limits = {id: limit for id, limit in limits.items() if scene[id].footing}
        return self._few(scene, made=scene, joins={}, limits=limits) if limits else scene

    def _falling(self, scene: Scene) -> dict[int, SceneObject]:
        """Objects that fall or slide on soft contacts, where they end, by id."""
        ends = soft_release(scene.objects, SOFT_TRAVEL)
        moved = {id: _ended(scene[id], T) for id, T in ends.items() if id not in self._restless}
        return {id: o for id, o in moved.items() if np.linalg.norm(scene[id].way_to(o)) > SOFT_TRAVEL}

    def _effects(
        self, after: Scene, among: frozenset[int], restless: frozenset[int]
    ) -> Mapping[frozenset[int], _Effect]:
        """Those on every group with an object ``among`` some."""
        was, now = visible_ious(self.scene), visible_ious(after)
        return {
            ids: _Effect(
                losses={id: was[id] - now[id] for id in ids},
                restless=ids & restless - self._restless,
                comes_to_rest=bool(ids & self._restless) and not ids & restless,
            )
            for ids in map(frozenset, groups_of(self.scene, after, self._config.contact.apart))
            if ids & among
        }

    def _take(self, one: _Try, ids: frozenset[int], among: frozenset[int], *, reason: str) -> None:
        """Let objects of a group have the parts and places of an attempt; the user is told where that costs."""
        effect = one.effects[ids]
        if effect.loss > LOSS:
            self._told += (
                Decision(
                    choice=f"moves as its group has fewer convex parts: visible IoU {-effect.losses[id]:+.3f}",
                    reason=reason,
                    about=id,
                )
                for id in effect.moving & among
            )
        self.scene = self.scene.with_objects(*(_noted(self.scene[id], one.scene[id]) for id in ids & among))
        self.left -= ids


def _ended(o: SceneObject, T_world_object: Array) -> SceneObject:
    T = T_world_object @ invert_pose(o.T_world_object)
    return o.moved(T, stage=Coarsened.stage, reason="fell or slid on soft contacts")


def _on_soft_contacts(id: int, travel: str, effect: _Effect, *, stays: bool) -> Decision:
    """What became of an object that falls or slides by ``travel`` on soft contacts; ``effect`` is that on its group."""
    if effect.restless:
        reason = "slides on soft contacts, which others have, wherever it is"
    elif stays:
        there = f"there its group loses {effect.loss:.2f} of visible IoU"
        reason = f"falls or slides by {travel} on soft contacts, which others have; {there}"
    else:
        reason = "rested on stiff contacts only: it fell or slid on soft ones, which others have"
    choice = "stays" if stays else f"moved by {travel}"
    return Decision(choice=choice, reason=reason, about=id, fallback=stays and not effect.restless)


def _noted(before: SceneObject, after: SceneObject) -> SceneObject:
    """The object with what physics moved it noted as this stage's."""
    new = (replace(m, stage=Coarsened.stage) for m in after.motion[len(before.motion) :])
    return replace(after, motion=(*before.motion, *new))
