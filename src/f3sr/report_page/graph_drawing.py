"""The scene graph: supports as a drawing, relations by kind, and where given ones and geometry disagree."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from f3sr.pipeline import Reconstruction
from f3sr.report import Decision
from f3sr.scene import GROUND, Predicate, Relation, Scene, SceneObject, Support
from f3sr.stages.relate import GraphOutcome
from f3sr.web.document import clean

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
SHOWN: tuple[tuple[Predicate, str], ...] = (
    ("supported_by", "supported by"),
    ("inside", "inside"),
    ("leaning_on", "leaning on"),
    ("touching", "touching"),
    ("next_to", "next to"),
    ("in_front_of", "in front of"),
    ("overlaps_2d", "overlapping in the picture"),
    ("unknown", "given, of an unknown kind"),
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


@dataclass(frozen=True, kw_only=True)
class SupportEdge:
    """A curve from an object to a support, and where the share of its load is written [px]."""

    path: str
    share: float
    x: float
    y: float


@dataclass(frozen=True, eq=False, kw_only=True)
class SupportDrawing:
    """Everything that the drawing shows [px]; ``floor``: the height of the ground's line."""

    width: float
    height: float
    floor: float
    edges: Sequence[SupportEdge]
    leans: Sequence[tuple[Spot, Spot]]
    boxes: Sequence[tuple[SceneObject, Spot, Sequence[str]]]
    """An object, the middle of its box and the lines of its label."""
    sentence: str
    """The drawing in words."""
    margin: float = EDGE
    box: tuple[float, float] = BOX


def drawing(scene: Scene) -> SupportDrawing:
    spots = _spots(scene)
    height = 2 * EDGE + STEP[1] * (max(s.y for s in spots.values()) + 1) + 20
    floor = height - EDGE - 20
    return SupportDrawing(
        width=2 * EDGE + STEP[0] * (max(s.x for s in spots.values()) + 1),
        height=height,
        floor=floor,
        edges=[_edge(spots, o.id, s, floor) for o in scene for s in o.supports if s.id in {GROUND, *spots}],
        leans=[(spots[a], spots[b]) for a, b in sorted(scene.graph.of("leaning_on")) if {a, b} <= spots.keys()],
        boxes=[(o, spots[o.id], _lines(o)) for o in scene],
        sentence="Supports: " + "; ".join(_supports(o) for o in scene if o.supports),
    )


def disagreements(result: Reconstruction) -> list[Decision]:
    """Where scene_graph.json says something else than geometry and the photo."""
    return [d for x in result.outcomes if isinstance(x, GraphOutcome) for d in x.disagreements]


def relations(scene: Scene) -> list[tuple[str, list[Relation]]]:
    """Every kind that the scene has, in words."""
    kinds = [(words, [r for r in scene.graph.relations if r.predicate == kind]) for kind, words in SHOWN]
    return [(words, found) for words, found in kinds if found]


def _supports(o: SceneObject) -> str:
    return f"{o.id} on {', '.join('ground' if s.id == GROUND else str(s.id) for s in o.supports)}"


def _lines(o: SceneObject) -> list[str]:
    return textwrap.wrap(f"{o.id} {clean(o.label)}", LABEL, max_lines=2, placeholder="…") or [str(o.id)]


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


def _edge(spots: Mapping[int, Spot], child: int, support: Support, floor: float) -> SupportEdge:
    start = spots[child]
    x2, y2 = (start.px, floor) if support.id == GROUND else (spots[support.id].px, spots[support.id].py - BOX[1] / 2)
    x1, y1 = start.px, start.py + BOX[1] / 2
    bend = BEND if _meets_a_box(spots, start, (x2, y2)) else 0
    dx, dy = (x2 - x1) / 3, (y2 - y1) / 3
    return SupportEdge(
        path=f"M {x1} {y1} C {x1 + dx + bend} {y1 + dy} {x2 - dx + bend} {y2 - dy} {x2} {y2}",
        share=support.share,
        x=x1 + 0.3 * (x2 - x1) + 0.63 * bend + 4,
        y=y1 + 0.3 * (y2 - y1) + 8,
    )


def _meets_a_box(spots: Mapping[int, Spot], start: Spot, end: tuple[float, float]) -> bool:
    """Whether a straight edge from a box down to ``end`` [px] crosses boxes on its way."""
    slope = (end[0] - start.px) / (end[1] - start.py)
    on_the_way = (s for s in spots.values() if start.py < s.py < end[1])
    return any(abs(start.px + slope * (s.py - start.py) - s.px) < BOX[0] / 2 for s in on_the_way)
