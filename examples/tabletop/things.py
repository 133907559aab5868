"""The ten objects of the example and where each is put down before physics takes over."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import manifold3d as mf
import numpy as np

from f3sr.core.transforms import Array, pose, rotation_about
from tabletop import looks, shapes
from tabletop.looks import Look
from tabletop.shapes import Shape


@dataclass(frozen=True, eq=False, kw_only=True)
class Thing:
    """One object: shape, look, ``mass`` [kg], mirror ``roughness``, and where it is released."""

    label: str
    shape: Shape
    look: Look
    mass: float
    at: tuple[float, float, float]
    turn: float = 0.0
    """About z [deg]."""
    roughness: float = 0.2
    round: bool = False
    """Rolls: takes rolling friction."""

    @property
    def T_start(self) -> Array:
        return pose(rotation_about([0, 0, 1], np.radians(self.turn)), self.at)

    @cached_property
    def triangles(self) -> tuple[Array, Array]:
        """Corners and shading normals (m, 3, 3), object frame; edges over 35 degrees stay sharp."""
        mesh = self.shape.solid.calculate_normals(0, 35.0).to_mesh()
        corners = np.asarray(mesh.vert_properties, float)[np.asarray(mesh.tri_verts)]
        return corners[..., :3], corners[..., 3:6]


def arrange() -> tuple[Thing, ...]:
    """Who stands where: a stack of three, a fruit in a bowl, a mug on a book, and loose things around."""
    carton, tin, block = (0.205, 0.135, 0.052), (0.0375, 0.102), 0.042
    volume = (0.165, 0.225, 0.026)
    stack = np.array([0.065, 0.115])
    orange_skin = looks.citrus_skin("#f08a1d", "#d96a0b", 0.0355, "#5d7a2a")
    lemon_skin = looks.citrus_skin("#f5d327", "#e0b010", 0.0385, "#9a8a2a")
    beech = looks.wood("#d9b07a", "#9a6a38", along=0, ring=0.006)
    return (
        Thing(
            label="biscuit_box", shape=shapes.box(carton, 0.0012), look=looks.biscuit_box(carton),
            mass=0.29, at=(*stack, 0.001), turn=14, roughness=0.25,
        ),
        Thing(
            label="tomato_tin", shape=shapes.tin(*tin), look=looks.tomato_tin(*tin),
            mass=0.46, at=(stack[0] + 0.035, stack[1] + 0.004, 0.054), turn=-4, roughness=0.16,
        ),
        Thing(
            label="letter_block", shape=shapes.box([block] * 3, 0.0022), look=looks.letter_block(block),
            mass=0.05, at=(stack[0] + 0.039, stack[1] + 0.001, 0.157), turn=-28,
        ),
        Thing(
            label="bowl", shape=shapes.bowl(0.086, 0.062), look=looks.striped_bowl(0.062),
            mass=0.34, at=(-0.085, -0.045, 0.001), roughness=0.06,
        ),
        Thing(
            label="orange", shape=shapes.citrus(0.0365, 0.0355), look=orange_skin,
            mass=0.19, at=(-0.083, -0.043, 0.011), turn=-70, roughness=0.3, round=True,
        ),
        Thing(
            label="book", shape=shapes.book(volume), look=looks.cloth_book(volume, title="GRAVITY"),
            mass=0.42, at=(0.175, -0.075, 0.001), turn=-112,
        ),
        Thing(
            label="dotted_mug", shape=shapes.mug(0.041, 0.092), look=looks.dotted_mug(0.041, 0.092),
            mass=0.32, at=(0.202, -0.052, 0.028), turn=-42, roughness=0.05,
        ),
        Thing(
            label="oil_bottle", shape=shapes.bottle(0.035, 0.245), look=looks.oil_bottle(0.035, 0.245),
            mass=0.78, at=(-0.165, 0.120, 0.001), turn=-72, roughness=0.05,
        ),
        Thing(
            label="wooden_spoon", shape=shapes.spoon(0.235), look=beech,
            mass=0.03, at=(-0.035, -0.185, 0.002), turn=-14,
        ),
        Thing(
            label="lemon", shape=shapes.citrus(0.0265, 0.033, nub=0.006), look=lemon_skin,
            mass=0.09, at=(-0.212, -0.108, 0.001), turn=35, roughness=0.3, round=True,
        ),
    )  # fmt: skip


def room() -> tuple[Thing, Thing]:
    """The table's slab (its top is z = 0) and the wall behind."""
    slab, wall = shapes.rounded_box([1.9, 1.06, 0.035], 0.004), shapes.rounded_box([8, 0.1, 6], 0.001)
    table, plaster = looks.table_top(), looks.plain_wall()
    return (
        Thing(label="table", shape=fixture(slab), look=table, mass=0, at=(0, 0.04, -0.035), roughness=0.3),
        Thing(label="wall", shape=fixture(wall), look=plaster, mass=0, at=(0, 1.25, -3)),
    )


def fixture(solid: mf.Manifold) -> Shape:
    """Scenery: seen but without convex parts."""
    return Shape(solid=solid, parts=())
