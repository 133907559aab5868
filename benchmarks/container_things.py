"""Scans in containers: fruit in a bowl, things in a pan, a mug, a crate and on a plate, dropped in from a seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import manifold3d as mf
import numpy as np

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, rotation_about
from f3sr.io.mesh_files import load_mesh
from f3sr.proxies import decompose
from stress_things import DENSITY, Item, Stage, X, Z, crate, item, turned
from tabletop.shapes import Shape

OBJECTS = Path(__file__).resolve().parents[2] / "shared" / "data" / "objects"
FRUIT = ("ycb_apple", "ycb_lemon", "ycb_orange", "ycb_strawberry", "ycb_tennis_ball")
SMALL = ("ycb_b_lego_duplo", "ycb_padlock", "ycb_strawberry", "ycb_lemon", "ycb_rubiks_cube", "ycb_gelatin_box")
LONG = ("ycb_spoon", "ycb_phillips_screwdriver", "ycb_spatula", "ycb_adjustable_wrench")
GROSS = ("ycb_foam_brick", "ycb_potted_meat_can", "ycb_tomato_soup_can", "ycb_gelatin_box", "ycb_apple", "ycb_orange")
ROUND = ("apple", "lemon", "orange", "strawberry", "tennis_ball")
DROP = 0.03
"""Height [m] between what is dropped and the tops below it."""


def contents(names: Sequence[str], count: int, radius: float, base: float, rng: np.random.Generator) -> list[Item]:
    """Different scans above each other within a ``radius`` [m] of the middle, turned at random."""
    items, height = list[Item](), base
    for name in rng.permutation(names)[:count]:
        shape, mesh = scan(str(name))
        R = turned(rng.uniform(0, 360)) @ turned(rng.uniform(-25, 25), X)
        away, angle = radius * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        at = (away * np.cos(angle), away * np.sin(angle), height)
        items.append(scanned(label_of(str(name)), shape, mesh, at, R))
        height += float(np.ptp(mesh.vertices @ R.T, axis=0)[2]) + DROP
    return items


def scanned(label: str, shape: Shape, mesh: Mesh, at: Sequence[float], R: Array, *, is_round: bool = False) -> Item:
    volume = sum(mf.Manifold.hull_points(p).volume() for p in shape.parts)
    return Item(
        label=label, shape=shape, look=lambda points: np.full_like(points, 0.5), mass=DENSITY * volume,
        at=(float(at[0]), float(at[1]), float(at[2])), R=R, round=is_round or label in ROUND, mesh=mesh,
    )  # fmt: skip


def label_of(name: str) -> str:
    return name.split("_", 1)[1]


@cache
def scan(name: str) -> tuple[Shape, Mesh]:
    """A scan and its convex parts, which are the product's own proxies."""
    mesh = load_mesh(OBJECTS / f"{name}.glb")
    parts = tuple(p.vertices for p in decompose(mesh).parts)
    return Shape(solid=mf.Manifold.hull_points(mesh.vertices), parts=parts), mesh


def container(name: str) -> Item:
    return scanned(label_of(name), *scan(name), (0.0, 0.0, 0.001), rotation_about(Z, 0.0))


def in_bowl(rng: np.random.Generator) -> Stage:
    items = [container("ycb_bowl"), *contents(FRUIT, 2 + int(rng.integers(3)), 0.03, 0.03, rng)]
    return Stage(items=items, distance=0.75, height=0.5, seconds=5.0)


def in_pan(rng: np.random.Generator) -> Stage:
    items = [container("gso_frypan"), *contents(SMALL, 2 + int(rng.integers(4)), 0.06, 0.04, rng)]
    return Stage(items=items, distance=0.8, height=0.55, seconds=5.0)


def in_mug(rng: np.random.Generator) -> Stage:
    """A tool that leans in a mug, and something beside it."""
    name = str(rng.permutation(LONG[:2])[0])
    shape, mesh = scan(name)
    up = mesh.vertices - mesh.vertices.mean(0)
    along = np.linalg.svd(up, full_matrices=False)[2][0]
    axis = np.cross(along, Z)
    R = rotation_about(axis, float(np.arccos(np.clip(along @ Z, -1, 1))) - 0.12)
    low = float((mesh.vertices @ R.T)[:, 2].min())
    middle = (mesh.vertices @ R.T).mean(0)
    tool = scanned(label_of(name), shape, mesh, (-middle[0], -middle[1], 0.02 - low), R)
    beside = contents(SMALL, 2, 0.01, 0.002, rng)
    moved = [scanned(i.label, i.shape, i.mesh, (0.16 - 0.3 * k, 0.03, 0.03), i.R) for k, i in enumerate(beside)]
    return Stage(items=[container("ycb_mug"), tool, *moved], distance=0.7, height=0.45, seconds=5.0)


def on_plate(rng: np.random.Generator) -> Stage:
    items = [container("ycb_plate"), *contents((*SMALL, *FRUIT[:2]), 3 + int(rng.integers(3)), 0.05, 0.04, rng)]
    return Stage(items=items, distance=0.8, height=0.55, seconds=5.0)


def in_crate(rng: np.random.Generator) -> Stage:
    items = [
        item("crate", crate(0.26, 0.09, wall=0.008), (0, 0, 0.001), rng),
        *contents(GROSS, 3 + int(rng.integers(4)), 0.07, 0.03, rng),
    ]
    return Stage(items=items, distance=0.9, height=0.7, seconds=6.0)


CASES: Mapping[str, Callable[[np.random.Generator], Stage]] = {
    "in_bowl": in_bowl, "in_pan": in_pan, "in_mug": in_mug, "on_plate": on_plate, "in_crate": in_crate,
}  # fmt: skip
