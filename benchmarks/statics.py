"""Statics against the physics engine on seeded stacks: does it know what falls, and do shifted stacks stand?

``python benchmarks/statics.py`` prints four tables: agreement of the equilibrium programme with an undamped release,
what becomes of stacks that fall when the smallest shifts are applied, what becomes of tilted stacks that are laid down
and shifted, and how times grow with the number of bodies.
Nothing is written. ``--stacks`` sets how many are drawn.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

import resting
import tables
from f3sr.contact import stability, stabilize
from f3sr.contact.compounds import placed
from f3sr.contact.static_bodies import StaticBody, bodies_of, contacts_of
from f3sr.contact.tipping import LandingConfig
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import UP, pose, rotation_about
from f3sr.physics import release
from f3sr.runtime.kernels import warm_up
from f3sr.scene import SceneObject

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import stacks

SPREADS = (0.02, 0.03, 0.04)
"""How far the middles of stacked bodies lie off the axis at most [m]: from nearly stable to hopeless."""
FELL = 2e-3
"""Travel of a centre of mass [m] that counts as falling: what closes gaps travels less than 2 mm."""
SECONDS = 3.0
"""Of each release."""
RESTS = 1e-3
"""Travel [m] that the issue allows a finished scene."""

T = TypeVar("T")
Objects = tuple[SceneObject, ...]


def timed(job: Callable[[], T]) -> tuple[T, float]:
    """The result and its processor time [s]."""
    start = time.process_time()
    result = job()
    return result, time.process_time() - start


def shifted(objects: Objects, found: stabilize.Balanced) -> Objects:
    return tuple(replace(o, T_world_object=pose(t=found.shifts[o.id]) @ o.T_world_object) for o in objects)


def compare(count: int) -> None:
    """Agreement (what is said, what happens), then repair, per spread."""
    agreement = [["spread mm", "stacks", "stand, rest", "stand, fall", "fall, fall", "fall, rest", "ms"]]
    repair = [["spread mm", "do not stand", "stand after", "of these rest", "rest without", "shift mm", "max", "ms"]]
    for spread in SPREADS:
        table = np.zeros((2, 2), int)
        times: list[float] = []
        outcomes: list[tuple[bool, float, float, float, float]] = []
        for seed in range(count):
            objects = stacks.stack(seed, spread=spread)
            bodies = bodies_of(objects)
            found, seconds = timed(lambda bodies=bodies: stability.stability(bodies))
            times.append(seconds)
            travel = release.release(objects, seconds=SECONDS).D_max
            table[int(found.stands), int(travel < FELL)] += 1
            if not found.stands:
                outcomes.append(repaired(objects, bodies, travel))
        name = f"{1000 * spread:.0f}"
        told = [table[1, 1], table[1, 0], table[0, 0], table[0, 1]]
        agreement.append([name, str(count), *map(str, told), f"{1000 * np.median(times):.0f}"])
        ok, before, after, shift, seconds = (np.array(x) for x in zip(*outcomes, strict=True))
        repair.append(
            [
                name,
                str(len(ok)),
                str(int(ok.sum())),
                str(int((ok & (after < RESTS)).sum())),
                str(int((before < RESTS).sum())),
                f"{1000 * np.median(shift[ok]):.1f}",
                f"{1000 * shift[ok].max():.1f}",
                f"{1000 * np.median(seconds):.0f}",
            ]
        )
    tables.show(agreement)
    print()
    tables.show(repair)


def repaired(
    objects: Objects, bodies: tuple[StaticBody, ...], travel: float
) -> tuple[bool, float, float, float, float]:
    """Whether it stands after shifts; travel [m] without and with them; largest shift [m]; processor time [s]."""
    supports = {o.id: o.supported_by for o in objects}
    found, seconds = timed(lambda: stabilize.balance(bodies, supports))
    after = release.release(shifted(objects, found), seconds=SECONDS).D_max
    shift = max(float(np.linalg.norm(s[:2])) for s in found.shifts.values())
    return not found.unbalanced, travel, after, shift, seconds


def lying(count: int) -> None:
    """Tilted stacks, as they come and after ``rest``."""
    table = [["tilt deg", "stacks", "rest before", "stand after", "of these rest", "travel mm", "after", "ms"]]
    for degrees in (1, 3):
        rows: list[tuple[float, bool, float, float]] = []
        for seed in range(count):
            objects = stacks.stack(seed, spread=0.015, tilt=np.radians(degrees))
            bodies, supports = bodies_of(objects), {o.id: o.supported_by for o in objects}
            allowed = LandingConfig(max_shift=0.15)
            found, seconds = timed(lambda a=bodies, b=supports, c=allowed: resting.rest(a, b, c))
            after = tuple(replace(o, T_world_object=found.motions[o.id] @ o.T_world_object) for o in objects)
            travels = [release.release(o, seconds=SECONDS).D_max for o in (objects, after)]
            rows.append((travels[0], found.after.stands, travels[1], seconds))
        before, stands, travel, seconds = (np.array(x) for x in zip(*rows, strict=True))
        counts = [count, (before < RESTS).sum(), stands.sum(), (stands & (travel < RESTS)).sum()]
        medians = [f"{1000 * np.median(before):.1f}", f"{1000 * np.median(travel):.2f}"]
        table.append([str(degrees), *map(str, counts), *medians, f"{1000 * np.median(seconds):.0f}"])
    tables.show(table)


def dish(id: int, sectors: int = 30) -> SceneObject:
    """A flat dish of as many convex parts."""
    signs = np.array([[x, y, z] for x in (0.2, 1) for y in (-1, 1) for z in (0, 1)])
    parts = []
    for k in range(sectors):
        wedge = signs * [0.1, 0.1 * np.tan(np.pi / sectors), 0.02] * np.where(signs[:, :1] < 1, [1, 0.2, 1], 1)
        parts.append(ConvexPart.hull_of(wedge @ rotation_about(UP, 2 * np.pi * k / sectors).T))
    return replace(stacks.thing(id, "box", np.eye(4)), parts=tuple(parts))


def growth() -> None:
    """Processor time with more bodies of 30 parts each, in towers of five."""
    table = [["bodies", "parts", "contacts", "find contacts ms", "stands ms", "stability ms"]]
    one = dish(0)
    for count in (5, 10, 20, 50):
        bodies = []
        for id in range(count):
            at = np.array([0.25 * (id // 5), 0.003 * (id % 5), stacks.CLEARANCE + (id % 5) * 0.0204])
            T = pose(rotation_about(UP, 0.1 * id), at)
            parts = placed(one.parts, T)
            center = at + 0.01 * UP
            bodies.append(StaticBody(id=id, parts=parts, mass=0.3, centers=center, friction=0.6))
        contacts, finding = timed(lambda bodies=bodies: contacts_of(bodies))
        _, quick = timed(lambda bodies=bodies, contacts=contacts: stability.stands(bodies, contacts))
        _, full = timed(lambda bodies=bodies, contacts=contacts: stability.stability(bodies, contacts))
        row = [count, 30 * count, len(contacts), *(round(1000 * s) for s in (finding, quick, full))]
        table.append([str(x) for x in row])
    tables.show(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stacks", type=int, default=60, help="stacks per spread")
    warm_up()
    count = parser.parse_args().stacks
    compare(count)
    print()
    lying(count)
    print()
    growth()


if __name__ == "__main__":
    main()
