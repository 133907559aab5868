"""Every stage: masks against renders before and after, what it measured, what it decided."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from f3sr.io.images import resized
from f3sr.report import Decision, Measure, Report
from f3sr.report_page.page_data import PageData, View, look_alike
from f3sr.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class StageSheet:
    """What the page shows of a stage."""

    report: Report
    pictures: Sequence[View]
    unchanged: bool
    """Whether the stage leaves the picture as it was."""
    columns: Sequence[str]
    """Names of measures of single objects."""
    per_object: Mapping[int, Sequence[Measure | None]]
    """By object its measures in the order of ``columns``."""
    decisions: Sequence[Decision]
    """On the whole scene, and fallbacks."""


def stages(page: PageData) -> list[StageSheet]:
    found: list[StageSheet] = []
    reports = page.result.reports
    first, start = next(iter(page.result.scenes.items()), ("", None))
    before = None if first in [r.stage for r in reports] else start  # an edited package is a scene already
    for report in reports:
        after = page.result.scenes.get(report.stage, page.result.scene)
        found.append(_sheet(report, page, before, after))
        before = after
    return found


def _sheet(report: Report, page: PageData, before: Scene | None, after: Scene) -> StageSheet:
    inpaint = report.stage == "inpaint"
    unchanged = not inpaint and before is not None and look_alike(before, after)
    single = {(x.about, x.name): x for x in report.measures if x.about is not None}
    columns = list(dict.fromkeys(name for _, name in single))
    return StageSheet(
        report=report,
        pictures=_background(page) if inpaint else [] if unchanged else _overlays(report.stage, page, before, after),
        unchanged=unchanged,
        columns=columns,
        per_object={id: [single.get((id, name)) for name in columns] for id, _ in single},
        decisions=[d for d in report.decisions if d.about is None or d.fallback],
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
