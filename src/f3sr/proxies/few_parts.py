"""Few convex parts for bodies at rest: joined where no other body is near, and with few vertices away from contacts.

Every part costs time in every later simulation. What touches is settled at rest, so parts may be coarse elsewhere: as
far as their mesh allows (``proxies.joins``) and as long as no part comes nearer to another body (docs: proxies).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from f3sr.contact import polytopes
from f3sr.contact.compounds import placed
from f3sr.contact.contact_patches import find_contacts
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, Array, transform
from f3sr.physics.mujoco_model import solid_of
from f3sr.proxies.collapse import Bounds, collapsed
from f3sr.proxies.hulls import outside, planes, qhull_of
from f3sr.proxies.joins import FELT, NEXT_TO, Join
from f3sr.scene import Scene, SceneObject

KEPT = (0.1, 0.05, 0.02, 0.0)
"""Radii around contacts in which vertices are kept, the first that is possible [size]."""
FARTHEST = (0.03, 0.1)
"""Distances from a facet's plane up to which vertices may come to lie, the first that is possible [size]."""
DEAREST = 0.1
"""Loss of one part fewer from which on parts are joined by volume, where they are still too many."""
PAST = 1e-3
"""How far a hull that is made thick may stand out of the parts [size]."""
THIN, THIN_M = 0.01, 2e-3
"""Least thickness of a hull, as a share of its object's size and in metres, where the object is as thick."""
NEARER = 5e-5
"""Distance [m] by which a joined part may come nearer to another body: a fifth of the clearance, which physics ends."""


@dataclass(frozen=True, kw_only=True)
class PartLimits:
    """How few parts an object may have, and how near they may come to other bodies."""

    worth: float
    """Loss that a part fewer is worth, as ``Join.loss``."""
    parts: int
    """Most parts, with footing, at any loss."""
    vertices: int
    """Most vertices of a part."""
    kept: float
    """Largest share of these that is kept around contacts: the rest has to hold all else."""
    apart: float
    """Distance [m] from which other bodies do not matter."""
    reach: float
    """Distance [m] to another body that a part may always have: bodies that touch are nearer."""


def with_few_parts(
    scene: Scene, made: Scene, joins: Mapping[int, Sequence[Join]], limits: Mapping[int, PartLimits]
) -> Scene:
    """The scene with fewer parts of the objects that have ``limits`` (by id); poses and masses are the same.

    ``made`` has the parts that the joins (by id) are about. Those of ``scene`` may have been cut back and split since.
    """
    bodies = {o.id: placed(o.solids, o.T_world_asset) for o in scene}
    contacts = find_contacts(bodies, reach=max(limit.reach for limit in limits.values()))
    now = list[SceneObject]()
    for o in scene:
        if o.id not in limits or not o.parts:
            continue
        rows = (contacts.upper == o.id) | (contacts.lower == o.id)
        others = [p for k, body in bodies.items() if k != o.id for p in body]
        fewer = _Fewer(o, others, contacts.points[rows], limits[o.id])
        parts, footing = fewer.on_footing(fewer.joined(made[o.id].parts, joins.get(o.id, ())))
        parts, footing = tuple(map(fewer.thick, parts)), tuple(map(fewer.thick, footing))
        now.append(replace(o, parts=parts, footing=footing, solid=solid_of(o)[0]))
        bodies[o.id] = placed(now[-1].solids, o.T_world_asset)
    return scene.with_objects(*now)


class _Fewer:
    """An object whose parts become fewer; ``others`` are the parts of all other bodies."""

    def __init__(self, o: SceneObject, others: Iterable[Polytope], contacts: Array, limits: PartLimits) -> None:
        self._o, self._limits = o, limits
        self._size = o.mesh.diagonal
        T_asset_world: Array = np.linalg.inv(o.T_world_asset).astype(np.float64)
        self._contacts = transform(T_asset_world, contacts)
        self._found: dict[tuple[int, ...], tuple[Sequence[ConvexPart], ConvexPart | None]] = {}
        self._volumes: dict[tuple[int, ...], tuple[Sequence[ConvexPart], float]] = {}
        boxes = np.array([[p.vertices.min(0), p.vertices.max(0)] for p in o.colliders_world])
        self._reached = limits.apart + max(FARTHEST) * self._size * o.scale
        low, high = boxes[:, 0].min(0) - self._reached, boxes[:, 1].max(0) + self._reached
        self._others = [p for p in others if (p.bounds[0] <= high).all() and (p.bounds[1] >= low).all()]

    def joined(self, made: Sequence[ConvexPart], joins: Sequence[Join]) -> list[ConvexPart]:
        """The object's parts, joined where that is worth it and comes no nearer to other bodies."""
        tree = _Tree(_pieces(self._o.parts, made), joins)
        most = max(1, self._limits.parts - len(self._o.footing))
        worth = self._limits.worth
        while True:
            worthy = tree.worthy(worth)
            parts = [part for root in tree.roots for part in self._under(root, tree, worthy)]
            if len(parts) <= most or worth > DEAREST:
                return self._paired(parts, most)
            worth *= 2

    def on_footing(self, parts: list[ConvexPart]) -> tuple[list[ConvexPart], list[ConvexPart]]:
        """Parts and the wedges of the footing that are left: a wedge joins the part with which it adds least volume.

        It stays a part of its own where that would add more than its own volume, unless there are too many."""
        left = list[ConvexPart]()
        crowded = len(parts) + len(self._o.footing) > self._limits.parts
        for wedge in self._o.footing:
            added, k = min((self._added(part, wedge), k) for k, part in enumerate(parts))
            one = self._hull((parts[k], wedge)) if crowded or added <= wedge.volume else None
            if one:
                parts = [*parts[:k], one, *parts[k + 1 :]]
            else:
                left.append(wedge)
        return parts, left

    def thick(self, part: ConvexPart) -> ConvexPart:
        """A part that reaches into the solid where it would be a thin layer: engines lose or throw thin hulls.

        Where the object itself is thin, it stays thin."""
        normals, _ = planes(part)
        width = np.ptp(part.vertices @ normals.T, axis=0)
        thinnest, least = normals[int(width.argmin())], max(THIN_M / self._o.scale, THIN * self._size)
        if width.min() >= least:
            return part
        middle = part.vertices.mean(0)
        for apex in (middle + least * thinnest, middle - least * thinnest):
            inner = np.concatenate([apex[None], (part.vertices + apex) / 2])
            if (outside(self._o.colliders, inner).min(1) <= PAST * self._size).all():
                thick = self._held(np.concatenate([part.vertices, apex[None]]), self._gaps(part))
                if thick:
                    return thick
        return part

    def _under(self, node: int, tree: _Tree, worthy: Collection[int]) -> Iterator[ConvexPart]:
        """What replaces the parts under a node of the tree: one hull where that is worth it and free."""
        pieces = tree.pieces[node]
        one = self._hull(pieces) if node in worthy else None
        if one:
            yield one
        elif node in tree.children:
            for child in tree.children[node]:
                yield from self._under(child, tree, worthy)
        else:
            yield from (self._hull((part,)) or part for part in pieces)

    def _paired(self, parts: list[ConvexPart], most: int) -> list[ConvexPart]:
        """Pairs joined that are free, those first that add least volume: as long as that is worth a part fewer, and at
        any volume while there are more than ``most``.

        The tree of joins does not know where other bodies forbid one of them."""
        hull = qhull_of(self._o.mesh.hull.vertices)
        worth = FELT * self._limits.worth * hull.area * self._size if hull else 0.0
        while True:
            crowded = len(parts) > most
            pairs = combinations(parts, 2)
            found = [(self._added(a, b), a, b) for a, b in pairs if crowded or self._are_neighbours(a, b)]
            found = sorted((f for f in found if crowded or f[0] <= worth), key=lambda f: f[0])
            pair = next(((a, b, one) for _, a, b in found if (one := self._hull((a, b)))), None)
            if pair is None:
                return parts
            parts = [*(p for p in parts if p not in pair[:2]), pair[2]]

    def _are_neighbours(self, a: ConvexPart, b: ConvexPart) -> bool:
        """Whether the boxes of two parts touch."""
        return _are_near(Polytope.of(a), Polytope.of(b), NEXT_TO * self._size)

    def _added(self, a: ConvexPart, b: ConvexPart) -> float:
        """The volume that one hull for both has more than they."""
        key = (id(a), id(b))
        if key not in self._volumes:
            hull = qhull_of(np.concatenate([a.vertices, b.vertices]))
            self._volumes[key] = (a, b), np.inf if hull is None else float(hull.volume) - a.volume - b.volume
        return self._volumes[key][1]

    def _hull(self, parts: tuple[ConvexPart, ...]) -> ConvexPart | None:
        """One hull of few vertices for parts; None where it would come too near to another body."""
        key = tuple(map(id, parts))
        if key not in self._found:
            if len(parts) == 1 and len(parts[0].vertices) <= self._limits.vertices:
                self._found[key] = parts, parts[0]
            else:
                gaps = np.min([self._gaps(part) for part in parts], axis=0)
                self._found[key] = parts, self._held(np.concatenate([part.vertices for part in parts]), gaps)
        return self._found[key][1]

    def _held(self, points: Array, gaps: Array) -> ConvexPart | None:
        """A hull of few vertices that holds points (n, 3) and comes no nearer to other bodies than ``gaps`` [m]."""
        allowed = np.minimum(gaps, self._limits.reach) - NEARER
        try:
            whole = ConvexPart.hull_of(points)
        except ValueError:  # hardly a volume
            return None
        if not self._is_free(whole, allowed):
            return None
        if len(whole.vertices) <= self._limits.vertices:
            return whole
        normals, offsets = self._separating(whole, allowed)
        contacts, tried = self._contacts / self._size, set[tuple[float, bytes]]()
        for farthest, radius in product(FARTHEST, KEPT):
            near = Bounds(normals=normals, offsets=offsets, points=contacts, radius=radius, farthest=farthest)
            kept = near.keeps(whole.vertices / self._size)
            if kept.sum() > self._limits.kept * self._limits.vertices or (farthest, kept.tobytes()) in tried:
                continue
            tried.add((farthest, kept.tobytes()))
            fewer = collapsed(whole.vertices / self._size, self._limits.vertices, near) * self._size
            part = ConvexPart.hull_of(fewer)
            if len(part.vertices) <= self._limits.vertices and self._is_free(part, allowed):
                return part
        return None

    def _separating(self, part: ConvexPart, allowed: Array) -> tuple[Array, Array]:
        """Planes (asset frame, normalised), normals (k, 3) and offsets (k,), that separate a part from other bodies."""
        normals, offsets = [-UP], [-float(allowed[-1])]
        body = Polytope.of(part).moved(self._o.T_world_asset)
        for other, least in zip(self._others, allowed[:-1], strict=True):
            if _are_near(body, other, self._reached):
                n, heights = polytopes.facets(body, other)
                k = int(heights.argmin())
                normals.append(n[k])
                offsets.append(float((body.vertices @ n[k]).max()) - float(heights[k]) - float(least))
        T = self._o.T_world_asset
        n = np.array(normals)
        in_asset = np.ascontiguousarray(n @ self._o.T_world_object[:3, :3])
        return in_asset, (np.array(offsets) - n @ T[:3, 3]) / self._o.scale / self._size

    def _is_free(self, part: ConvexPart, allowed: Array) -> bool:
        return bool((self._gaps(part) >= allowed).all())

    def _gaps(self, part: ConvexPart) -> Array:
        """Distance (n + 1,) [m] of a part from other bodies' parts and from the ground, negative inside.

        What is far counts as ``apart``."""
        body = Polytope.of(part).moved(self._o.T_world_asset)
        apart = self._limits.apart
        gaps = np.full(len(self._others) + 1, apart)
        gaps[-1] = min(apart, float(body.bounds[0, 2]))
        for k, other in enumerate(self._others):
            if _are_near(body, other, apart):
                gaps[k] = min(apart, -float(polytopes.facets(body, other)[1].min()))
        return gaps


def _are_near(a: Polytope, b: Polytope, apart: float) -> bool:
    """Whether boxes come within ``apart`` [m] of each other."""
    return bool((a.bounds[0] - apart < b.bounds[1]).all() and (b.bounds[0] - apart < a.bounds[1]).all())


class _Tree:
    """The tree of joins: under every node the pieces that one hull would replace."""

    def __init__(self, leaves: Mapping[int, tuple[ConvexPart, ...]], joins: Sequence[Join]) -> None:
        self.pieces = dict(leaves)
        self.children = {len(leaves) + k: (join.first, join.second) for k, join in enumerate(joins)}
        self._loss = dict.fromkeys(leaves, 0.0)
        for (node, (a, b)), join in zip(self.children.items(), joins, strict=True):
            self.pieces[node] = (*self.pieces[a], *self.pieces[b])
            self._loss[node] = self._loss[a] + self._loss[b] + join.loss
        joined = {k for pair in self.children.values() for k in pair}
        self.roots = [k for k in self.pieces if k not in joined]

    def worthy(self, worth: float) -> set[int]:
        """Nodes at which one hull loses no more than its parts, of which each is ``worth`` that loss, would cost.

        Of all ways to cut the tree, that of least loss plus worth of parts (Chou, Lookabaugh, Gray, Optimal pruning
        with applications to tree-structured source coding, IEEE Trans. Information Theory 1989)."""
        price = {k: worth * len(self.pieces[k]) for k in self.pieces if k not in self.children}
        found = {k for k, pieces in self.pieces.items() if k not in self.children and len(pieces) > 1}
        for node, (a, b) in self.children.items():
            one, several = self._loss[node] + worth, price[a] + price[b]
            price[node] = min(one, several)
            if one <= several:
                found.add(node)
        return found


def _pieces(parts: Sequence[ConvexPart], made: Sequence[ConvexPart]) -> dict[int, tuple[ConvexPart, ...]]:
    """Which parts came of which part that was made: the first ones in their order, the others by where they lie."""
    found: dict[int, tuple[ConvexPart, ...]] = {k: (part,) for k, part in enumerate(parts[: len(made)])}
    for part in parts[len(made) :]:
        nearest = int(np.argmin(outside(made, part.vertices).max(0)))
        found[nearest] = (*found[nearest], part)
    return found
