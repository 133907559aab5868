"""Ways into contact: lifts and horizontal moves, and others where those lose much of the masks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

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
"""Mean score that a group loses by lifts and horizontal moves, from which on moves in space are tried too: visible IoU,
less errors of measured depth."""


def bring_into_contact(layout: Placement, config: SeparateConfig) -> list[Decision]:
    """Bring each body onto its support and end all overlap.

    Groups that lose much of their masks by lifts and horizontal moves also try other ways, the others held. Each group
    goes the way that keeps most of its masks, if that leaves no new overlap. All of them go along viewing rays, so
    there are none where objects only lift."""
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
    ends = list[tuple[str, Mapping[int, float], frozenset[int], Saved]]()
    for told, move in _other_ways(layout, tried, config).items():
        layout.restore(layout.saved_with(start, tried))
        with _held(layout, tried):
            move()
        ends.append((told, _scores(layout.moved_scene()), _overlapping(layout) - overlapping, layout.saved()))
    layout.restore(lifted)
    decisions = list[Decision]()
    for g in lost:
        told, scores, new, end = max(ends, key=lambda e: (not g & e[2], _mean(e[1], g)))
        if not g & new and _mean(scores, g) > _mean(first, g):
            layout.restore(layout.saved_with(end, g))
            decisions.append(_told(told, g, before, first, scores))
    return decisions


def _other_ways(layout: Placement, tried: Collection[int], config: SeparateConfig) -> dict[str, Callable[[], None]]:
    """Moves by what they are told as: in space, and as lifts, but by one standard deviation along viewing rays at most.

    Bowls in bowls would leave each other along a ray, as no silhouette changes: only what hides what."""
    error = max(layout.depth_sigma[id] for id in tried)
    near = replace(config, max_ray_scale=min(error, config.max_ray_scale))
    return {
        "parted in space": partial(_in_space, layout, config),
        "parted near where the photo shows them": partial(_by_lifts, layout, near),
    }


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
    choice: str,
    group: Collection[int],
    before: Mapping[int, float],
    lifts: Mapping[int, float],
    after: Mapping[int, float],
) -> Decision:
    return Decision(
        choice=f"{choice}: {', '.join(name_of(id) for id in sorted(group))}",
        reason=f"score of the group {_mean(before, group):.3f} -> {_mean(after, group):.3f}, and "
        f"{_mean(lifts, group):.3f} by lifts and horizontal moves",
    )
