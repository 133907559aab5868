"""A made scene for goals: a tall carton, a can, a ball, an open crate, a block and a lid on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import pose
from f3sr.language.grammar.materials import material_of
from f3sr.physics.contact_margin import DEFAULT_MARGIN
from f3sr.scene import GROUND, Scene, SceneObject, Support
from f3sr.scene_package.package import Package, read_package, write_package
from scenes import HEIGHT, WIDTH, ball_mesh, box, scene_of

GAP = DEFAULT_MARGIN.clearance
"""Two contact margins: how far things rest from each other [m]."""
CARTON, CAN, BALL, CRATE, BLOCK, LID = range(6)


def goal_scene() -> Scene:
    return scene_of(
        thing(CARTON, "cereal box", box(0, size=(0.1, 0.05, 0.2)).mesh, (-0.25, 0.0, 0.1)),
        thing(CAN, "soup can", _prism(0.033, 0.1), (0.25, 0.1, 0.05)),
        thing(BALL, "tennis ball", ball_mesh(0.032, rings=16), (0.0, -0.1, 0.032)),
        _crate(CRATE, "crate", (0.0, 0.25, 0.0)),
        thing(BLOCK, "wooden block", box(0, size=(0.12, 0.12, 0.06)).mesh, (0.2, -0.2, 0.03)),
        thing(LID, "sponge", box(0, size=(0.06, 0.05, 0.03)).mesh, (0.2, -0.2, 0.075 + GAP), on=BLOCK),
    )


def goal_package(folder: Path, scene: Scene | None = None) -> Package:
    """The package of a scene, in a new folder. That of ``goal_scene()``, which many tests ask for, is written once."""
    if scene is not None:
        return read_package(write_package(scene, folder))
    for name, data in _written().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return read_package(folder)


@cache
def _written() -> dict[str, bytes]:
    """Files of the package of ``goal_scene()`` by their paths in it."""
    with TemporaryDirectory() as place:
        folder = write_package(goal_scene(), Path(place) / "package")
        return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def thing(id: int, label: str, mesh: Mesh, at: Sequence[float], *, on: int = GROUND) -> SceneObject:
    """An object as its label has it, with its middle at a place (3,) [m] one gap higher."""
    o = box(id, label=label)
    return replace(
        o,
        mesh=mesh,
        parts=(ConvexPart.hull_of(mesh.vertices),),
        T_world_object=pose(t=np.add(at, (0, 0, GAP))),
        mask=_mask(id),
        supports=(Support(id=on),),
        supported_by=on,
        **(known.properties | {"material_source": "label"} if (known := material_of(label)) else {}),
    )


def _prism(radius: float, height: float, sides: int = 24) -> Mesh:
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    hull = ConvexPart.hull_of(np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-1, 1)]))
    return Mesh(vertices=hull.vertices * [1, 1, height / 2], faces=hull.faces)


def _crate(id: int, label: str, at: Sequence[float], side: float = 0.16, height: float = 0.1) -> SceneObject:
    """An open box of five boards."""
    wall, half = 0.01, side / 2
    boards = [((side, side, wall), (0, 0, wall / 2))]
    boards += [((wall, side, height), (s * (half - wall / 2), 0, height / 2)) for s in (-1, 1)]
    boards += [((side, wall, height), (0, s * (half - wall / 2), height / 2)) for s in (-1, 1)]
    parts = tuple(ConvexPart.hull_of(_corners(size, middle)) for size, middle in boards)
    vertices = np.concatenate([p.vertices for p in parts])
    starts = np.cumsum([0, *(len(p.vertices) for p in parts[:-1])])
    faces = np.concatenate([p.faces + k for p, k in zip(parts, starts, strict=True)]).astype(np.int32)
    o = thing(id, label, box(0).mesh, at)
    return replace(o, mesh=Mesh(vertices=vertices, faces=faces), parts=parts)


def _corners(size: Sequence[float], middle: Sequence[float]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    signs = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    return signs * np.array(size) + np.array(middle)


def _mask(id: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[10:30, 3 + 9 * id : 9 + 9 * id] = True
    return mask
