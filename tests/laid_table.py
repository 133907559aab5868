"""A laid table for the tests of words: coloured boxes under everyday names, seen from the front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from f3sr.core.camera import Camera
from f3sr.scene import GROUND, Photo, Relation, Scene, SceneGraph, SceneObject, Support
from scenes import HEIGHT, WIDTH, box, scene_of

RGB = {
    "red": (200, 20, 30),
    "orange": (245, 130, 10),
    "yellow": (240, 210, 30),
    "green": (20, 130, 40),
    "blue": (20, 50, 190),
    "purple": (110, 30, 140),
    "pink": (250, 160, 185),
    "brown": (105, 68, 38),
    "white": (240, 240, 236),
    "grey": (128, 128, 128),
    "black": (20, 20, 22),
}


def thing(
    id: int,
    label: str,
    *,
    at: Sequence[float],
    size: Sequence[float] = (0.08, 0.08, 0.1),
    on: int = GROUND,
    fixed: bool = False,
) -> SceneObject:
    """A box at (x, y, z of its underside) [m] whose mask is a patch of the photo where the camera sees its middle."""
    x, y, z = at
    o = box(id, size=size, at=(x, y, z + size[2] / 2), label=label)
    column = int(np.clip(WIDTH / 2 + 60 * x / (y + 1), 2, WIDTH - 3))
    row = int(np.clip(HEIGHT / 2 - 60 * (z + size[2] / 2 - 0.3) / (y + 1), 2, HEIGHT - 3))
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[row - 2 : row + 2, column - 2 : column + 2] = True
    supports = (Support(id=on),)
    return replace(o, mask=mask, supports=supports, supported_by=on, mobility="fixed" if fixed else "dynamic")


def painted(scene: Scene, colours: dict[int, str]) -> Scene:
    """The scene with a grey photo on which objects have colours."""
    rgb = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    for id, colour in colours.items():
        rgb[scene[id].mask] = RGB[colour]
    return replace(scene, photo=Photo(rgb=rgb))


def table() -> Scene:
    """Two mugs, two cans of which one stands on a box, a bowl with an apple, a bottle at the back, a fixed shelf, and
    something without a name."""
    objects = (
        thing(0, "mug", at=(-0.4, 0, 0)),
        thing(1, "mug", at=(0.4, 0, 0)),
        thing(3, "cracker box", at=(0, 0, 0), size=(0.16, 0.1, 0.2)),
        thing(4, "tomato soup can", at=(0, 0, 0.2), on=3),
        thing(5, "potted meat can", at=(0.2, 0.3, 0)),
        thing(6, "bowl", at=(-0.2, -0.2, 0), size=(0.12, 0.12, 0.06)),
        thing(7, "apple", at=(-0.2, -0.2, 0.06), size=(0.05, 0.05, 0.05), on=6),
        thing(8, "mustard bottle", at=(-0.3, 0.6, 0), size=(0.07, 0.07, 0.2)),
        thing(9, "shelf", at=(0.9, 0.8, 0), size=(0.3, 0.2, 0.5), fixed=True),
        thing(12, "", at=(0.2, -0.3, 0), size=(0.03, 0.03, 0.03)),
    )
    colours = {0: "red", 1: "blue", 3: "red", 4: "white", 5: "green", 6: "white", 7: "red", 8: "yellow", 9: "brown"}
    pairs = (("inside", 7, 6), ("contains", 6, 7), ("next_to", 0, 6))
    relations = tuple(
        Relation(subject=a, predicate=p, object=b, confidence=1.0, evidence="test")  # type: ignore[arg-type]
        for p, a, b in pairs
    )
    scene = replace(scene_of(*objects), graph=SceneGraph(relations=relations, source="test"))
    return painted(scene, {**colours, 12: "black"})


def mirrored(scene: Scene) -> Scene:
    """The scene as a mirror shows it: left is right. The camera looks along y from the middle."""

    def turned(o: SceneObject) -> SceneObject:
        T = o.T_world_object.copy()
        T[0, 3] *= -1
        return replace(o, T_world_object=T, mask=o.mask[:, ::-1])

    photo = Photo(rgb=scene.photo.rgb[:, ::-1])
    return replace(scene, photo=photo, objects=tuple(turned(o) for o in scene))


def relabelled(scene: Scene, *, shift: int) -> Scene:
    """The same scene under other ids and in another order."""
    count = len(scene.objects)
    order = sorted(range(count), key=lambda k: (k * 7 + shift) % count)
    new = {scene.objects[k].id: 20 + i for i, k in enumerate(order)} | {GROUND: GROUND}
    objects = [
        replace(
            o,
            id=new[o.id],
            supports=tuple(Support(id=new[s.id]) for s in o.supports),
            supported_by=None if o.supported_by is None else new[o.supported_by],
        )
        for o in scene
    ]
    relations = tuple(replace(r, subject=new[r.subject], object=new[r.object]) for r in scene.graph.relations)
    graph = replace(scene.graph, relations=relations)
    return replace(scene, objects=tuple(sorted(objects, key=lambda o: o.id)), graph=graph)


def camera_of(R_world_camera: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Camera:
    """A camera with some axes, 1 m up."""
    T = np.eye(4)
    T[:3, :3], T[2, 3] = R_world_camera, 1.0
    return Camera(width=WIDTH, height=HEIGHT, K=np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), T_world_camera=T)
