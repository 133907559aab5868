"""Objects that come near each other, and settled scenes that are compared group by group."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from f3sr.contact.compounds import overlapping_pairs, placed
from f3sr.core.transforms import Array
from f3sr.metrics.measures import mean_over_masks, visible_ious
from f3sr.scene import Scene
from f3sr.vision.depth_prior import depth_errors

IOU_OF_SHIFT = 4.0
"""IoU that a shift across the viewing rays costs, per size of an object: 8 / pi per diameter of a disc, whose box has a
diagonal of 1.6 diameters. A sensor sees shifts along the rays; they count the same."""
IOU_OF_GAP = 2.0
"""Loss of visible IoU allowed per closed gap, in sizes of the object above it: half of what a shift by it may cost."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SettledScene:
    """A scene after settling, and which of its objects do not rest."""

    scene: Scene
    restless: frozenset[int]

    @cached_property
    def ious(self) -> Mapping[int, float]:
        """Of every object's visible pixels with its mask, by id."""
        return visible_ious(self.scene)

    @cached_property
    def overlapping(self) -> frozenset[int]:
        """Ids of the objects whose colliders overlap another's."""
        bodies = {o.id: placed(o.solids, o.T_world_asset) for o in self.scene}
        return frozenset(id for pair in overlapping_pairs(bodies) for id in pair)

    @cached_property
    def scores(self) -> Mapping[int, float]:
        """``ious``, less what an object's distance from its measured depth would cost across the viewing rays."""
        errors = depth_errors(self.scene)
        return {id: iou - IOU_OF_SHIFT * errors[id] / self.scene[id].size for id, iou in self.ious.items()}

    @property
    def seen(self) -> float:
        """mIoU_visible."""
        return mean_over_masks(self.ious, self.scene)

    @property
    def score(self) -> float:
        """The mean of ``scores`` over the masks, as ``seen``."""
        return mean_over_masks(self.scores, self.scene)

    def with_groups(self, other: SettledScene, groups: Collection[Collection[int]]) -> SettledScene:
        """This scene with some groups as in another one."""
        ids = frozenset(id for g in groups for id in g)
        scene = self.scene.with_objects(*(other.scene[id] for id in sorted(ids)))
        return SettledScene(scene=scene, restless=self.restless - ids | other.restless & ids)

    def or_better(self, other: SettledScene, apart: float) -> SettledScene:
        """This scene with those groups of another one that overlap less, or rest, where these do not, or agree better
        with the photo.

        Objects with ``apart`` [m] between them belong to different groups."""
        better = [g for g in groups_of(self.scene, other.scene, apart) if other._rank(g) > self._rank(g)]
        return self.with_groups(other, better)

    def _rank(self, group: set[int]) -> tuple[bool, bool, float]:
        return not group & self.overlapping, not group & self.restless, _mean(self.scores, group)


def mean_gain(ids: Collection[int], was: Mapping[int, float], now: Mapping[int, float]) -> float:
    """What the mean of some objects gains, of values by id."""
    return float(np.mean([now[id] - was[id] for id in ids]))


def _mean(values: Mapping[int, float], ids: Collection[int]) -> float:
    return float(np.mean([values[id] for id in ids]))


def groups_of(before: Scene, after: Scene, apart: float) -> list[set[int]]:
    """Groups of ids whose objects come within ``apart`` [m] of each other in either scene, or across the two scenes."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ids = [o.id for o in before]
    boxes = [[scene[id].boxes_world for id in ids] for scene in (before, after)]
    pairs = [
        (i, j)
        for i, j in combinations(range(len(ids)), 2)
        if any(_are_near(a[i], b[j], apart) for a in boxes for b in boxes)
    ]
    rows, columns = np.array(pairs, int).reshape(-1, 2).T
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(ids), len(ids)))
    count, group = connected_components(links, directed=False)
    return [{ids[i] for i in np.flatnonzero(group == k)} for k in range(count)]


def _are_near(a: Array, b: Array, apart: float) -> bool:
    """Whether any of boxes a (n, 2, 3) is within ``apart`` [m] of any of b (m, 2, 3) along every axis."""
    # (n, m, 3) gaps per axis: the low side of one less the high side of the other; negative where they overlap.
    between = np.maximum(a[:, None, 0] - b[None, :, 1], b[None, :, 0] - a[:, None, 1])
    return bool((between < apart).all(-1).any())
