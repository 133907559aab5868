"""The top of the page: the photo, the verdict in one line, and what to be wary of."""

from __future__ import annotations

import numpy as np

from f3sr.metrics.measures import visible_ious
from f3sr.options import SKIPPABLE
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS
from f3sr.report_page.formatting import about, counted, length, listed, name_of, ratio, share, told
from f3sr.report_page.page_data import PageData, look_alike
from f3sr.scene import SceneObject
from f3sr.stages.refine import TOPPLE
from f3sr.stages.settle import Settled
from f3sr.web.figures import figure, img
from f3sr.web.markup import Child, Markup, el, join

TIPPED = TOPPLE
FAR_OFF = 0.5
"""Visible IoU under which an object is not where the photo shows it."""
PAID = 0.1
"""Visible IoU that an object may lose after align before that is said."""
REST_TRAVEL = 0.1
"""Largest travel of a centre of mass in 5 s of undamped physics [cm] that is called rest here."""


def head(m: PageData, links: Markup) -> Markup:
    photo = img(m.backdrop.rgb, "The photo")
    size = f"{m.scene.photo.width} × {m.scene.photo.height} px"
    return el(
        "header",
        el(
            "div",
            el("p", "f3sr reconstruction report", class_="kicker"),
            el("h1", verdict(m)),
            _summary(m),
            warnings(m),
            links,
        ),
        figure(photo, join("Photo, ", size)),
    )


def verdict(m: PageData) -> str:
    """One line for somebody who wants to use the scene."""
    return f"{counted(len(m.scene.objects), 'object')}, {_rest(m)}; {_contact(m)}"


def _rest(m: PageData) -> str:
    if m.result.evaluation:
        travel = m.result.evaluation.result.D_max_cm
        return "at rest" if travel <= REST_TRAVEL else f"not at rest (moves {length(travel / 100)} in 5 s)"
    rested = [x.at_rest for x in m.result.outcomes if isinstance(x, Settled)]
    if not rested:
        return "rest not measured"
    scenes = m.result.scenes
    refined = "refine" in scenes and not look_alike(scenes["settle"], scenes["refine"])  # kept only where it rests
    return "at rest after settling" if rested[-1] or refined else "not at rest after settling"


def _contact(m: PageData) -> str:
    if m.details is None:
        return "penetrations and gaps not measured"
    pairs = len(m.details.overlaps)
    worst = max(m.details.gaps, key=lambda g: g.distance / g.size)
    overlap = "no penetrations" if not pairs else counted(pairs, "pair penetrates", "pairs penetrate")
    gap = f"worst gap {length(worst.distance)}" if worst.distance > 0 else "no gap"
    return f"{overlap}; {gap}"


def _summary(m: PageData) -> Child:
    """What the verdict leaves out, in small print."""
    parts: list[Child] = []
    if m.details:
        worst = max(m.details.gaps, key=lambda g: g.distance / g.size)
        if worst.distance > 0:
            of = f"The worst gap is {share(worst.distance / worst.size)} of the size of "
            parts += [of, el("bdi", name_of(worst.id, m.scene)), ", to ", el("bdi", name_of(worst.nearest, m.scene))]
            parts += [f". Contacts rest {length(2 * DEFAULT_PHYSICS.margin)} apart, the physics engine's margin. "]
        sunk = max(m.details.gaps, key=lambda g: g.below)
        if sunk.below > 0:
            parts += [el("bdi", name_of(sunk.id, m.scene)), f" reaches {length(sunk.below)} under the ground. "]
    fixed = [name_of(o.id, m.scene) for o in m.scene if o.mobility == "fixed"]
    if fixed:
        parts += ["Fixed: ", el("bdi", listed(fixed)), ". "]
    return el("p", parts, class_="summary") if parts else None


def warnings(m: PageData) -> Markup:
    """Fallbacks first, then what was left out."""
    notes: list[Child] = [
        el(
            "li",
            el("b", "Fallback"),
            f" in {report.stage}, ",
            about(d.about, m.scene),
            ": ",
            told(d.choice),
            "; ",
            told(d.reason),
        )
        for report in m.result.reports
        for d in report.fallbacks
    ]
    notes += [el("li", el("b", "Excluded"), " mask ", el("bdi", e.mask), ": ", e.reason) for e in m.scene.excluded]
    notes += _off_their_masks(m)
    notes += _paid(m)
    notes += _tipped(m)
    if skipped := skipped_stages(m):
        notes.append(el("li", el("b", "Skipped"), f": {listed(skipped)}"))
    if not notes:
        return el(
            "p",
            "No fallback, no skipped stage, no excluded mask, no object off its mask, moved away from it or tipped.",
            class_="fine",
        )
    return el("ul", notes, class_="warnings")


def _off_their_masks(m: PageData) -> list[Child]:
    """Objects that the photo shows elsewhere."""
    off = [o for o in m.details.objects if o.IoU_visible < FAR_OFF] if m.details else []
    return [
        el(
            "li",
            el("b", "Off its mask"),
            ": ",
            el("bdi", name_of(o.id, m.scene)),
            ", visible IoU ",
            ratio(o.IoU_visible),
        )
        for o in off
    ]


def _paid(m: PageData) -> list[Child]:
    """Objects that contact and physics moved away from where they fitted their masks."""
    aligned = m.result.scenes.get("align")
    if aligned is None or not m.details:
        return []
    before, after = visible_ious(aligned), visible_ious(m.scene)
    return [
        el(
            "li",
            el("b", "Moved off its mask by contact"),
            ": ",
            el("bdi", name_of(id, m.scene)),
            ", visible IoU ",
            ratio(before[id]),
            " after align, ",
            ratio(after[id]),
            " in the result",
        )
        for id in after
        if before[id] - after[id] > PAID
    ]


def _tipped(m: PageData) -> list[Child]:
    """Objects that physics turned over after they were put in place."""
    placed = m.result.scenes.get("separate")
    if placed is None:
        return []
    leans = ((o, _lean(placed[o.id], o)) for o in m.scene)
    return [
        el(
            "li",
            el("b", "Tipped or rolled"),
            ": ",
            el("bdi", name_of(o.id, m.scene)),
            f", by {np.degrees(lean):.0f}° since separate",
        )
        for o, lean in leans
        if lean > TIPPED
    ]


def _lean(a: SceneObject, b: SceneObject) -> float:
    """The angle [rad] between the vertical and where b's pose took it from a's: turns about the vertical are none."""
    R = b.T_world_object[:3, :3] @ a.T_world_object[:3, :3].T
    return float(np.arccos(np.clip(R[2, 2], -1, 1)))


def skipped_stages(m: PageData) -> list[str]:
    """Stages without a report; parts of stages are not told from their settings."""
    done = {*(report.stage for report in m.result.reports), *(["evaluate"] if m.result.evaluation else [])}
    return [name for name in SKIPPABLE if name not in done and "-" not in name]
