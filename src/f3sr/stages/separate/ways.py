"""Ways into contact: lifts and horizontal moves, and others where those lose much of the masks."""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from f3sr.metrics.contact_groups import SettledScene, groups_of
from f3sr.report import Decision
from f3sr.scene import Scene, name_of
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.overlaps import part, part_in_space
from f3sr.stages.separate.placement import Placement, Saved
from f3sr.stages.separate.support_contact import seat

PASSES = 3
"""Maximum number of passes. A pass brings objects onto supports, then ends overlap, which may lift them off again."""
LOST = 0.03
"""Mean score, or visible IoU, that a group loses by lifts and horizontal moves, from which on other ways are tried."""
LEAST_GAIN = 0.005
"""Score from which on another way is better: the same way ends that far apart by the steps of its searches."""


def bring_into_contact(layout: Placement, config: SeparateConfig) -> list[Decision]:
    """Bring each body onto its support and end all overlap.

    Groups that lose much of their score by lifts and horizontal moves also try moves in space. Those that lose much of
    their IoU also try lifts with short moves along viewing rays: long ones change no silhouette, but what hides what.
    Where they came, overlap may hide the wrong ones, so there IoU counts where nothing hides them. Others are held
    meanwhile. Each group goes the way that keeps most of its score, if that leaves no new
    overlap. All of them go along viewing rays, so there are none where objects only lift."""
    start = _End.of(layout)
    _by_lifts(layout, config)
    if not config.max_ray_scale:
        return []
    lifted = _End.of(layout)
    shown = {id: max(iou, layout.came_with(id)) for id, iou in start.ious.items()}
    groups = [g for g in groups_of(start.scene, lifted.scene, config.contact.apart) if len(g) > 1]
    far = [g for g in groups if start.score(g) - lifted.score(g) > LOST]
    hidden = [g for g in groups if _mean(shown, g) - lifted.iou(g) > LOST]
    near = replace(config, max_ray_scale=min(config.max_ray_scale, max(layout.depth_sigma.values())))
    ways = list[_Way]()
    for told, tried, move in (
        ("in space", far, partial(_in_space, layout, config)),
        ("near their places", hidden, partial(_by_lifts, layout, near)),
    ):
        if tried:
            moving = frozenset(id for g in tried for id in g)
            layout.restore(lifted.saved)
            layout.restore(layout.saved_with(start.saved, moving))
            with _held(layout, moving):
                move()
            ways.append(_Way(told=told, groups=tried, end=_End.of(layout)))
    layout.restore(lifted.saved)
    decisions = list[Decision]()
    for g in groups:
        better = [w for w in ways if g in w.groups and not g & (w.end.overlapping - lifted.overlapping)]
        best = max(better, key=lambda w: w.end.score(g), default=None)
        if best and best.end.score(g) > lifted.score(g) + LEAST_GAIN:
            layout.restore(layout.saved_with(best.end.saved, g))
            decisions.append(_told(best, g, start, lifted))
    return decisions


@dataclass(frozen=True, eq=False, kw_only=True)
class _End:
    """A layout and how it is seen; ``overlapping`` are ids of bodies that overlap another one or the ground."""

    saved: Saved
    scene: Scene
    overlapping: frozenset[int]

    @classmethod
    def of(cls, layout: Placement) -> _End:
        overlapping = frozenset(id for pair in layout.collisions() for id in pair)
        return cls(saved=layout.saved(), scene=layout.moved_scene(), overlapping=overlapping)

    @property
    def ious(self) -> Mapping[int, float]:
        """Visible IoU by object id."""
        return self._seen.ious

    @cached_property
    def _seen(self) -> SettledScene:
        return SettledScene(scene=self.scene, restless=frozenset())

    def score(self, group: Collection[int]) -> float:
        """Mean visible IoU of a group, less what errors of measured depths would cost across the viewing rays."""
        return _mean(self._seen.scores, group)

    def iou(self, group: Collection[int]) -> float:
        """Mean visible IoU of a group."""
        return _mean(self._seen.ious, group)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Way:
    """Where another way leads, and the groups that tried it."""

    told: str
    groups: list[set[int]]
    end: _End


def _by_lifts(layout: Placement, config: SeparateConfig) -> None:
    """Onto supports along the viewing rays and vertically, out of overlap horizontally."""
    for _ in range(PASSES):
        seat(layout, config)
        if not part(layout, config):
            break
    else:
        seat(layout, config)


def _in_space(layout: Placement, config: SeparateConfig) -> None:
    """Down onto whatever is below, and out of all overlap by moves in space."""
    for _ in range(PASSES):
        seat(layout, config, lifts=False)
        if not part_in_space(layout, config):
            break


@contextmanager
def _held(layout: Placement, moving: Collection[int]) -> Generator[None]:
    """Only some bodies may move meanwhile."""
    whole = layout.scene
    layout.scene = whole.with_objects(*(replace(o, mobility="fixed") for o in whole if o.id not in moving))
    try:
        yield
    finally:
        layout.scene = whole


def _mean(seen: Mapping[int, float], group: Collection[int]) -> float:
    return float(np.mean([seen[id] for id in group]))


def _told(way: _Way, group: Collection[int], start: _End, lifted: _End) -> Decision:
    return Decision(
        choice=f"parted {way.told}: {', '.join(name_of(id) for id in sorted(group))}",
        reason=f"score of the group {start.score(group):.3f} -> {way.end.score(group):.3f}, and "
        f"{lifted.score(group):.3f} by lifts and horizontal moves",
    )
