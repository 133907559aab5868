"""Who rests on whom, as a drawing: the ground at the bottom, edges with the share of the load."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from f3sr.page.markup import Markup, clean, el, join
from f3sr.page.material import Material
from f3sr.scene import GROUND, Scene

BOX = (112, 46)
"""Width and height of an object's box [px]."""
STEP = (132, 104)
"""From box to box, and from row to row."""
LABEL = 14
"""Characters of a line in a box."""
EDGE = 12
"""Room around the drawing."""


@dataclass(frozen=True)
class Spot:
    """The middle of an object's box."""

    x: float
    y: float


def graph(m: Material) -> Markup:
    scene = m.scene
    rows = _rows(scene)
    spots = _spots(rows)
    width = 2 * EDGE + STEP[0] * max(len(row) for row in rows)
    height = 2 * EDGE + STEP[1] * len(rows) + 20
    floor = height - EDGE - 20
    ground = join(
        el("line", x1=EDGE, x2=width - EDGE, y1=floor, y2=floor, class_="floor"),
        el("text", "ground", x=width / 2, y=floor + 18),
    )
    edges = [_edge(spots, o.id, s.id, s.share, floor) for o in scene for s in o.supports if s.id in {GROUND, *spots}]
    boxes = [_box(spots[o.id], scene, o.id) for o in scene]
    drawing = el(
        "svg",
        ground,
        edges,
        boxes,
        viewBox=f"0 0 {width} {height}",
        width=width,
        height=height,
        role="img",
        aria_label=_sentence(scene),
        class_="graph",
    )
    return join(
        el("p", "An edge leads down to what carries the box above; its number is the share of the load. ", _note(scene), class_="fine"),
        el("div", drawing, class_="scroll", tabindex="0"),
    )


def _note(scene: Scene) -> str:
    loose = [o.id for o in scene if not o.supports]
    return f"Dashed: nothing is known of what carries {', '.join(map(str, loose))}." if loose else ""


def _sentence(scene: Scene) -> str:
    """The drawing in words."""
    carried = (f"{o.id} on {', '.join('ground' if s.id == GROUND else str(s.id) for s in o.supports)}" for o in scene if o.supports)
    return "Supports: " + "; ".join(carried)


def levels(scene: Scene) -> Mapping[int, int]:
    """Row of every object, 0 for those on the ground alone: one above the highest thing that carries it."""
    level = {o.id: 0 for o in scene}
    for _ in scene:  # as often as the longest chain; a circle of supports ends here too
        level = {
            o.id: min(len(level), max((level[s.id] + 1 for s in o.supports if s.id in level), default=0)) for o in scene
        }
    return level


def _rows(scene: Scene) -> list[list[int]]:
    """Ids from left to right, the top row first; an object stands near what carries it."""
    level = levels(scene)
    ground_first = [[id for id in level if level[id] == k] for k in sorted(set(level.values()))]
    place = {id: float(k) for k, id in enumerate(ground_first[0])}
    for row in ground_first[1:]:
        for id in row:
            carriers = [place[s.id] for s in scene[id].supports if s.id in place]
            place[id] = sum(carriers) / len(carriers) if carriers else 0.0
        row.sort(key=lambda id: (place[id], id))
    return ground_first[::-1]


def _spots(rows: Sequence[Sequence[int]]) -> dict[int, Spot]:
    """Rows are centred above each other."""
    widest = max(len(row) for row in rows)
    return {
        id: Spot(
            EDGE + STEP[0] * (k + 0.5 + (widest - len(row)) / 2),
            EDGE + BOX[1] / 2 + STEP[1] * r,
        )
        for r, row in enumerate(rows)
        for k, id in enumerate(row)
    }


def _edge(spots: Mapping[int, Spot], child: int, carrier: int, share: float, floor: float) -> Markup:
    start = spots[child]
    x2, y2 = (start.x, floor) if carrier == GROUND else (spots[carrier].x, spots[carrier].y - BOX[1] / 2)
    x1, y1 = start.x, start.y + BOX[1] / 2
    line = el("line", x1=x1, y1=y1, x2=x2, y2=y2, stroke_width=f"{1 + 2.5 * share:.2f}", class_="edge")
    words = el("text", f"{100 * share:.0f} %", x=x1 + 0.3 * (x2 - x1) + 4, y=y1 + 0.3 * (y2 - y1) + 8, class_="share")
    return join(line, words)


def _box(spot: Spot, scene: Scene, id: int) -> Markup:
    o = scene[id]
    kind = "box" if o.supports else "box loose"
    kind += " fixed" if o.mobility == "fixed" else ""
    x, y = spot.x - BOX[0] / 2, spot.y - BOX[1] / 2
    lines = textwrap.wrap(f"{o.id} {clean(o.label)}", LABEL, max_lines=2, placeholder="…") or [str(o.id)]
    first = spot.y + 5 - 8 * (len(lines) - 1)
    words = (el("text", text, x=spot.x, y=first + 16 * k) for k, text in enumerate(lines))
    return el(
        "g", el("title", f"{o.id} {o.label}"), el("rect", x=x, y=y, width=BOX[0], height=BOX[1], rx=3), words, class_=kind
    )
