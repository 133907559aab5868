"""relate: the scene graph. Who rests on whom and all other relations, from geometry, masks and depth alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypedDict

from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import GROUND, Scene, SceneGraph, SceneObject, Support, name_of
from f3sr.stages.relate.config import RelateConfig
from f3sr.stages.relate.given import Given, canonical, held_against
from f3sr.stages.relate.known import Known
from f3sr.stages.relate.leaning import rests_on
from f3sr.stages.relate.load_shares import Carried, carried, without_circles
from f3sr.stages.relate.scene_graph import FoundSupports, graph_of
from f3sr.stages.relate.supports import Candidate, candidates, forest, likelihood
from f3sr.stages.relate.unseen import Hanging, hanging

__all__ = ["Candidate", "Described", "GraphOutcome", "RelateConfig", "Related", "describe", "forest", "relate"]

Found = Mapping[int, Sequence[Candidate]]


@dataclass(frozen=True, kw_only=True)
class GraphOutcome(Outcome):
    """How many objects rest on what, and what became of given relations."""

    on_ground: int = 0
    on_objects: int = 0
    on_unseen: int = 0
    given: int = 0
    """Different given relations."""
    allowed: int = 0
    """Those of them that geometry allows."""
    disagreements: tuple[Decision, ...] = ()
    """Those of the decisions that tell where given relations and geometry disagree."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        told = (
            Measure(name="given relations", after=self.given),
            Measure(name="given relations that geometry allows", after=self.allowed),
        )
        return (
            Measure(name="objects on the ground", after=self.on_ground),
            Measure(name="objects on objects", after=self.on_objects),
            Measure(name="objects on something unseen", after=self.on_unseen),
            *(told if self.given else ()),
        )


@dataclass(frozen=True, kw_only=True)
class Related(GraphOutcome):
    stage: ClassVar[str] = "relate"


@dataclass(frozen=True, kw_only=True)
class Described(GraphOutcome):
    stage: ClassVar[str] = "describe"


def relate(scene: Scene, config: RelateConfig | None = None) -> tuple[Scene, Related]:
    """Name every object's supports and build the scene graph.

    The support forest has one parent per object and no cycles; the likeliest candidates come first. Given supports that
    geometry allows precede all found ones. The ground is a candidate for every object, at any distance: a floating
    object will come down to it. An object that must hang on something unseen stays fixed in its pose.
    """
    known = Known.of(scene, config or RelateConfig())
    found = {o.id: candidates(o, known) for o in scene}
    given = held_against(scene.graph, found, known)
    chosen = forest([*given.supports, *(c for cs in found.values() for c in cs)])
    resting = _resting(chosen, found, given, known)
    hang = {o.id: how for o in scene if (how := _hanging(o, chosen[o.id], found[o.id], known))}
    unseen = {id for id, how in hang.items() if how.is_sure}
    objects = tuple(_supported(o, resting[o.id], o.id in unseen) for o in scene)
    related = scene.with_objects(*objects)
    judged = FoundSupports(found=found, chosen=chosen, resting=resting, given=given)
    graph = graph_of(related, judged, known, exact=False)
    disagreements = [*given.decisions, *_circles(given, chosen)]
    decisions = list(disagreements)
    for o in related:
        decisions.append(_said(o, chosen[o.id], found[o.id], hang.get(o.id)))
        if o.id not in unseen and (overruled := _overruled(chosen[o.id], found[o.id])):
            decisions.append(overruled)
            disagreements.append(overruled)
    if len(unseen) > 1 and 2 * len(unseen) > len(scene.objects):
        reason = f"{len(unseen)} of {len(scene.objects)} are above it by the photo's geometry; look at its mask"
        decisions.append(Decision(choice="most objects hang: the ground may be wrong", reason=reason, fallback=True))
    outcome = Related(decisions=tuple(decisions), disagreements=tuple(disagreements), **_counts(related, given))
    return replace(related, graph=graph), outcome


def describe(scene: Scene, config: RelateConfig | None = None) -> tuple[Scene, Described]:
    """The scene graph of a scene at rest: the supports are those that the objects have, from contact forces, contact is
    that of the proxies. No object changes; given relations that no longer hold are told and left out. What rests
    outside a container in which the photo shows it is a fallback."""
    known = Known.of(scene, config or RelateConfig())
    found = {o.id: candidates(o, known) for o in scene}
    given = held_against(scene.graph, found, known)
    chosen = {o.id: _main(o, found[o.id]) for o in scene if o.supported_by is not None}
    resting = {id: carried(c, found[id], known) for id, c in chosen.items()}
    judged = FoundSupports(found=found, chosen=chosen, resting=resting, given=given)
    graph = graph_of(scene, judged, known, exact=True)
    carriers = {(o.id, s.id) for o in scene for s in o.supports}
    decisions = [
        Decision(
            choice=f"given support by {name_of(c.parent)} carries nothing at rest",
            reason="contact forces name " + (_named(scene[c.child].supports) or "nothing"),
            about=c.child,
        )
        for c in given.supports
        if (c.child, c.parent) not in carriers
    ]
    told = (*given.decisions, *decisions)
    outcome = Described(decisions=(*told, *_left_containers(scene, graph)), disagreements=told, **_counts(scene, given))
    return replace(scene, graph=graph), outcome


def _left_containers(scene: Scene, at_rest: SceneGraph) -> Iterator[Decision]:
    """Objects at rest outside a container in which the photo shows them, carried by it."""
    carriers: dict[int, list[int]] = {o.id: [] for o in scene}
    for child, parent in scene.graph.of("supported_by"):
        carriers[child].append(parent)
    in_photo, now = rests_on(carriers), rests_on({o.id: o.carriers for o in scene})
    for id, container in sorted(scene.graph.of("inside") - at_rest.of("inside")):
        if id in in_photo[container] - now[container]:
            yield Decision(
                choice=f"rests outside {name_of(container)}, in which the photo shows it",
                reason="of all places that were tried, none inside agrees better with the masks and rests",
                about=id,
                fallback=True,
            )


def _resting(chosen: Mapping[int, Candidate], found: Found, given: Given, known: Known) -> dict[int, Carried]:
    """What carries every object; nothing is carried by what rests on it."""
    above = rests_on({id: [c.parent] for id, c in chosen.items()})
    resting: dict[int, Carried] = {}
    for id, c in chosen.items():
        others = [other for other in found[id] if other.parent != c.parent and other.parent not in above[id]]
        named = {g.parent for g in given.supports if g.child == id}
        resting[id] = carried(c, others, known, given=named)
    return without_circles(resting)


def _hanging(o: SceneObject, chosen: Candidate, found: Sequence[Candidate], known: Known) -> Hanging | None:
    """How an object hangs in the air; what is given to move or to rest on something does not."""
    if chosen.cost < 0 or (o.mobility == "dynamic" and o.mobility_source == "given"):
        return None
    return hanging(o, found, known)


def _supported(o: SceneObject, resting: Carried, unseen: bool) -> SceneObject:
    if unseen:
        return o.on_something_unseen()
    return replace(o, supported_by=resting.patches[0].id, supports=resting.supports)


def _main(o: SceneObject, found: Sequence[Candidate]) -> Candidate:
    """The main support that an object has, with the contact found here if there is one."""
    assert o.supported_by is not None
    unknown = Candidate(child=o.id, parent=o.supported_by, cost=0.0, evidence="")
    same = next((c for c in found if c.parent == o.supported_by), unknown)
    return replace(same, contact=replace(same.contact, k=1.0))


def _circles(given: Given, chosen: Mapping[int, Candidate]) -> list[Decision]:
    """Given supports that were not followed though geometry allows them: the first of a child's is its main one."""
    first: dict[int, Candidate] = {}
    for c in sorted(given.supports, key=lambda c: (c.cost, c.parent)):
        first.setdefault(c.child, c)
    return [
        Decision(
            choice=f"given support by {name_of(c.parent)} dropped",
            reason="it would close a circle with surer given supports",
            about=c.child,
        )
        for id, c in sorted(first.items())
        if chosen[id].parent != c.parent
    ]


def _said(o: SceneObject, chosen: Candidate, found: Sequence[Candidate], hang: Hanging | None) -> Decision:
    """What an object rests on and why."""
    if hang and hang.is_sure:
        choice = "rests on something unseen, kept fixed where it is"
        return Decision(choice=choice, reason=hang.evidence, about=o.id, fallback=True)
    if hang and chosen.parent == GROUND:
        choice = "comes down to the ground, unless it hangs on something unseen"
        return Decision(choice=choice, reason=hang.evidence, about=o.id, fallback=True)
    further = _named(o.supports[1:])
    choice = f"rests on {name_of(chosen.parent)}" + (f", also on {further}" if further else "")
    if _overruled(chosen, found):
        return Decision(choice=choice, reason=chosen.evidence, about=o.id)
    rivals = [c for c in found if c.parent != chosen.parent]
    runner_up = min(rivals, key=lambda c: (c.cost, c.parent), default=None)
    against = f"; {name_of(runner_up.parent)}: {100 * likelihood(runner_up, found):.2g}% likely" if runner_up else ""
    return Decision(choice=choice, reason=chosen.evidence + against, about=o.id)


def _overruled(chosen: Candidate, found: Sequence[Candidate]) -> Decision | None:
    """Where a given support was chosen and another one found here."""
    best = min(found, key=lambda c: (c.cost, c.parent))
    if chosen.cost >= 0 or best.parent == chosen.parent:
        return None
    return Decision(
        choice=f"rests on {name_of(chosen.parent)} as given, not on {name_of(best.parent)} as found",
        reason=f"found: {best.evidence}",
        about=chosen.child,
    )


def _named(supports: Sequence[Support]) -> str:
    return ", ".join(f"{name_of(s.id)} ({100 * s.share:.0f}%)" for s in supports)


class _Counts(TypedDict):
    on_ground: int
    on_objects: int
    on_unseen: int
    given: int
    allowed: int


def _counts(scene: Scene, given: Given) -> _Counts:
    on_ground = sum(o.supported_by == GROUND for o in scene)
    unseen = sum(o.supported_by is None for o in scene)
    return {
        "on_ground": on_ground,
        "on_objects": len(scene.objects) - on_ground - unseen,
        "on_unseen": unseen,
        "given": given.count,
        "allowed": len(given.supports) + len(canonical(given.relations)) if given.count else 0,
    }
