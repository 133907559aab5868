"""Light and exposures of a film from a scene and its photo, with decisions for the user."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array
from f3sr.rendering.colour_mix import colour_mix
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.evidence import Evidence, evidence_of
from f3sr.rendering.layers import Buffers, Things, draw_surfaces
from f3sr.rendering.light import DIRECT_ON_GROUND, SKY_ON_GROUND, Light, disc, ground_sky
from f3sr.rendering.light_fit import (
    DEFAULT,
    FittedLight,
    common_exposure,
    exposures,
    find_light,
    picture_error,
    with_shadows_of,
)
from f3sr.rendering.shadow_maps import Caster, Maps
from f3sr.rendering.surface_kernels import FrameGeometry
from f3sr.report import keep_better
from f3sr.scene import Scene

UNLIT = replace(DEFAULT, unlit=True)
"""Objects as their textures are, shadows on the ground of the default light."""

PATCH = 1 / 16
"""Side of the patches whose colours are compared, in radii of the scene's ball."""


def lit_as_photo(
    scene: Scene,
    background: NDArray[np.uint8] | None,
    things: Things,
    ball: tuple[Array, float],
    config: RenderConfig,
) -> tuple[Light, Array, tuple[str, ...]]:
    """Light, exposures (N, 3, 3) from texture colours to shown ones in linear light, and decisions for the user.

    ``background`` (h, w, 3) is the completed photo. Without it the ground tells nothing of shadows. ``ball``: middle
    (3,) in the world and radius [m] of what shadow maps cover."""
    count = len(scene.objects)
    unexposed = np.tile(np.eye(3), (count, 1, 1))
    if not config.light.enabled or not count:
        return UNLIT, unexposed, ()
    evidence = _evidence(scene, scene.photo.rgb if background is None else background, things, ball, config)
    if not evidence.photo[evidence.group < count].any():  # nothing compared, or all of it black
        return UNLIT, unexposed, ("light: no object can be compared with the photo; shown without",)
    poses = np.array([o.T_world_object for o in scene.objects])
    casters = things.casting(poses, range(count)).disc
    # Half the film's resolution: many maps are drawn for the search, and samples average over them.
    side = config.shadows.map_size // 2
    found = find_light(evidence, casters, ball=ball, objects=count, side=side, config=config.light)
    mix = colour_mix(evidence, found.lit, objects=count, side=PATCH * ball[1])
    matrix = np.eye(3) if mix is None else mix[0]
    mixed = np.maximum(found.lit @ matrix.T, 0)
    gains = exposures(evidence, mixed, count + 1)
    shown, exposure = gains[evidence.group] * mixed, common_exposure(evidence, count)
    best, guard = keep_better(
        evidence.albedo * exposure,
        shown,
        score=lambda shown: -picture_error(evidence, shown, count),
        step="light",
        measure="minus the difference of colours on objects",
    )
    if best is not shown:
        reason = f"{guard.choice}, {guard.reason}; objects are shown without light, at one exposure"
        return UNLIT, np.tile(np.diag(exposure), (count, 1, 1)), (reason,)
    light, evident = _with_shadows(evidence, found.light, casters, ball, side, count)
    decisions = [_told(found)]
    if mix is not None:
        decisions.append(f"colours: mixed as the photo's camera does; {100 * mix[1]:.0f}% less off than without")
    if not evident:
        decisions.append("shadows: the photo's ground shows too little of them; as dark as the light makes them")
    # diag(gain) @ matrix for every object: mixed first, then exposed.
    return light, gains[:count, :, None] * matrix, tuple(decisions)


def _with_shadows(
    evidence: Evidence, light: Light, casters: list[Caster], ball: tuple[Array, float], side: int, ground: int
) -> tuple[Light, bool]:
    lights = disc(light.direction, light.angle, DIRECT_ON_GROUND), ground_sky(SKY_ON_GROUND)
    maps = Maps.empty(lights[0], *ball, side), Maps.empty(lights[1], *ball, side)
    for m in maps:
        m.cast(casters)
    return with_shadows_of(evidence, light, maps, ground)


def _told(found: FittedLight) -> str:
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
    view: FrameGeometry = things.seen_by(scene.camera, poses, config.near)
    # Faces only: no lights, no words of ground shadows.
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
