"""The objects of the stress scenes and where each is put down before physics takes over: analytic, from a seed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import manifold3d as mf
import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, pose, rotation_about

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
from tabletop import shapes
from tabletop.degrade import Damage
from tabletop.shapes import Shape
from tabletop.things import Thing

DENSITY = 600.0
"""[kg/m3], the product's default."""
X, Y, Z = np.eye(3)
GENERATED = Damage(bump=0.002, squash=0.0)
"""What generated assets miss of place, turn and size (as the bundled example's), their shapes nearly right."""
PUSHED = Damage(unit=1.0, focal=1.0, depth=0, sideways=0, turn=0, scale=0, bump=0, squash=0)
"""Assets where they truly are but for what a stage pushes them; a geometry with its noise."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Item(Thing):
    """A thing that may start tilted, and whose asset may be pushed from where it truly is."""

    R: Array = field(default_factory=lambda: np.eye(3))
    push: Array = field(default_factory=lambda: np.zeros(3))
    """[m] in the world: on top of what a generator misses."""
    mesh: Mesh | None = None
    """Its surface and colours where they are a scan's; else ``shape`` and ``look`` are."""

    @property
    def T_start(self) -> Array:
        return pose(self.R, self.at)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """Items and how the photo is taken: from ``distance`` [m] away and ``height`` [m] above the floor."""

    items: Sequence[Item]
    distance: float
    height: float
    seconds: float = 3.0
    """Of physics until all rests."""
    skip: str = ""
    """Stages that f3sr is told to leave out."""
    damage: Damage = GENERATED
    """What geometry and assets miss."""
    seen: int = 60
    """Pixels. What shows less has no mask and is no object: nobody would prompt for it."""


def item(label: str, shape: Shape, at: Sequence[float], rng: np.random.Generator, **more: object) -> Item:
    """An item of an even density in a colour of its own."""
    color, phase = 0.15 + 0.6 * rng.random(3), rng.uniform(0, 6, 3)
    volume = shape.solid.volume()
    size = float(np.linalg.norm(np.ptp(shapes.vertices(shape.solid), axis=0)))

    def look(points: Array) -> Array:
        bands = np.sin(points @ rng_waves.T / size + phase).sum(1)
        return np.clip(color * (1 + 0.12 * bands[:, None]), 0, 1)

    rng_waves = rng.normal(size=(3, 3)) * 25
    return Item(label=label, shape=shape, look=look, mass=DENSITY * volume, at=tuple(map(float, at)), **more)  # type: ignore[arg-type]


def turned(degrees: float, axis: Array = Z) -> Array:
    return rotation_about(axis, np.radians(degrees))


def frame(*boxes: tuple[Sequence[float], Sequence[float]]) -> Shape:
    """Boxes of (size, middle) joined to one solid: furniture. Every box is one convex part."""
    solids = [mf.Manifold.cube(np.asarray(size, float), True).translate(list(middle)) for size, middle in boxes]
    joined = mf.Manifold.batch_boolean(solids, mf.OpType.Add)
    return Shape(solid=joined, parts=tuple(shapes.vertices(s) for s in solids))


def crate(width: float, height: float, *, wall: float) -> Shape:
    """A square open box, its floor and walls a convex part each."""
    w, h = width, height
    return frame(
        ((w, w, wall), (0, 0, wall / 2)),
        *(((wall, w, h), (i * (w - wall) / 2, 0, h / 2)) for i in (-1, 1)),
        *(((w, wall, h), (0, j * (w - wall) / 2, h / 2)) for j in (-1, 1)),
    )


def ball(radius: float) -> Shape:
    return shapes.convex(mf.Manifold.sphere(radius, 48).translate([0, 0, radius]))


def can(radius: float, height: float) -> Shape:
    return shapes.convex(mf.Manifold.cylinder(height, radius, radius, 48))


def brick(size: Sequence[float]) -> Shape:
    return shapes.box(size, 0.03 * min(size))


# --- the scenes -----------------------------------------------------------------------------------------------------


def tower(rng: np.random.Generator) -> Stage:
    """Ten bricks and cans on each other."""
    items, top = list[Item](), 0.001
    for k in range(10):
        side, height = 0.11 - 0.005 * k, rng.uniform(0.03, 0.055)
        round_one = k % 4 == 2
        shape = can(side / 2, height) if round_one else brick((side, side * rng.uniform(0.8, 1.0), height))
        at = (*rng.normal(scale=0.004, size=2), top)
        items.append(item("can" if round_one else "brick", shape, at, rng, R=turned(rng.uniform(-30, 30))))
        top += height + 0.001
    return Stage(items=items, distance=1.5, height=0.75)


def bowls(rng: np.random.Generator) -> Stage:
    """Four bowls in each other with an apple in the last, and three equal ones stacked."""
    items = list[Item]()
    for k, radius in enumerate((0.13, 0.105, 0.083, 0.063)):
        at = (-0.14 + 0.002 * k, 0.0, 0.001 + 0.026 * k)
        items.append(item("bowl", shapes.bowl(radius, 0.62 * radius), at, rng))
    items.append(item("apple", ball(0.034), (-0.136, 0.002, 0.105), rng, round=True))
    items += [item("small_bowl", shapes.bowl(0.075, 0.05), (0.15, 0.02, 0.001 + 0.026 * k), rng) for k in range(3)]
    return Stage(items=items, distance=0.8, height=0.6)


def planks(rng: np.random.Generator) -> Stage:
    """Planks that lean on blocks, two that lean on each other, and one that bridges two blocks."""
    items = [
        item("block", brick((0.09, 0.16, 0.15)), (-0.2, 0.05, 0.001), rng),
        item("block", brick((0.09, 0.12, 0.11)), (0.18, 0.06, 0.001), rng),
        item("block", brick((0.08, 0.12, 0.112)), (0.36, 0.04, 0.001), rng),
        item("bridge", brick((0.28, 0.05, 0.012)), (0.27, 0.06, 0.115), rng),
    ]
    for y, degrees in ((0.0, 62.0), (0.06, 58.0), (0.11, 66.0)):
        items.append(leaning(0.2, degrees, -0.153, y, rng))
    c, s = np.cos(np.radians(64)), np.sin(np.radians(64))
    for sign in (-1, 1):
        R = turned(sign * 64, Y)
        middle = np.array([sign * (0.09 * c + 0.005), -0.12, 0.002 + 0.09 * s])
        items.append(item("plank", brick((0.18, 0.05, 0.008)), middle - 0.004 * R[:, 2], rng, R=R))
    return Stage(items=items, distance=1.1, height=0.6)


def leaning(length: float, degrees: float, x: float, y: float, rng: np.random.Generator) -> Item:
    """A plank that leans towards -x against what ends at ``x``, its foot on the ground."""
    R = turned(degrees, Y)  # its own +x end points down and away
    shape = brick((length, 0.04, 0.008))
    foot = R @ [length / 2, 0, 0]
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    at = np.array([x + 0.012 / s + length * c / 2, y, 0.004 - foot[2]])
    return item("plank", shape, at, rng, R=R)


def pile(rng: np.random.Generator) -> Stage:
    """Thirty things dropped on a heap."""
    items = list[Item]()
    for k in range(30):
        corner = 0.06 * (2 * np.array([k % 2, k // 2 % 2]) - 1)
        at = (*(corner + rng.normal(scale=0.002, size=2)), 0.06 + 0.12 * (k // 4))
        R = turned(rng.uniform(0, 360)) @ turned(rng.uniform(-60, 60), X)
        items.append(any_thing(k, at, rng, R=R))
    return Stage(items=items, distance=1.0, height=0.8, seconds=6.0)


def any_thing(k: int, at: Sequence[float], rng: np.random.Generator, **more: object) -> Item:
    """One of six kinds in a size of its own, 4 to 10 cm long."""
    s = rng.uniform(0.8, 1.25)
    make: Sequence[tuple[str, Callable[[], Shape], bool]] = (
        ("brick", lambda: brick(s * np.array([0.075, 0.05, 0.035])), False),
        ("can", lambda: can(s * 0.022, s * 0.06), False),
        ("ball", lambda: ball(s * 0.026), True),
        ("slab", lambda: brick(s * np.array([0.09, 0.06, 0.012])), False),
        ("cube", lambda: brick(s * np.array([0.045] * 3)), False),
        ("cup", lambda: shapes.bowl(s * 0.036, s * 0.034), False),
    )
    label, shape, is_round = make[k % len(make)]
    return item(label, shape(), at, rng, round=is_round, **more)


def floor(rng: np.random.Generator, count: int = 50) -> Stage:
    """Things of 5 to 30 cm spread over a floor."""
    columns = int(np.ceil(np.sqrt(1.4 * count)))
    items = list[Item]()
    for k in range(count):
        cell = np.array([k % columns - (columns - 1) / 2, k // columns]) * 0.3
        at = (*(cell + rng.uniform(-0.05, 0.05, 2)), 0.001)
        items.append(floor_thing(k, at, rng))
    return Stage(items=items, distance=0.3 * columns + 1.0, height=0.22 * columns + 0.6)


def floor_thing(k: int, at: Sequence[float], rng: np.random.Generator) -> Item:
    s = rng.uniform(0.8, 1.25)
    make: Sequence[tuple[str, Callable[[], Shape], bool]] = (
        ("carton", lambda: brick(s * np.array([0.2, 0.14, 0.07])), False),
        ("bottle", lambda: shapes.bottle(s * 0.035, s * 0.24), False),
        ("ball", lambda: ball(s * 0.06), True),
        ("mug", lambda: shapes.mug(s * 0.042, s * 0.095), False),
        ("book", lambda: shapes.book((s * 0.165, s * 0.225, s * 0.026)), False),
        ("bowl", lambda: shapes.bowl(s * 0.085, s * 0.06), False),
        ("tin", lambda: shapes.tin(s * 0.04, s * 0.11), False),
    )
    label, shape, is_round = make[k % len(make)]
    return item(label, shape(), at, rng, R=turned(rng.uniform(0, 360)), round=is_round)


def overlaps(rng: np.random.Generator) -> Stage:
    """Neighbours pushed into each other by half of their size, beside, upon and all three ways; not aligned, as
    alignment would see them apart."""
    items = list[Item]()

    def pair(x: float, y: float, a: Shape, b: Shape, b_at: Array, push: Array) -> None:
        items.append(item("first", a, (x, y, 0.001), rng, push=push / 2))
        items.append(item("second", b, np.array([x, y, 0.001]) + b_at, rng, push=-push / 2))

    pair(-0.3, 0.1, brick([0.1, 0.1, 0.1]), brick([0.1, 0.1, 0.1]), 0.104 * X, 0.05 * X)
    pair(-0.1, 0.12, can(0.04, 0.12), brick([0.08, 0.08, 0.06]), 0.083 * X, 0.04 * X)
    pair(0.14, 0.1, brick([0.12, 0.12, 0.06]), brick([0.09, 0.09, 0.08]), 0.061 * Z, 0.04 * Z)
    pair(-0.25, -0.12, shapes.mug(0.042, 0.095), ball(0.04), -0.09 * X, -0.04 * X)
    pair(0.05, -0.12, shapes.bowl(0.085, 0.06), brick([0.1, 0.1, 0.04]), 0.14 * X, 0.07 * X)
    return Stage(items=items, distance=1.1, height=0.75, skip="align", damage=PUSHED)


def dining(rng: np.random.Generator) -> Stage:
    """A table with four chairs, two of them pushed under it, and four things on it."""
    board, leg = (1.4, 0.8, 0.04), 0.06
    feet = [((leg, leg, 0.72), (i * 0.62, j * 0.32, 0.36)) for i in (-1, 1) for j in (-1, 1)]
    table = frame((board, (0, 0, 0.74)), *feet)
    items = [item("table", table, (0, 0, 0.001), rng)]
    places = ((-0.35, -0.5, 0), (0.35, -0.72, 12), (-0.3, 0.5, 180), (0.98, 0.0, 80))
    items += [item("chair", chair(), (x, y, 0.001), rng, R=turned(yaw)) for x, y, yaw in places]
    items += [
        item("bowl", shapes.bowl(0.15, 0.1), (-0.2, 0.05, 0.762), rng),
        item("bottle", shapes.bottle(0.045, 0.3), (0.15, 0.12, 0.762), rng),
        item("box", brick((0.3, 0.2, 0.12)), (0.42, -0.1, 0.762), rng, R=turned(25)),
        item("mug", shapes.mug(0.045, 0.1), (-0.5, -0.15, 0.762), rng, R=turned(60)),
    ]
    return Stage(items=items, distance=4.0, height=1.7)


def chair() -> Shape:
    """Its back towards -y."""
    legs = [((0.04, 0.04, 0.44), (i * 0.18, j * 0.18, 0.22)) for i in (-1, 1) for j in (-1, 1)]
    back = ((0.4, 0.03, 0.45), (0, -0.185, 0.685))
    return frame(((0.4, 0.4, 0.04), (0, 0, 0.46)), *legs, back)


def shelf(rng: np.random.Generator) -> Stage:
    """An open shelf with boxes in its compartments, a crate with a ball beside it, and cartons stacked."""
    boards = [((1.0, 0.35, 0.025), (0, 0, z)) for z in (0.0725, 0.4325, 0.7925, 1.1525, 1.5125)]
    sides = [((0.025, 0.35, 1.525), (i * 0.4875, 0, 0.7625)) for i in (-1, 1)]
    back = ((1.0, 0.02, 1.525), (0, 0.165, 0.7625))
    items = [item("shelf", frame(*boards, *sides, back), (0, 0, 0.001), rng)]
    for z in (0.086, 0.446, 0.806, 1.166):
        for x in (-0.28, 0.18):
            size = (rng.uniform(0.2, 0.3), 0.24, rng.uniform(0.12, 0.25))
            items.append(item("box", brick(size), (x + rng.uniform(-0.03, 0.03), -0.03, z), rng))
    items += [
        item("crate", crate(0.4, 0.25, wall=0.02), (0.95, -0.2, 0.001), rng, R=turned(15)),
        item("ball", ball(0.11), (0.95, -0.2, 0.023), rng, round=True),
        item("carton", brick((0.4, 0.35, 0.3)), (-0.95, -0.25, 0.001), rng, R=turned(-10)),
        item("carton", brick((0.35, 0.3, 0.25)), (-0.93, -0.24, 0.303), rng, R=turned(12)),
        item("vase", shapes.bottle(0.07, 0.35), (0.1, 0.0, 1.527), rng),
    ]
    return Stage(items=items, distance=4.5, height=1.6)


def mixed(rng: np.random.Generator, count: int) -> Stage:
    """Groups of five of the growth table: a can on a carton, a ball in a bowl, and a mug; no two alike."""
    groups = -(-count // 5)
    columns = int(np.ceil(np.sqrt(1.4 * groups)))
    items = list[Item]()
    for g in range(groups):
        x, y = np.array([g % columns - (columns - 1) / 2, g // columns]) * [0.5, 0.4] + rng.uniform(-0.02, 0.02, 2)
        s = rng.uniform(0.85, 1.2, 5)
        items += [
            item("carton", brick(s[0] * np.array([0.15, 0.11, 0.06])), (x - 0.12, y, 0.001), rng),
            item("can", shapes.tin(s[1] * 0.036, s[1] * 0.1), (x - 0.12, y, 0.002 + s[0] * 0.06), rng),
            item("bowl", shapes.bowl(s[2] * 0.085, s[2] * 0.06), (x + 0.06, y, 0.001), rng),
            item("ball", ball(s[3] * 0.03), (x + 0.06, y, 0.012 + s[2] * 0.01), rng, round=True),
            item("mug", shapes.mug(s[4] * 0.041, s[4] * 0.092), (x + 0.02, y - 0.15, 0.001), rng, R=turned(200 * s[4])),
        ]
    return Stage(items=items[:count], distance=0.4 * columns + 0.7, height=0.3 * columns + 0.4)


CASES: Mapping[str, Callable[[np.random.Generator], Stage]] = {
    "tower": tower,
    "bowls": bowls,
    "planks": planks,
    "pile": pile,
    "floor": floor,
    "overlaps": overlaps,
    "dining": dining,
    "shelf": shelf,
    **{f"mixed_{n}": partial(mixed, count=n) for n in (5, 10, 20, 50)},
}
"""By name; ``mixed_N`` are those of the growth table."""
