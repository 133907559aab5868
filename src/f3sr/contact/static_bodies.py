"""Bodies at rest in the world, where their mass may be, and which carries which."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from f3sr.contact.compounds import Compound, placed
from f3sr.contact.contact_patches import Contacts, find_contacts
from f3sr.core.transforms import Array, frozen, transform
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.physics.mujoco_model import body_of
from f3sr.scene import SceneObject


@dataclass(frozen=True, eq=False, kw_only=True)
class StaticBody:
    """A rigid body at rest, in the world.

    ``centers`` (n, 3) [m]: the places its centre of mass may have. It stands when it does with each of them: physics
    engines differ in where they put it (``PhysicsConfig``: the solid's own; release: spread evenly over the parts).
    """

    id: int
    parts: Compound
    mass: float
    """[kg]"""
    centers: Array
    friction: float
    """Coefficient of sliding friction; a contact has the larger of its two bodies'."""
    fixed: bool = False
    """Whether it is held still, whatever acts on it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "centers", frozen(np.reshape(self.centers, (-1, 3))))

    @property
    def size(self) -> float:
        """Diagonal of its bounding box [m]."""
        return self.parts.size

    def moved(self, T: Array) -> StaticBody:
        """The body under a rigid motion T (4, 4), or a similarity: its mass stays."""
        return replace(self, parts=self.parts.moved(T), centers=transform(T, self.centers))


def bodies_of(
    objects: Iterable[SceneObject],
    *,
    parts: Mapping[int, Compound] | None = None,
) -> tuple[StaticBody, ...]:
    """The objects as bodies; ``parts``: their parts in the world where somebody has them already."""
    return tuple(_body_of(o, parts[o.id] if parts else None) for o in objects)


def _body_of(o: SceneObject, parts: Compound | None) -> StaticBody:
    body = body_of(o)
    volumes = np.array([p.volume for p in o.solids])
    even = volumes @ np.array([p.centroid for p in o.solids]) / volumes.sum()
    return StaticBody(
        id=o.id,
        parts=parts or placed(o.solids, o.T_world_asset),
        mass=body.mass,
        centers=transform(o.T_world_object, np.stack([body.center, o.scale * even])),
        friction=o.friction,
        fixed=body.fixed,
    )


def contacts_of(bodies: Sequence[StaticBody], *, reach: float = DEFAULT_MARGIN.reach) -> Contacts:
    """Where the bodies touch each other and the ground: gaps of at most ``reach`` [m]."""
    return find_contacts({b.id: b.parts for b in bodies}, reach=reach)


def islands(bodies: Sequence[StaticBody], contacts: Contacts) -> Iterator[tuple[StaticBody, ...]]:
    """Groups of movable bodies that touch each other, directly or through others that are movable."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    free = [b for b in bodies if not b.fixed]
    place = {b.id: k for k, b in enumerate(free)}
    links = [(place[a], place[b]) for a, b in contacts.pairs if a in place and b in place]
    i, j = np.array(links, np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(i)), (i, j)), shape=(len(free), len(free)))
    count, label = connected_components(graph, directed=False)
    for k in range(count):
        yield tuple(b for b, island in zip(free, label, strict=True) if island == k)


def rigid(members: Sequence[StaticBody], id: int) -> StaticBody:
    """Movable bodies as one rigid body, with the ``id`` and the friction of one of them. ``centers`` are combined."""
    free = [m for m in members if not m.fixed]
    masses = np.array([m.mass for m in free])
    n = max(len(m.centers) for m in free)
    centers = [sum(m.mass * m.centers[min(c, len(m.centers) - 1)] for m in free) / masses.sum() for c in range(n)]
    return StaticBody(
        id=id,
        parts=Compound.of(m.parts for m in free),
        mass=float(masses.sum()),
        centers=np.array(centers),
        friction=next(m.friction for m in members if m.id == id),
    )


def center_of(objects: Sequence[SceneObject], *, parts: Mapping[int, Compound] | None = None) -> Array:
    """Common centre of mass (3,) of movable objects; ``parts`` as for ``bodies_of``."""
    return rigid(bodies_of(objects, parts=parts), objects[0].id).centers[0]
