"""A film of one tiny frame that calls every kernel of the renderer, so that all are compiled and cached."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from f3sr.core.camera import Camera
from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import UP, pose, rotation_about
from f3sr.rendering.config import RenderConfig, ShadowConfig
from f3sr.rendering.renderer import Renderer
from f3sr.scene import Photo, Scene, SceneObject

SIDE = 32
"""Of the picture [px]: small, and large enough that the light is looked for."""


def warm_up() -> None:
    """Compile every kernel of the renderer: draw a tent on the ground from above, at rest and moved."""
    mesh = Mesh(
        vertices=np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 0.5]]) / 4,
        faces=np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32),
        uv=np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]]),
        vertex_colors=np.full((5, 3), 200, np.uint8),
        materials=(Material(texture=np.full((4, 4, 3), 100, np.uint8)),),
    )
    mask = np.zeros((SIDE, SIDE), np.bool_)
    mask[SIDE // 4 : -SIDE // 4, SIDE // 4 : -SIDE // 4] = True
    thing = SceneObject(id=0, label="", mask_name="", mask=mask, mesh=mesh, T_world_object=pose())
    K = np.array([[SIDE, 0, SIDE / 2], [0, SIDE, SIDE / 2], [0, 0, 1.0]])
    above = Camera(width=SIDE, height=SIDE, K=K, T_world_camera=pose(np.diag([1.0, -1, -1]), UP))
    photo = Photo(rgb=np.where(mask[..., None], 90, 180).repeat(3, axis=2).astype(np.uint8))
    scene = Scene(photo=photo, camera=above, objects=(thing,))
    config = replace(RenderConfig(), shadows=ShadowConfig(map_size=64))
    renderer = Renderer.of(scene, np.full((SIDE, SIDE, 3), 180, np.uint8), config=config)
    renderer.frame([pose()])
    renderer.frame([pose(rotation_about(UP, 0.1), 0.1 * UP)])
