"""Where things are in a scene, for whoever sets one off: outlines, free ways, tops, friction, the photo's frame."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from f3sr.contact.compounds import Compound, free_travel, placed
from f3sr.core.transforms import UP, Array, transform
from f3sr.goals.cavity import Cavity, cavity_of
from f3sr.physics import mujoco_model
from f3sr.physics.mujoco_model import Body, engine
from f3sr.physics.restitution import solref
from f3sr.scene import GRAVITY, GROUND, Scene
from f3sr.vision.rasterizer import render

ROUND = 0.24
"""Share by which the radii of what rolls differ at most: an octagon's differ by .08, a square's by .3."""

LONG = 1.5
"""Factor by which what lies is longer than high. What is as much higher than deep stands on an edge."""
VIEW = 256
"""Longer side of the picture in which objects hide others [px]: places of things that fall are no nearer."""


def outline(points: Array) -> Array:
    """Sides (k, 3) of the convex hull of points (n, 2): inside is ``n . x + c <= 0`` with unit normals n."""
    from scipy.spatial import ConvexHull

    return np.asarray(ConvexHull(points).equations)


def base_of(corners: Array) -> Array:
    """The lowest of an object's corners (n, 3), within 2 % of its height: generated undersides are not quite level."""
    return corners[corners[:, 2] <= corners[:, 2].min() + 0.02 * np.ptp(corners[:, 2])]


def way_between(a: Array, b: Array, u: Array) -> tuple[float, float]:
    """The interval of shifts along ``u`` (2,) at which the hull of ``a`` (n, 2) overlaps that of ``b`` (m, 2).

    It is empty if the first value is not less than the second."""
    sides = outline((b[:, None] - a[None]).reshape(-1, 2))
    speed, room = sides[:, :2] @ u, -sides[:, 2]
    if (room[np.abs(speed) < 1e-12] < 0).any():
        return np.inf, -np.inf
    with np.errstate(divide="ignore", invalid="ignore"):
        t = room / speed
    return float(np.max(t[speed < -1e-12], initial=-np.inf)), float(np.min(t[speed > 1e-12], initial=np.inf))


class SceneLayout:
    """A scene of objects as a plan makes them, at rest, and MuJoCo's model of it."""

    def __init__(self, scene: Scene, model: Any = None) -> None:
        self.scene, self._model = scene, model
        self._bodies: dict[int, Body] = {}
        self._corners: dict[int, Array] = {}
        self._polytopes: dict[int, Compound] = {}
        self._others: dict[int, Array] = {}

    @cached_property
    def model(self) -> Any:
        return self._model or mujoco_model.compiled(mujoco_model.build_spec(self.scene.objects))

    @cached_property
    def data(self) -> Any:
        data = engine().MjData(self.model)
        engine().mj_forward(self.model, data)
        return data

    def body(self, id: int) -> Body:
        if id not in self._bodies:
            self._bodies[id] = mujoco_model.body_of(self.scene[id])
        return self._bodies[id]

    def mass(self, id: int) -> float:
        return self.body(id).mass

    def loaded_mass(self, id: int) -> float:
        """With all that rests on it [kg]."""
        return sum(self.mass(i) for i in self.scene.subtree(id))

    def center(self, id: int) -> Array:
        """Centre of mass (3,) [m]."""
        return transform(self.scene[id].T_world_object, self.body(id).center[None])[0]

    def inertia(self, id: int) -> Array:
        """(3, 3) about the centre of mass, in the world."""
        R = self.scene[id].T_world_object[:3, :3]
        return np.asarray(R @ self.body(id).inertia @ R.T)

    def corners(self, id: int) -> Array:
        """(n, 3): corners of what touches, in the world."""
        if id not in self._corners:
            parts = np.concatenate([q.vertices for q in self.body(id).parts])
            self._corners[id] = transform(self.scene[id].T_world_object, parts)
        return self._corners[id]

    def polytopes(self, id: int) -> Compound:
        """Its collision parts, in the world."""
        if id not in self._polytopes:
            T = self.scene[id].T_world_object
            self._polytopes[id] = placed(self.body(id).parts, T)
        return self._polytopes[id]

    @cached_property
    def ceiling(self) -> float:
        """Height of the highest point of all objects [m]."""
        return max(float(self.span(o.id)[1, 2]) for o in self.scene)

    def span(self, id: int) -> Array:
        """(2, 3): lowest and highest corner of the bounding box."""
        return np.stack([self.corners(id).min(0), self.corners(id).max(0)])

    def hull(self, id: int) -> Array:
        """(k, 2): corners of the outline seen from above."""
        from scipy.spatial import ConvexHull

        flat = self.corners(id)[:, :2]
        return flat[ConvexHull(flat).vertices]

    def size(self, id: int) -> float:
        return float(np.linalg.norm(np.ptp(self.span(id), axis=0)))

    def support(self, id: int) -> int:
        """What mainly carries it; the ground where nothing is known."""
        below = self.scene[id].supported_by
        return GROUND if below is None else below

    def floor_of(self, a: int, b: int) -> int:
        """What two objects stand on, directly or not: the nearest that carries both and holds neither. A desk for a cup
        and a mug on it; the ground for what stands on two desks, or lies in one bowl."""
        below = self.scene.ancestors(b)
        return next((k for k in self.scene.ancestors(a) if k in below and not self.pool(k)), GROUND)

    def friction(self, id: int) -> float:
        """Between an object and what carries it, as the engine takes it: the larger, or that of what bounces."""
        o, below = self.scene[id], self.support(id)
        if solref(o.restitution) is not None:
            return o.friction
        other = self.scene.ground.friction if below == GROUND else self.scene[below].friction
        return max(o.friction, other)

    def sliding_force(self, id: int) -> float:
        """Force [N] that moves an object, with all that rests on it, along what carries it."""
        return self.friction(id) * self.loaded_mass(id) * GRAVITY

    def is_ball(self, id: int) -> bool:
        """Whether it rolls whichever way."""
        return all(self.rolls(id, np.array([np.cos(a), np.sin(a), 0.0])) for a in np.linspace(0, np.pi, 4, False))

    def lies(self, id: int) -> bool:
        """Whether it is long, and its long axis nearly level: a bottle on its side. A box on a long side is no such
        thing, for it is higher than deep."""
        flat = self.hull(id)
        sides = np.diff(flat, axis=0, append=flat[:1])
        along = sides[np.linalg.norm(sides, axis=1) > 0]
        axes = along / np.linalg.norm(along, axis=1)[:, None]
        widths = np.array([np.ptp(flat @ [-y, x]) for x, y in axes])
        narrow = float(widths.min())
        x, y = axes[int(widths.argmin())]
        height = float(np.ptp(self.span(id)[:, 2]))
        return float(np.ptp(flat @ [x, y])) > LONG * height and height < LONG * narrow

    def can_roll(self, id: int) -> bool:
        """Whether it rolls some way, as balls, fruit and what lies on a round side."""
        return any(self.rolls(id, np.array([np.cos(a), np.sin(a), 0.0])) for a in np.linspace(0, np.pi, 12, False))

    def rolls(self, id: int, direction: Array) -> bool:
        """Whether it is round seen across a horizontal direction: about its middle as far to every side."""
        corners = self.corners(id) - self.span(id).mean(0)
        angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        far = np.max(corners @ (np.outer(direction, np.cos(angles)) + np.outer(UP, np.sin(angles))), axis=0)
        return bool(far.min() > (1 - ROUND) * far.max())

    def meets(self, id: int, direction: Array) -> list[tuple[float, int]]:
        """Objects in the path along a horizontal direction, nearest first, with the distance to each [m].

        Supports, objects on it and its container are left out."""
        own, (low, high), found = self.hull(id), self.span(id)[:, 2], list[tuple[float, int]]()
        besides = {*self.scene.subtree(id), *self.scene.ancestors(id), *(s.id for s in self.scene[id].supports)}
        for o in self.scene:
            bottom, top = self.span(o.id)[:, 2]
            if o.id in besides or bottom > high - 2e-3 or top < low + 2e-3:
                continue
            first, last = way_between(own, self.hull(o.id), direction[:2])
            if first < last and last > 0 and (first > -1e-3 or last > 0.3 * self.size(id)):
                found.append((max(first, 0.0), o.id))
        return sorted(found)

    def over_the_edge(self, id: int, support: int, direction: Array) -> float:
        """How far the centre of mass of what stands on something is from its edge along a direction [m]."""
        sides = outline(self.hull(support))
        speed = sides[:, :2] @ direction[:2]
        room = -(sides[:, :2] @ self.center(id)[:2] + sides[:, 2])
        ahead = speed > 1e-9
        return float(np.min(room[ahead] / speed[ahead]))

    def top(self, x: float, y: float, *, without: int = GROUND) -> tuple[float, int]:
        """Height of the highest surface at a place and whose it is; one object may be looked through."""
        above, hit = np.array([x, y, 100.0]), np.zeros(1, np.int32)
        body = -1 if without == GROUND else [o.id for o in self.scene].index(without) + 1
        far = engine().mj_ray(self.model, self.data, above, -UP, None, 1, body, hit)
        body = int(self.model.geom_bodyid[hit[0]]) if far >= 0 else 0
        return (100.0 - far if far >= 0 else 0.0), GROUND if body == 0 else self.scene.objects[body - 1].id

    def landing(self, id: int, shift: Array) -> tuple[float, int]:
        """Height of an object's lowest point when it is moved by (2,), lowered from above and first touches something.

        Returns it with the id of what it touches. Exact for the collision parts."""
        body, bottom = self.polytopes(id), float(self.span(id)[0, 2])
        start = [p.shifted([*shift, self.ceiling - bottom]) for p in body]
        travels = [(self.ceiling, GROUND)]
        travels += [(free_travel(start, self.polytopes(o.id), -UP), o.id) for o in self.scene if o.id != id]
        far, whose = min(travels)
        return self.ceiling - far, whose

    def pool(self, id: int) -> Cavity | None:
        """What of it would hold water; None where that is too little for things to lie in."""
        return cavity_of(self.scene[id])

    def spots(self, id: int) -> list[Array]:
        """Places (2,) on an object where nothing else stands, the nearest to its middle first."""
        low, high = self.span(id)[:, :2]
        found = list[tuple[float, Array]]()
        for i, j in np.ndindex(7, 7):
            place = low + (high - low) * (np.array([i, j]) + 0.5) / 7
            round_it = [place + 0.05 * (high - low) * k for k in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
            tops = [self.top(float(x), float(y)) for x, y in round_it]
            if all(whose == id for _, whose in tops):
                found.append((float(np.linalg.norm((place - (low + high) / 2) / (high - low))) - 1e-6 * i, place))
        return [place for _, place in sorted(found, key=lambda f: f[0])]

    def under(self, id: int, shift: Array, *, reach: tuple[float, float] = (0.5, 0.97)) -> list[tuple[float, int]]:
        """Heights of the surfaces below an object's outline shifted by (2,), and whose they are, itself left out."""
        hull = self.hull(id) + shift
        middle = hull.mean(0)
        places = [
            middle,
            *(middle + f * (corner - middle) for corner in hull[:: max(1, len(hull) // 8)] for f in reach),
        ]
        return [self.top(float(x), float(y), without=id) for x, y in places]

    def in_frame(self, id: int, shift: Array) -> float:
        """Share of an object's corners that the photo's frame holds when it is shifted (3,)."""
        return self.scene.camera.share_in_frame(self.corners(id) + shift)

    def in_view(self, id: int, corners: Array) -> float:
        """Share of corners (n, 3) of an object that the photo would show, moved there: in its frame, behind no other
        one."""
        camera = self.scene.camera.limited(VIEW)
        if id not in self._others:
            self._others[id] = render([o for o in self.scene if o.id != id], camera).depth
        pixels, depth = camera.project(corners)
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < (camera.width, camera.height)).all(1)
        x, y = pixels[inside].astype(int).T
        return float(np.count_nonzero(depth[inside] < self._others[id][y, x])) / len(corners)

    def on_support(self, id: int, shift: Array) -> bool:
        """Whether an object that stands on the support would stand on what the photo shows of it, shifted by (3,).

        True where that says nothing: without a mask, outside the frame, and for what is not on the mask now."""
        mask = self.scene.ground_mask
        if mask is None or self.support(id) != GROUND:
            return True
        foot = base_of(self.corners(id)).mean(0)
        (now, then), depth = self.scene.camera.project(np.array([foot, foot + shift]))
        h, w = mask.shape
        if not ((depth > 0).all() and all(0 <= u < w and 0 <= v < h for u, v in (now, then))):
            return True
        return bool(mask[int(then[1]), int(then[0])] or not mask[int(now[1]), int(now[0])])

    def room(self, id: int, direction: Array, farthest: float) -> float:
        """How far [m] an object can go along a direction, up to a limit, and stay on what the photo shows of its
        support, mostly in the frame."""
        steps = np.linspace(0, farthest, 25)
        seen = [self.in_frame(id, s * direction) >= 0.7 and self.on_support(id, s * direction) for s in steps]
        first = next((k for k, ok in enumerate(seen) if not ok), len(steps))
        return float(steps[max(first - 1, 0)])
