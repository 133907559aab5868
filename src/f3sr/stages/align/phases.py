"""From a start to the pose beside it that the photo shows: equation 9 over equation 8's freedom, then the extensions.

Every phase ends with a guard and leaves the object as it was where it did not gain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from f3sr.core.transforms import UP, Array, rotation_about
from f3sr.mesh_poses.orientations import facet_turn
from f3sr.report import Decision, keep_better
from f3sr.stages.align.comparison import Comparison, Placed, about_middle, moved
from f3sr.vision.decimated import outlined
from f3sr.vision.depth_prior import GEOMETRY_PIXELS, GEOMETRY_REACH, GEOMETRY_SPREAD
from f3sr.vision.photometric import principal_axes
from f3sr.vision.silhouette_fit import EQUATION_8

NEAR_VERTICAL = 0.9
"""Cosine to the vertical from which on an axis is taken for it."""
SHIFTS_AND_SCALE = [0, 1, 5]
"""Parameters of an object's freedom that may go on beyond their bounds."""
BLIND_TURN = np.radians(16)
"""The turn that a silhouette is tried at: a smaller one is hidden by what is wrong of a shape [rad]."""

Phase = Callable[[Placed, Comparison], tuple[Placed, list[Decision]]]


def fitted(placed: Placed, photo: Comparison) -> tuple[Placed, list[Decision]]:
    """Equations 8 and 9: the best of several seeds; of all shifts where that misses its mask; again from there where
    shift or scale end at their bounds."""
    config = photo.config
    found = _best_of_seeds(placed, photo)
    if config.anywhere:
        if found.iou < config.orientations.enough:
            found = _clearly_better(found, _by_overlap(placed, found, photo), photo)
        found = _clearly_better(found, _beyond_bounds(found, photo), photo)
    kept, decision = keep_better(
        placed, found, score=_iou, step="object", measure="valid mask IoU",
        about=placed.base.id,
    )  # fmt: skip
    return kept, [decision]


def polished(placed: Placed, photo: Comparison) -> tuple[Placed, list[Decision]]:
    """All degrees of freedom together, silhouette and appearance, also from the turn that the photo's detail tells."""
    config, settings = photo.config, photo.config.appearance
    was = photo.scores(placed)
    best, now = placed, was
    for start in (placed, *turned_by_detail(placed, was.correlation, settings.near, settings.gain, photo)):
        found = photo.refined(start, iterations=config.search.iterations, free=photo.free)
        scores = photo.scores(found)
        if scores.total > now.total and scores.iou >= was.iou - settings.loss and scores.agrees(was):
            best, now = found, scores
    decision = Decision(
        choice=f"tilt and detail: {'rolled back' if best is placed else 'accepted'}", reason=was.told(now),
        about=placed.base.id,
    )  # fmt: skip
    return best, [decision]


def standing(placed: Placed, photo: Comparison) -> tuple[Placed, list[Decision]]:
    """On the nearest stable facet, where that is near and the picture does not mind."""
    config = photo.config
    turn = facet_turn(photo.textured(placed.object), config.facets.most)
    if turn is None:
        return placed, []
    start = photo.after(placed, about_middle(placed.object, turn))
    found = photo.refined(start, iterations=config.search.iterations // 2, free=EQUATION_8)
    was, now = photo.scores(placed), photo.scores(found)
    is_kept = now.total >= was.total - config.facets.loss
    decision = Decision(
        choice=f"onto a stable facet: {'accepted' if is_kept else 'rolled back'}", reason=was.told(now),
        about=placed.base.id,
    )  # fmt: skip
    return (found if is_kept else placed), [decision]


def at_its_depth(placed: Placed, photo: Comparison) -> tuple[Placed, list[Decision]]:
    """Along its viewing rays to where the geometry sees it; no silhouette changes."""
    assert photo.depth is not None
    was = photo.depth.residual(placed.object)
    if was.pixels < GEOMETRY_PIXELS or was.spread > GEOMETRY_SPREAD:
        reason = f"{was.pixels} pixels in common, depths spread by {100 * was.spread:.1f} % of the distance"
        return placed, [Decision(choice="the geometry does not tell its distance", reason=reason, about=placed.base.id)]
    k = float(np.clip(np.exp(-was.median), 1 - GEOMETRY_REACH, 1 + GEOMETRY_REACH))
    there = photo.after(placed, photo.view.scene.camera.homothety(k), scale=k)
    now = photo.depth.residual(there.object)
    kept, decision = keep_better(
        (placed, was), (there, now), score=lambda c: -c[1].size, step="to the geometry's distance",
        measure="", about=placed.base.id,
    )  # fmt: skip
    bound = ", the bound" if abs(k - 1) >= GEOMETRY_REACH - 1e-9 else ""
    told = f"distance times {k:.3f}{bound}; depths {100 * was.size:.2f} -> {100 * now.size:.2f} % off"
    return kept[0], [replace(decision, reason=told)]


def turned_by_detail(
    placed: Placed, correlation: float, turns: Sequence[float], gain: float, photo: Comparison
) -> list[Placed]:
    """The object turned [rad] about the vertical, or an axis its silhouette is blind to, to where the photo's detail
    fits better by a ``gain``; none where no turn does."""
    if photo.appearance is None or correlation >= photo.config.appearance.known:
        return []
    o = placed.object
    for axis in (UP, *_blind_axes(placed, photo)):
        tried = [about_middle(o, rotation_about(axis, turn)) for turn in turns]
        scores = [photo.appearance.correlation(photo.textured(moved(o, T))) for T in tried]
        best = int(np.argmax(scores))
        if scores[best] >= correlation + gain:
            return [photo.after(placed, tried[best])]
    return []


def _blind_axes(placed: Placed, photo: Comparison) -> Iterator[Array]:
    """Own axes (3,), not near the vertical, about which the silhouette does not see a turn to either side."""
    o, least = placed.object, placed.iou - photo.config.appearance.blind
    for axis in principal_axes(photo.textured(o)):
        if abs(axis @ UP) < NEAR_VERTICAL:
            turns = (about_middle(o, rotation_about(axis, sign * BLIND_TURN)) for sign in (-1, 1))
            if all(photo.after(placed, T).iou >= least for T in turns):
                yield axis


def _best_of_seeds(placed: Placed, photo: Comparison) -> Placed:
    search = photo.config.search
    starts = [np.zeros(6), *map(placed.fit.seed, search.yaw_seeds)]
    return placed.moved(placed.fit.best(starts, kept=search.kept_seeds, iterations=search.iterations).x)


def _by_overlap(placed: Placed, found: Placed, photo: Comparison) -> Placed:
    """The best of seeds at whichever shift covers the mask best, in each yaw and scale; what was ``found`` where no
    coarse silhouette is better than its."""
    search, coarse = photo.config.search, photo.config.orientations
    light = photo.fit(outlined(placed.base, coarse.max_faces), resolution=coarse.resolution)
    light = replace(light, freedom=placed.fit.freedom)
    starts = light.seeds_by_overlap(search.yaw_seeds, search.overlap_scales)
    best = light.best(starts, kept=search.kept_seeds, iterations=search.iterations).x
    if light.value(best) >= light.value(found.u):
        return found
    return placed.moved(placed.fit.refined(best, iterations=search.iterations).x)


def _clearly_better(found: Placed, other: Placed, photo: Comparison) -> Placed:
    """The other one where it misses its mask by clearly less."""
    return other if 1 - other.iou <= photo.config.orientations.share * (1 - found.iou) else found


def _beyond_bounds(placed: Placed, photo: Comparison) -> Placed:
    """Searches from where the last one ended, while shift or scale are at their bounds there."""
    for _ in range(photo.config.search.further):
        if np.abs(placed.u[SHIFTS_AND_SCALE]).max() < 1:
            break
        placed = _best_of_seeds(photo.started(placed.object), photo)
    return placed


def _iou(placed: Placed) -> float:
    return placed.iou
