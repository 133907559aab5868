"""Scans as the ten rendered scenes have them: piled, stacked, scattered and mixed, from a seed.

Their assets miss as much as those of the ten scenes, also on the sides that the photo does not show."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from container_things import DROP, FRUIT, OBJECTS, SMALL, container, contents, label_of, scan, scanned
from f3sr.core.transforms import Array
from stress_things import Item, Stage, X, Y, turned
from tabletop.degrade import Damage

BLOCKS = (
    *("ycb_cracker_box", "ycb_sugar_box", "ycb_gelatin_box", "ycb_foam_brick", "ycb_rubiks_cube"),
    *("ycb_potted_meat_can", "ycb_tomato_soup_can", "hope_macaroni_and_cheese"),
)
"""What others can stand on."""
TALL = ("ycb_mustard_bottle", "ycb_bleach_cleanser", "ycb_windex_bottle", "hope_ketchup", "ycb_mug")
WIDE = ("ycb_bowl", "gso_frypan", "ycb_plate")
LYING = (
    *("ycb_hammer", "ycb_spatula", "ycb_spoon", "ycb_phillips_screwdriver", "ycb_adjustable_wrench"),
    *("ycb_a_toy_airplane", "ycb_padlock", *FRUIT),
)
"""What lies on its flattest side."""
LIFT = 0.001
"""Height [m] from which everything falls."""
SEEN = 600
"""Least pixels of an object that has a mask."""


def scan_pile(rng: np.random.Generator) -> Stage:
    """Six to eight things dropped on each other, turned at random."""
    items, height = list[Item](), LIFT
    for name in rng.permutation(_all())[: 6 + int(rng.integers(3))]:
        R = turned(rng.uniform(0, 360)) @ turned(rng.uniform(-90, 90), X) @ turned(rng.uniform(-90, 90), Y)
        items.append(put(str(name), rng.normal(scale=0.05, size=2), height, R))
        height = _top(items[-1]) + DROP
    return _stage(items, seconds=8.0, height=0.6)


def scan_stack(rng: np.random.Generator) -> Stage:
    """Two stacks of two or three, and two things beside them."""
    places, names = apart(rng, 4, half=0.2, gap=0.22), list(map(str, rng.permutation(BLOCKS)))
    items = list[Item]()
    for place in places[:2]:
        height = LIFT
        for _ in range(2 + int(rng.integers(2))):
            name = names.pop()
            items.append(put(name, place + rng.normal(scale=0.008, size=2), height, flat(name, rng)))
            height = _top(items[-1]) + LIFT
    for place, name in zip(places[2:], rng.permutation([*TALL, *WIDE])[:2], strict=True):
        items.append(put(str(name), place, LIFT, turned(rng.uniform(0, 360))))
    return _stage(items)


def scan_scatter(rng: np.random.Generator) -> Stage:
    """Six to eight things that stand or lie alone."""
    count = 6 + int(rng.integers(3))
    names = map(str, rng.permutation(_all())[:count])
    places = apart(rng, count, half=0.25, gap=0.17)
    return _stage([put(n, at, LIFT, _stood(n, rng)) for n, at in zip(names, places, strict=True)], height=0.5)


def scan_mixed(rng: np.random.Generator) -> Stage:
    """A container with contents, a stack behind it, and things around them."""
    items = [
        container(str(rng.permutation(WIDE)[0])),
        *contents((*SMALL, *FRUIT[:3]), 2 + int(rng.integers(3)), 0.03, 0.05, rng),
    ]
    height = LIFT
    for name in _others(BLOCKS, items, rng)[:2]:
        items.append(put(name, (0.05, 0.32), height, flat(name, rng)))
        height = _top(items[-1]) + LIFT
    around = ((-0.25, -0.25), (0.0, -0.3), (0.27, -0.22), (-0.28, 0.2))
    for place, name in zip(around, _others((*LYING, *TALL), items, rng), strict=False):
        items.append(put(name, place, LIFT, _stood(name, rng)))
    return _stage(items, distance=1.1, height=0.6)


def put(name: str, at: Sequence[float] | Array, height: float, R: Array) -> Item:
    """A scan turned by R, its box with its middle over ``at`` (2,) and its lowest point at a ``height`` [m]."""
    shape, mesh = scan(name)
    low, high = (f(mesh.vertices @ R.T, axis=0) for f in (np.min, np.max))
    x, y = np.asarray(at) - (low + high)[:2] / 2
    return scanned(label_of(name), shape, mesh, (x, y, height - low[2]), R)


def flat(name: str, rng: np.random.Generator) -> Array:
    """A turn that lays a scan on its flattest side."""
    thinnest = int(np.argmin(np.ptp(scan(name)[1].vertices, axis=0)))
    onto_z = (turned(90, Y), turned(90, X), np.eye(3))[thinnest]
    return turned(rng.uniform(0, 360)) @ onto_z


def apart(rng: np.random.Generator, count: int, *, half: float, gap: float) -> list[Array]:
    """Places (2,) in a square, none nearer to another than ``gap`` [m]."""
    places = list[Array]()
    while len(places) < count:
        at = rng.uniform(-half, half, 2)
        if all(np.hypot(*(at - other)) > gap for other in places):
            places.append(at)
    return places


def _all() -> list[str]:
    return [file.stem for file in sorted(OBJECTS.glob("*.glb"))]


def _stood(name: str, rng: np.random.Generator) -> Array:
    return flat(name, rng) if name in LYING else turned(rng.uniform(0, 360))


def _others(names: Sequence[str], items: Sequence[Item], rng: np.random.Generator) -> list[str]:
    """Names in a random order of what is not there yet."""
    there = {i.label for i in items}
    return [str(n) for n in rng.permutation(names) if label_of(str(n)) not in there]


def _top(i: Item) -> float:
    assert i.mesh is not None
    return float((i.mesh.vertices @ i.R.T)[:, 2].max() + i.at[2])


def _stage(items: Sequence[Item], *, seconds: float = 5.0, distance: float = 1.0, height: float = 0.55) -> Stage:
    return Stage(items=items, distance=distance, height=height, seconds=seconds, damage=Damage(), seen=SEEN)


CASES: Mapping[str, Callable[[np.random.Generator], Stage]] = {
    "scan_pile": scan_pile, "scan_stack": scan_stack, "scan_scatter": scan_scatter, "scan_mixed": scan_mixed,
}  # fmt: skip
