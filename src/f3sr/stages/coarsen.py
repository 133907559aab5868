"""coarsen: few convex parts for the scene at rest, as every part costs time in every later simulation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from f3sr.metrics.contact_groups import SettledScene, groups_of
from f3sr.metrics.measures import visible_ious
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.proxies import Join
from f3sr.proxies.few_parts import PartLimits, with_few_parts
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene, SceneObject
from f3sr.settings import settings

LOSS = 2e-3
"""Largest mean loss of visible IoU of a group by new parts: where something tips or slides, it is more."""
KEPT, KEPT_MOVED = 0.25, 0.75
"""Share of the vertices that is kept around contacts, of an object that rests so and of one that moved with fewer."""
TRIES = 3
"""Most attempts: with the parts wanted, with finer ones of what moves, at last with still finer ones of the group."""
ROUNDS = 2
"""Most rounds of settling: what takes more moves with its new parts."""
FINER = 0.1
"""What a part fewer is worth of an object that moved, as a share of before."""


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
    restless: Collection[int] = (),
) -> tuple[Scene, Coarsened]:
    """Give objects at rest few convex parts, where contact does not feel it (docs: proxies).

    ``made`` is the scene as decomposed, ``joins`` (by object id) tell how its parts may be joined. ``settled`` runs
    physics. A group of touching objects keeps its new parts if it rests as before. Where it does not, what moves gets
    finer parts, at last all of the group; after ``TRIES`` the group keeps its parts. Objects that were ``restless`` may
    stay so.
    """
    start, moved = scene, Counter[int]()
    left = frozenset(o.id for o in scene if o.parts)
    for attempt in range(TRIES):
        if not left:
            break
        tried = with_few_parts(scene, made, joins, {id: config.limits(moved[id]) for id in left})
        rested = settled(replace(tried, objects=tuple(o for o in tried if o.id in left)))
        after = tried.with_objects(*rested.scene)
        spoilt = _spoilt(scene, after, left, rested.restless.difference(restless), config.contact)
        scene = scene.with_objects(*(_noted(scene[id], after[id]) for id in left.difference(*spoilt)))
        moved.update(id for ids in spoilt.values() for id in ids)
        left = frozenset[int]().union(*spoilt)
        if attempt == TRIES - 2:
            moved.update(left)
    kept = (Decision(choice="keeps all its convex parts", reason="moves with fewer", about=id) for id in sorted(left))
    return scene, Coarsened(
        parts={o.id: (len(start[o.id].colliders), len(o.colliders)) for o in scene}, decisions=tuple(kept)
    )


def _noted(before: SceneObject, after: SceneObject) -> SceneObject:
    """The object with what physics moved it noted as this stage's."""
    new = (replace(m, stage=Coarsened.stage) for m in after.motion[len(before.motion) :])
    return replace(after, motion=(*before.motion, *new))


def _spoilt(
    before: Scene, after: Scene, ids: Collection[int], restless: frozenset[int], contact: ContactMargin
) -> dict[frozenset[int], frozenset[int]]:
    """Groups (of some ids) that do not rest as before, each with the objects that move."""
    was, now = visible_ious(before), visible_ious(after)
    found = dict[frozenset[int], frozenset[int]]()
    for group in map(frozenset, groups_of(before, after, contact.apart)):
        losses = {id: was[id] - now[id] for id in group}
        if group.intersection(ids) and (group & restless or np.mean([*losses.values()]) > LOSS):
            found[group] = frozenset(id for id in group if id in restless or losses[id] > LOSS)
    return found
