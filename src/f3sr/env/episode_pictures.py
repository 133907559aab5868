"""What a camera sees of an episode: the film's renderer, with the gripper as further objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from f3sr.core.mesh import ConvexPart, Material, Mesh
from f3sr.core.transforms import Array, rotation_from_vector
from f3sr.env.gripper import FINGERS, HAND, Block, GripperConfig, blocks
from f3sr.env.resets import Randomization
from f3sr.film.studio import PackagePictures, with_deleted
from f3sr.rendering.renderer import Renderer
from f3sr.scene import Scene, SceneObject
from f3sr.scene_package.package import Package

GREY = (0.18, 0.18, 0.2)
"""Colour of the gripper."""
CUBE = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


class EpisodePictures:
    """Pictures of one package from the photo's camera, at most ``longest`` pixels wide or high; made on first use."""

    def __init__(self, package: Package, longest: int, gripper: GripperConfig | None) -> None:
        self._package, self._longest, self._gripper = package, longest, gripper
        self._varied: Renderer | None = None

    @cached_property
    def _shown(self) -> PackagePictures:
        return PackagePictures.of(self._package, self._longest)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        camera = self._shown.scene.camera
        return camera.height, camera.width

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return (HAND, *FINGERS) if self._gripper else ()

    @cached_property
    def _renderer(self) -> Renderer:
        shown = self._shown.shown
        free = max((o.id for o in shown), default=-1) + 1
        own = blocks(self._gripper) if self._gripper else ()
        parts = [_drawable(free + k, shown, block) for k, block in enumerate(own)]
        return Renderer.of(shown, self._shown.background, kept=self._shown.kept, also=parts)

    def vary(self, rng: np.random.Generator, config: Randomization) -> None:
        """Turn the light and move the camera as one reset draws; without, the photo's own."""
        turn, shift = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)
        self._varied = None
        if not (config.light or config.camera):
            return
        setting = self._renderer.setting
        light, camera = setting.light, setting.camera
        R = rotation_from_vector(config.light * turn / max(1.0, float(np.linalg.norm(turn))))
        direction = R @ light.direction
        direction[2] = max(direction[2], 0.3)  # lights below the table light nothing
        moved = camera.T_world_camera.copy()
        distance = float(np.linalg.norm(camera.center - setting.ball[0]))
        moved[:3, 3] += camera.T_world_camera[:3, :3] @ (config.camera * distance * shift * [1, 1, 0])
        self._varied = self._renderer.varied(
            light=replace(light, direction=direction / np.linalg.norm(direction)),
            camera=replace(camera, T_world_camera=moved),
        )

    def drawn(self, T_world_object: Array, gripper: Mapping[str, Array]) -> NDArray[np.uint8]:
        """(h, w, 3) with the objects at poses (N, 4, 4) and the gripper's bodies at theirs."""
        own = np.array([gripper[name] for name in self._names]).reshape(-1, 4, 4)
        objects = with_deleted(T_world_object, self._shown.scene, self._shown.shown)
        return (self._varied or self._renderer).frame(np.concatenate([objects, own]))


def _drawable(id: int, scene: Scene, block: Block) -> SceneObject:
    """A box of the gripper, which the photo does not show."""
    hull = ConvexPart.hull_of(CUBE * block.half + block.middle)
    mesh = Mesh(vertices=hull.vertices, faces=hull.faces, materials=(Material(base_color=GREY),))
    mask = np.zeros((scene.camera.height, scene.camera.width), np.bool_)
    return SceneObject(id=id, label="", mask_name="", mask=mask, mesh=mesh, T_world_object=np.eye(4))
