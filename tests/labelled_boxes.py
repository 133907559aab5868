"""A scene for tests of exports: three boxes, one turned and one fixed, under labels of people and of attackers."""

from __future__ import annotations

from dataclasses import replace

from f3sr.core.transforms import rotation_about
from f3sr.scene import Scene
from scenes import box, box_stack_scene, scene_of


def labelled_boxes() -> Scene:
    """Its camera's principal point is off the centre, and pixels are not square."""
    a, b, _ = box_stack_scene(3)
    turned = rotation_about([1.0, 2, 3], 0.7)
    scene = scene_of(
        replace(a, label="Red Mug", mobility="fixed", restitution=0.3),
        replace(b, label="../<x>", friction=0.3, rolling_friction=0.002),
        box(12, size=(0.03, 0.06, 0.1), at=(0.3, 0.1, 0.2), R=turned, textured=True, label="", scale=0.1),
    )
    K = scene.camera.K.copy()
    K[:2, 2] += [5, -3]
    K[1, 1] *= 1.1
    return replace(scene, camera=replace(scene.camera, K=K))
