"""Input, direct composition and ours: as the photo sees them, and from the side with defects boxed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.transforms import Array, box_corners
from f3sr.metrics.measures import Details, Gap, Overlap
from f3sr.report_page.formatting import counted, length, name_of, share
from f3sr.report_page.page_data import PageData, View, look_alike
from f3sr.scene import GROUND, Scene
from f3sr.vision.pictures import Image, composite, ground_row, side_camera, side_cameras, side_view

SIDE = (720, 420)
"""Width and height of a side view [px]."""
MOST_BOXES = 3
"""Boxes of each kind (gaps, sunk objects, penetrations), the worst first."""
SHOWN_SHARE = 0.005
"""From which share of an object's size on a gap or a depth below the ground is boxed."""
LEAST_BOX = 30
"""Smallest side of a box [px]."""


@dataclass(frozen=True, eq=False)
class Mark:
    """A defect: corners in the world (n, 3) and what is wrong."""

    points: Array
    words: str

    def box(self, camera: Camera) -> tuple[float, float, float, float]:
        """Left, top, width and height [px] of a box around the corners, inside the picture."""
        pixels, _ = camera.project(self.points)
        low, high = pixels.min(0), pixels.max(0)
        grow = np.maximum(6, (LEAST_BOX - (high - low)) / 2)
        size = np.array([camera.width, camera.height])
        low, high = np.clip(low - grow, 2, size - LEAST_BOX), np.clip(high + grow, LEAST_BOX, size - 2)
        left, top, width, height = np.round([*low, *(high - low)], 1).tolist()
        return left, top, width, height


@dataclass(frozen=True, eq=False, kw_only=True)
class SideView:
    """A side view with its defects. ``ground``: the row of z = 0 [px], None where it is unknown."""

    picture: Image
    camera: Camera
    title: str
    note: str
    ground: float | None = None
    marks: Sequence[Mark] = ()


def front_views(page: PageData) -> list[View]:
    """The photo's camera: the input and direct composition, as one picture where they look alike, and ours."""
    ours = View(
        picture=composite(page.scene, page.backdrop),
        alt="Ours, seen by the photo's camera",
        title="Ours",
        note=": unlit textures over the photo",
    )
    before = composite(page.given, page.backdrop)
    if look_alike(page.given, page.direct):
        title = "Input as it came, and direct composition"
        note = ": levelling turns camera and objects together, so both look alike"
        return [View(picture=before, alt=title, title=title, note=note), ours]
    direct = composite(page.direct, page.backdrop)
    return [
        View(picture=before, alt="Input as it came", title="Input as it came"),
        View(picture=direct, alt="Direct composition", title="Direct composition"),
        ours,
    ]


def side_views(page: PageData) -> list[SideView]:
    level = side_camera(page.given, width=SIDE[0], height=SIDE[1], ground=False)
    picture = side_view(page.given, level, ground=False)
    note = ". It has no ground: z = 0 is the height of its camera, and gaps are undefined."
    direct, ours = side_cameras(page.direct, page.scene, *SIDE)
    return [
        SideView(picture=picture, camera=level, title="Input as it came", note=note),
        _measured("Direct composition", page.direct, direct, page.direct_details),
        _measured("Ours", page.scene, ours, page.details),
    ]


def _measured(title: str, scene: Scene, camera: Camera, details: Details | None) -> SideView:
    return SideView(
        picture=side_view(scene, camera, ground=True),
        camera=camera,
        title=title,
        note=_note(details),
        ground=ground_row(camera),
        marks=marks(details, scene),
    )


def _note(details: Details | None) -> str:
    """What is right."""
    if details is None:
        return ". Gaps and penetrations were not measured."
    good = {
        f"no gap of {share(SHOWN_SHARE)} of an object's size or more": not any(_far(g) for g in details.gaps),
        "no penetration": not details.overlaps,
        "nothing below the ground": not any(_deep(g) for g in details.gaps),
    }
    shown = ", ".join(words for words, so in good.items() if so)
    return f": {shown}" if shown else ""


def _far(g: Gap) -> bool:
    return g.distance >= SHOWN_SHARE * g.size


def _deep(g: Gap) -> bool:
    return g.below >= SHOWN_SHARE * g.size


def marks(details: Details | None, scene: Scene) -> list[Mark]:
    """Defects of a measured scene, worst first per kind."""
    if details is None:
        return []
    gaps = sorted(filter(_far, details.gaps), key=lambda g: -g.distance / g.size)
    gaps = [g for k, g in enumerate(gaps) if (g.nearest, g.id) not in {(h.id, h.nearest) for h in gaps[:k]}]
    sunk = sorted(filter(_deep, details.gaps), key=lambda g: -g.below / g.size)
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
    words = f"{name_of(g.id, scene)} is {length(g.below)} below the ground ({share(g.below / g.size)} of its size)"
    return Mark(np.stack([lowest, lowest * [1, 1, 0]]), words)


def _overlap(o: Overlap, scene: Scene) -> Mark:
    corners = box_corners(np.array([o.low, o.high]))
    names = f"{name_of(o.a, scene)}, {name_of(o.b, scene)}"
    words = f"{o.a} and {o.b} overlap ({names}; {counted(o.crossings, 'crossing')} of triangles)"
    return Mark(corners, words)
