"""From a scene and its photo to the light and exposures of a film, and what a user should know of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from f3sr.frames import Array
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.evidence import Evidence, evidence_of
from f3sr.rendering.layers import Buffers, Things, draw_surfaces
from f3sr.rendering.light import DIRECT_ON_GROUND, SKY_ON_GROUND, Light, disc, ground_sky
from f3sr.rendering.light_fit import DEFAULT, Found, find_light, with_shadows_of
from f3sr.rendering.shadow_maps import Maps
from f3sr.rendering.surface_kernels import View
from f3sr.scene import Scene

UNLIT = replace(DEFAULT, even=np.ones(3), direct=np.zeros(3), sky=np.zeros(3))


def lit_as_photo(
    scene: Scene,
    background: NDArray[np.uint8] | None,
    things: Things,
    ball: tuple[Array, float],
    config: RenderConfig,
) -> tuple[Light, Array, tuple[str, ...]]:
    """Light, exposures (N, 3) and decisions. Without the photo's ``background`` the ground tells nothing."""
    count = len(scene.objects)
    if not config.light.enabled or not count:
        return _unlit(), np.ones((count, 3)), ()
    evidence = _evidence(scene, scene.photo.rgb if background is None else background, things, ball, config)
    if not (evidence.group < count).any():
        return _unlit(), np.ones((count, 3)), ("light: no object can be compared with the photo; shown without",)
    poses = np.array([o.T_world_object for o in scene.objects])
    casters = things.casting(poses, range(count)).disc
    side = config.shadows.map_size // 2
    found = find_light(evidence, casters, ball=ball, objects=count, side=side, config=config.light)
    decisions = [_told(found)]
    lights = disc(found.light.direction, found.light.angle, DIRECT_ON_GROUND), ground_sky(SKY_ON_GROUND)
    maps = Maps.empty(lights[0], *ball, side), Maps.empty(lights[1], *ball, side)
    for m in maps:
        m.cast(casters)
    light, evident = with_shadows_of(evidence, found.light, maps, count)
    if not evident:
        decisions.append("shadows: the photo's ground shows too little of them; as dark as the light makes them")
    return light, found.gains, tuple(decisions)


def _unlit() -> Light:
    """Textures as they are, shadows on the ground of the default light."""
    return UNLIT


def _told(found: Found) -> str:
    if not found.directed:
        return "light: no direction found in the photo; shadows fall from above, soft"
    x, y, z = found.light.direction
    height, turn = np.degrees(np.arcsin(z)), np.degrees(np.arctan2(y, x))
    return (
        f"light: found {height:.0f} deg high, at {turn:.0f} deg about z, {np.degrees(found.light.angle):.0f} deg wide; "
        f"misfit {100 * (1 - np.exp(found.misfit - found.undirected)):.0f}% lower than without"
    )


def _evidence(
    scene: Scene, background: NDArray[np.uint8], things: Things, ball: tuple[Array, float], config: RenderConfig
) -> Evidence:
    poses = np.array([o.T_world_object for o in scene.objects])
    view: View = things.seen_by(scene.camera, poses, config.near)
    maps = Maps.empty(np.zeros((0, 3)), *ball, 1)
    drawn = Buffers.empty(scene.camera, maps, scene.camera, 0)
    draw_surfaces(things, view, range(len(poses)), config.near, drawn)
    return evidence_of(
        scene,
        background,
        shapes=things.shapes,
        textures=things.textures,
        view=view,
        face=drawn.face,
        near=config.near,
        ball=ball,
        samples=config.light.samples,
    )
