"""Every decision of every stage, fallbacks marked."""

from __future__ import annotations

from f3sr.report import Decision, Report
from f3sr.report_page.formatting import about, counted, told
from f3sr.report_page.page_data import PageData
from f3sr.scene import Scene
from f3sr.web.markup import Markup, el, join


def decisions(m: PageData) -> Markup:
    taken = [r for r in m.result.reports if r.decisions]
    if not taken:
        return el("p", "No stage had anything to decide.", class_="fine")
    return join(_stage(r, m.scene) for r in taken)


def _stage(report: Report, scene: Scene) -> Markup:
    count = counted(len(report.decisions), "decision")
    fallbacks = f", {counted(len(report.fallbacks), 'fallback')}" if report.fallbacks else ""
    head = el("tr", (el("th", t, scope="col") for t in ("About", "Choice", "Reason")))
    return join(
        el("h3", report.stage, " ", el("small", count + fallbacks), id=f"decisions-{report.stage}"),
        el("table", el("thead", head), el("tbody", (_row(d, scene) for d in report.decisions)), class_="cards tight"),
    )


def _row(d: Decision, scene: Scene) -> Markup:
    mark = el("b", "Fallback ", class_="fallback") if d.fallback else None
    return el(
        "tr",
        el("th", about(d.about, scene), scope="row"),
        el("td", mark, told(d.choice)),
        el("td", told(d.reason)),
        class_="fell" if d.fallback else None,
    )
