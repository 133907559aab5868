"""The scene graph: who rests on whom as a drawing, every object in words, all other relations with their evidence."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass

from f3sr.report_page.formatting import about, counted, name_of, ratio, share, told
from f3sr.report_page.page_data import PageData
from f3sr.scene import GROUND, Predicate, Relation, Scene
from f3sr.stages.relate import GraphOutcome
from f3sr.web.markup import Child, Markup, clean, el, join

BOX = (106, 46)
"""Width and height of an object's box [px]."""
STEP = (120, 104)
"""From box to box, and from row to row."""
BEND = 79
"""How far an edge swings to the side that would cross another box [px]."""
LABEL = 13
"""Characters of a line in a box."""
EDGE = 12
"""Room around the drawing."""
ROWS = 150
"""Relations of a kind that are listed; scene.json has all."""
SHOWN: tuple[tuple[Predicate, str], ...] = (
    ("supported_by", "supported by"),
    ("inside", "inside"),
    ("leaning_on", "leaning on"),
    ("touching", "touching"),
    ("next_to", "next to"),
    ("in_front_of", "in front of"),
    ("overlaps_2d", "overlapping in the picture"),
    ("unknown", "given, of no known kind"),
)
"""Kinds that are listed, in words; inverses say nothing new."""


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


def graph(m: PageData) -> Markup:
    scene = m.scene
    return join(_supports(scene), _disagreements(m), _nodes(scene), _relations(scene))


def _supports(scene: Scene) -> Markup:
    spots = _spots(scene)
    width = 2 * EDGE + STEP[0] * (max(s.x for s in spots.values()) + 1)
    height = 2 * EDGE + STEP[1] * (max(s.y for s in spots.values()) + 1) + 20
    floor = height - EDGE - 20
    ground = join(
        el("line", x1=EDGE, x2=width - EDGE, y1=floor, y2=floor, class_="floor"),
        el("text", "ground", x=width / 2, y=floor + 18),
    )
    edges = [_edge(spots, o.id, s.id, s.share, floor) for o in scene for s in o.supports if s.id in {GROUND, *spots}]
    leans = [_lean(spots[a], spots[b]) for a, b in sorted(scene.graph.of("leaning_on")) if {a, b} <= spots.keys()]
    boxes = [_box(spots[o.id], scene, o.id) for o in scene]
    drawing = el(
        "svg",
        ground,
        edges,
        leans,
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
            "A dotted line leads to what a box leans on. " if leans else None,
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
    bend = BEND if _meets_a_box(spots, start, (x2, y2)) else 0
    dx, dy = (x2 - x1) / 3, (y2 - y1) / 3
    path = f"M {x1} {y1} C {x1 + dx + bend} {y1 + dy} {x2 - dx + bend} {y2 - dy} {x2} {y2}"
    line = el("path", d=path, stroke_width=f"{1 + 2.5 * share:.2f}", class_="edge")
    at = x1 + 0.3 * (x2 - x1) + 0.63 * bend + 4, y1 + 0.3 * (y2 - y1) + 8
    words = el("text", f"{100 * share:.0f} %", x=at[0], y=at[1], class_="share")
    return join(line, words)


def _meets_a_box(spots: Mapping[int, Spot], start: Spot, end: tuple[float, float]) -> bool:
    """Whether a straight edge from a box down to ``end`` [px] crosses boxes on its way."""
    slope = (end[0] - start.px) / (end[1] - start.py)
    on_the_way = (s for s in spots.values() if start.py < s.py < end[1])
    return any(abs(start.px + slope * (s.py - start.py) - s.px) < BOX[0] / 2 for s in on_the_way)


def _lean(start: Spot, end: Spot) -> Markup:
    return el("line", x1=start.px, y1=start.py, x2=end.px, y2=end.py, stroke_dasharray="2 5", class_="edge lean")


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


def _disagreements(m: PageData) -> Child:
    """Where scene_graph.json says something else than geometry and the photo."""
    taken = [d for x in m.result.outcomes if isinstance(x, GraphOutcome) for d in x.disagreements]
    if not taken:
        return None
    rows = (
        el("tr", el("th", about(d.about, m.scene), scope="row"), el("td", told(d.choice)), el("td", told(d.reason)))
        for d in taken
    )
    return join(el("h3", "Given and found disagree"), _table(("About", "Choice", "Reason"), rows))


def _nodes(scene: Scene) -> Child:
    if not scene.graph.nodes:
        return None
    rows = (
        el("tr", el("th", about(n.id, scene), scope="row"), el("td", n.description), el("td", share(n.visibility)))
        for n in scene.graph.nodes
    )
    return join(el("h3", "In words"), _table(("Object", "Description", "Visible"), rows, "nodes"))


def _relations(scene: Scene) -> Child:
    kinds = [(words, [r for r in scene.graph.relations if r.predicate == kind]) for kind, words in SHOWN]
    if not any(found for _, found in kinds):
        return None
    return join(el("h3", "Relations"), (_kind(words, found, scene) for words, found in kinds if found))


def _kind(words: str, found: list[Relation], scene: Scene) -> Markup:
    more = len(found) - ROWS
    rows = (_relation(r, words, scene) for r in found[:ROWS])
    return el(
        "details",
        el("summary", f"{words}: {len(found)}"),
        _table(("Relation", "Confidence", "Evidence"), rows, "relations"),
        el("p", f"{counted(more, 'more relation')} in scene.json.", class_="fine") if more > 0 else None,
    )


def _relation(r: Relation, words: str, scene: Scene) -> Markup:
    mark = el("b", "given ", class_="tag") if r.source == "given" else None
    who = join(mark, about(r.subject, scene), f" {words} ", el("bdi", name_of(r.object, scene)))
    return el("tr", el("th", who, scope="row"), el("td", ratio(r.confidence)), el("td", told(r.evidence)))


def _table(titles: tuple[str, ...], rows: Child, kind: str = "") -> Markup:
    head = el("tr", (el("th", t, scope="col") for t in titles))
    return el("table", el("thead", head), el("tbody", rows), class_=f"cards tight {kind}".strip())
