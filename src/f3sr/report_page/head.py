"""The top of the page: the verdict in one line, and what to be wary of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.metrics.measures import Details, Gap, ObjectMeasures, visible_ious
from f3sr.options import EDIT, SKIPPABLE
from f3sr.report_page.formatting import counted, length, name_of
from f3sr.report_page.page_data import PageData, look_alike
from f3sr.scene import SceneObject
from f3sr.stages.refine import TOPPLE
from f3sr.stages.settle import Settled

FAR_OFF = 0.5
"""Visible IoU under which an object is not where the photo shows it."""
PAID = 0.1
"""Loss of visible IoU after align from which on an object is named."""
REST_TRAVEL = 0.1
"""Largest travel of a centre of mass in 5 s of undamped physics [cm] that is called rest here."""
PARTS = ("align-camera", "align-objects")
"""Parts of the stage align: they have no report of their own."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Head:
    verdict: str
    gap: Gap | None
    """The worst one."""
    sunk: Gap | None
    """Of the deepest object below the ground."""
    clearance: float
    """How far apart objects in contact rest [m]."""
    fixed: Sequence[str]
    off_mask: Sequence[ObjectMeasures]
    """Objects that the photo shows elsewhere."""
    moved_off: Sequence[tuple[int, float, float]]
    """Objects that contact and physics moved off their masks: id, visible IoU after align and in the result."""
    tipped: Sequence[tuple[int, float]]
    """Objects that physics turned over after separate: id and angle from the vertical [degrees]."""
    skipped: Sequence[str]


def head(page: PageData) -> Head:
    gap = page.details and _worst(page.details)
    sunk = page.details and max(page.details.gaps, key=lambda g: g.below)
    return Head(
        verdict=f"{counted(len(page.scene.objects), 'object')}, {_rest(page)}; {_contact(page.details)}",
        gap=gap if gap and gap.distance > 0 else None,
        sunk=sunk if sunk and sunk.below > 0 else None,
        clearance=page.result.config.settle.physics.contact.clearance,
        fixed=[name_of(o.id, page.scene) for o in page.scene if o.mobility == "fixed"],
        off_mask=[o for o in page.details.objects if o.IoU_visible < FAR_OFF] if page.details else [],
        moved_off=_moved_off(page),
        tipped=_tipped(page),
        skipped=_skipped(page),
    )


def _rest(page: PageData) -> str:
    if page.result.evaluation:
        travel = page.result.evaluation.result.D_max_cm
        return "at rest" if travel <= REST_TRAVEL else f"not at rest (moves {length(travel / 100)} in 5 s)"
    rested = [x.at_rest for x in page.result.outcomes if isinstance(x, Settled)]
    if not rested:
        return "rest not measured"
    scenes = page.result.scenes
    refined = "refine" in scenes and not look_alike(scenes["settle"], scenes["refine"])  # kept only where it rests
    return "at rest after settling" if rested[-1] or refined else "not at rest after settling"


def _contact(details: Details | None) -> str:
    if details is None:
        return "penetrations and gaps not measured"
    pairs, gap = len(details.overlaps), _worst(details).distance
    overlap = "no penetrations" if not pairs else counted(pairs, "pair penetrates", "pairs penetrate")
    return f"{overlap}; {f'worst gap {length(gap)}' if gap > 0 else 'no gap'}"


def _worst(details: Details) -> Gap:
    return max(details.gaps, key=lambda g: g.distance / g.size)


def _moved_off(page: PageData) -> list[tuple[int, float, float]]:
    aligned = page.result.scenes.get("align")
    if aligned is None or not page.details:
        return []
    before, after = visible_ious(aligned), visible_ious(page.scene)
    return [(id, before[id], after[id]) for id in after if before[id] - after[id] > PAID]


def _tipped(page: PageData) -> list[tuple[int, float]]:
    placed = page.result.scenes.get("separate")
    if placed is None:
        return []
    leans = {o.id: _lean(placed[o.id], o) for o in page.scene}
    return [(id, math.degrees(lean)) for id, lean in leans.items() if lean > TOPPLE]


def _lean(a: SceneObject, b: SceneObject) -> float:
    """The angle [rad] between the vertical and where b's pose took it from a's: turns about the vertical are none."""
    R = b.T_world_object[:3, :3] @ a.T_world_object[:3, :3].T
    return float(np.arccos(np.clip(R[2, 2], -1, 1)))


def _skipped(page: PageData) -> list[str]:
    """Stages without a report; an edited package has that of its stages elsewhere."""
    if EDIT in page.result.scenes:
        return []
    done = {*(x.stage for x in page.result.outcomes), *(["evaluate"] if page.result.evaluation else []), *PARTS}
    return [name for name in SKIPPABLE if name not in done]
