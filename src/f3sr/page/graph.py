"""Who rests on whom, as a drawing: the ground at the bottom, edges with the share of the load."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

from f3sr.page.markup import Markup, clean, el, join
from f3sr.page.material import Material
from f3sr.scene import GROUND, Scene

BOX = (106, 46)
"""Width and height of an object's box [px]."""
STEP = (120, 104)
"""From box to box, and from row to row."""
LABEL = 13
"""Characters of a line in a box."""
EDGE = 12
"""Room around the drawing."""


@dataclass(frozen=True)
class Spot:
    """The middle of an object's box, in steps from the upper left one."""

    x: float
    y: float

    @property
    def px(self) -> float:
        return EDGE + STEP[0] * (self.x + 0.5)

    @property
    def py(self) -> float:
        return EDGE + BOX[1] / 2 + STEP[1] * self.y


def graph(m: Material) -> Markup:
    scene = m.scene
    spots = _spots(scene)
    width = 2 * EDGE + STEP[0] * (max(s.x for s in spots.values()) + 1)
    height = 2 * EDGE + STEP[1] * (max(s.y for s in spots.values()) + 1) + 20
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
        el(
            "p",
            "An edge leads down to what carries the box above; its number is the share of the load. ",
            _note(scene),
            class_="fine",
        ),
        el("div", drawing, class_="scroll", tabindex="0"),
    )


def _note(scene: Scene) -> str:
    loose = [o.id for o in scene if not o.supports]
    return f"Dashed: nothing is known of what carries {', '.join(map(str, loose))}." if loose else ""


def _sentence(scene: Scene) -> str:
    """The drawing in words."""
    carried = (
        f"{o.id} on {', '.join('ground' if s.id == GROUND else str(s.id) for s in o.supports)}"
        for o in scene
        if o.supports
    )
    return "Supports: " + "; ".join(carried)


def levels(scene: Scene) -> Mapping[int, int]:
    """Row of every object, 0 for those on the ground alone: one above the highest thing that carries it."""
    level = {o.id: 0 for o in scene}
    for _ in scene:  # as often as the longest chain; a circle of supports ends here too
        level = {
            o.id: min(len(level), max((level[s.id] + 1 for s in o.supports if s.id in level), default=0)) for o in scene
        }
    return level


def _spots(scene: Scene) -> dict[int, Spot]:
    """Where boxes stand, in steps: every object above the middle of those it carries most of, nothing above others."""
    level = levels(scene)
    carrier = {o.id: max(o.supports, key=lambda s: s.share).id if o.supports else None for o in scene}
    carried = {id: [c for c in level if carrier[c] == id and level[c] > level[id]] for id in level}
    spots: dict[int, Spot] = {}
    free = 0.0

    def place(id: int) -> float:
        nonlocal free
        xs = [place(c) for c in carried[id]]
        if not xs:
            free += 1
        x = (xs[0] + xs[-1]) / 2 if xs else free - 1
        spots[id] = Spot(x, max(level.values()) - level[id])
        return x

    for id in level:
        if not any(id in children for children in carried.values()):
            place(id)
    return spots


def _edge(spots: Mapping[int, Spot], child: int, carrier: int, share: float, floor: float) -> Markup:
    start = spots[child]
    x2, y2 = (start.px, floor) if carrier == GROUND else (spots[carrier].px, spots[carrier].py - BOX[1] / 2)
    x1, y1 = start.px, start.py + BOX[1] / 2
    line = el("line", x1=x1, y1=y1, x2=x2, y2=y2, stroke_width=f"{1 + 2.5 * share:.2f}", class_="edge")
    words = el("text", f"{100 * share:.0f} %", x=x1 + 0.3 * (x2 - x1) + 4, y=y1 + 0.3 * (y2 - y1) + 8, class_="share")
    return join(line, words)


def _box(spot: Spot, scene: Scene, id: int) -> Markup:
    o = scene[id]
    kind = "box" if o.supports else "box loose"
    kind += " fixed" if o.mobility == "fixed" else ""
    x, y = spot.px - BOX[0] / 2, spot.py - BOX[1] / 2
    lines = textwrap.wrap(f"{o.id} {clean(o.label)}", LABEL, max_lines=2, placeholder="…") or [str(o.id)]
    first = spot.py + 5 - 8 * (len(lines) - 1)
    words = (el("text", text, x=spot.px, y=first + 16 * k) for k, text in enumerate(lines))
    return el(
        "g",
        el("title", f"{o.id} {o.label}"),
        el("rect", x=x, y=y, width=BOX[0], height=BOX[1], rx=3),
        words,
        class_=kind,
    )
