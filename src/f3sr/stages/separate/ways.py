"""Two ways into contact: lifts and horizontal moves, and moves in space where those lose much of the masks."""

from __future__ import annotations

from collections.abc import Collection, Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from f3sr.metrics.contact_groups import SettledScene, groups_of
from f3sr.report import Decision
from f3sr.scene import Scene, name_of
from f3sr.stages.separate.config import SeparateConfig
from f3sr.stages.separate.overlaps import part, part_in_space
from f3sr.stages.separate.placement import Placement
from f3sr.stages.separate.support_contact import seat

PASSES = 3
"""Maximum number of passes. A pass brings objects onto supports, then ends overlap, which may lift them off again."""
LOST = 0.03
"""Mean score that a group loses by lifts and horizontal moves, from which on moves in space are tried too: visible IoU,
less errors of measured depth."""


def bring_into_contact(layout: Placement, config: SeparateConfig) -> list[Decision]:
    """Bring each body onto its support and end all overlap.

    Groups that lose much of their masks by lifts and horizontal moves also try moves in space, the others held. Each
    group goes the way that keeps more of its masks, if that leaves no new overlap. Moves in space go along viewing
    rays too, so there are none where objects only lift."""
    start, came = layout.saved(), layout.moved_scene()
    before = _scores(came)
    _by_lifts(layout, config)
    lifted, there = layout.saved(), layout.moved_scene()
    first = _scores(there)
    groups = [g for g in groups_of(came, there, config.contact.apart) if len(g) > 1]
    lost = [g for g in groups if _mean(before, g) - _mean(first, g) > LOST]
    if not lost or not config.max_ray_scale:
        return []
    overlapping = _overlapping(layout)
    tried = frozenset(id for g in lost for id in g)
    layout.restore(layout.saved_with(start, tried))
    with _held(layout, tried):
        _in_space(layout, config)
    second, new = _scores(layout.moved_scene()), _overlapping(layout) - overlapping
    better = [g for g in lost if _mean(second, g) > _mean(first, g) and not g & new]
    space = layout.saved()
    layout.restore(lifted)
    layout.restore(layout.saved_with(space, [id for g in better for id in g]))
    return [_told(g, before, first, second) for g in better]


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


def _scores(scene: Scene) -> Mapping[int, float]:
    """Visible IoU by id, less what errors of measured depths would cost across the viewing rays."""
    return SettledScene(scene=scene, restless=frozenset()).scores


def _overlapping(layout: Placement) -> frozenset[int]:
    """Ids of bodies that overlap another one or the ground."""
    return frozenset(id for pair in layout.collisions() for id in pair)


def _mean(seen: Mapping[int, float], group: Collection[int]) -> float:
    return float(np.mean([seen[id] for id in group]))


def _told(
    group: Collection[int], before: Mapping[int, float], lifts: Mapping[int, float], space: Mapping[int, float]
) -> Decision:
    return Decision(
        choice=f"parted in space: {', '.join(name_of(id) for id in sorted(group))}",
        reason=f"score of the group {_mean(before, group):.3f} -> {_mean(space, group):.3f}, and "
        f"{_mean(lifts, group):.3f} by lifts and horizontal moves",
    )
