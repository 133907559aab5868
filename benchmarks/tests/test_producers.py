"""Laws of when a producer's frame needs no package of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.mesh import Material
from f3sr.core.transforms import pose
from f3sr.scene import SceneObject
from producers import is_same
from scenes import box, scene_of


def other_pixel(o: SceneObject) -> SceneObject:
    texture = o.mesh.materials[0].texture
    assert texture is not None
    changed = texture.copy()
    changed[0, 0, 0] ^= 1
    return replace(o, mesh=replace(o.mesh, materials=(Material(texture=changed),)))


def nudged(o: SceneObject) -> SceneObject:
    return replace(o, T_world_object=pose(t=np.nextafter(o.T_world_object[:3, 3], 1)) @ pose(o.T_world_object[:3, :3]))


def other_vertex(o: SceneObject) -> SceneObject:
    return replace(o, mesh=o.mesh.with_vertices(np.nextafter(o.mesh.vertices, 1)))


def larger(o: SceneObject) -> SceneObject:
    return replace(o, scale=float(np.nextafter(o.scale, 2)))


def test_a_scene_is_the_same_as_itself() -> None:
    assert is_same(scene_of(box(1), box(2, textured=True)), scene_of(box(1), box(2, textured=True)))


@pytest.mark.parametrize("change", [other_pixel, nudged, other_vertex, larger])
def test_the_last_bit_of_a_texture_a_pose_a_vertex_or_a_size_makes_another_scene(
    change: Callable[[SceneObject], SceneObject],
) -> None:
    before = box(2, textured=True)
    assert not is_same(scene_of(before), scene_of(change(before)))
