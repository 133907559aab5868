"""coarsen: few convex parts for the scene at rest, as every part costs time in every later simulation."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from f3sr.contact.few_parts import Limits, with_few_parts
from f3sr.metrics.contact_groups import SettledScene, groups_of
from f3sr.physics.contact_margin import DEFAULT_MARGIN, ContactMargin
from f3sr.proxies import Join
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import Scene
from f3sr.settings import settings

LOSS = 2e-3
"""Largest loss of mean visible IoU of a group by new parts: what still tips or slides loses more."""


@settings
class CoarsenConfig:
    """How few parts are delivered. Parts keep their shape at contacts."""

    worth: Annotated[float, Interval(ge=0, le=1)] = 0.025
    """Loss that a part fewer is worth: a stand-off by 2 % of the size over 2 % of the surface, or by 4 % over .5 %. On
    the floor of a cavity less. 0 keeps all parts."""
    max_parts: Annotated[int, Interval(ge=1, le=256)] = 32
    """Convex parts of one object, with footing, above which they are joined at any loss."""
    max_vertices: Annotated[int, Interval(ge=16, le=1000)] = 64
    """Most vertices of a part. PhysX takes 64, some engines on a GPU 32."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Parts come no nearer to another body than they were, within its ``apart``."""


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
    limits = Limits(
        worth=config.worth,
        parts=config.max_parts,
        vertices=config.max_vertices,
        apart=config.contact.apart,
        reach=config.contact.reach,
    )
    tried = with_few_parts(scene, made, joins, limits)
    rested = settled(tried)
    was, now = SettledScene(scene=scene, restless=frozenset()).ious, rested.ious
    result, decisions = scene, list[Decision]()
    for group in groups_of(scene, rested.scene, config.contact.apart):
        loss = float(np.mean([was[id] - now[id] for id in group]))
        spoilt = group & rested.restless - frozenset(restless)
        if loss <= LOSS and not spoilt:
            result = result.with_objects(*(rested.scene[id] for id in sorted(group)))
        else:
            names = ", ".join(map(str, sorted(group)))
            reason = f"visible IoU of the group {-loss:+.4f}" + (", and it does not rest" if spoilt else "")
            decisions.append(Decision(choice=f"all parts kept of object {names}", reason=reason))
    return result, Coarsened(
        parts={o.id: (len(o.colliders), len(result[o.id].colliders)) for o in scene}, decisions=tuple(decisions)
    )
