"""Input, direct composition and ours beside each other: as the photo sees them, and from the side with what is wrong
boxed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, box_corners
from f3sr.metrics.measures import Details, Gap, Overlap
from f3sr.report_page.formatting import counted, length, name_of, share
from f3sr.report_page.page_data import PageData, look_alike
from f3sr.scene import GROUND, Scene
from f3sr.vision.pictures import composite, ground_row, side_camera, side_cameras, side_view
from f3sr.web.figures import figure, img
from f3sr.web.markup import Child, Markup, el, join

SIDE = (720, 420)
"""Width and height of a side view [px]."""
MOST_BOXES = 3
"""Boxes of each kind (gaps, sunk objects, penetrations), the worst first."""
SHOWN_SHARE = 0.005
"""From which share of an object's size on a gap or a depth under the ground is boxed."""
LEAST_BOX = 30
"""Smallest side of a box [px]."""


@dataclass(frozen=True, eq=False)
class Mark:
    """A place that is wrong: corners in the world (n, 3) and what is wrong."""

    points: Array
    words: str


def compare(m: PageData) -> Markup:
    return join(
        el("h3", "From the photo's camera"),
        el("div", _front(m), class_="row"),
        el("h3", "From the side"),
        el(
            "p",
            "A level camera to the side of the photo's. ",
            el("span", "Green", class_="key ground"),
            " is z = 0, ",
            el("span", "red boxes", class_="key box"),
            " are measured gaps, penetrations and depths under the ground, the worst of each kind.",
            class_="fine",
        ),
        el("div", _sides(m), class_="row"),
    )


def _front(m: PageData) -> list[Markup]:
    one = look_alike(m.given, m.direct)
    name = "Input as it came, and direct composition" if one else "Input as it came"
    note = ": levelling turns camera and objects together, so both look alike" if one else ""
    shown = [figure(img(composite(m.given, m.backdrop), name), join(el("b", name), note))]
    if not one:
        shown.append(figure(img(composite(m.direct, m.backdrop), "Direct composition"), el("b", "Direct composition")))
    ours = img(composite(m.scene, m.backdrop), "Ours, seen by the photo's camera")
    return [*shown, figure(ours, join(el("b", "Ours"), ": unlit textures over the photo"))]


def _sides(m: PageData) -> list[Markup]:
    given = join(
        el("b", "Input as it came"),
        ". It knows no ground: z = 0 is the height of its camera, and gaps are not defined.",
    )
    width, height = SIDE
    level = side_camera(m.given, width=width, height=height, ground=False)
    cameras = side_cameras(m.direct, m.scene, width, height)
    return [
        side_figure(m.given, level, [], given, ground=False),
        side_figure(
            m.direct, cameras[0], marks(m.direct_details, m.direct), _caption("Direct composition", m.direct_details)
        ),
        side_figure(m.scene, cameras[1], marks(m.details, m.scene), _caption("Ours", m.details)),
    ]


def side_figure(scene: Scene, camera: Camera, wrong: Sequence[Mark], caption: Child, *, ground: bool = True) -> Markup:
    """The side view with lettered red boxes, and what they mean below."""
    lettered = list(zip("ABCDEFGHI", wrong, strict=False))
    boxes = [_box(mark, camera, letter) for letter, mark in lettered]
    if ground:
        boxes.insert(0, el("text", "z = 0", x=6, y=ground_row(camera) + 20, class_="zero"))
    size = f"0 0 {camera.width} {camera.height}"
    lines = el("svg", boxes, viewBox=size, class_="marks", aria_hidden="true")
    words = el("ol", (el("li", el("b", letter), " ", mark.words) for letter, mark in lettered))
    view = img(side_view(scene, camera, ground=ground), "Side view")
    return figure(el("div", view, lines, class_="marked"), join(caption, words if wrong else None))


def marks(details: Details | None, scene: Scene) -> list[Mark]:
    """What is wrong in a measured scene, worst first per kind."""
    if details is None:
        return []
    gaps = sorted((g for g in details.gaps if g.distance >= SHOWN_SHARE * g.size), key=lambda g: -g.distance / g.size)
    gaps = [g for k, g in enumerate(gaps) if (g.nearest, g.id) not in {(h.id, h.nearest) for h in gaps[:k]}]
    sunk = sorted((g for g in details.gaps if g.below >= SHOWN_SHARE * g.size), key=lambda g: -g.below / g.size)
    overlaps = sorted(details.overlaps, key=lambda o: -o.crossings)
    return [
        *(_gap(g, scene) for g in gaps[:MOST_BOXES]),
        *(_sunk(g, scene) for g in sunk[:MOST_BOXES]),
        *(_overlap(o, scene) for o in overlaps[:MOST_BOXES]),
    ]


def _gap(g: Gap, scene: Scene) -> Mark:
    where = "below" if g.nearest == GROUND else f"from {name_of(g.nearest, scene)} to"
    words = f"gap {length(g.distance)} {where} {name_of(g.id, scene)} ({share(g.distance / g.size)} of its size)"
    return Mark(np.array([g.start, g.end]), words)


def _sunk(g: Gap, scene: Scene) -> Mark:
    lowest = np.array(g.lowest)
    words = f"{name_of(g.id, scene)} is {length(g.below)} under the ground ({share(g.below / g.size)} of its size)"
    return Mark(np.stack([lowest, lowest * [1, 1, 0]]), words)


def _overlap(o: Overlap, scene: Scene) -> Mark:
    corners = box_corners(np.array([o.low, o.high]))
    names = f"{name_of(o.a, scene)}, {name_of(o.b, scene)}"
    words = f"{o.a} and {o.b} overlap ({names}; {counted(o.crossings, 'crossing')} of triangles)"
    return Mark(corners, words)


def _box(mark: Mark, camera: Camera, letter: str) -> Markup:
    """A box around the mark's places, inside the picture, its letter at a corner."""
    pixels, _ = camera.project(mark.points)
    low, high = pixels.min(0), pixels.max(0)
    grow = np.maximum(6, (LEAST_BOX - (high - low)) / 2)
    size = np.array([camera.width, camera.height])
    low, high = np.clip(low - grow, 2, size - LEAST_BOX), np.clip(high + grow, LEAST_BOX, size - 2)
    x, y, w, h = (f"{v:.1f}" for v in (*low, *(high - low)))
    above = low[1] > 30
    at = low[1] - 6 if above else high[1] + 26
    return join(el("rect", x=x, y=y, width=w, height=h), el("text", letter, x=x, y=f"{at:.1f}"))


def _caption(name: str, details: Details | None) -> Markup:
    title = el("b", name)
    if details is None:
        return join(title, ". Gaps and penetrations were not measured.")
    small = all(g.distance < SHOWN_SHARE * g.size for g in details.gaps)
    sunk = any(g.below >= SHOWN_SHARE * g.size for g in details.gaps)
    good: list[str] = []
    if small:
        good.append(f"no gap of {share(SHOWN_SHARE)} of an object's size or more")
    if not details.overlaps:
        good.append("no penetration")
    if not sunk:
        good.append("nothing under the ground")
    return join(title, f": {', '.join(good)}" if good else None)
