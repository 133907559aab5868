"""report.html: one page, without a network, that shows what a reconstruction did and how good it is."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable
from pathlib import Path
from string import Template

from f3sr.errors import OutputError
from f3sr.page.compare import compare
from f3sr.page.decisions import decisions
from f3sr.page.graph import graph
from f3sr.page.head import head, verdict
from f3sr.page.markup import Child, Markup, el, join
from f3sr.page.masks import masks
from f3sr.page.material import Material, Sizes
from f3sr.page.objects import objects
from f3sr.page.scores import scores
from f3sr.page.stages import stages
from f3sr.page.viewer import viewer
from f3sr.pipeline import Reconstruction

__all__ = ["LARGEST_PAGE", "report_page"]

LARGEST_PAGE = 15 * 10**6
"""Bytes."""
SIZES = (
    Sizes(picture=960, panels=6_000_000, faces=240_000, texture=512),
    Sizes(picture=800, panels=4_000_000, faces=100_000, texture=256),
    Sizes(picture=640, panels=2_000_000, faces=40_000, texture=128),
    Sizes(picture=400, panels=1_000_000, faces=8_000, texture=32),
)
"""Tried in order until the page is small enough."""
SECTIONS: tuple[tuple[str, str, Callable[[Material], Child]], ...] = (
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
        page = _page(Material(result, sizes))
        if len(page) <= LARGEST_PAGE:
            return page
    raise OutputError(f"report.html: would have more than {LARGEST_PAGE:,} bytes with the smallest pictures")


def _page(m: Material) -> bytes:
    style, script = _part("page.css"), _part("viewer.js")
    policy = (
        f"default-src 'none'; img-src data:; style-src {_hash(style)}; script-src {_hash(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    links = el("nav", (el("a", title, href=f"#{id}") for id, title, _ in SECTIONS), aria_label="Sections")
    sections = [el("section", el("h2", title), make(m), id=id) for id, title, make in SECTIONS]
    text = Template(_part("page.html")).substitute(
        policy=policy,
        title=join(f"f3sr: {verdict(m)}"),
        style=style,
        script=script,
        body=join(head(m, links), el("main", sections)),
    )
    return text.encode("utf-8")


def _part(name: str) -> Markup:
    return Markup((Path(__file__).parent / name).read_text(encoding="utf-8"))


def _hash(text: str) -> str:
    """What a content security policy names an inline style or script by."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
