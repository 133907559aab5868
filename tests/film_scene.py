"""A played goal on the made scene, drawn unlit, and films of it: what the tests of films and of the player share."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.film import make_film
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.scene import Photo, Scene
from f3sr.scene_package.package import Package
from f3sr.vision import rasterizer
from goal_scene import goal_package, goal_scene

GOAL = "throw the ball at the soup can"
SIZE = 160, 120


@dataclass(frozen=True, eq=False)
class Given:
    package: Package
    played: Played

    @property
    def scene(self) -> Scene:
        return self.package.scene


@cache
def given(goal: str = GOAL) -> Given:
    with tempfile.TemporaryDirectory() as folder:
        package = goal_package(Path(folder) / "package", enlarged(goal_scene()))
        played = simulate_goal(package, goal)
    assert isinstance(played, Played)
    return Given(package, played)


def enlarged(scene: Scene) -> Scene:
    """The same view in more pixels, before a quiet ground."""
    rgb = np.full((SIZE[1], SIZE[0], 3), (150, 160, 140), np.uint8)
    objects = [replace(o, mask=np.kron(o.mask, np.ones((3, 3), bool))[: SIZE[1], : SIZE[0]]) for o in scene]
    return replace(scene, photo=Photo(rgb=rgb), camera=scene.camera.resized(*SIZE), objects=tuple(objects))


def unlit(scene: Scene) -> Callable[[Array], NDArray[np.uint8]]:
    def draw(poses: Array) -> NDArray[np.uint8]:
        objects = [replace(o, T_world_object=T) for o, T in zip(scene, poses, strict=True)]
        fragments = rasterizer.render(objects, scene.camera)
        picture, covered = scene.photo.rgb.copy(), fragments.ids != rasterizer.EMPTY
        shown = rasterizer.shade(fragments, objects) * (0.3 + 0.1 * (fragments.ids[..., None] % 6))
        picture[covered] = (255 * shown[covered]).round()
        return picture

    return draw


@cache
def film_files(slow: float = 1) -> Mapping[str, bytes]:
    g = given()
    return make_film(g.scene, g.played.plan, g.played.rollout, g.played.verdict, unlit(g.scene), slow=slow)
