"""separate: the smallest moves after which every object touches its support and no two overlap."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field, replace
from itertools import combinations
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from f3sr import contact, landing, parting
from f3sr.bodies import StaticBody, bodies_of, contacts_of, rigid
from f3sr.contact import Polytope
from f3sr.equilibrium import Balance
from f3sr.footing import GROUND_PLANE, FootingConfig, Plane, flush, footing, support_plane
from f3sr.frames import UP, Array, pose, rotation_from_vector, transform, vector_from_rotation
from f3sr.landing import LandingConfig
from f3sr.measures import visible_ious
from f3sr.mesh import ConvexPart
from f3sr.physics import DEFAULT_PHYSICS
from f3sr.report import Decision, Measure, Report
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.sensitivity import loss_matrix
from f3sr.settings import settings

STILL = 1e-3
"""Turn [rad] that is not worth laying an object down."""
UNFELT = 0.1
"""IoU that a move by its own size costs an object in directions which the picture does not feel."""
PASSES = 3
"""Most times that objects are seated and then parted, which may take them off their supports again."""
WAYS_BACK = (0.0, 0.5, 1.0)
"""Shares of an object's way along the viewing rays that are taken back before it is laid down."""
PARTS_OF_A_TURN = (0.25, 0.5, 0.75)
"""Of the turn until an object lies, after which it is tried whether a footing makes it stand."""
ROOM = 1.2e-3
"""Gap [m] that counts as contact while it is asked whether a footing makes a body stand: parts stand off the mesh, so
that they may keep a wedge that much off its support."""
RAY_STEPS = 10
"""Places to either side that are tried along the viewing rays before the best is refined."""


@settings
class SeparateConfig:
    clearance: Annotated[float, Interval(ge=0, le=0.01)] = 3.2e-4
    """Gap left between parted objects [m] (eps_g of equation 11): the contact margins of the two
    bodies added, so that nothing pushes when physics starts."""
    max_ray_scale: Annotated[float, Interval(ge=0, le=0.5)] = 0.1
    """How far an object may slide along its viewing rays to reach its support, as a share of its distance to the
    camera; 0 turns it off. The right factor lies within .07 of 1 on scenes with known poses."""
    depth_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.01
    """How well the distance to an object is known where the photo has a geometry, as a share of it (one standard
    deviation; .009 between the objects of ten known scenes after alignment)."""
    unknown_depth_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.03
    """The same where it has none (.022 of the poses of generated assets)."""
    picture_sigma: Annotated[float, Interval(gt=0, le=1)] = 0.02
    """How well an object's place in the picture is known, as the IoU with its mask that lifting or lowering it costs:
    more trust in the picture costs places in depth, less costs the picture without places gained."""
    slide_sigma: Annotated[float, Interval(gt=0, le=10)] = 0.25
    """How well its place on another object is known, as a share of its size: moving along the viewing rays must not
    take it over the edge of what it rests on."""
    rounds: Annotated[int, Interval(ge=1, le=100)] = 16
    """Most rounds of horizontal parting; the report allows 32."""
    footing: FootingConfig = field(default_factory=FootingConfig)
    landing: LandingConfig = field(default_factory=lambda: LandingConfig(max_turn=0.5, max_shift=0.1))


def separate(scene: Scene, config: SeparateConfig | None = None) -> tuple[Scene, Report]:
    """Bring every object onto its support and part what overlaps (equations 10 and 11).

    First all objects together are moved along their viewing rays to where half of them would sink into the ground.
    In forest order an object is then brought into contact with its support, with all that rests on it: along its
    viewing rays, scaled alike about the camera centre, which leaves the picture as it is, and by the smallest lift, or
    by lowering, each as far as is likely by what is known of distances and of the picture. Then unrelated objects that
    overlap are parted by one joint horizontal move, each with all it carries. At last a nearly flat underside gets a
    footing, so that physics leaves the object as it stands, and what has none is laid down. What still overlaps is
    counted, never hidden.
    """
    config = config or SeparateConfig()
    scene = scene.with_objects(*(replace(o, footing=()) for o in scene if o.footing))
    layout = _Layout(scene)
    before = len(layout.collisions())
    layout.all_along_rays(_common_scale(layout, config))
    for _ in range(PASSES):
        _seat(layout, config)
        if not _part(layout, config):
            break
    else:
        _seat(layout, config)
    decisions = _stand(layout, config)
    left = layout.collisions()
    decisions += [
        Decision(choice=f"still overlaps {_name(b)} after separation", reason="no free place found", about=a)
        for a, b in left
    ]
    moved = scene.with_objects(*(layout.object(o.id) for o in scene))
    measures = [Measure(name="overlapping pairs", before=before, after=len(left))]
    measures += [Measure(name="moved", after=1000 * layout.travel(o.id), unit="mm", about=o.id) for o in scene]
    measures += [
        Measure(name="scale along viewing rays", after=layout.scale[o.id], before=1.0, about=o.id) for o in scene
    ]
    return moved, Report(stage="separate", measures=tuple(measures), decisions=tuple(decisions))


class _Layout:
    """Where the bodies are while they are being moved: polytopes in the world under ``x -> scale R x + shift``."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.bodies = {o.id: _polytopes(o, o.parts) for o in scene}
        self.footings: dict[int, tuple[ConvexPart, ...]] = {}
        self.parts: dict[int, tuple[ConvexPart, ...]] = {o.id: o.parts for o in scene}
        self.shift: dict[int, Array] = {o.id: np.zeros(3) for o in scene}
        self.scale: dict[int, float] = {o.id: 1.0 for o in scene}
        self.rotation: dict[int, Array] = {o.id: np.eye(3) for o in scene}
        self.common = 1.0
        """What all were scaled by at the start."""

    def saved(self) -> tuple[dict[int, Any], ...]:
        """Where everything is, for ``restore``."""
        state = (self.bodies, self.footings, self.parts, self.shift, self.scale, self.rotation)
        return tuple(dict(d) for d in state)

    def restore(self, saved: tuple[dict[int, Any], ...]) -> None:
        self.bodies, self.footings, self.parts, self.shift, self.scale, self.rotation = (dict(d) for d in saved)

    def move(self, ids: tuple[int, ...], t: Array, *, scale: float = 1.0) -> None:
        """Apply ``x -> scale x + t`` to bodies; fixed ones stay."""
        for id in ids:
            if self.scene[id].mobility == "fixed":
                continue
            self.bodies[id] = _moved(self.bodies[id], t, scale)
            self.shift[id] = scale * self.shift[id] + t
            self.scale[id] *= scale

    def turn(self, ids: tuple[int, ...], T: Array) -> None:
        """Apply a rigid motion (4, 4) to bodies; fixed ones stay."""
        for id in ids:
            if self.scene[id].mobility == "fixed":
                continue
            self.bodies[id] = tuple(p.moved(T) for p in self.bodies[id])
            self.shift[id] = transform(T, self.shift[id][None])[0]
            self.rotation[id] = T[:3, :3] @ self.rotation[id]

    def along_rays(self, ids: tuple[int, ...], k: float) -> None:
        """The homothety ``X -> C + k (X - C)`` about the camera centre C: no silhouette changes."""
        self.move(ids, (1 - k) * self.scene.camera.center, scale=k)

    def object(self, id: int) -> SceneObject:
        """The scene's object where its body is now."""
        o, t, k, R = self.scene[id], self.shift[id], self.scale[id], self.rotation[id]
        if t.any() or k != 1 or (np.eye(3) != R).any():
            reason = f"onto its support and out of others: {1000 * self.travel(id):.1f} mm, scale {k:.4f}"
            o = o.moved(pose(R, t), scale=k, stage="separate", reason=reason)
        return replace(o, parts=self.parts[id], footing=self.footings.get(id, ()))

    def carriers(self, id: int) -> tuple[Polytope, ...]:
        """All that carries a body but the ground."""
        return tuple(p for k in _supports(self.scene[id]) if k != GROUND for p in self.bodies[k])

    def stand(self, id: int, parts: tuple[ConvexPart, ...], wedges: tuple[ConvexPart, ...]) -> None:
        """Put a body with other parts on a footing (asset frame)."""
        self.parts[id], self.footings[id] = parts, wedges
        self.bodies[id] = _polytopes(self.object(id), (*parts, *wedges))

    def all_along_rays(self, k: float) -> None:
        """Move the whole scene; it uses up nobody's way along the rays."""
        self.along_rays(tuple(self.bodies), k)
        self.common = k

    def rays_left(self, id: int, limit: float) -> tuple[float, float]:
        """The least and largest k that keep a body within ``limit`` of where it was along its viewing rays."""
        used = self.scale[id] / self.common
        return min(1.0, (1 - limit) / used), max(1.0, (1 + limit) / used)

    def distance(self, id: int) -> float:
        """From the camera to the middle of a body [m]."""
        place = self.place(id, self.scene[id].bounds_world.mean(0))
        return float(np.linalg.norm(place - self.scene.camera.center))

    def travel(self, id: int) -> float:
        """How far the middle of a body has moved [m]."""
        middle = self.scene[id].bounds_world.mean(0)
        return float(np.linalg.norm(self.place(id, middle) - middle))

    def place(self, id: int, point: Array) -> Array:
        """Where a point (3,) of a body is now."""
        return self.scale[id] * (self.rotation[id] @ point) + self.shift[id]

    def loss(self, id: int) -> Array:
        """What the picture feels of a body's shifts: W (3, 3), d' W d the square of the IoU it loses."""
        o = self.scene[id]
        return loss_matrix(o.mask, self.scene.camera, self.place(id, o.bounds_world.mean(0)))

    def lowest(self, id: int) -> float:
        return min(float(p.bounds[0, 2]) for p in self.bodies[id])

    def collisions_of(self, id: int) -> set[int]:
        """Other bodies that a body overlaps."""
        return {k for k in self.bodies if k != id and contact.collide(self.bodies[id], self.bodies[k])}

    def collisions(self) -> list[tuple[int, int]]:
        """Pairs of ids that overlap, the ground included as the second."""
        pairs = [(a, b) for a, b in combinations(self.bodies, 2) if contact.collide(self.bodies[a], self.bodies[b])]
        return pairs + [(id, GROUND) for id in self.bodies if self.lowest(id) < -1e-9]


def _seat(layout: _Layout, config: SeparateConfig) -> None:
    """Bring every object into contact with its support, supports first, with the supported subtree."""
    for id in _supports_first(layout.scene):
        if layout.scene[id].supported_by is None:
            layout.move(layout.scene.subtree(id), max(0.0, config.clearance - layout.lowest(id)) * UP)
            continue
        if config.max_ray_scale:
            layout.along_rays(layout.scene.subtree(id), _contact_scale(layout, id, config))
        layout.move(layout.scene.subtree(id), -_gap(layout.bodies[id], id, layout, config) * UP)


def _gap(body: contact.Body, id: int, layout: _Layout, config: SeparateConfig) -> float:
    """How far a body hangs over its support and the ground [m]; negative: how far it must rise to be free of them."""
    lowest = min(float(p.bounds[0, 2]) for p in body) - config.clearance
    carriers = layout.carriers(id)
    if not carriers:
        return lowest
    rise = max(contact.smallest_shift(body, carriers, UP, config.clearance), -lowest)
    if rise > 0:
        return -rise
    return min(contact.free_travel(body, carriers, -UP) - config.clearance, lowest)


def _stand(layout: _Layout, config: SeparateConfig) -> list[Decision]:
    """Let every object stand before physics, supports first: as it is, on a footing, or turned until it lies."""
    decisions: list[Decision] = []
    for id in _supports_first(layout.scene):
        o = layout.object(id)
        if o.mobility == "fixed" or o.supported_by is None:
            continue
        decision = _put_on_a_footing(layout, o, config) or _lie_down(layout, o, config)
        if decision:
            decisions.append(decision)
    return decisions


def _put_on_a_footing(layout: _Layout, o: SceneObject, config: SeparateConfig) -> Decision | None:
    """Give an object where its body is now a footing, if that makes it stand and is in nobody's way."""
    plane = _plane_below(layout, o, config.footing) if config.footing.enabled else None
    wedges = footing(o, plane, config.footing) if plane else ()
    if not plane or not wedges:
        return None
    before, was = layout.saved(), layout.collisions_of(o.id)
    layout.stand(o.id, flush(o, plane), wedges)
    if layout.collisions_of(o.id) - was - set(_supports(o)):
        layout.restore(before)
        return None
    layout.move(layout.scene.subtree(o.id), -_gap(layout.bodies[o.id], o.id, layout, config) * UP)
    return _footing_decision(o, wedges)


def _lie_down(layout: _Layout, o: SceneObject, config: SeparateConfig) -> Decision | None:
    """Let an object come to lie from where it is, or from farther back on its way along the viewing rays: what leans may
    have been moved past what it leans on. Of where it stands, what shows most of the photo is kept."""
    members, start = layout.scene.subtree(o.id), layout.saved()
    was = {k: layout.collisions_of(k) for k in members}
    found: list[tuple[bool, float, int, tuple[dict[int, Any], ...], Decision | None]] = []
    for turn, share in enumerate(WAYS_BACK):
        layout.restore(start)
        layout.along_rays(members, float((layout.common / layout.scale[o.id]) ** share))
        layout.move(members, -_gap(layout.bodies[o.id], o.id, layout, config) * UP)
        if any(layout.collisions_of(k) - was[k] - set(members) for k in members):
            continue
        decision, stands = _laid_down(layout, layout.object(o.id), config)
        if turn == 0 and decision is None and stands:
            return None
        now = layout.scene.with_objects(*(layout.object(k.id) for k in layout.scene))
        found.append((stands, float(np.mean(list(visible_ious(now).values()))), -turn, layout.saved(), decision))
    if not found:
        layout.restore(start)
        return None
    if DEBUG: print(o.id, [(f[:3], f[4] and f[4].choice) for f in found])
    *_, saved, decision = max(found, key=lambda f: f[:3])
    layout.restore(saved)
    return decision


DEBUG=0
def _laid_down(layout: _Layout, o: SceneObject, config: SeparateConfig) -> tuple[Decision | None, bool]:
    """Turn an object, with all it carries, about its contacts until it lies, or only until a footing makes it stand;
    on the ground it keeps its place. What was done, and whether it stands."""
    members = layout.scene.subtree(o.id)
    whole, others = _parted(layout, o.id)
    found = landing.land(whole, others, config.landing, clearance=config.clearance)
    if found.tipped or found.turn < STILL:
        return None, found.stands
    if on_the_way := _lie_down_in_part(layout, o, whole.centers[0], found, config):
        return on_the_way, True
    was = {k: layout.collisions_of(k) for k in members}
    layout.turn(members, found.T)
    if o.supported_by == GROUND:
        back = whole.centers[0] - transform(found.T, whole.centers[:1])[0]
        lying = layout.saved()
        layout.move(members, np.append(back[:2], 0.0))
        if any(layout.collisions_of(k) - was[k] - set(members) for k in members):
            layout.restore(lying)
    decision = Decision(
        choice=f"laid down by {np.degrees(found.turn):.1f} degrees",
        reason="so that its weight is between its contacts before physics starts",
        about=o.id,
    )
    return decision, found.stands


def _parted(layout: _Layout, id: int) -> tuple[StaticBody, list[StaticBody]]:
    """A body with all it carries as one, and all others, held still."""
    members = layout.scene.subtree(id)
    bodies = {b.id: b for b in bodies_of([layout.object(k.id) for k in layout.scene], parts=layout.bodies)}
    whole = rigid([bodies[k] for k in members], id)
    return whole, [replace(bodies[k], fixed=True) for k in bodies if k not in members]


def _stands(layout: _Layout, id: int, config: SeparateConfig) -> bool:
    """Whether a body with all it carries stands by the margin that is asked of footings, all others held still."""
    whole, others = _parted(layout, id)
    everything = [whole, *others]
    contacts = contacts_of(everything, reach=ROOM)
    friction = DEFAULT_PHYSICS.ground_friction[0]
    return Balance([whole], everything, contacts, friction).margin()[0] >= config.footing.min_margin


def _lie_down_in_part(
    layout: _Layout, o: SceneObject, center: Array, found: landing.Landing, config: SeparateConfig
) -> Decision | None:
    """The least of a landing's turn, about an object's centre (3,), after which a footing makes it stand."""
    members = layout.scene.subtree(o.id)
    axis = vector_from_rotation(found.T[:3, :3])
    before, was = layout.saved(), {k: layout.collisions_of(k) for k in members}
    for share in PARTS_OF_A_TURN:
        R = rotation_from_vector(share * axis)
        T = pose(R, center - R @ center)
        layout.turn(members, T)
        above = min(layout.lowest(k) for k in members)
        layout.move(members, max(0.0, config.clearance - above) * UP)
        decision = _put_on_a_footing(layout, layout.object(o.id), config)
        is_free = not any(layout.collisions_of(k) - was[k] - set(members) for k in members)
        if decision and is_free and _stands(layout, o.id, config):
            turned = f"turned by {share * np.degrees(found.turn):.1f} of {np.degrees(found.turn):.1f} degrees and "
            return replace(decision, choice=turned + decision.choice)
        layout.restore(before)
    return None


def _footing_decision(o: SceneObject, wedges: tuple[ConvexPart, ...]) -> Decision:
    height = max(float(np.ptp(w.moved(o.T_world_asset).vertices[:, 2])) for w in wedges)
    reason = (
        f"its underside, which no photo shows, is uneven or turned against what it stands on: up to "
        f"{1000 * height:.1f} mm ({100 * height / o.size:.1f} % of its size) added below it, for contact only"
    )
    return Decision(choice="given a footing", reason=reason, about=o.id)


def _plane_below(layout: _Layout, o: SceneObject, config: FootingConfig) -> Plane | None:
    """What a flat underside would rest on."""
    if o.supported_by == GROUND:
        return GROUND_PLANE
    below = [layout.object(k).colliders_world for k in _supports(o) if k != GROUND]
    return support_plane(o, [part for parts in below for part in parts], config)


def _common_scale(layout: _Layout, config: SeparateConfig) -> float:
    """The k by which all objects together are moved along their viewing rays, so that half of those on the ground
    would have to come nearer to reach it and half go farther: how high the camera stands is one number for all."""
    scales = [_ground_scale(layout, o.id, config) for o in layout.scene if o.supported_by == GROUND]
    limit = config.max_ray_scale
    return float(np.clip(np.median(scales), 1 - limit, 1 + limit)) if scales else 1.0


def _ground_scale(layout: _Layout, id: int, config: SeparateConfig) -> float:
    """The k at which a body, moved along its viewing rays, rests on the ground: C_z / (C_z - z_lowest)."""
    eye = float(layout.scene.camera.center[2])
    height = eye - layout.lowest(id)
    return (eye - config.clearance) / height if height > 1e-9 else 1.0


def _contact_scale(layout: _Layout, id: int, config: SeparateConfig) -> float:
    """The k by which the body is moved along its viewing rays before it is lifted or lowered onto its support.

    It is the most likely one: distances are known to ``depth_sigma`` and places in the picture to ``picture_sigma``,
    so k has the least (log k / depth_sigma)^2 + (loss(gap(k)) / picture_sigma)^2 within its bound, where loss is the
    IoU that the lift costs; on another object a third term holds it in place. Over the ground gap(k) is linear.
    """
    loss = float(np.sqrt(layout.loss(id)[2, 2]))
    sigma = config.depth_sigma if layout.scene.geometry else config.unknown_depth_sigma
    C, body = layout.scene.camera.center, layout.bodies[id]
    on_the_ground = layout.scene[id].supported_by == GROUND
    slide = 0.0 if on_the_ground else layout.distance(id) / (config.slide_sigma * layout.scene[id].size)

    def gap(k: float) -> float:
        if on_the_ground:
            return float(C[2]) + k * (layout.lowest(id) - float(C[2])) - config.clearance
        return _gap(_moved(body, (1 - k) * C, k), id, layout, config)

    def cost(k: float) -> float:
        lifted = loss * gap(k) / config.picture_sigma
        return float(np.log(k) / sigma) ** 2 + (slide * (k - 1)) ** 2 + lifted**2

    low, high = layout.rays_left(id, config.max_ray_scale)
    tried = np.linspace(low, high, 2 * RAY_STEPS + 1)
    best = int(np.argmin([cost(float(k)) for k in tried]))
    return _least(cost, float(tried[max(best - 1, 0)]), float(tried[min(best + 1, len(tried) - 1)]))


def _least(cost: Callable[[float], float], a: float, b: float) -> float:
    """Where ``cost`` is least between a and b, to 1e-4 (golden section search)."""
    ratio = (np.sqrt(5) - 1) / 2
    c, d = b - ratio * (b - a), a + ratio * (b - a)
    at_c, at_d = cost(c), cost(d)
    while b - a > 1e-4:
        if at_c < at_d:
            b, d, at_d = d, c, at_c
            c = b - ratio * (b - a)
            at_c = cost(c)
        else:
            a, c, at_c = c, d, at_d
            d = a + ratio * (b - a)
            at_d = cost(d)
    return (a + b) / 2


def _polytopes(o: SceneObject, parts: tuple[ConvexPart, ...]) -> tuple[Polytope, ...]:
    return tuple(Polytope.of(p).moved(o.T_world_asset) for p in parts)


def _moved(body: contact.Body, t: Array, scale: float) -> tuple[Polytope, ...]:
    T = pose(scale * np.eye(3), t)
    return tuple(p.moved(T) for p in body)


def _part(layout: _Layout, config: SeparateConfig) -> bool:
    """Part all unrelated pairs that overlap by one joint horizontal move, the one that the picture feels least; what an
    object carries goes with it. Returns whether anything moved."""
    moved = False
    for _ in range(config.rounds):
        pairs = [(a, b) for a, b in _unrelated(layout.scene) if contact.collide(layout.bodies[a], layout.bodies[b])]
        if not pairs:
            break
        found = parting.part(
            layout.bodies,
            pairs,
            {o.id: _weight(layout, o.id) for o in layout.scene if o.mobility == "dynamic"},
            carriers={o.id: None if o.supported_by == GROUND else o.supported_by for o in layout.scene},
            clearance=config.clearance,
        )
        for id, shift in found.own.items():
            layout.move(layout.scene.subtree(id), np.append(shift, 0.0))
            moved = moved or bool(shift.any())
        if len(found.unsolved) == len(pairs):
            break
    return moved


def _weight(layout: _Layout, id: int) -> Array:
    """What moving a body with all it carries costs (2, 2): the IoU that they lose, and a little per length."""
    felt = sum((layout.loss(k)[:2, :2] for k in layout.scene.subtree(id)), np.zeros((2, 2)))
    return felt + np.eye(2) * (UNFELT / layout.scene[id].size) ** 2


def _unrelated(scene: Scene) -> Iterator[tuple[int, int]]:
    """Pairs that neither carry nor contain one another."""
    inside = scene.graph.of("inside") | {(b, a) for a, b in scene.graph.of("contains")}
    for a, b in combinations([o.id for o in scene], 2):
        carried = a in _carriers(scene, b) or b in _carriers(scene, a)
        related = carried or (a, b) in inside or (b, a) in inside
        if not related:
            yield a, b


def _carriers(scene: Scene, id: int) -> set[int]:
    """All that carries an object, directly or not."""
    return {*scene.ancestors(id), *_supports(scene[id])}


def _supports(o: SceneObject) -> list[int]:
    """Ids of what an object rests on, its place in the forest included."""
    main = () if o.supported_by is None else (o.supported_by,)
    return sorted({*main, *(s.id for s in o.supports)})


def _supports_first(scene: Scene) -> list[int]:
    return sorted((o.id for o in scene), key=lambda id: (len(scene.ancestors(id)), id))


def _name(id: int) -> str:
    return "the ground" if id == GROUND else f"object {id}"
