"""report.html: one page, without a network, that shows what a reconstruction did and how good it is.

``templates/report.html`` has its sections; the modules here compute what they show.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from f3sr.errors import OutputError
from f3sr.pipeline import Reconstruction
from f3sr.report_page.compare import front_views, side_views
from f3sr.report_page.formatting import counted, length, listed, name_of, number, share
from f3sr.report_page.graph_drawing import disagreements, drawing, relations
from f3sr.report_page.head import head
from f3sr.report_page.mask_comparison import folded
from f3sr.report_page.object_table import rows
from f3sr.report_page.page_data import PageData, Sizes
from f3sr.report_page.scores import scores
from f3sr.report_page.stages import stages
from f3sr.report_page.viewer import STILL_TURN, scene_data, still_picture
from f3sr.web.data_uri import jpeg_uri
from f3sr.web.document import WEB, document

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


def report_page(result: Reconstruction) -> bytes:
    """The page of a reconstruction, at most ``LARGEST_PAGE`` bytes: the same for the same result, wherever and
    whenever it was made, and whether or not stages came from a store."""
    for sizes in SIZES:
        page = document(
            HERE / "templates" / "report.html",
            _values(PageData(result, sizes)),
            styles=(WEB / "page.css",),
            scripts=(WEB / "view3d.js", HERE / "viewer.js"),
        )
        if len(page) <= LARGEST_PAGE:
            return page
    raise OutputError(f"report.html: would have more than {LARGEST_PAGE:,} bytes with the smallest pictures")


def _values(page: PageData) -> dict[str, Any]:
    """What the templates may name: the sections' data, and how numbers and objects are written."""
    return {
        "page": page,
        "head": head(page),
        "scores": scores(page),
        "front": front_views(page),
        "sides": side_views(page),
        "cards": folded(page),
        "scene_data": scene_data(page),
        "still": still_picture(page),
        "turn": STILL_TURN,
        "objects": rows(page),
        "drawing": drawing(page.scene),
        "disagreements": disagreements(page.result),
        "relations": relations(page.scene),
        "stages": stages(page),
        "jpeg_uri": jpeg_uri,
        "name_of": partial(name_of, scene=page.scene),
        **{f.__name__: f for f in (counted, length, listed, number, share)},
    }
