"""Few convex parts for bodies at rest: joined where no other body is near, and with few vertices away from contacts.

Every part costs time in every later simulation. What touches is settled at rest, so parts may be coarse elsewhere: as
far as their mesh allows (``proxies.joins``) and as long as no part comes nearer to another body (docs: proxies).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from f3sr.contact import polytopes
from f3sr.contact.compounds import Compound, placed
from f3sr.contact.contact_patches import find_contacts
from f3sr.contact.footing import footing_again, supplied
from f3sr.contact.polytopes import Polytope
from f3sr.contact.static_bodies import center_of
from f3sr.contact.undersides import FootingConfig
from f3sr.core.flats import flattened
from f3sr.core.mesh import ConvexPart
from f3sr.core.surface_samples import sample_surface
from f3sr.core.transforms import UP, Array, transform
from f3sr.physics.mujoco_model import solid_of
from f3sr.proxies.collapse import Bounds
from f3sr.proxies.hulls import beyond, planes, qhull_of
from f3sr.proxies.joins import FELT, NEXT_TO, Join
from f3sr.proxies.known_parts import KnownParts, hull_of
from f3sr.proxies.neighbouring_parts import NeighbouringParts, are_near
from f3sr.proxies.pair_volumes import Pair, PairQueue
from f3sr.scene import GROUND, Scene, SceneObject

KEPT = (0.1, 0.05, 0.02, 0.0)
"""Radii around contacts in which vertices are kept, the first that is possible [size]."""
FARTHEST = (0.03, 0.1, 0.3)
"""Distances from a facet's plane up to which vertices may come to lie, the first that is possible [size]."""
REACHED = 0.1
"""Distance from a part in which other bodies bound where its vertices may come to lie [size]."""
LEAST = 1e-5
"""Loss of one part fewer from which on more are tried, where parts are too many."""
DEAREST = 0.1
"""Loss of one part fewer from which on parts are joined by volume, where they are still too many."""
PAST = 1e-3
"""How far a hull that is made thick may stand out of the parts [size]."""
THIN, THIN_M = 0.01, 2e-3
"""Least thickness of a hull, as a share of its object's size and in metres, where the object is as thick."""
NEARER = 2e-4
"""Distance [m] by which a joined part may come nearer to another body: six tenths of the clearance, which physics
ends. With half of it MuJoCo plays stacks at .6 to .8 of the speed; with more of it more groups move."""
MUCH_NEARER = (1, 2, 4)
"""The same in units of ``NEARER``, the first that is possible, where there are too many parts or vertices."""
FLAT = 2e-5
"""Distance [m] behind the plane of a flat up to which vertices are moved onto it: bodies of some hundred grams sink as
deep into a contact, so they touch there anyway."""
REFUSALS = 12
"""Most joins of an object that are refused as its parts stand off too much."""
SAMPLES = 1200
"""Points on all of an object's parts together by which their stand-off is measured."""


PartsAndFooting = tuple[tuple[ConvexPart, ...], tuple[ConvexPart, ...]]
"""An object's parts and its footing."""


@dataclass(frozen=True, kw_only=True)
class PartLimits:
    """How few parts an object may have, and how near they may come to other bodies."""

    worth: float
    """Loss that a part fewer is worth, as ``Join.loss``."""
    parts: int
    """Most parts, with footing, at any loss."""
    vertices: int
    """Most vertices of a part."""
    stand_off: float
    """Most mean distance of the parts' own surface from the mesh [size], if parts fewer are joined by choice."""
    kept: float
    """Largest share of these that is kept around contacts: the rest has to hold all else."""
    apart: float
    """Distance [m] from which other bodies do not matter."""
    reach: float
    """Distance [m] to another body that a part may always have: bodies that touch are nearer."""


def with_few_parts(
    scene: Scene,
    made: Scene,
    joins: Mapping[int, Sequence[Join]],
    limits: Mapping[int, PartLimits],
    *,
    footing: FootingConfig,
    clearance: float,
    known: MutableMapping[int, KnownParts] | None = None,
) -> Scene:
    """The scene with fewer parts of the objects that have ``limits`` (by id); poses and masses are the same.

    ``made`` has the parts that the joins (by id) are about. Those of ``scene`` may have been cut back and split since.
    Footings are made anew on what carries an object then, ``clearance`` [m] above it. ``known`` (by id) keeps from call
    to call what does not depend on the limits.
    """
    known = {} if known is None else known
    bodies = {o.id: placed(o.solids, o.T_world_asset) for o in scene}
    reach = max(limit.reach for limit in limits.values())
    contacts = find_contacts(bodies, reach=reach)
    now = dict[int, SceneObject]()
    for id in scene.supports_first:
        o = scene[id]
        if id not in limits or not o.parts:
            continue
        others = {k: body for k, body in bodies.items() if k != id}
        if o.footing and o.mobility != "fixed" and now.keys() & set(o.carriers):
            members = scene.subtree(id)
            around = Compound.of(body for k, body in bodies.items() if k not in members)
            wedges, rise = footing_again(
                o,
                [now.get(k, scene[k]) for k in o.carriers if k != GROUND],
                around,
                footing,
                clearance=clearance,
                center=center_of([scene[k] for k in scene.load(id)], parts=bodies),
                below=supplied(o) if scene.has_measured_depth else 0.0,
            )
            if rise <= NEARER:
                o = replace(o, footing=wedges)
                bodies[id] = placed(o.solids, o.T_world_asset)
                contacts = find_contacts(bodies, reach=reach)
        rows = (contacts.upper == id) | (contacts.lower == id)
        about = known.setdefault(id, KnownParts(o.mesh))
        fewer = _Fewer(o, about, [p for body in others.values() for p in body], contacts.points[rows], limits[id])
        parts, left = fewer.few(made[id].parts, joins.get(id, ()))
        now[id] = replace(o, parts=parts, footing=left, solid=solid_of(o)[0])
        bodies[id] = placed(now[id].solids, o.T_world_asset)
    return scene.with_objects(*now.values())


class _Fewer:
    """An object whose parts become fewer; ``others`` are the parts of all other bodies."""

    def __init__(
        self, o: SceneObject, known: KnownParts, others: Iterable[Polytope], contacts: Array, limits: PartLimits
    ) -> None:
        self._o, self._known, self._limits = o, known, limits
        self._size = known.size
        self._contacts = transform(np.linalg.inv(o.T_world_asset).astype(np.float64), contacts)
        self._found: dict[tuple[ConvexPart, ...], ConvexPart | None] = {}
        self._joined: dict[ConvexPart, tuple[ConvexPart, ...]] = {}
        self._between: dict[ConvexPart, Array] = {}
        self._refused = set[tuple[ConvexPart, ...]]()
        self._few: dict[ConvexPart, ConvexPart | None] = {}
        self._nearer = NEARER
        self._reached = limits.apart + REACHED * self._size * o.scale
        self._around = NeighbouringParts(o, others, within=self._reached, reach=limits.reach)

    def few(self, made: Sequence[ConvexPart], joins: Sequence[Join]) -> PartsAndFooting:
        """Parts and what is left of the footing.

        Joins are refused where parts stand off farthest, until their mean is as asked, or that of before. Where no
        refusal leads there, the nearest parts are taken."""
        tree, far = _Tree(_pieces(self._o.parts, made), joins), list[tuple[float, PartsAndFooting]]()
        while True:
            parts, footing = self._on_footing(self._joined_by(tree))
            found = [(part, few) for part in (*parts, *footing) for few in self._delivered(part)]
            few = [tuple(few for part, few in found if part in some) for some in (parts, footing)]
            farthest, mean = self._farthest(found)
            if farthest is None:
                return few[0], few[1]
            far.append((mean, (few[0], few[1])))
            if len(far) > REFUSALS:
                return min(far, key=lambda tried: tried[0])[1]
            self._refused.add(self._joined[farthest])

    def _farthest(self, found: Sequence[tuple[ConvexPart, ConvexPart]]) -> tuple[ConvexPart | None, float]:
        """Of parts, each with what is delivered of it, the joined one that stands off most, None where that may be; and
        their mean stand-off [size]."""
        if len(found) >= self._limits.parts or not any(part in self._joined for part, _ in found):
            return None, 0.0
        off = self._stand_off([few for _, few in found])
        mean = float(np.concatenate(off).mean())
        joined = [(float(each.sum()), k) for k, each in enumerate(off) if found[k][0] in self._joined]
        is_far = mean > self._limits.stand_off and mean > self._off_before
        return found[max(joined)[1]][0] if is_far else None, mean

    @cached_property
    def _off_before(self) -> float:
        return float(np.concatenate(self._stand_off(self._o.colliders)).mean())

    def _stand_off(self, parts: Sequence[ConvexPart]) -> list[Array]:
        """Distances [size] from the mesh of points on each part's surface, of those in no other part."""
        count = max(20, SAMPLES // len(parts))
        on = [sample_surface(part.vertices, part.faces, count) for part in parts]
        points = np.concatenate(on)
        is_own = np.min([beyond(points, *self._known.planes(part)) for part in parts], axis=0) >= -1e-4 * self._size
        off = self._known.surface.query(points)[0] / self._size
        return [off[k : k + count][is_own[k : k + count]] for k in range(0, len(points), count)]

    def _joined_by(self, tree: _Tree) -> list[ConvexPart]:
        """The object's parts, joined where that is worth it and comes no nearer to other bodies."""
        most = max(1, self._limits.parts - len(self._o.footing))
        worth = self._limits.worth
        while True:
            worthy = tree.worthy(worth)
            parts = [part for root in tree.roots for part in self._under(root, tree, worthy)]
            if len(parts) <= most or worth > DEAREST:
                break
            worth = max(2 * worth, LEAST)
        for self._nearer in (NEARER * k for k in MUCH_NEARER):
            parts = self._paired(parts, most)
            if len(parts) <= most:
                break
            self._found = {parts: one for parts, one in self._found.items() if one}
        self._nearer = NEARER
        return parts

    def _on_footing(self, parts: list[ConvexPart]) -> tuple[list[ConvexPart], list[ConvexPart]]:
        """Parts and the wedges of the footing that are left: a wedge joins the part with which it adds least volume.

        It stays a part of its own where that would add more than its own volume and than a part fewer is worth, unless
        there are too many."""
        left = list[ConvexPart]()
        crowded = len(parts) + len(self._o.footing) > self._limits.parts
        for wedge in self._o.footing:
            pairs = PairQueue(self._known.volumes, np.inf if crowded else max(wedge.volume, self._worth))
            pairs.push((part, wedge) for part in parts)
            found = pairs.pop()
            one = self._hull(found[1]) if found else None
            if found and one:
                parts = [one if part is found[1][0] else part for part in parts]
            else:
                left.append(wedge)
        return parts, left

    def _delivered(self, part: ConvexPart) -> Iterator[ConvexPart]:
        """A part as thick and with as few vertices as it has to be; where that cannot be, the parts that it joins."""
        if part not in self._few:
            tries = (self._of_few_vertices(self._thick(part), k * NEARER) for k in MUCH_NEARER)
            self._few[part] = next(filter(None, tries), None)
        few = self._few[part]
        if few or part not in self._joined:
            yield few or part
        else:
            for each in self._joined[part]:
                yield from self._delivered(each)

    def _thick(self, part: ConvexPart) -> ConvexPart:
        """A part that reaches into the solid where it would be a thin layer: engines lose or throw thin hulls.

        Where the object itself is thin, it stays thin."""
        normals, _ = self._known.planes(part)
        width = np.ptp(part.vertices @ normals.T, axis=0)
        thinnest, least = normals[int(width.argmin())], max(THIN_M / self._o.scale, THIN * self._size)
        if width.min() >= least:
            return part
        middle = part.vertices.mean(0)
        for apex in (middle + least * thinnest, middle - least * thinnest):
            inner = np.concatenate([apex[None], (part.vertices + apex) / 2])
            if self._is_solid(inner):
                thick = self._free(hull_of(np.concatenate([part.vertices, apex[None]])), self._gaps(part))
                if thick:
                    return thick
        return part

    def _is_solid(self, points: Array) -> bool:
        """Whether each of points (n, 3) is in a part, or hardly outside."""
        left = points
        for part in self._o.colliders:
            left = left[beyond(left, *self._known.planes(part)) > PAST * self._size]
            if not len(left):
                return True
        return False

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
            yield from pieces

    def _paired(self, parts: list[ConvexPart], most: int) -> list[ConvexPart]:
        """Pairs joined that are free, those first that add least volume: as long as that is worth a part fewer, and at
        any volume while there are more than ``most``.

        The tree of joins does not know where other bodies forbid one of them."""
        worth, crowded = self._worth, len(parts) > most
        pairs = PairQueue(self._known.volumes, np.inf if crowded else worth)
        pairs.push(pair for k, part in enumerate(parts) for pair in self._pairs(parts[:k], part, anywhere=crowded))
        while found := pairs.pop(parts):
            added, pair = found
            crowded = len(parts) > most
            if added > worth and not crowded:
                break
            one = self._hull(pair) if crowded or self._pairs(pair[:1], pair[1]) else None
            if one:
                parts = [part for part in parts if part not in pair]
                pairs.push(self._pairs(parts, one, anywhere=crowded))
                parts.append(one)
        return parts

    @cached_property
    def _worth(self) -> float:
        """Volume that a part fewer may add."""
        hull = qhull_of(self._o.mesh.hull.vertices)
        return FELT * self._limits.worth * hull.area * self._size if hull else 0.0

    def _pairs(self, parts: Sequence[ConvexPart], part: ConvexPart, *, anywhere: bool = False) -> list[Pair]:
        """A part with each of those whose boxes touch its own, or with all that may have one hull with it."""
        if anywhere:
            near = ~self._are_parted(parts, part)
        else:
            boxes = np.array([self._known.box(p) for p in parts]).reshape(-1, 2, 3)
            near = are_near(boxes, self._known.box(part), NEXT_TO * self._size)
        return [(parts[k], part) for k in np.flatnonzero(near).tolist()]

    def _are_parted(self, parts: Sequence[ConvexPart], part: ConvexPart) -> NDArray[np.bool_]:
        """Which of some parts have another body between them and a part, so that no hull of both is free."""
        if not parts:
            return np.zeros(0, bool)
        allowed = np.minimum([self._gaps(p) for p in parts], self._gaps(part)) - max(MUCH_NEARER) * NEARER
        middles = np.array([p.vertices.mean(0) for p in parts])
        return self._around.are_between(part.vertices.mean(0), middles, allowed)

    def _hull(self, parts: tuple[ConvexPart, ...]) -> ConvexPart | None:
        """One hull for parts; None where it would come too near to another body."""
        if len(parts) == 1:
            return parts[0]
        if parts in self._refused:
            return None
        if parts not in self._found:
            gaps = np.min([self._gaps(part) for part in parts], axis=0)
            one = self._found[parts] = self._free(self._known.hull(parts), gaps)
            if one:
                self._joined[one] = parts
        return self._found[parts]

    def _free(self, whole: ConvexPart | None, gaps: Array) -> ConvexPart | None:
        """A hull, if it is one and comes hardly nearer to other bodies than ``gaps`` [m]."""
        if whole is None or not self._is_free(whole, gaps - self._nearer):
            return None
        self._between[whole] = gaps - (self._nearer - NEARER)
        return whole

    def _of_few_vertices(self, part: ConvexPart, nearer: float = NEARER) -> ConvexPart | None:
        """A hull of few vertices that holds a part and comes hardly nearer to other bodies; None where that is none."""
        allowed = self._gaps(part) - nearer
        if len(part.vertices) <= self._limits.vertices:
            return self._flattened(part, allowed)
        normals, offsets = self._separating(part, allowed)
        contacts, tried = self._contacts / self._size, set[tuple[float, bytes]]()
        for farthest, radius in product(FARTHEST, KEPT):
            near = Bounds(normals=normals, offsets=offsets, points=contacts, radius=radius, farthest=farthest)
            kept = near.keeps(part.vertices / self._size)
            if kept.sum() > self._limits.kept * self._limits.vertices or (farthest, kept.tobytes()) in tried:
                continue
            tried.add((farthest, kept.tobytes()))
            few = self._known.few(part, self._limits.vertices, near)
            if len(few.vertices) <= self._limits.vertices and self._is_free(few, allowed):
                return self._flattened(few, allowed)
        return None

    def _flattened(self, part: ConvexPart, allowed: Array) -> ConvexPart:
        """A part with exactly plane flats, where that is as far from other bodies as ``allowed`` (n + 1,) [m]."""
        flat = flattened(part, FLAT / self._o.scale)
        return flat if flat is part or self._is_free(flat, allowed) else part

    def _separating(self, part: ConvexPart, allowed: Array) -> tuple[Array, Array]:
        """Planes (asset frame, normalised), normals (k, 3) and offsets (k,), that separate a part from other bodies."""
        normals, offsets = [-UP], [-float(allowed[-1])]
        body = Polytope.of(part).moved(self._o.T_world_asset)
        for k in self._around.near(body.bounds, self._reached).tolist():
            n, heights = polytopes.facets(body, self._around.parts[k])
            best = int(heights.argmin())
            normals.append(n[best])
            offsets.append(float((body.vertices @ n[best]).max()) - float(heights[best]) - float(allowed[k]))
        T = self._o.T_world_asset
        n = np.array(normals)
        in_asset = np.ascontiguousarray(n @ self._o.T_world_object[:3, :3])
        return in_asset, (np.array(offsets) - n @ T[:3, 3]) / self._o.scale / self._size

    def _is_free(self, part: ConvexPart, allowed: Array) -> bool:
        """Whether a part is as far from other bodies' parts and from the ground as ``allowed`` (n + 1,) [m]."""
        return self._around.are_apart(part, self._known.planes(part), allowed)

    def _gaps(self, part: ConvexPart) -> Array:
        """Distance (n + 1,) [m] of a part from other bodies' parts and from the ground."""
        if part not in self._between:
            self._between[part] = self._around.gaps(part)
        return self._between[part]


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
    faces = [planes(part) for part in made] if len(parts) > len(made) else []
    for part in parts[len(made) :]:
        nearest = int(np.argmin([beyond(part.vertices, *each).max() for each in faces]))
        found[nearest] = (*found[nearest], part)
    return found
