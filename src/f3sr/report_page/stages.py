"""Every stage: masks against renders before and after, what it measured, what it decided."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from f3sr.report import Decision, Measure, Report
from f3sr.report_page.page_data import PageData, View, look_alike
from f3sr.scene import Scene
from f3sr.vision.pictures import resized

PURPOSE = {
    "assemble": "Brings photo, masks, geometry and meshes into one camera frame.",
    "level": "Finds the ground and turns the scene upright.",
    "align": "Moves the camera, then each object, so that silhouettes match their masks.",
    "relate": "Finds supports and the other relations between objects.",
    "decompose": "Covers every mesh with convex collision parts.",
    "separate": "Moves objects along viewing rays onto their supports and separates those that overlap.",
    "settle": "Simulates the scene until every object is at rest.",
    "refine": "Stands toppled objects up and aligns the scene at rest once more.",
    "close": "Trims colliders to the meshes where objects touch, and lowers floating objects.",
    "describe": "Finds the relations of the scene at rest; supports come from contact forces.",
    "inpaint": "Completes the photo behind the objects and their shadows, for films only.",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class StageSheet:
    """What the page shows of a stage."""

    name: str
    purpose: str
    pictures: Sequence[View]
    unchanged: bool
    """Whether the stage leaves the picture as it was."""
    measures: Sequence[Measure]
    """Of the whole scene."""
    columns: Sequence[str]
    """Names of measures of single objects."""
    per_object: Sequence[tuple[int | None, Sequence[Measure | None]]]
    """Per object its measures in the order of ``columns``."""
    decisions: Sequence[Decision]
    """On the whole scene, and fallbacks."""
    more_decisions: int
    """Number of the others."""


def stages(page: PageData) -> list[StageSheet]:
    found: list[StageSheet] = []
    before: Scene | None = None
    for report in page.result.reports:
        after = page.result.scenes.get(report.stage, page.result.scene)
        found.append(_sheet(report, page, before, after))
        before = after
    return found


def _sheet(report: Report, page: PageData, before: Scene | None, after: Scene) -> StageSheet:
    inpaint = report.stage == "inpaint"
    unchanged = not inpaint and before is not None and look_alike(before, after)
    single = [x for x in report.measures if x.about is not None]
    by_name = {(x.about, x.name): x for x in single}
    columns = list(dict.fromkeys(x.name for x in single))
    decisions = [d for d in report.decisions if d.about is None or d.fallback]
    return StageSheet(
        name=report.stage,
        purpose=PURPOSE.get(report.stage, ""),
        pictures=_background(page) if inpaint else [] if unchanged else _overlays(report.stage, page, before, after),
        unchanged=unchanged,
        measures=[x for x in report.measures if x.about is None],
        columns=columns,
        per_object=[
            (id, [by_name.get((id, name)) for name in columns]) for id in dict.fromkeys(x.about for x in single)
        ],
        decisions=decisions,
        more_decisions=len(report.decisions) - len(decisions),
    )


def _background(page: PageData) -> list[View]:
    """The background of films."""
    if page.result.inpainting is None:
        return []
    height, width = page.backdrop.rgb.shape[:2]
    title = "The photo completed behind the objects"
    return [View(picture=resized(page.result.inpainting.rgb, width, height), alt=title, title=title)]


def _overlays(stage: str, page: PageData, before: Scene | None, after: Scene) -> list[View]:
    if before is None:
        return [View(picture=page.overlay(after), alt=f"After {stage}", title="After: the input as it came")]
    shown = (("Before", before), ("After", after))
    return [View(picture=page.overlay(scene), alt=f"{when.lower()} {stage}", title=when) for when, scene in shown]
