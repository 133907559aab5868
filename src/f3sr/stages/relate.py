"""relate: who rests on whom, told from heights, footprints and what lies below each mask in the photo."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Interval

from f3sr import heights
from f3sr.report import Decision, Measure, Report
from f3sr.scene import GROUND, Relation, Scene, SceneGraph, SceneObject, Support
from f3sr.settings import settings


@settings
class RelateConfig:
    cells: Annotated[int, Interval(ge=8, le=512)] = 48
    """Grid cells along an object's longer horizontal side for height maps."""
    min_overlap: Annotated[float, Interval(gt=0, lt=1)] = 0.03
    """Share of the object's footprint that must lie over a support."""
    max_gap: Annotated[float, Interval(gt=0, le=1)] = 0.25
    """Largest vertical gap or depth between an object and its support, in object sizes: generated
    poses miss an object's place by up to a fifth of its size."""
    picture_weight: Annotated[float, Interval(ge=0, le=1)] = 0.15
    """Weight, in object sizes of vertical gap, of what the photo shows just below the object."""
    full_overlap: Annotated[float, Interval(gt=0, le=1)] = 0.3
    """Share of the footprint over a support from which on more overlap says nothing."""
    overlap_weight: Annotated[float, Interval(ge=0, le=1)] = 0.1
    """Weight, in object sizes of vertical gap, of lacking overlap."""
    inside_overlap: Annotated[float, Interval(gt=0, le=1)] = 0.9
    """Share of the footprint that lies over a container when the object is inside it."""
    inside_depth: Annotated[float, Interval(ge=0, le=1)] = 0.1
    """How far an object's lowest point is below the rim of what contains it, in object sizes."""
    below_pixels: Annotated[float, Interval(gt=0, le=0.1)] = 0.004
    """How far below its mask's lower edge an object's support is looked for, as a share of the image height."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A possible support of ``child``: its ``cost`` in object sizes, lower is better, and the evidence for it."""

    child: int
    parent: int
    cost: float
    evidence: str
    inside: bool = False


def relate(scene: Scene, config: RelateConfig | None = None) -> tuple[Scene, Report]:
    """Build the support forest: one parent per object, no cycles, the cheapest candidates first.

    Relations of a given scene graph come before anything found here. The ground is a candidate for every object,
    however far below: what floats over nothing will come down to it.
    """
    config = config or RelateConfig()
    given = [Candidate(child=r.subject, parent=r.object, cost=-r.confidence, evidence=r.evidence)
             for r in scene.graph.relations if r.predicate == "supported_by"]  # fmt: skip
    found = [c for o in scene for c in candidates(o, scene, config)]
    chosen = forest([*given, *found])
    objects: list[SceneObject] = []
    decisions: list[Decision] = []
    for c in given:
        if chosen[c.child].parent != c.parent:
            reason = "it would close a circle, or another given support is surer"
            decisions.append(
                Decision(choice=f"given support by {_name(c.parent)} dropped", reason=reason, about=c.child)
            )
    for o in scene:
        best = chosen[o.id]
        objects.append(replace(o, supported_by=best.parent, supports=(Support(id=best.parent),)))
        runner_up = min((c.cost for c in found if c.child == o.id and c.parent != best.parent), default=None)
        margin = (
            "" if runner_up is None or best.cost < 0 else f"; the next candidate costs {runner_up - best.cost:.2f} more"
        )
        decisions.append(Decision(choice=f"rests on {_name(best.parent)}", reason=best.evidence + margin, about=o.id))
    graph = SceneGraph(
        relations=(*scene.graph.relations, *_relations(chosen.values(), scene)), source=scene.graph.source
    )
    if scene.graph.source == "provisional":
        graph = replace(graph, source="geometry and masks")
    on_ground = sum(o.supported_by == GROUND for o in objects)
    measures = (
        Measure(name="objects on the ground", after=on_ground),
        Measure(name="objects on objects", after=len(objects) - on_ground),
    )
    scene = replace(scene, objects=tuple(objects), graph=graph)
    return scene, Report(stage="relate", measures=measures, decisions=tuple(decisions))


def candidates(o: SceneObject, scene: Scene, config: RelateConfig) -> list[Candidate]:
    """All supports of one object that its height, its footprint and the photo allow, the ground included."""
    below = _below_in_photo(o, scene, config)
    lowest = float(o.bounds_world[0, 2])
    ground_cost = abs(lowest) / o.size + config.picture_weight * (1 - below.get(GROUND, 0.0))
    evidence = (
        f"lowest point {1000 * lowest:.0f} mm above it, {100 * below.get(GROUND, 0):.0f}% of the mask stands on it"
    )
    found = [Candidate(child=o.id, parent=GROUND, cost=ground_cost, evidence=evidence)]
    for p in scene:
        if p.id != o.id and (candidate := _on_object(o, p, below.get(p.id, 0.0), config)):
            found.append(candidate)
    return found


def forest(candidates: Iterable[Candidate]) -> dict[int, Candidate]:
    """The cheapest candidate per child that closes no cycle, by ascending cost; ties by ids."""
    chosen: dict[int, Candidate] = {}
    for c in sorted(candidates, key=lambda c: (c.cost, c.child, c.parent)):
        if c.child in chosen:
            continue
        walk: int | None = c.parent
        while walk in chosen:
            walk = chosen[walk].parent
            if walk == c.child:
                break
        if walk != c.child:
            chosen[c.child] = c
    return chosen


def _on_object(o: SceneObject, p: SceneObject, seen_below: float, config: RelateConfig) -> Candidate | None:
    """Whether ``o`` can rest on ``p``, by the least distance from o's underside to p's top where they overlap."""
    low = np.maximum(o.bounds_world[0], p.bounds_world[0])
    high = np.minimum(o.bounds_world[1], p.bounds_world[1])
    if np.any(low[:2] >= high[:2]):
        return None
    box = o.bounds_world
    grid = heights.Grid.over(box[0], box[1], float((box[1] - box[0])[:2].max()) / config.cells)
    underside = heights.lower(o.vertices_world, o.mesh.faces, grid)
    top = heights.upper(p.vertices_world, p.mesh.faces, grid)
    both = np.isfinite(underside) & np.isfinite(top)
    footprint = np.count_nonzero(np.isfinite(underside))
    overlap = np.count_nonzero(both) / max(footprint, 1)
    if overlap < config.min_overlap:
        return None
    gap = float(np.percentile((underside - top)[both], 2))
    if abs(gap) > config.max_gap * o.size:
        return None
    missing = max(0.0, 1 - overlap / config.full_overlap)
    cost = abs(gap) / o.size + config.picture_weight * (1 - seen_below) + config.overlap_weight * missing
    evidence = (
        f"{1000 * gap:.0f} mm above it over {100 * overlap:.0f}% of the footprint, "
        f"{100 * seen_below:.0f}% of the mask stands on it"
    )
    sunk = float(p.bounds_world[1, 2] - o.bounds_world[0, 2])
    inside = bool(overlap > config.inside_overlap and sunk > config.inside_depth * o.size)
    return Candidate(child=o.id, parent=p.id, cost=cost, evidence=evidence, inside=inside)


def _below_in_photo(o: SceneObject, scene: Scene, config: RelateConfig) -> dict[int, float]:
    """What the photo shows just below the lower edge of a mask: the share of its columns over each id.

    Pixels of no mask count as ground; pixels beyond the image count for nothing.
    """
    height = o.mask.shape[0]
    step = max(2, round(config.below_pixels * height))
    columns = np.flatnonzero(o.mask.any(axis=0))
    rows = height - 1 - np.argmax(o.mask[::-1, columns], axis=0) + step
    inside = rows < height
    rows, columns = rows[inside], columns[inside]
    if not len(columns):
        return {}
    shares = {p.id: float(p.mask[rows, columns].mean()) for p in scene if p.id != o.id}
    shares[GROUND] = 1 - sum(shares.values())
    return shares


def _relations(chosen: Iterable[Candidate], scene: Scene) -> list[Relation]:
    given = scene.graph.of("supported_by")
    relations: list[Relation] = []
    for c in sorted(chosen, key=lambda c: c.child):
        if (c.child, c.parent) in given:
            continue
        confidence = float(np.clip(1 - 2 * c.cost, 0.05, 1))
        relations.append(Relation(subject=c.child, predicate="supported_by", object=c.parent, confidence=confidence,
                                  evidence=c.evidence))  # fmt: skip
        if c.inside:
            evidence = "within the footprint and below the rim"
            relations += [
                Relation(
                    subject=c.child,
                    predicate="inside",
                    object=c.parent,
                    confidence=confidence,
                    evidence=evidence,
                ),
                Relation(
                    subject=c.parent,
                    predicate="contains",
                    object=c.child,
                    confidence=confidence,
                    evidence=evidence,
                ),
            ]
    return relations


def _name(id: int) -> str:
    return "the ground" if id == GROUND else f"object {id}"
