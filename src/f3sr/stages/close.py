"""close: colliders cut back to the meshes at contacts, so that no object at rest shows a gap."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Interval

from f3sr.contact.compounds import Compound, free_travel, placed
from f3sr.contact.contact_patches import find_contacts
from f3sr.contact.footing import footing_again, supplied
from f3sr.contact.static_bodies import center_of
from f3sr.contact.undersides import FootingConfig
from f3sr.contact.vertical_gap import Meeting, meeting
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, pose, transform
from f3sr.metrics.contact_groups import IOU_OF_GAP, SettledScene, groups_of, mean_gain
from f3sr.metrics.measures import visible_ious
from f3sr.physics.contact_margin import DEFAULT_MARGIN, TOUCHING, ContactMargin
from f3sr.proxies import trim
from f3sr.proxies.trim import MeshSurface, Near, Place
from f3sr.report import Decision, Measure, Outcome
from f3sr.scene import GROUND, Scene, SceneObject, names_of
from f3sr.settings import constants, settings
from f3sr.vision import depth_prior

SEEN = 0.5
"""Standard deviation of an object's place across its viewing ray, as the photo tells it [px]."""
SHOWN = 0.02
"""Loss of visible IoU of a group, by being lowered straight down, at which it is lowered along viewing rays at once."""
STEPS = 24
"""Maximum number of contacts that are cut free, one by one, while one object is lowered."""


@constants
class CutBackConfig:
    """How colliders are cut back at contacts. Lengths are shares of the smaller of the two sizes."""

    tolerance: float = 5e-4
    """Largest distance of a collider from its mesh at a contact, on each side."""
    radius: float = 0.03
    """Radius around a contact in which colliders are cut back: as far as objects move while they settle. It doubles in
    every round, so that an object that rolled may stay."""
    reach: float = 0.1
    """Largest distance from a contact at which the mesh is searched: parts hardly stand off farther."""
    added: int = 64
    """Most convex parts that splits add to one object. Crumpled meshes are hollow at every contact, and every part
    costs time of physics."""


@settings
class CloseConfig:
    """When the gap below an object at rest is closed, and at what cost."""

    rounds: Annotated[int, Interval(ge=0, le=10)] = 3
    """Most rounds in which objects are lowered and settled; settling tilts them onto other contacts."""
    loss: Annotated[float, Interval(ge=0, le=1)] = 0.005
    """Largest mean loss of visible IoU of a group of touching objects. A group that loses more is put back."""
    cut: CutBackConfig = CutBackConfig()
    footing: FootingConfig = FootingConfig()
    """That of ``separate``: footings are made anew on what was cut back."""
    contact: ContactMargin = DEFAULT_MARGIN
    """Its clearance stays below a lowered object. Objects that are ``apart`` by it do not affect each other."""


@dataclass(frozen=True, kw_only=True)
class Closed(Outcome):
    """What ``close`` did. Pairs are before and after; mappings are by object id."""

    stage: ClassVar[str] = "close"
    gaps: Mapping[int, tuple[float, float]] = field(default_factory=dict[int, tuple[float, float]])
    """Vertical gap below each object [m]."""
    parts: Mapping[int, tuple[int, int]] = field(default_factory=dict[int, tuple[int, int]])
    """Number of convex parts of each object that was cut."""

    @property
    def measures(self) -> tuple[Measure, ...]:
        return (
            *(
                Measure(name="gap below", before=1000 * was, after=1000 * now, unit="mm", about=id)
                for id, (was, now) in self.gaps.items()
            ),
            *(Measure(name="convex parts", before=was, after=now, about=id) for id, (was, now) in self.parts.items()),
        )


def close(
    scene: Scene,
    config: CloseConfig | None = None,
    *,
    settled: Callable[[Scene], SettledScene],
    restless: Collection[int] = (),
) -> tuple[Scene, Closed]:
    """Lower objects whose mesh has a gap above its support, and settle them, until all meshes touch.

    Convex parts stand off their mesh, so colliders meet before meshes do. The colliders are cut back at contacts. A gap
    that a footing supplies for a short underside stays. ``settled`` runs physics. A group of touching objects keeps its
    new state if it rests and loses little visible IoU. One that loses more by being lowered is lowered along viewing
    rays next: that hardly shows. Groups with a ``restless`` id, which do not rest, stay as they are. Returns the scene
    with poses, parts and footings changed, and the outcome with gaps in metres.
    """
    config = config or CloseConfig()
    left = {id for g in groups_of(scene, scene, config.contact.apart) if g.intersection(restless) for id in g}
    start, gaps = scene, _gaps(scene)
    decisions, spoilt, lost = list[Decision](), set[int](), frozenset[int]()
    for k in range(config.rounds):
        wider = replace(config, cut=replace(config.cut, radius=min(0.5, config.cut.radius * 2**k)))
        tried = lowered(scene, wider, but=left | spoilt, along_rays=lost)
        if shown := _shown(scene, tried, config) - lost:
            lost |= shown
            tried = lowered(scene, wider, but=left | spoilt, along_rays=lost)
        changed = frozenset(o.id for o in scene if tried[o.id] is not o)
        if not changed:
            break
        scene, told, spoiling, losing = _better(start, scene, tried, changed, config, settled)
        decisions += told
        first = losing - lost
        spoilt |= spoiling - first
        lost |= first
    after = _gaps(scene)
    cut = [(start[o.id], o) for o in scene if o.parts is not start[o.id].parts]
    return scene, Closed(
        gaps={id: (gap, after[id]) for id, gap in gaps.items()},
        parts={now.id: (len(was.parts), len(now.parts)) for was, now in cut},
        decisions=tuple(decisions),
    )


def _gaps(scene: Scene) -> Mapping[int, float]:
    return {o.id: _gap(o, scene) for o in scene}


def _gap(o: SceneObject, scene: Scene) -> float:
    return meeting(o, [other for other in scene if other.id != o.id]).gap


def _better(
    start: Scene,
    before: Scene,
    tried: Scene,
    changed: frozenset[int],
    config: CloseConfig,
    settled: Callable[[Scene], SettledScene],
) -> tuple[Scene, list[Decision], frozenset[int], frozenset[int]]:
    """``before`` with the groups of ``tried`` that rest after settling and keep the visible IoU that they had at the
    ``start``.

    Also returns decisions, the ids of objects that make their group fail, and of what changed in groups that are off
    their masks already as they are lowered. Only groups that changed are settled."""
    moving = frozenset(id for g in groups_of(before, tried, config.contact.apart) if g & changed for id in g)
    rested = settled(replace(tried, objects=tuple(o for o in tried if o.id in moving)))
    after = tried.with_objects(*rested.scene)
    was, now, sunk = visible_ious(start), visible_ious(after), SettledScene(scene=tried, restless=frozenset())
    scene, decisions, spoiling, losing = before, list[Decision](), set[int](), set[int]()
    for group in groups_of(before, after, config.contact.apart):
        if not group & changed:
            continue
        losses = {id: was[id] - now[id] for id in sorted(group)}
        loss = float(np.mean(list(losses.values())))
        reason = f"visible IoU of the group {-loss:+.4f}"
        restless, apart = group & rested.restless, group - moving
        if restless:
            reason += f", not at rest: {names_of(restless)}"
        if apart:
            reason += f", touched, but not settled with it: {names_of(apart)}"
        allowed = max(config.loss, IOU_OF_GAP * _closed(start, after, group & changed))
        is_better = not restless and not apart and loss <= allowed
        verdict = "accepted" if is_better else "rolled back"
        choice = f"colliders cut back of {names_of(group & changed)}: {verdict}"
        decisions.append(Decision(choice=choice, reason=reason))
        if is_better:
            scene = scene.with_objects(*(after[id] for id in sorted(group)))
        else:
            spoiling |= restless or {id for id, lost in losses.items() if lost > allowed}
            losing |= group & changed if not restless and mean_gain(group, sunk.ious, was) > allowed else set()
    return scene, decisions, frozenset(spoiling), frozenset(losing)


def _shown(before: Scene, sunk: Scene, config: CloseConfig) -> frozenset[int]:
    """Objects that are lowered in groups that lose over ``SHOWN`` of visible IoU by that alone; none where a sensor
    tells how far away they are."""
    changed = {o.id for o in before if sunk[o.id] is not o}
    if before.has_measured_depth or not changed:
        return frozenset()
    was, now = visible_ious(before), visible_ious(sunk)
    groups = groups_of(before, sunk, config.contact.apart)
    return frozenset(id for g in groups if mean_gain(g, now, was) > SHOWN for id in g & changed)


def _closed(before: Scene, after: Scene, ids: Collection[int]) -> float:
    """Decrease of the widest gap below some objects, as a share of their size."""
    was, now = (max(_gap(s[id], s) / s[id].size for id in ids) for s in (before, after))
    return was - now


def lowered(scene: Scene, config: CloseConfig, *, but: Collection[int] = (), along_rays: Collection[int] = ()) -> Scene:
    """The scene with all objects lowered that have a gap above their support, ``but`` some, supports first; some
    ``along_rays`` as far as their depth is uncertain.

    An object goes down with its subtree until colliders meet. They are cut back there, and it goes on until its mesh
    meets another mesh. Objects without a gap stay the same values.
    """
    layout = _Layout(scene, config, frozenset(along_rays))
    for id in scene.supports_first:
        if scene[id].supported_by is not None and id not in but:
            layout.lower(id)
    return scene.with_objects(*(body.now for body in layout.bodies.values()))


class _Layout:
    """The mutable state of ``close``: all objects while they are lowered."""

    def __init__(self, scene: Scene, config: CloseConfig, along_rays: frozenset[int]) -> None:
        self.scene, self.config, self.along_rays = scene, config, along_rays
        self.sigmas = depth_prior.sigmas(scene) if along_rays else {}
        self.bodies = {o.id: _Lowered(o, len(o.parts) + config.cut.added) for o in scene}

    def lower(self, id: int) -> None:
        """Lower an object with its subtree until its mesh meets another mesh, or no more can be cut back."""
        members = self.scene.subtree(id)
        if any(self.scene[k].mobility == "fixed" for k in members):
            return
        others = [b.now for k, b in self.bodies.items() if k not in members]
        goal = meeting(self.bodies[id].now, others)
        if self.scene.has_measured_depth:
            goal = replace(goal, gap=goal.gap - self.bodies[id].supplied)
        near = self._near(id, goal.other)
        if goal.gap <= self.config.contact.clearance + 2 * near.tolerance:
            return
        self._meet(id, goal, near)
        way = self._way(id, members, goal.gap)
        drop = 0.0
        for _ in range(STEPS):
            drop += self._move(members, self._room(members, way), way)
            if goal.gap - drop <= 2 * near.tolerance or not self._cut_free(members, goal.gap - drop):
                break
        self._move(members, self._room(members, way) - self.config.contact.clearance, way)
        self._stand_again(id)

    def _way(self, id: int, members: tuple[int, ...], drop: float) -> Array:
        """The way (3,) on which some objects go down by 1: straight down, or the one of least cost. That is straight
        down too where several objects carry the lowest one, which lies between them, and where anything but what
        carries it is in its way before it is down by ``drop`` [m]."""
        o, camera = self.bodies[id].now, self.scene.camera
        if id not in self.along_rays or len(o.carriers) > 1:
            return -UP
        ray = o.middle - camera.center
        distance = float(np.linalg.norm(ray))
        ray /= distance
        along, across = self.sigmas[id] * distance, SEEN * distance / float(camera.K[0, 0])
        # A shift d with d_z = -1 of least cost d' C^-1 d is -C z / z' C z.
        spread = across**2 * UP + (along**2 - across**2) * ray[2] * ray
        way = -spread / spread[2]
        mine, _ = self._parted(members)
        beside = Compound.of(b.body for k, b in self.bodies.items() if k not in members and k not in o.carriers)
        return way if free_travel(mine, beside, way) > drop else -UP

    def _stand_again(self, id: int) -> None:
        """Make the footing of an object anew, as what it rests on was cut back."""
        if not self.scene[id].footing:
            return
        o, members = self.bodies[id].now, self.scene.subtree(id)
        wedges, rise = footing_again(
            o,
            [self.bodies[k].now for k in o.carriers if k != GROUND],
            self._parted(members)[1],
            self.config.footing,
            clearance=self.config.contact.clearance,
            center=center_of([self.bodies[k].now for k in self.scene.load(id)]),
            below=self.bodies[id].supplied if self.scene.has_measured_depth else 0.0,
        )
        self.bodies[id].stand(wedges)
        self._move(members, -rise, -UP)

    def _parted(self, members: tuple[int, ...]) -> tuple[Compound, Compound]:
        """Bodies of some objects, and of all others."""
        mine = Compound.of(self.bodies[k].body for k in members)
        return mine, Compound.of(b.body for k, b in self.bodies.items() if k not in members)

    def _meet(self, id: int, goal: Meeting, near: Near) -> None:
        """Cut back colliders between the two points that are to meet."""
        self.bodies[id].cut_on(goal.above, -UP, near)
        if goal.other != GROUND:
            self.bodies[goal.other].cut_on(goal.below, UP, near)

    def _room(self, members: tuple[int, ...], way: Array) -> float:
        """Distance [m] that some objects can be lowered on a way (3,) until colliders meet."""
        mine, others = self._parted(members)
        return min(mine.lowest, free_travel(mine, others, way))

    def _move(self, members: tuple[int, ...], drop: float, way: Array) -> float:
        for k in members:
            self.bodies[k].shift(drop * way)
        return drop

    def _cut_free(self, members: tuple[int, ...], left: float) -> bool:
        """Cut back colliders that meet below objects that must go ``left`` [m] down. Returns whether any was cut."""
        found = find_contacts(self._around(members), reach=TOUCHING)
        cut, shaved = False, set[int]()
        for a, b, x, n in zip(found.upper.tolist(), found.lower.tolist(), found.points, found.normals, strict=True):
            if (a in members) == (b in members):
                continue
            near = self._near(a, b)
            if a in members and a not in shaved and self.bodies[a].stands_on_footing(x, near):
                shaved.add(a)
                cut |= self.bodies[a].shave(n, x, left * float(n[2]))
            for id in (a, b):
                if id != GROUND:
                    cut |= self.bodies[id].cut_near(x, near)
        return cut

    def _around(self, members: tuple[int, ...]) -> dict[int, Compound]:
        """Bodies of some objects and of all whose boxes overlap theirs."""
        boxes = {k: b.body.bounds for k, b in self.bodies.items()}
        low = np.min([boxes[k][0] for k in members], axis=0) - TOUCHING
        high = np.max([boxes[k][1] for k in members], axis=0) + TOUCHING
        reached = [k for k, box in boxes.items() if (box[0] <= high).all() and (box[1] >= low).all()]
        return {k: self.bodies[k].body for k in reached}

    def _near(self, a: int, b: int) -> Near:
        size = min(self.scene[k].size for k in (a, b) if k != GROUND)
        cut = self.config.cut
        return Near(tolerance=cut.tolerance * size, radius=cut.radius * size, reach=cut.reach * size)


class _Lowered:
    """An object while it is lowered and its colliders are cut back; points and lengths are in the world."""

    def __init__(self, o: SceneObject, most: int) -> None:
        self._start, self._shift, self._most = o, np.zeros(3), most
        self.now = o
        """The present object."""
        self.supplied = supplied(o)
        """Height [m] that its footing supplies below its mesh, which is no gap to be closed."""

    @cached_property
    def body(self) -> Compound:
        """All colliders, footing included, in the world."""
        return placed(self.now.solids, self.now.T_world_asset)

    @cached_property
    def _surface(self) -> MeshSurface:
        return MeshSurface.of(self._start.mesh)

    def shift(self, way: Array) -> None:
        if not way.any():
            return
        self._shift = self._shift + way
        reason = f"lowered by {-1000 * self._shift[2]:.2f} mm, until its mesh meets what it rests on"
        moved = self._start.moved(pose(t=self._shift), stage="close", reason=reason)
        self._change(replace(moved, parts=self.now.parts, footing=self.now.footing))

    def stand(self, wedges: tuple[ConvexPart, ...]) -> None:
        """Replace the footing by other wedges (asset frame)."""
        self._change(replace(self.now, footing=wedges))

    def cut_on(self, point: Array, outward: Array, near: Near) -> bool:
        """Cut back parts that stand off a mesh point (3,) in a direction (3,). Returns whether any was cut."""
        there = trim.place_on(self._surface, self.now.parts, *self._to_asset(point, outward))
        return self._trim(there, near)

    def cut_near(self, x: Array, near: Near) -> bool:
        """Cut back parts that stand off the mesh at a contact point (3,). Returns whether any was cut."""
        point, _ = self._to_asset(x, UP)
        there = trim.place_near(self._surface, self.now.parts, point, near.scaled(1 / self.now.scale))
        return there is not None and self._trim(there, near)

    def stands_on_footing(self, x: Array, near: Near) -> bool:
        """Whether a contact point (3,) is on the footing, with no mesh near."""
        footing = self.body[len(self.body) - len(self.now.footing) :]
        if not any(float((p.normals @ x - p.offsets).max()) <= 2 * TOUCHING for p in footing):
            return False
        return self._surface.nearest(self._to_asset(x, UP)[0], near.tolerance / self.now.scale) is None

    def shave(self, upward: Array, x: Array, height: float) -> bool:
        """Remove a layer of ``height`` [m] from the footing's underside, a plane through x with normal ``upward``."""
        point, n = self._to_asset(x, -upward)
        offset = float(n @ point) - height / self.now.scale
        cut = [trim.less(p, n, offset, self._surface.size) for p in self.now.footing]
        self._change(replace(self.now, footing=tuple(p for p in cut if p is not None)))
        return True

    def _trim(self, there: Place, near: Near) -> bool:
        parts = trim.trimmed(self._surface, self.now.parts, there, near.scaled(1 / self.now.scale), most=self._most)
        if len(parts) == len(self.now.parts) and all(a is b for a, b in zip(parts, self.now.parts, strict=True)):
            return False
        self._change(replace(self.now, parts=parts))
        return True

    def _change(self, o: SceneObject) -> None:
        self.now = o
        self.__dict__.pop("body", None)

    def _to_asset(self, point: Array, direction: Array) -> tuple[Array, Array]:
        """A point (3,) and a unit direction (3,) of the world in the asset's frame."""
        R = self.now.T_world_object[:3, :3]
        T_asset_world: Array = np.linalg.inv(self.now.T_world_asset).astype(np.float64)
        return transform(T_asset_world, point[None])[0], R.T @ direction
