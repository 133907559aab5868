"""A scene whose program says where everything is. Absent masks, and an absent photo, are drawn from the poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array
from f3sr.errors import InputError
from f3sr.io.images import encode_png
from f3sr.io.masks import MIN_PIXELS
from f3sr.scene import GROUND, SceneObject
from f3sr.vision import rasterizer

GROUND_REACH = 30.0
"""Half side of the ground that is drawn, in distances of the camera from the scene's middle."""
GROUND_GREY, SKY_GREY = 150, 215
"""Of drawn photos: of what objects stand on, and of what is behind it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ComposedObject:
    """A mesh in its own axes and where it stands: ``x_world = T_world_mesh (scale x)``, T (4, 4) rigid [m]."""

    id: int
    label: str
    mesh: Mesh
    T_world_mesh: Array
    scale: float = 1.0

    @property
    def in_world(self) -> SceneObject:
        """The object as renderers take it, without a mask."""
        return SceneObject(
            id=self.id, label=self.label, mask_name="", mask=np.ones((1, 1), np.bool_), mesh=self.mesh,
            T_world_object=self.T_world_mesh, scale=self.scale,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class LeftOut:
    """What of a scene is not imported, and why."""

    label: str
    reason: str
    id: int | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Composition:
    """Objects in a world, seen by a camera.

    In an ``upright`` world +Z is up, and ``ground`` is the height of the plane they stand on [m]. Else its axes are
    those of a level camera, nobody tells gravity, and no geometry is written but the camera's K.
    """

    source: str
    """The program, and its file."""
    photo: bytes | None
    """A PNG or JPEG file; None where there is none: then it is drawn."""
    camera: Camera
    objects: tuple[ComposedObject, ...]
    ground: float | None = 0.0
    upright: bool = True
    masks: Mapping[int, NDArray[np.bool_]] | None = None
    """(H, W) by id, where they are given. None: they are drawn."""
    supports: tuple[tuple[int, int], ...] = ()
    """Pairs (upper, lower) of ids that the program says rest on each other."""
    left_out: tuple[LeftOut, ...] = ()
    remarks: tuple[str, ...] = ()
    """What was assumed, and what was not read, for the user."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DrawnView:
    """What the camera sees of a composition, at the photo's pixels."""

    masks: Mapping[int, NDArray[np.bool_]]
    """(H, W) by id, where nothing nearer hides it; without objects that the camera hardly sees."""
    ground: NDArray[np.bool_]
    """(H, W)"""
    points: NDArray[np.float32]
    """(H, W, 3) [m] in OpenCV camera axes."""
    valid: NDArray[np.bool_]
    """(H, W) where points are known."""
    photo: bytes = field(repr=False, default=b"")
    """The composition's, or a PNG of unlit textures where it has none."""


def drawn(composition: Composition) -> DrawnView:
    """The view that the poses give: it is the picture to keep where there are no masks.

    Raises InputError where no object can be seen."""
    camera = composition.camera
    objects = [o.in_world for o in composition.objects]
    shown = [*objects, *_ground(composition, objects)]
    fragments = rasterizer.render(shown, camera)
    masks = composition.masks or {o.id: mask for o in objects if (mask := fragments.ids == o.id).sum() >= MIN_PIXELS}
    if not masks:
        raise InputError(composition.source, found="no object that its camera sees", accepted="at least one")
    seen = fragments.ids != rasterizer.EMPTY
    rows, columns = np.indices(seen.shape) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.K).T
    points = np.where(seen[..., None], rays * np.where(seen, fragments.depth, 1.0)[..., None], 0.0)
    return DrawnView(
        masks=masks,
        ground=(fragments.ids == GROUND) & ~np.any(list(masks.values()), axis=0),
        points=points.astype(np.float32),
        valid=seen,
        photo=composition.photo or _photo(fragments, shown),
    )


def _photo(fragments: rasterizer.Fragments, shown: list[SceneObject]) -> bytes:
    colours = np.round(255 * rasterizer.shade(fragments, shown)).astype(np.uint8)
    colours[fragments.ids == rasterizer.EMPTY] = SKY_GREY
    return encode_png(colours)


def _ground(composition: Composition, objects: list[SceneObject]) -> list[SceneObject]:
    """The ground as a large square under the scene."""
    if composition.ground is None:
        return []
    middle = np.mean([o.middle for o in objects], axis=0)
    side = GROUND_REACH * float(np.linalg.norm(middle - composition.camera.center))
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side
    corners += [middle[0], middle[1], composition.ground]
    square = Mesh(
        vertices=corners,
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        vertex_colors=np.full((4, 3), GROUND_GREY, np.uint8),
    )
    return [
        SceneObject(id=GROUND, label="ground", mask_name="", mask=np.ones((1, 1), np.bool_), mesh=square,
                    T_world_object=np.eye(4))
    ]  # fmt: skip
