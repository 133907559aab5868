"""Every stage: masks against renders before and after, what it measured, what it decided."""

from __future__ import annotations

from collections.abc import Sequence

from f3sr.io.images import resized
from f3sr.report import Decision, Measure, Report
from f3sr.report_page.formatting import about, counted, quantity, told
from f3sr.report_page.mask_comparison import legend
from f3sr.report_page.page_data import PageData, look_alike
from f3sr.scene import Scene
from f3sr.web.figures import figure, img
from f3sr.web.markup import Child, Markup, el, join

PURPOSE = {
    "assemble": "Brings photo, masks, geometry and meshes into one camera frame.",
    "level": "Finds the ground and turns the scene upright.",
    "align": "Moves the camera, then each object, so that silhouettes meet their masks.",
    "relate": "Finds who rests on whom, and how else objects relate.",
    "decompose": "Covers every mesh with convex collision parts.",
    "separate": "Brings objects to their supports along viewing rays and parts those that overlap.",
    "settle": "Lets physics bring everything to rest.",
    "refine": "Stands up what toppled and aligns what rests once more.",
    "close": "Cuts colliders back to the meshes where things touch, and lowers what floats.",
    "describe": "Tells the relations of the scene at rest, supports from contact forces.",
    "inpaint": "Completes the photo behind the objects and their shadows, for films only.",
}


def stages(m: PageData) -> Markup:
    parts: list[Markup] = []
    before: Scene | None = None
    for number, report in enumerate(m.result.reports, start=1):
        after = m.result.scenes.get(report.stage, m.result.scene)
        shown = _background(m) if report.stage == "inpaint" else _pictures(m, report.stage, before, after)
        parts.append(stage(number, report, shown, after))
        before = after
    return join(legend(), parts)


def stage(number: int, report: Report, pictures: Child, after: Scene) -> Markup:
    return el(
        "article",
        el("h3", f"{number} {report.stage}"),
        el("p", PURPOSE.get(report.stage), class_="fine"),
        pictures,
        _scene_measures([x for x in report.measures if x.about is None]),
        _object_measures([x for x in report.measures if x.about is not None], after),
        _decisions(report, after),
        class_="stage",
    )


def _background(m: PageData) -> Child:
    """What films are drawn over."""
    if m.result.inpainting is None:
        return None
    h, w = m.backdrop.rgb.shape[:2]
    picture = img(resized(m.result.inpainting.rgb, w, h), "The photo completed behind the objects")
    return el("div", figure(picture, "The photo completed behind the objects"), class_="row")


def _pictures(m: PageData, name: str, before: Scene | None, after: Scene) -> Child:
    """Both overlays, or a sentence where the stage leaves the picture as it was."""
    if before is None:
        return el("div", figure(m.overlay(after, f"After {name}"), "After: the input as it came"), class_="row")
    if look_alike(before, after):
        return el("p", "The picture stays as it was: no object moves before the camera.", class_="fine")
    shown = (("before", before), ("after", after))
    return el("div", (figure(m.overlay(s, f"{w} {name}"), w.capitalize()) for w, s in shown), class_="row")


def _scene_measures(measures: Sequence[Measure]) -> Child:
    if not measures:
        return None
    rows = (el("tr", el("th", x.name, scope="row"), el("td", _before_after(x), class_="num")) for x in measures)
    return el("table", el("tbody", rows), class_="plain")


def _object_measures(measures: Sequence[Measure], scene: Scene) -> Child:
    """One row per object, one column per measure."""
    if not measures:
        return None
    names = list(dict.fromkeys(x.name for x in measures))
    found = {(x.about, x.name): x for x in measures}
    head = el("tr", el("th", "Object", scope="col"), (el("th", n, class_="num", scope="col") for n in names))
    rows = (
        el(
            "tr",
            el("th", about(id, scene), scope="row"),
            (el("td", _before_after(x) if (x := found.get((id, n))) else quantity(None), class_="num") for n in names),
        )
        for id in dict.fromkeys(x.about for x in measures)
    )
    table = el("table", el("thead", head), el("tbody", rows), class_="plain")
    summary = el("summary", f"Per object: {', '.join(names)}")
    return el("details", summary, el("div", table, class_="scroll", tabindex="0"))


def _before_after(x: Measure) -> Markup:
    after = quantity(x.after, x.unit)
    return after if x.before is None else join(quantity(x.before, x.unit), " → ", after)


def _decisions(report: Report, scene: Scene) -> Child:
    """What concerns the whole scene, and fallbacks; the rest stands in its own section."""
    shown = [d for d in report.decisions if d.about is None or d.fallback]
    rest = len(report.decisions) - len(shown)
    link = el("a", f"{counted(rest, 'decision')} on single objects", href=f"#decisions-{report.stage}")
    if not shown and not rest:
        return None
    return el("ul", (el("li", line(d, scene)) for d in shown), el("li", link) if rest else None, class_="decisions")


def line(d: Decision, scene: Scene) -> Markup:
    mark = el("b", "Fallback ", class_="fallback") if d.fallback else None
    where = join(about(d.about, scene), ": ") if d.about is not None else None
    return join(mark, where, told(d.choice), " ", el("span", told(d.reason), class_="quiet"))
