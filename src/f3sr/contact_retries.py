"""Objects of a scene at rest, brought to rest again from other poses: what ``refine`` and samples try.

Objects that do not come near each other do not act on each other. So some groups move, and all else is held.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from f3sr.core.transforms import Array
from f3sr.language.grammar.materials import material_of
from f3sr.metrics.contact_groups import SettledScene, groups_of, mean_gain
from f3sr.metrics.measures import full_silhouette
from f3sr.physics.contact_margin import ContactMargin
from f3sr.pipeline_config import Config
from f3sr.scene import Scene, SceneObject
from f3sr.stages.align import align
from f3sr.stages.balance import Footed, balance
from f3sr.stages.close import close, lowered
from f3sr.stages.refine import GAIN, UNSEEN, UPRIGHT, moved_off_masks, newly_fixed
from f3sr.stages.separate import on_footings_in_place, on_own_footings, separate
from f3sr.stages.settle import at_rest
from f3sr.uncertainty.pose_information import precisions
from f3sr.vision.silhouette import iou

WON_BACK = 0.02
"""Most score that closing its gaps may win back for a group: .013 after ``separate``, which leaves gaps."""
WON_BACK_BALANCED = 0.0
"""The same for a group in balance: in none of 30 such ends it won anything."""

FALL = 0.2
"""Shift of the middle of an object, as a share of its size, that is a fall, however much it still shows."""

ROUNDS, SECONDS = 3, 2.0
"""Most rounds of settling of a retry, and most damped simulation [s]. Of 147 that rested, 145 took no more, 133 of them
one round and .4 s: what rolls for longer ends where the photo does not show it."""


@dataclass(frozen=True, kw_only=True)
class ContactRetries:
    """Each method moves some objects of a scene at rest and returns the whole as it would be delivered: at rest and
    closed. A group that lost too much before gaps are closed is put back instead, unless the method says otherwise.

    ``before`` is the scene at rest that is to become better; ``ids`` name what is aligned first. Where a method has a
    ``start``, ``moving`` objects begin where they are in it, and all others stay as they are.
    """

    config: Config
    """With shared settings (``pipeline_config``)."""
    closes: bool = True
    """Whether gaps are closed."""

    def realigned(self, before: Scene, ids: Collection[int], *, balanced: frozenset[int]) -> SettledScene:
        """Align objects under contact; groups move that gain by it.

        They are separated, but for what is ``balanced``: with such objects all go to the nearest equilibrium, sought
        from where they rest. A group that loses there is put back before physics. Gaps are not closed there: it won
        nothing and took most of the time."""
        aligned, _ = align(before, self.config.align.under_contact(), only=ids)
        retry = Retry.of(before, aligned, ids, self._contact)
        if not retry.moving:
            return SettledScene(scene=before, restless=frozenset())
        if retry.moving & balanced:
            placed = self._placed(retry.scene, self._costs(retry.scene), start=before)
            there = SettledScene(scene=placed, restless=frozenset())
            retry = retry.without_losers(there, self._contact, won_back=WON_BACK_BALANCED)
            if not retry.moving:
                return SettledScene(scene=before, restless=frozenset())
            rested = self._on_best_footings(retry.scene)
            return self._ended(retry, rested, won_back=WON_BACK_BALANCED, closes=False)
        return self._ended(retry, self._separated(retry.scene))

    def stood_up(self, before: Scene, ids: Collection[int], *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """Turn objects onto a stable facet and align them so. None is put back."""
        aligned, _ = align(start, self.config.align.upright(within=UPRIGHT), only=ids)
        return self.settled(before, start=aligned, moving=moving)

    def replaced(self, before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """Separate objects and let them settle."""
        retry = Retry.of_moving(before, start, moving)
        return self._ended(retry, self._separated(retry.scene))

    def settled(self, before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """As ``replaced``, but none is put back."""
        retry = Retry.of_moving(before, start, moving)
        rested = self._separated(retry.scene)
        return self._delivered(replace(retry, scene=rested.scene), rested)

    def balanced(self, before: Scene, *, start: Scene, moving: frozenset[int]) -> SettledScene:
        """Move objects to their nearest equilibrium.

        Closing cuts colliders back where they meet. If it then moves a group off its masks, the equilibrium is sought
        once more, with colliders that are cut back as to lower the group from the first one."""
        retry = Retry.of_moving(before, start, moving)
        rested = self._best_balance(retry.scene)
        best = self._ended(retry, rested, won_back=WON_BACK_BALANCED)
        if off := moved_off_masks(best, rested, self._contact) & moving:
            down = lowered(rested.scene, self.config.close)
            cut = (replace(o, parts=down[o.id].parts) for o in retry.scene if o.id in off)
            retry = Retry.of_moving(best.scene, retry.scene.with_objects(*cut), off, restless=best.restless)
            again = self._ended(retry, self._best_balance(retry.scene), won_back=WON_BACK_BALANCED)
            best = best.or_better(again, self._contact.apart)
        return best

    def held(self, before: Scene, *, start: Scene, moving: frozenset[int], most: int) -> SettledScene:
        """Move objects to their nearest equilibrium, with some of them fixed where contact cannot carry them.

        Those are what no forces balance. Where that is no object, or others fall all the same, they are what fell
        although forces balance it. What stays once others are fixed is free again. Where there is none, or more than
        ``most``, all is as before. Where that leaves much off its masks, the search begins once more where nothing
        overlaps."""
        retry, seen = Retry.of_moving(before, start, moving), SettledScene(scene=start, restless=frozenset())
        best = SettledScene(scene=before, restless=frozenset())
        for apart in (False, True):
            found = self._held(retry, start, most, apart=apart)
            if found and _worth(found, before, moving) > _worth(best, before, moving):
                best = found
            if not moved_off_masks(best, seen, self._contact) & moving:
                break
        return best

    def _held(self, retry: Retry, start: Scene, most: int, *, apart: bool) -> SettledScene | None:
        """``held`` from one start; None where nothing is held."""
        scene, may_hold = retry.scene, [id for id in retry.moving if retry.before.may_be_unsupported(id)]
        seek = partial(
            balance,
            costs=self._costs(scene),
            contact=self._contact,
            footed=self._footed,
            guessed=_guessed(scene),
            apart=apart,
        )
        placed = seek(scene, may_hold=may_hold, most=most)
        if placed is scene:
            return None
        is_held = bool(newly_fixed(scene, placed, may_hold))
        if self._fallen_from(scene, placed, may_hold) if is_held else _fallen(start, retry.before, may_hold):
            found = self._with_fallen_held(scene, seek(scene) if is_held else placed, seek, may_hold, most)
            placed = placed if found is scene else found
        if not newly_fixed(scene, placed, may_hold):
            return None
        placed = self._with_fewest_held(scene, placed, seek, may_hold)
        return self._ended(retry, self._on_best_footings(placed), won_back=WON_BACK_BALANCED)

    def _with_fallen_held(
        self, scene: Scene, placed: Scene, seek: Callable[[Scene], Scene], may_hold: Collection[int], most: int
    ) -> Scene:
        """The scene in balance with objects fixed that come to rest far from where it has them, one by one the lowest
        of them; ``placed`` is its equilibrium without. The scene as it is where more than ``most`` would be fixed."""
        free = scene
        for left in range(most, -1, -1):
            fallen = self._fallen_from(scene, placed, may_hold)
            lowest = next((id for id in scene.supports_first if id in fallen), None)
            if lowest is None:
                return placed
            if left:
                scene = scene.with_objects(scene[lowest].on_something_unseen())
                placed = seek(scene)
        return free

    def _with_fewest_held(
        self, scene: Scene, placed: Scene, seek: Callable[[Scene], Scene], may_hold: Collection[int]
    ) -> Scene:
        """The scene in balance without those fixed that stay once the others are; ``placed`` is that with all."""
        held = newly_fixed(scene, placed, may_hold)
        for id in held:
            others = [k for k in held if k != id]
            if not others:
                break
            there = seek(scene.with_objects(*(scene[k].on_something_unseen() for k in others)))
            if not self._fallen_from(scene, there, may_hold):
                held, placed = others, there
        return placed

    def _fallen_from(self, scene: Scene, placed: Scene, ids: Collection[int]) -> frozenset[int]:
        """Those of some objects that rest far from where the scene has them, once physics starts where they are
        ``placed``: an equilibrium may itself be far from there."""
        return _fallen(scene, self._at_rest(placed).scene, ids)

    def rebalanced(self, before: Scene, moving: frozenset[int], *, finished: Callable[[Scene], Scene]) -> SettledScene:
        """Move objects with other parts to their nearest equilibrium; frictions stay. None is closed or put back.

        ``finished`` gives the scene its last parts, where objects have their footings and before physics. No other
        equilibrium is sought: in seven scenes further ones changed no outcome, and they took half of the time."""
        retry = Retry.of_moving(before, before, moving)
        rested = self._on_best_footings(self._placed(retry.scene, self._costs(retry.scene), rougher=False), finished)
        return retry.ended(rested, self._contact, settled=self._at_rest)

    @property
    def _contact(self) -> ContactMargin:
        return self.config.refine.contact

    @property
    def _footed(self) -> Footed:
        return partial(on_own_footings, config=self.config.separate)

    def _ended(
        self, retry: Retry, rested: SettledScene, *, won_back: float = WON_BACK, closes: bool = True
    ) -> SettledScene:
        return self._delivered(retry.without_losers(rested, self._contact, won_back=won_back), rested, closes=closes)

    def _delivered(self, retry: Retry, rested: SettledScene, *, closes: bool = True) -> SettledScene:
        """What came to rest, closed where it ``closes``, and with all that was held free again."""
        scene = retry.scene
        if closes and self.closes and retry.moving:
            scene, _ = close(scene, self.config.close, settled=self._at_rest, restless=rested.restless)
        return retry.ended(replace(rested, scene=scene), self._contact, settled=self._at_rest)

    def _at_rest(self, scene: Scene) -> SettledScene:
        return at_rest(scene, self.config.settle.within(ROUNDS, SECONDS))

    def _separated(self, scene: Scene) -> SettledScene:
        parted, _ = separate(scene, self.config.separate, ground=False, margin=False)
        return self._at_rest(parted)

    def _best_balance(self, scene: Scene) -> SettledScene:
        """Contact groups at rest near their equilibria, each at the best of up to three.

        Groups that lose much of what they showed seek another one: from where nothing overlaps, then from where the
        best so far rests."""
        seen, costs = SettledScene(scene=scene, restless=frozenset()), self._costs(scene)
        best = self._nearest_balance(scene, costs)
        for apart in (True, False):
            lost = moved_off_masks(best, seen, self._contact)
            if not lost & costs.keys():
                break
            retry = Retry.of_moving(best.scene, scene, lost, restless=best.restless)
            left = {id: cost for id, cost in costs.items() if id in lost}
            if apart:
                found = self._nearest_balance(retry.scene, left, apart=True)
            else:
                found = self._nearest_balance(retry.scene, left, start=best.scene, descends=True)
            best = best.or_better(retry.ended(found, self._contact, settled=self._at_rest), self._contact.apart)
        return best

    def _nearest_balance(
        self,
        scene: Scene,
        costs: Mapping[int, Array],
        *,
        apart: bool = False,
        start: Scene | None = None,
        descends: bool = False,
    ) -> SettledScene:
        """Contact groups at rest near an equilibrium, each on the better of two kinds of footings."""
        return self._on_best_footings(self._placed(scene, costs, apart=apart, start=start, descends=descends))

    def _placed(
        self,
        scene: Scene,
        costs: Mapping[int, Array],
        *,
        rougher: bool = True,
        apart: bool = False,
        start: Scene | None = None,
        descends: bool = False,
    ) -> Scene:
        """Contact groups in an equilibrium by statics alone. Guessed frictions may become ``rougher``."""
        return balance(
            scene,
            costs,
            self._contact,
            footed=self._footed,
            apart=apart,
            start=start,
            guessed=_guessed(scene) if rougher else [],
            descends=descends,
        )

    def _on_best_footings(
        self, placed: Scene, finished: Callable[[Scene], Scene] = lambda scene: scene
    ) -> SettledScene:
        """Contact groups in balance at rest, each on the better of two kinds of footings.

        The second kind is not asked where all groups rest on the first and show what they show in balance."""
        rested, shown = self._at_rest(finished(placed)), SettledScene(scene=placed, restless=frozenset()).scores
        groups = groups_of(placed, rested.scene, self._contact.apart)
        if not rested.restless and all(mean_gain(g, shown, rested.scores) > -GAIN for g in groups):
            return rested
        standing = finished(on_footings_in_place(placed, self.config.separate))
        return rested.or_better(self._at_rest(standing), self._contact.apart)

    def _costs(self, scene: Scene) -> Mapping[int, Array]:
        """What moves of each free object cost in ``balance``, by id."""
        return precisions(scene, [o.id for o in scene if o.mobility != "fixed"], self.config.refine.uncertainty)


@dataclass(frozen=True, eq=False, kw_only=True)
class Retry:
    """A scene at rest in which some groups are to move: the others are held where they rest.

    Objects that do not come near each other do not act on each other, so what stays is no matter of physics."""

    before: Scene
    scene: Scene
    """With new poses; what stays is fixed."""
    moving: frozenset[int]
    """Ids of all objects that may move."""
    restless: frozenset[int] = frozenset()
    """Ids of those that did not rest before, where that is known."""

    @classmethod
    def of(cls, before: Scene, aligned: Scene, ids: Collection[int], contact: ContactMargin) -> Retry:
        """Groups that gain by the alignment of the objects ``ids``, before physics takes its part; all else is held.

        What gains may need room that its neighbours leave by their alignment, so a group moves as a whole. Of a group
        that does not gain as a whole only what gains is aligned. A group that does not gain by that either is held:
        contact adds little, and in none of 25 such attempts a group gained in the end."""

        def scores(scene: Scene) -> Mapping[int, float]:
            return SettledScene(scene=scene, restless=frozenset()).scores

        def gaining(was: Mapping[int, float], after: Scene, now: Mapping[int, float]) -> frozenset[int]:
            groups = groups_of(before, after, contact.apart)
            return frozenset(id for g in groups if g.intersection(ids) and mean_gain(g, was, now) > GAIN for id in g)

        was, now = scores(before), scores(aligned)
        whole = gaining(was, aligned, now)
        start = before.with_objects(*(aligned[id] for id in ids if id in whole or now[id] > was[id] + GAIN))
        moving = gaining(was, start, scores(start))
        return cls.of_moving(before, before.with_objects(*(start[id] for id in ids if id in moving)), moving)

    @classmethod
    def of_moving(
        cls, before: Scene, aligned: Scene, moving: frozenset[int], *, restless: frozenset[int] = frozenset()
    ) -> Retry:
        """Some objects move, whatever they gain, as those that do not rest yet; all else is held."""
        held = (replace(o, mobility="fixed") for o in before if o.id not in moving)
        return cls(before=before, scene=aligned.with_objects(*held), moving=moving, restless=restless)

    def ended(
        self, rested: SettledScene, contact: ContactMargin, *, settled: Callable[[Scene], SettledScene]
    ) -> SettledScene:
        """The scene with the others free again, as restless as before. What came to touch them is ``settled`` with
        them, as they were held."""
        restless = rested.restless | self.restless - self.moving
        scene = rested.scene.with_objects(
            *(replace(o, mobility=self.before[o.id].mobility) for o in rested.scene if o.id not in self.moving)
        )
        groups = groups_of(scene, scene, contact.apart) if len(self.moving) < len(scene.objects) else []
        mixed = {id for g in groups if g & self.moving and g - self.moving for id in g}
        if not mixed:
            return SettledScene(scene=scene, restless=restless)
        both = settled(replace(scene, objects=tuple(o for o in scene if o.id in mixed)))
        return SettledScene(scene=scene.with_objects(*both.scene), restless=(restless - mixed) | both.restless)

    def without_losers(self, rested: SettledScene, contact: ContactMargin, *, won_back: float = WON_BACK) -> Retry:
        """The retry without groups that lost more score than ``close`` may win back: they are as before."""
        was, now = SettledScene(scene=self.before, restless=frozenset()).scores, rested.scores
        groups = groups_of(self.before, rested.scene, contact.apart)
        lost = {id for g in groups if g & self.moving and mean_gain(g & self.moving, was, now) < -won_back for id in g}
        back = (replace(self.before[id], mobility="fixed") for id in sorted(lost & self.moving))
        return replace(self, scene=rested.scene.with_objects(*back), moving=self.moving - lost)


def _fallen(before: Scene, after: Scene, ids: Collection[int]) -> frozenset[int]:
    """Those of some objects that are far from where they were; where none is, those with another outline in the photo:
    thin ones need not go far for that."""
    far = frozenset(id for id in ids if np.linalg.norm(before[id].way_to(after[id])) > FALL * before[id].size)
    outlines = ((id, *(full_silhouette(s[id], before.camera) for s in (before, after))) for id in ids)
    return far or frozenset(id for id, was, now in outlines if iou(was, now) < 1 - UNSEEN)


def _worth(state: SettledScene, before: Scene, moving: frozenset[int]) -> tuple[bool, float]:
    """What a scene with some objects held shows, less what each of them has to win; first whether it is at rest."""
    held = len(newly_fixed(before, state.scene, moving))
    return not state.restless & moving, sum(state.ious[id] for id in moving) - UNSEEN * held


def _guessed(scene: Scene) -> list[int]:
    """Ids of what may move and whose friction nothing but its label tells, or nothing at all."""
    return [o.id for o in scene if o.mobility != "fixed" and _is_guessed(o)]


def _is_guessed(o: SceneObject) -> bool:
    known = material_of(o.label)
    return o.material_source != "given" and o.friction == (known.friction if known else SceneObject.friction)
