"""report.html: one page, without a network, that shows what a reconstruction did and how good it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from f3sr.errors import OutputError
from f3sr.pipeline import Reconstruction
from f3sr.report_page.compare import compare
from f3sr.report_page.decisions import decisions
from f3sr.report_page.graph_drawing import graph
from f3sr.report_page.head import head, verdict
from f3sr.report_page.mask_comparison import masks
from f3sr.report_page.object_table import objects
from f3sr.report_page.page_data import PageData, Sizes
from f3sr.report_page.scores import scores
from f3sr.report_page.stages import stages
from f3sr.report_page.viewer import viewer
from f3sr.web.document import WEB, document, part
from f3sr.web.markup import Child, el

__all__ = ["LARGEST_PAGE", "report_page"]

HERE = Path(__file__).parent
LARGEST_PAGE = 15 * 10**6
"""Bytes."""
SIZES = (
    Sizes(picture=960, panels=6_000_000, faces=240_000, texture=512),
    Sizes(picture=800, panels=4_000_000, faces=100_000, texture=256),
    Sizes(picture=640, panels=2_000_000, faces=40_000, texture=128),
    Sizes(picture=400, panels=1_000_000, faces=8_000, texture=32),
)
"""Tried in order until the page is small enough."""
SECTIONS: tuple[tuple[str, str, Callable[[PageData], Child]], ...] = (
    ("measures", "Measures", scores),
    ("compare", "Before and after", compare),
    ("masks", "Masks", masks),
    ("view", "3-D view", viewer),
    ("objects", "Objects", objects),
    ("supports", "Scene graph", graph),
    ("stages", "Stages", stages),
    ("decisions", "Decisions", decisions),
)


def report_page(result: Reconstruction) -> bytes:
    """The page of a reconstruction, at most ``LARGEST_PAGE`` bytes: the same for the same result, wherever and
    whenever it was made, and whether or not stages came from a store."""
    for sizes in SIZES:
        page = _page(PageData(result, sizes))
        if len(page) <= LARGEST_PAGE:
            return page
    raise OutputError(f"report.html: would have more than {LARGEST_PAGE:,} bytes with the smallest pictures")


def _page(m: PageData) -> bytes:
    links = el("nav", (el("a", title, href=f"#{id}") for id, title, _ in SECTIONS), aria_label="Sections")
    sections = [el("section", el("h2", title), make(m), id=id) for id, title, make in SECTIONS]
    return document(
        f"f3sr: {verdict(m)}",
        [head(m, links), el("main", sections)],
        style=part(WEB / "page.css"),
        script=part(WEB / "view3d.js", HERE / "viewer.js"),
    )
