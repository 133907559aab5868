"""Rooms: a floor, furniture that is itself objects, scans at their size and scaled up, from a seed.

A seed moves, turns and sizes what stands freely; what each room has stays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from container_things import scan, scanned
from f3sr.core.transforms import Array
from stress_things import Item, Stage, ball, brick, chair, crate, frame, item, turned
from tabletop import shapes
from tabletop.shapes import Shape

GAP = 0.002
"""Height [m] from which things are let go."""


def kitchen(rng: np.random.Generator) -> Stage:
    """A counter with a pan, a bottle, cups and groceries; before it a microwave, a bin, a stool and a barrel."""
    top = 0.9
    stuff = _Room(rng)
    stuff.put("counter", table((2.0, 0.6, top), 0.05, panels=True), (0, 0))
    stuff.put("microwave", microwave(), (-1.4, -0.55), yaw=40)
    stuff.put_scan("frying_pan", "gso_frypan", (-0.25, 0.02), top, yaw=stuff.any_yaw())
    stuff.put("bottle", shapes.bottle(0.038, 0.27), (0.33, -0.08), top)
    stuff.put("cup", cup(), (0.47, -0.18), top, yaw=stuff.any_yaw())
    stuff.put_scan("mug", "ycb_mug", (0.66, -0.12), top, yaw=stuff.any_yaw())
    stuff.put_scan("cereal_box", "ycb_cracker_box", (0.82, 0.1), top, factor=1.4, yaw=80)
    stuff.put_scan("bleach", "ycb_bleach_cleanser", (0.55, 0.15), top, yaw=stuff.any_yaw())
    stuff.put("trash_bin", trash_bin(0.15, 0.36), (-0.25, -0.8))
    stuff.put("stool", stool(), (0.35, -0.7), yaw=stuff.any_yaw())
    stuff.put_scan("barrel", "ycb_tomato_soup_can", (0.9, -0.65), factor=3.5, yaw=stuff.any_yaw())
    return stuff.stage(distance=2.4, height=1.7)


def lounge(rng: np.random.Generator) -> Stage:
    """A sofa with pillows, a low table with cups and books, a bookcase, a backpack and a ball on the floor."""
    low = 0.42
    stuff = _Room(rng)
    stuff.put("sofa", sofa(), (-0.4, 0.5))
    stuff.put("pillow", pillow(), (-0.95, 0.45), 0.42, yaw=10)
    stuff.put("cushion", pillow(0.8), (0.1, 0.45), 0.42, yaw=-20)
    stuff.put("coffee_table", table((1.0, 0.5, low), 0.04), (-0.35, -0.5))
    stuff.put("cup", cup(), (0.0, -0.62), low, yaw=stuff.any_yaw())
    stuff.put_scan("mug", "ycb_mug", (-0.17, -0.6), low, yaw=stuff.any_yaw())
    stuff.put("book", shapes.book((0.17, 0.24, 0.03)), (-0.42, -0.5), low, yaw=20)
    stuff.put_scan("plate", "ycb_plate", (-0.7, -0.4), low)
    stuff.put("bookcase", bookcase((0.8, 0.3, 1.3), 3), (1.15, 0.55))
    for k, x in enumerate((0.95, 1.25)):
        stuff.put(("box", "carton")[k], brick((0.2, 0.2, rng.uniform(0.16, 0.26))), (x, 0.52), (0.087, 0.514)[k])
    stuff.put("vase", shapes.bottle(0.06, 0.3), (1.2, 0.55), 1.3)
    stuff.put("backpack", backpack(), (0.55, -0.55), yaw=rng.uniform(-40, 40))
    stuff.put("ball", ball(0.11), (1.15, -0.45), is_round=True)
    return stuff.stage(distance=3.2, height=1.7)


def bedroom(rng: np.random.Generator) -> Stage:
    """A bed with two pillows and a backpack, a nightstand, a toy plane and a wardrobe box."""
    stuff = _Room(rng)
    stuff.put("bed", bed(), (-0.3, 0.1))
    stuff.put("pillow", pillow(), (-0.7, 0.6), 0.5, yaw=5)
    stuff.put_scan("cushion", "ycb_foam_brick", (0.0, 0.55), 0.5, factor=4.5, yaw=70)
    stuff.put("backpack", backpack(), (-0.35, -0.25), 0.5, yaw=rng.uniform(-30, 30))
    stuff.put("nightstand", table((0.45, 0.4, 0.5), 0.03, panels=True), (0.85, 0.75))
    stuff.put("book", shapes.book((0.15, 0.21, 0.028)), (0.78, 0.7), 0.5, yaw=15)
    stuff.put("cup", cup(), (0.97, 0.72), 0.5, yaw=stuff.any_yaw())
    stuff.put_scan("toy_plane", "ycb_a_toy_airplane", (1.0, -0.5), factor=1.8, yaw=stuff.any_yaw())
    stuff.put_scan("hassock", "ycb_potted_meat_can", (1.3, 0.1), factor=4.0, yaw=stuff.any_yaw())
    stuff.put("ball", ball(0.1), (0.75, -0.1), is_round=True)
    return stuff.stage(distance=2.8, height=1.8)


def study(rng: np.random.Generator) -> Stage:
    """A desk with a monitor, books, cups and a bottle; a chair, a trash bin, a bookcase and parcels."""
    top = 0.74
    stuff = _Room(rng)
    stuff.put("desk", table((1.5, 0.7, top), 0.04), (0, 0))
    stuff.put("monitor", monitor(), (0.05, 0.15), top)
    for k, yaw in enumerate((5, -12, 20)):
        size = (0.18 - 0.01 * k, 0.24 - 0.01 * k, 0.03)
        stuff.put(f"book_{'abc'[k]}", shapes.book(size), (-0.5, 0.05), top + 0.033 * k, yaw=yaw, jitter=0.01)
    stuff.put_scan("mug", "ycb_mug", (0.48, -0.12), top, yaw=stuff.any_yaw())
    stuff.put("cup", cup(), (0.62, -0.15), top, yaw=stuff.any_yaw())
    stuff.put_scan("spray_bottle", "ycb_windex_bottle", (0.6, 0.18), top, yaw=stuff.any_yaw())
    stuff.put_scan("cube", "ycb_rubiks_cube", (-0.2, -0.2), top, yaw=stuff.any_yaw())
    stuff.put("chair", chair(), (0.05, -0.85), yaw=rng.uniform(150, 210))
    stuff.put("trash_bin", trash_bin(0.14, 0.32), (-0.75, -0.75))
    stuff.put("bookcase", bookcase((0.7, 0.3, 1.2), 3), (1.35, 0.2))
    stuff.put_scan("sugar", "ycb_sugar_box", (1.2, 0.15), 1.2, factor=1.5, yaw=stuff.any_yaw())
    stuff.put("parcel", brick((0.35, 0.3, 0.22)), (0.85, -0.7), yaw=rng.uniform(-30, 30))
    stuff.put("small_parcel", brick((0.25, 0.2, 0.15)), (0.85, -0.7), 0.224, yaw=rng.uniform(-40, 40), jitter=0.015)
    return stuff.stage(distance=2.8, height=1.7)


def dining_room(rng: np.random.Generator) -> Stage:
    """A laid table with a bowl of fruit, plates, cups and a bottle; two chairs and a stool."""
    top = 0.74
    stuff = _Room(rng)
    stuff.put("dining_table", table((1.5, 0.8, top), 0.05), (0, 0))
    stuff.put_scan("fruit_bowl", "ycb_bowl", (0.0, 0.1), top, factor=1.6)
    stuff.put_scan("apple", "ycb_apple", (-0.01, 0.1), top + 0.04, is_round=True, jitter=0.005)
    stuff.put_scan("plate", "ycb_plate", (-0.4, -0.2), top)
    stuff.put("cup", cup(), (-0.12, -0.25), top, yaw=stuff.any_yaw())
    stuff.put("beaker", shapes.bowl(0.05, 0.09), (0.1, -0.25), top)
    stuff.put("bottle", shapes.bottle(0.04, 0.3), (0.35, -0.05), top)
    stuff.put_scan("mustard", "ycb_mustard_bottle", (0.5, 0.1), top, yaw=stuff.any_yaw())
    stuff.put_scan("pan", "gso_frypan", (0.52, -0.2), top, yaw=rng.uniform(-30, 30))
    stuff.put("chair", chair(), (-0.4, -0.72), yaw=rng.uniform(-15, 15))
    stuff.put("armchair", chair(), (1.1, 0.0), yaw=rng.uniform(70, 110))
    stuff.put("stool", stool(), (0.5, -0.75), yaw=stuff.any_yaw())
    return stuff.stage(distance=2.7, height=1.7)


def storeroom(rng: np.random.Generator) -> Stage:
    """Shelves with boxes and cans, crates, barrels, stacked cartons and tools."""
    stuff = _Room(rng)
    stuff.put("shelf", bookcase((1.2, 0.4, 1.6), 4), (0, 0))
    for k, z in enumerate((0.087, 0.475, 0.863, 1.251)):
        for j, x in enumerate((-0.3, 0.25)):
            size = (rng.uniform(0.22, 0.34), 0.28, rng.uniform(0.14, 0.26))
            stuff.put(f"box_{'abcdefgh'[2 * k + j]}", brick(size), (x, -0.04), z, jitter=0.02)
    stuff.put_scan("barrel", "ycb_tomato_soup_can", (-1.0, -0.1), factor=5.0, yaw=stuff.any_yaw())
    stuff.put_scan("canister", "ycb_bleach_cleanser", (-0.85, -0.6), factor=1.7, yaw=stuff.any_yaw())
    stuff.put("carton", brick((0.42, 0.36, 0.3)), (0.98, -0.1), yaw=rng.uniform(-20, 20))
    stuff.put("small_carton", brick((0.32, 0.3, 0.22)), (0.98, -0.1), 0.304, yaw=rng.uniform(-30, 30), jitter=0.02)
    stuff.put("crate", crate(0.4, 0.22, wall=0.02), (0.3, -0.75), yaw=rng.uniform(-25, 25), jitter=0)
    stuff.put("ball", ball(0.1), (0.3, -0.75), 0.025, is_round=True, jitter=0.01)
    stuff.put("bucket", trash_bin(0.14, 0.26), (-0.35, -0.7))
    stuff.put_scan("hammer", "ycb_hammer", (0.85, -0.7), factor=1.2, yaw=stuff.any_yaw())
    return stuff.stage(distance=3.2, height=1.8)


class _Room:
    """Items on a floor, each a little off the place it is given."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.items = rng, list[Item]()

    def any_yaw(self) -> float:
        return float(self.rng.uniform(0, 360))

    def put(self, label: str, shape: Shape, at: Sequence[float], height: float = 0.0, *, yaw: float = 0.0,
            is_round: bool = False, jitter: float = 0.03) -> None:  # fmt: skip
        R = turned(yaw)
        self.items.append(item(label, shape, self._place(at, height, jitter), self.rng, R=R, round=is_round))

    def put_scan(self, label: str, name: str, at: Sequence[float], height: float = 0.0, *, factor: float = 1.0,
                 yaw: float = 0.0, is_round: bool = False, jitter: float = 0.03) -> None:  # fmt: skip
        """A scan, ``factor`` times its size."""
        shape, mesh = scan(name)
        big = Shape(solid=shape.solid.scale([factor] * 3), parts=tuple(factor * p for p in shape.parts))
        mesh = mesh.with_vertices(factor * mesh.vertices)
        place = self._place(at, height, jitter)
        self.items.append(scanned(label, big, mesh, place, turned(yaw), is_round=is_round))

    def stage(self, *, distance: float, height: float) -> Stage:
        return Stage(items=self.items, distance=distance, height=height, seconds=4.0)

    def _place(self, at: Sequence[float], height: float, jitter: float) -> Array:
        return np.array([*(np.asarray(at) + self.rng.uniform(-jitter, jitter, 2)), height + GAP])


def table(size: tuple[float, float, float], board: float, *, panels: bool = False) -> Shape:
    """A table, or with ``panels`` at both ends and behind a counter, of a width, depth and height [m]."""
    x, y, z = size
    under = z - board
    if panels:
        feet = [((0.04, y - 0.04, under), (i * (x / 2 - 0.04), 0, under / 2)) for i in (-1, 1)]
        feet.append(((x - 0.1, 0.03, under), (0, y / 2 - 0.05, under / 2)))
    else:
        leg = 0.06
        feet = [
            ((leg, leg, under), (i * (x / 2 - 0.06), j * (y / 2 - 0.06), under / 2)) for i in (-1, 1) for j in (-1, 1)
        ]
    return frame(((x, y, board), (0, 0, z - board / 2)), *feet)


def bookcase(size: tuple[float, float, float], compartments: int) -> Shape:
    """Open to the front, -y; its lowest board is 6 cm above the floor."""
    x, y, z = size
    wall, low = 0.025, 0.0725
    heights = np.linspace(low, z - wall / 2, compartments + 1)
    boards = [((x, y, wall), (0, 0, h)) for h in heights]
    sides = [((wall, y, z), (i * (x - wall) / 2, 0, z / 2)) for i in (-1, 1)]
    return frame(*boards, *sides, ((x, 0.02, z), (0, y / 2 - 0.01, z / 2)))


def sofa() -> Shape:
    seat = ((1.9, 0.85, 0.42), (0, 0, 0.21))
    arms = [((0.18, 0.85, 0.62), (i * 0.86, 0, 0.31)) for i in (-1, 1)]
    return frame(seat, ((1.9, 0.2, 0.8), (0, 0.325, 0.4)), *arms)


def bed() -> Shape:
    return frame(((1.3, 1.9, 0.5), (0, 0, 0.25)), ((1.4, 0.06, 0.9), (0, 0.97, 0.45)))


def stool() -> Shape:
    legs = [((0.04, 0.04, 0.45), (i * 0.13, j * 0.13, 0.225)) for i in (-1, 1) for j in (-1, 1)]
    return frame(((0.34, 0.34, 0.035), (0, 0, 0.4675)), *legs)


def microwave() -> Shape:
    """Its door towards -y, with a handle."""
    return frame(((0.5, 0.36, 0.28), (0, 0, 0.14)), ((0.02, 0.03, 0.2), (0.13, -0.19, 0.14)))


def monitor() -> Shape:
    return frame(
        ((0.55, 0.03, 0.33), (0, 0, 0.265)), ((0.06, 0.03, 0.12), (0, 0.01, 0.06)), ((0.24, 0.18, 0.012), (0, 0, 0.006))
    )


def backpack() -> Shape:
    """A tall bag with a pocket to the front."""
    body = shapes.rounded_box([0.32, 0.17, 0.46], 0.05)
    pocket = shapes.rounded_box([0.25, 0.12, 0.24], 0.04).translate([0, -0.08, 0])
    return Shape(solid=body + pocket, parts=(shapes.vertices(body), shapes.vertices(pocket)))


def pillow(size: float = 1.0) -> Shape:
    return shapes.box((size * 0.5, size * 0.34, size * 0.14), size * 0.06)


def cup() -> Shape:
    return shapes.mug(0.042, 0.1)


def trash_bin(radius: float, height: float) -> Shape:
    """Round, open, wider towards its rim."""
    wall = 0.012
    t = np.linspace(0, 1, 9)
    outer = np.stack([radius * (0.78 + 0.22 * t), height * t], -1)
    inner = np.stack([radius * (0.78 + 0.22 * t) - wall, wall + (height - wall) * t], -1)
    return shapes.vessel(outer, inner, every=4)


CASES: Mapping[str, Callable[[np.random.Generator], Stage]] = {
    "kitchen": kitchen, "lounge": lounge, "bedroom": bedroom, "study": study, "dining_room": dining_room,
    "storeroom": storeroom,
}  # fmt: skip
