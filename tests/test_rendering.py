"""The film's renderer against closed forms, and against the laws that make a film one: order, threads and history."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numba import njit
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.corner_normals import corner_normals
from f3sr.core.mesh import Material, Mesh
from f3sr.core.srgb import linear, srgb
from f3sr.core.transforms import UP, Array, pose, rotation_from_vector, transform
from f3sr.errors import InputError
from f3sr.rendering import LightConfig, RenderConfig, Renderer, ShadowConfig
from f3sr.rendering.canvas import Canvas
from f3sr.rendering.colour_mix import colour_mix
from f3sr.rendering.evidence import Evidence
from f3sr.rendering.light import Light
from f3sr.rendering.picture_kernels import ground_light
from f3sr.rendering.still_photo import StillPhoto, light_ratio
from f3sr.rendering.surface_kernels import texture_at
from f3sr.rendering.textures import textures_of
from f3sr.scene import Photo, Scene, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.regions import grown

NO_LIGHT = LightConfig(enabled=False)
PLAIN = RenderConfig(light=NO_LIGHT, shadows=ShadowConfig(enabled=False))
"""Textures as they are, without shadows."""
SHADOWS = RenderConfig(light=NO_LIGHT)
GREY = 180
SIZE = 96, 72


def camera_at(eye: Array, target: Array, *, focal: float = 110.0, size: tuple[int, int] = SIZE) -> Camera:
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, UP if abs(forward[2]) < 0.99 else [0.0, 1, 0])
    right /= np.linalg.norm(right)
    R = np.column_stack([right, np.cross(forward, right), forward])
    K = np.array([[focal, 0.3, size[0] / 2 + 3.3], [0, focal, size[1] / 2 - 2.1], [0, 0, 1]])
    return Camera(width=size[0], height=size[1], K=K, T_world_camera=pose(R, eye))


OBLIQUE = camera_at(np.array([0.1, -1.0, 0.7]), np.array([0.0, 0, 0.05]))


def box(size: float = 0.2, color: int = 200) -> Mesh:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))], np.int32)
    return Mesh(vertices=corners, faces=faces, vertex_colors=np.full((8, 3), color, np.uint8))


def ball(radius: float = 0.1, rows: int = 40) -> Mesh:
    polar, turn = np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)
    p, t = np.meshgrid(polar, turn, indexing="ij")
    points = radius * np.stack([np.sin(p) * np.cos(t), np.sin(p) * np.sin(t), np.cos(p)], -1).reshape(-1, 3)
    a = np.arange(rows * 2 * rows).reshape(rows, 2 * rows)
    b = np.roll(a, -1, axis=1)
    faces = np.concatenate([np.stack([a, a + 2 * rows, b], -1), np.stack([b, a + 2 * rows, b + 2 * rows], -1)])
    return Mesh(vertices=points, faces=faces.reshape(-1, 3), vertex_colors=np.full((len(points), 3), 190, np.uint8))


def sheet(width: float, height: float, material: Material | None = None) -> Mesh:
    """A level rectangle around the origin, facing up."""
    x, y = width / 2, height / 2
    return Mesh(
        vertices=np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        uv=np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]),
        materials=(material or Material(),),
    )


def scene_of(meshes: list[Mesh], poses: list[Array], camera: Camera = OBLIQUE, rgb: NDArray | None = None) -> Scene:
    size = camera.height, camera.width
    shown = [
        SceneObject(id=k, label="", mask_name="", mask=np.zeros(size, np.bool_), mesh=m, T_world_object=T)
        for k, (m, T) in enumerate(zip(meshes, poses, strict=True))
    ]
    seen = rasterizer.visible_ids(shown, camera)
    objects = tuple(replace(o, mask=seen == o.id) for o in shown)
    return Scene(photo=Photo(rgb=plain(camera) if rgb is None else rgb), camera=camera, objects=objects)


def plain(camera: Camera = OBLIQUE) -> NDArray[np.uint8]:
    return np.full((camera.height, camera.width, 3), GREY, np.uint8)


def at_rest(scene: Scene) -> Array:
    return np.array([o.T_world_object for o in scene.objects])


def table() -> Scene:
    """A box, a ball beside it and a box on the first."""
    tilt = rotation_from_vector([0, 0, 0.4])
    poses = [pose(tilt, [0, 0, 0.1]), pose(t=[0.25, 0.05, 0.1]), pose(t=[0.02, 0, 0.25])]
    return scene_of([box(), ball(), box(0.1, 90)], poses)


def lit(scene: Scene, light: Light, config: RenderConfig = SHADOWS) -> Canvas:
    """A canvas with a given light, whatever the photo says."""
    setting = Renderer.of(scene, plain(scene.camera), config=config).setting
    return Canvas(replace(setting, light=light))


def walk(steps: int, seed: int = 0) -> list[Array]:
    """Poses of ``table``: the ball flies and turns, then the upper box falls, then nothing moves."""
    rng = np.random.default_rng(seed)
    frames = [at_rest(table())]
    for k in range(steps):
        T = frames[-1].copy()
        moved = [1] if k < steps // 3 else [1, 2] if k < steps // 2 else [2] if k < steps - 2 else []
        for i in moved:
            T[i, :3, :3] = rotation_from_vector(rng.normal(size=3) * 0.2) @ T[i, :3, :3]
            T[i, :3, 3] += rng.normal(size=3) * [0.05, 0.05, 0.04]
        frames.append(T)
    return frames


# --- against what is known without light --------------------------------------------------------------------------


def test_without_light_and_motion_it_is_the_unlit_composite() -> None:
    scene = table()
    drawn = Renderer.of(scene, plain(), config=replace(PLAIN, samples=1)).frame(at_rest(scene))
    fragments = rasterizer.render(scene.objects, scene.camera)
    unlit = np.rint(255 * rasterizer.shade(fragments, scene.objects))
    expected = np.where((fragments.ids >= 0)[..., None], unlit, plain())
    assert (fragments.ids >= 0).mean() > 0.05
    assert np.abs(drawn.astype(int) - expected).max() <= 1


def test_a_texture_is_turned_as_the_raster_turns_it() -> None:
    texture = np.zeros((4, 4, 3), np.uint8)
    texture[0, 0], texture[0, 3], texture[3, 0] = (250, 0, 0), (0, 250, 0), (0, 0, 250)
    texture = texture.repeat(8, axis=0).repeat(8, axis=1)
    above = camera_at(np.array([0, 0, 1.0]), np.zeros(3), focal=60)
    scene = scene_of([sheet(1, 0.8, Material(texture=texture))], [pose(t=[0, 0, 0.1])], above)
    drawn = Renderer.of(scene, plain(above), config=replace(PLAIN, samples=1)).frame(at_rest(scene))
    expected = np.rint(255 * rasterizer.shade(rasterizer.render(scene.objects, above), scene.objects, filter="nearest"))
    solid = (expected.max(2) == 250) & (drawn.max(2) == 250)
    assert solid.sum() > 30
    assert np.array_equal(drawn[solid] > 125, expected[solid] > 125)


def test_coverage_is_the_area_in_linear_light() -> None:
    above = camera_at(np.array([0, 0, 1.0]), np.zeros(3), focal=60)
    turned = pose(rotation_from_vector([0, 0, 0.3]), [0, 0, 0.1])
    scene = scene_of([sheet(0.5, 0.3)], [turned], above)
    black = np.zeros_like(plain(above))
    drawn = Renderer.of(scene, black, config=replace(PLAIN, samples=4)).frame(at_rest(scene))
    assert linear(drawn / 255).sum() / 3 == pytest.approx(0.15 * (60 / 0.9) ** 2, rel=0.01)


# --- levels of detail ---------------------------------------------------------------------------------------------


def checker(squares: int, side: int) -> NDArray[np.uint8]:
    y, x = np.mgrid[: squares * side, : squares * side] // side
    return np.where(((x + y) % 2)[..., None], 255, 0).repeat(3, axis=2).astype(np.uint8)


def test_a_fine_checker_far_away_is_grey_in_linear_light() -> None:
    far = camera_at(np.array([0, 0, 8.0]), np.zeros(3), focal=200)
    scene = scene_of([sheet(2, 2, Material(texture=checker(256, 1)))], [pose(t=[0, 0, 0.1])], far)
    drawn = Renderer.of(scene, plain(far), config=PLAIN).frame(at_rest(scene))
    assert np.abs(drawn[25:45, 35:60].astype(int) - round(255 * float(srgb(np.array(0.5))))).max() <= 1


@njit
def sampled(textures: Any, slot: int, u: float, v: float, footprint: float) -> Any:
    return texture_at(textures, slot, u, v, footprint)


def test_the_level_of_detail_is_that_of_the_footprint() -> None:
    textures = textures_of(scene_of([sheet(1, 1, Material(texture=checker(8, 4)))], [pose()]).objects)
    middle = 1 / 16  # of a black square of 4 texels
    colors = [sampled(textures, 0, middle, 1 - middle, f)[0] for f in (0.1, 4.0, 16.0, 32.0, 64.0, 4096.0)]
    assert np.allclose(colors, [0, 0, 0, 0.25, 0.5, 0.5], atol=1e-4)  # a square is a texel of level 2; then they mix


def test_what_no_triangle_shows_does_not_bleed_into_coarse_levels() -> None:
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[20:44, 20:44] = 200
    shown = sheet(1, 1, Material(texture=texture))
    assert shown.uv is not None
    mesh = replace(shown, uv=0.5 + (shown.uv - 0.5) * 24 / 64)
    textures = textures_of(scene_of([mesh], [pose()]).objects)
    white = float(linear(np.array(200 / 255)))
    for footprint in (1.0, 9.0, 100.0, 4000.0):
        assert sampled(textures, 0, 0.33, 0.33, footprint)[0] == pytest.approx(white, abs=1e-4)


# --- light --------------------------------------------------------------------------------------------------------


def test_a_ball_shows_the_cosine() -> None:
    scene = scene_of([ball()], [pose(t=[0, 0, 0.3])])
    direction = np.array([0.8, 0.1, 0.6]) / np.linalg.norm([0.8, 0.1, 0.6])
    light = Light(direction=direction, angle=0.01, even=np.full(3, 0.1), direct=np.full(3, 0.7))
    drawn = lit(scene, light).drawn(at_rest(scene))
    fragments = rasterizer.render(scene.objects, scene.camera)
    normals = corner_normals(scene.objects[0].mesh, 0.7)[fragments.face]
    n = (normals * fragments.bary[..., None]).sum(2)
    cosine = n @ direction
    facing = (fragments.ids == 0) & (n @ (scene.camera.center - [0, 0, 0.3]) > 0.6)
    inner, dark = facing & (cosine > 0.15), facing & (cosine < -0.05)
    expected = srgb(linear(np.array(190 / 255)) * (0.1 + 0.7 * cosine))
    assert inner.sum() > 100
    assert np.abs(drawn[inner][:, 0] / 255 - expected[inner]).max() < 0.03
    assert np.abs(drawn[inner][:, 0] / 255 - expected[inner]).mean() < 0.006
    assert dark.sum() > 5
    assert np.abs(drawn[dark][:, 0] / 255 - srgb(linear(np.array(190 / 255)) * 0.1)).max() < 0.01


@pytest.mark.parametrize(("height", "angle"), [(0.2, 0.2), (0.4, 0.2), (0.4, 0.1)])
def test_a_penumbra_is_as_wide_as_height_and_disc_make_it(height: float, angle: float) -> None:
    """A disc of angular radius a in the zenith over an edge at height h: at x from the edge, t = x / (h tan a), the
    segment (acos t - t sqrt(1 - t^2)) / pi of the disc is hidden."""
    above = camera_at(np.array([0.05, 0, 3.0]), np.array([0.05, 0, 0]), focal=900)
    edge = sheet(1.0, 2.0)
    scene = scene_of([edge], [pose(t=[-0.5, 0, height])], above)
    drawn = lit(scene, Light(direction=UP, angle=angle, direct=np.ones(3))).drawn(at_rest(scene))
    columns = np.arange(above.width) + 0.5
    middle = above.height // 2
    ray = np.linalg.inv(above.K) @ np.stack([columns, np.full_like(columns, middle + 0.5), np.ones_like(columns)])
    world = above.center[:, None] + 3.0 * (above.T_world_camera[:3, :3] @ ray)
    t = np.clip(world[0] / (height * np.tan(angle)), -1, 1)
    expected = 1 - (np.arccos(t) - t * np.sqrt(1 - t * t)) / np.pi
    ground = rasterizer.render(scene.objects, above).ids[middle] == rasterizer.EMPTY
    left = linear(drawn[middle, :, 0] / 255) / linear(np.array(GREY / 255))
    assert (ground & (np.abs(t) < 1)).sum() > 5
    assert np.abs(left - expected)[ground][2:].max() < 0.06


def test_shadows_fall_on_objects_too_and_are_sharper_near_their_cause() -> None:
    above = camera_at(np.array([0, 0, 2.0]), np.zeros(3), focal=200)
    light = Light(direction=np.array([0.6, 0, 0.8]), angle=0.1, even=np.full(3, 0.2), direct=np.ones(3))
    widths = []
    for height in (0.05, 0.2):
        scene = scene_of([sheet(1, 1), sheet(0.2, 1)], [pose(t=[0, 0, 0.1]), pose(t=[0.1, 0, 0.1 + height])], above)
        drawn = lit(scene, light, RenderConfig(light=NO_LIGHT, shadows=ShadowConfig(map_size=512)))
        row = linear(drawn.drawn(at_rest(scene))[36, :, 0] / 255)
        assert row.min() == pytest.approx(0.2, abs=0.03)  # of the even light only
        widths.append(int(((row > 0.3) & (row < 0.9)).sum()))
    assert widths[1] > widths[0]


def test_nothing_but_the_ground_below_the_horizon_takes_shadows() -> None:
    level = camera_at(np.array([0, -1.5, 0.3]), np.array([0, 0, 0.3]))
    scene = scene_of([box()], [pose(t=[0, 0, 0.1])], level)
    seen = Renderer.of(scene, plain(level), config=SHADOWS).setting.receives
    horizon = int(level.K[1, 2])
    assert not seen[: horizon - 1].any()
    assert (seen[-1] > 0.2).all()
    assert seen[horizon + 12 : -4, 30:60].max() == 1


def test_the_light_of_a_picture_is_found_again() -> None:
    scene = big_table()
    direction = np.array([0.5, -0.4, 0.75]) / np.linalg.norm([0.5, -0.4, 0.75])
    light = Light(direction=direction, angle=0.15, direct=np.full(3, 0.8), sky=np.full(3, 0.4))
    photo = lit(scene, light).drawn(at_rest(scene))
    renderer = Renderer.of(replace(scene, photo=Photo(rgb=photo)), plain(scene.camera))
    found = renderer.setting.light
    assert np.degrees(np.arccos(found.direction @ direction)) < 8
    assert found.direct[0] * found.direction[2] / found.sky[0] == pytest.approx(0.8 * direction[2] / 0.4, rel=0.35)
    again = renderer.frame(at_rest(scene))
    assert np.abs(again.astype(int) - photo).mean() < 2
    assert "found" in renderer.decisions[0]


def test_a_picture_without_shading_has_no_direction() -> None:
    scene = big_table()
    photo = Renderer.of(scene, plain(scene.camera), config=PLAIN).frame(at_rest(scene))
    renderer = Renderer.of(replace(scene, photo=Photo(rgb=photo)), plain(scene.camera))
    assert "no direction" in renderer.decisions[0]
    shown = rasterizer.visible_ids(scene.objects, scene.camera) >= 0
    assert np.abs(renderer.frame(at_rest(scene)).astype(int) - photo)[shown].mean() < 2


def test_a_texture_that_lies_some_pixels_off_tints_nothing() -> None:
    """Blue and yellow stripes have most contrast in red: a regression's slope would take most of that channel."""
    stripes = np.where((np.arange(64) // 4 % 2)[:, None], (230, 200, 20), (20, 60, 140)).astype(np.uint8)
    texture = stripes[None].repeat(64, axis=0)
    above = camera_at(np.array([0, 0, 1.0]), np.zeros(3), focal=300, size=(240, 180))
    shown, off = (sheet(0.6, 0.4, Material(texture=x)) for x in (texture, np.roll(texture, 2, axis=1)))
    photo = Renderer.of(scene_of([off], [pose(t=[0, 0, 0.1])], above), plain(above), config=PLAIN).frame(
        [pose(t=[0, 0, 0.1])]
    )
    scene = scene_of([shown], [pose(t=[0, 0, 0.1])], above, photo)
    drawn = Renderer.of(scene, plain(above)).frame(at_rest(scene))
    inside = scene.objects[0].mask
    ratio = linear(drawn[inside] / 255).mean(0) / linear(photo[inside] / 255).mean(0)
    assert np.abs(ratio - 1).max() < 0.05


def big_table() -> Scene:
    camera = camera_at(np.array([0.1, -1.0, 0.7]), np.array([0.1, 0, 0.05]), focal=330, size=(288, 216))
    return scene_of([o.mesh for o in table().objects], list(at_rest(table())), camera)


# --- the film -----------------------------------------------------------------------------------------------------


def test_the_number_of_threads_changes_no_byte(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, films = table(), []
    for threads in (1, 2, 5):
        monkeypatch.setattr(rasterizer, "THREADS", threads)
        renderer = Renderer.of(scene, plain(), config=SHADOWS)
        films.append([renderer.frame(T) for T in walk(4)])
    assert all(np.array_equal(a, b) for film in films[1:] for a, b in zip(films[0], film, strict=True))


def test_a_frame_does_not_depend_on_those_before() -> None:
    renderer = Renderer.of(table(), plain(), config=SHADOWS)
    light = Light(direction=np.array([0.6, 0, 0.8]), angle=0.1, direct=np.ones(3), sky=np.full(3, 0.3))
    setting = replace(renderer.setting, light=light)
    film = Canvas(setting)
    frames = walk(20)
    for T in [*frames, *frames[::7]]:
        assert np.array_equal(film.drawn(T), Canvas(setting).drawn(T))


def test_poses_that_are_changed_in_place_are_drawn_anew() -> None:
    renderer, T = Renderer.of(table(), plain(), config=SHADOWS), at_rest(table())
    before = renderer.frame(T)
    T[1, 2, 3] += 0.2
    after = renderer.frame(T)
    assert not np.array_equal(before, after) and np.array_equal(after, renderer.frame(T.copy()))


def test_what_moves_away_leaves_no_trace() -> None:
    scene = table()
    renderer = Renderer.of(scene, plain(), config=PLAIN)
    assert not np.array_equal(renderer.frame(at_rest(scene)), plain())
    away = at_rest(scene)
    away[:, :3, 3] += [0, -40.0, 0]  # behind the camera
    assert np.array_equal(renderer.frame(away), plain())


def test_the_photo_stays_as_it_is_where_it_was_not_completed() -> None:
    scene = big_table()
    light = Light(direction=np.array([0.5, 0, 0.87]), angle=0.3, direct=np.full(3, 0.8), sky=np.full(3, 0.4))
    photo = lit(scene, light).drawn(at_rest(scene))
    near = np.zeros(photo.shape[:2], np.bool_)
    near[40:190, 60:240] = True
    background = np.where(near[..., None], plain(scene.camera), photo)
    renderer = Renderer.of(replace(scene, photo=Photo(rgb=photo)), background)
    objects = rasterizer.visible_ids(scene.objects, scene.camera) >= 0
    outside = ~grown(near | objects, 2)
    assert (photo[outside] != GREY).any()  # shadows of the sky reach there
    assert np.array_equal(renderer.frame(at_rest(scene))[outside], photo[outside])


@cache
def shadowed() -> tuple[Scene, NDArray[np.bool_], NDArray[np.bool_]]:
    """``big_table`` in a photo whose shadows are redder than the light's, ground beside its objects, and the
    part of it in shadow."""
    scene = big_table()
    light = Light(direction=np.array([0.5, 0, 0.87]), angle=0.2, direct=np.full(3, 0.6), sky=np.full(3, 0.4))
    photo = lit(scene, light).drawn(at_rest(scene))
    ground = ~grown(rasterizer.visible_ids(scene.objects, scene.camera) >= 0, 4)
    dark = ground & (photo < GREY - 12).all(2)
    left = linear(photo / 255) / linear(np.array(GREY / 255))
    tinted = np.rint(255 * srgb(linear(np.array(GREY / 255)) * (1 - [0.95, 1.0, 1.05] * (1 - left))))
    photo = np.where(ground[..., None], tinted, photo).astype(np.uint8)
    return replace(scene, photo=Photo(rgb=photo)), ground, dark


def test_the_scene_at_rest_has_the_photos_own_shadows_and_what_leaves_takes_its_own_along() -> None:
    scene, ground, dark = shadowed()
    renderer = Renderer.of(scene, plain(scene.camera))
    assert dark.sum() > 300
    off = np.abs(renderer.frame(at_rest(scene)).astype(int) - scene.photo.rgb)
    assert off[dark].mean() < 4 and off[ground].mean() < 2
    away = at_rest(scene)
    away[:, :3, 3] += [0, -40.0, 0]  # behind the camera
    assert np.array_equal(renderer.frame(away), plain(scene.camera)), "and the background is whole"
    assert not renderer.decisions[1:]


def test_what_an_object_sheds_of_its_colour_past_its_mask_is_no_light() -> None:
    scene, ground, _ = shadowed()
    objects = rasterizer.visible_ids(scene.objects, scene.camera) >= 0
    rim = grown(objects, 7) & ground
    photo = np.where(rim[..., None], [150, 40, 40], scene.photo.rgb).astype(np.uint8)
    renderer = Renderer.of(replace(scene, photo=Photo(rgb=photo)), plain(scene.camera))
    T = at_rest(scene)
    T[:, :3, 3] += [0.01, 0, 0]
    shown = renderer.frame(T)[rim].astype(int)
    assert np.abs(shown[:, 0] - shown[:, 2]).mean() < 12


def test_shadows_of_the_photo_go_without_a_step() -> None:
    scene, ground, _ = shadowed()
    renderer = Renderer.of(scene, plain(scene.camera))
    frames = []
    for k in range(9):
        T = at_rest(scene)
        T[:, 2, 3] += 0.002 * k
        frames.append(renderer.frame(T)[ground].astype(int))
    assert max(np.abs(b - a).mean() for a, b in pairwise(frames)) < 1.5
    assert np.abs(frames[1] - frames[0]).mean() < 2 * np.abs(frames[2] - frames[1]).mean() + 0.1


def test_a_background_in_another_light_says_nothing_of_the_photos_shadows() -> None:
    scene, _, dark = shadowed()
    other = np.full_like(scene.photo.rgb, [30, 200, 60])
    renderer = Renderer.of(scene, other)
    assert any("not lit as the photo" in d for d in renderer.decisions)
    tint = renderer.frame(at_rest(scene))[dark].astype(float)
    assert np.all(tint[:, 1] > 2 * tint[:, 0])


# --- the photo beside what moves ----------------------------------------------------------------------------------

BALL_ONLY = np.array([False, True, False])


@cache
def photographed(*ball_at: float) -> tuple[Scene, Renderer, Callable[[Array], NDArray[np.uint8]]]:
    """``big_table``, its renderer, and photos of it at any poses: greener than its meshes and darker to the left."""
    scene = big_table()
    if ball_at:
        poses = at_rest(scene)
        poses[1, :3, 3] = ball_at
        scene = scene_of([o.mesh for o in scene.objects], list(poses), scene.camera)
    light = Light(direction=np.array([0.5, 0, 0.87]), angle=0.2, direct=np.full(3, 0.6), sky=np.full(3, 0.4))
    darker = np.linspace(0.15, 1, scene.camera.width)[:, None] * [0.5, 0.9, 0.5]
    canvas = lit(scene, light)

    def photo(poses: Array) -> NDArray[np.uint8]:
        seen = rasterizer.visible_ids(
            [replace(o, T_world_object=T) for o, T in zip(scene.objects, poses, strict=True)], scene.camera
        )
        rgb = canvas.drawn(poses)
        tinted = np.rint(255 * srgb(linear(rgb / 255) * darker))
        return np.where((seen >= 0)[..., None], tinted, rgb).astype(np.uint8)

    scene = replace(scene, photo=Photo(rgb=photo(at_rest(scene))))
    return scene, Renderer.of(scene, plain(scene.camera)), photo


def test_beside_what_moves_a_film_shows_the_photo_itself() -> None:
    scene, renderer, _ = photographed()
    nothing = renderer.beside_photo(scene, np.zeros(3, np.bool_))
    assert nothing is not None
    assert np.array_equal(nothing.frame(at_rest(scene)), scene.photo.rgb)
    still = renderer.beside_photo(scene, BALL_ONLY)
    assert still is not None
    away = at_rest(scene)
    away[1, :3, 3] += [0, -40.0, 0]
    shown, ids = still.frame(away), rasterizer.visible_ids(scene.objects, scene.camera)
    far = (ids >= 0) & ~grown(ids == 1, 30)
    assert far.sum() > 500
    assert np.abs(shown[far].astype(int) - scene.photo.rgb[far]).mean() < 1
    assert np.abs(shown[ids == 1].astype(int) - scene.photo.rgb[ids == 1]).mean() > 20, "the ball has left"


def test_what_a_moving_object_uncovers_has_the_photos_colours_of_what_rests() -> None:
    scene, renderer, photo = photographed(-0.05, -0.25, 0.1)  # the ball stands before the box
    ids = rasterizer.visible_ids(scene.objects, scene.camera)
    without = rasterizer.visible_ids((scene.objects[0], scene.objects[2]), scene.camera)
    hidden = (ids == 1) & (without == 0) & ~grown(ids != 1, 2)
    assert hidden.sum() > 200
    still = renderer.beside_photo(scene, BALL_ONLY)
    assert still is not None
    away = at_rest(scene)
    away[1, :3, 3] += [0, -40.0, 0]
    truth = photo(away)[hidden].astype(int)
    shown, drawn = (np.abs(picture[hidden] - truth).mean() for picture in (still.frame(away), renderer.frame(away)))
    assert shown < 0.5 * drawn, (shown, drawn)


def test_what_is_uncovered_has_no_colours_of_another_side() -> None:
    """The photo is as drawn, but that the upright sides of a box are redder. What stood on the box shaded all its top:
    only there the light of the sides may not be asked."""
    scene = big_table()
    light = Light(direction=np.array([0.5, 0, 0.87]), angle=0.2, direct=np.full(3, 0.6), sky=np.full(3, 0.4))
    canvas, rest, away = lit(scene, light), at_rest(scene), at_rest(scene)
    away[2, :3, 3] += [0, -40.0, 0]
    drawn, truth = canvas.drawn(rest), canvas.drawn(away)
    ids, without = (rasterizer.visible_ids(objects, scene.camera) for objects in (scene.objects, scene.objects[:2]))
    top = scene.objects[0].mesh.vertices[scene.objects[0].mesh.vertices[:, 2] > 0]
    corners = transform(rest[0], np.unique(top, axis=0)[[0, 1, 3, 2]])
    upper = rasterizer.silhouette(
        scene.camera.to_camera(corners), np.array([[0, 1, 2], [0, 2, 3]], np.int32), scene.camera.K,
        scene.camera.width, scene.camera.height,
    )  # fmt: skip
    sides, hidden = (ids == 0) & ~grown(upper, 1), (ids == 2) & (without == 0) & upper & ~grown(without != 0, 2)
    assert sides.sum() > 200 and hidden.sum() > 50
    photo = drawn.copy()
    photo[sides] = np.rint(255 * srgb(linear(drawn[sides] / 255) * [1.6, 0.6, 0.6]).clip(0, 1))
    scene = replace(scene, photo=Photo(rgb=photo))
    still = StillPhoto.of(canvas, scene, np.array([False, False, True]))
    off = np.abs(still.frame(away)[hidden].astype(int) - truth[hidden]).mean()
    assert off < 6, off


def test_a_shadow_that_comes_darkens_the_photo_as_it_darkens_the_drawn_object() -> None:
    scene, renderer, _ = photographed()
    still = renderer.beside_photo(scene, BALL_ONLY)
    assert still is not None
    rest, over = at_rest(scene), at_rest(scene)
    over[1, :3, 3] = [0.15, 0.0, 0.5]
    ids = rasterizer.visible_ids(scene.objects, scene.camera)
    moved = rasterizer.visible_ids(
        [replace(o, T_world_object=T) for o, T in zip(scene.objects, over, strict=True)], scene.camera
    )
    box_seen = (ids == 0) & (moved == 0) & ~grown((ids == 1) | (moved == 1), 6)
    drawn = [linear(renderer.frame(T)[box_seen] / 255).mean() for T in (rest, over)]
    shown = [linear(still.frame(T)[box_seen] / 255).mean() for T in (rest, over)]
    assert drawn[1] < 0.97 * drawn[0], "the shadow falls there"
    assert shown[1] / shown[0] == pytest.approx(drawn[1] / drawn[0], abs=0.02)


def test_a_shadow_that_the_photo_does_not_have_leaves_nothing_bright() -> None:
    scene, _, photo = photographed(0.15, 0.0, 0.5)  # the ball shades the box when drawn
    ids, away = rasterizer.visible_ids(scene.objects, scene.camera), at_rest(scene)
    away[1, :3, 3] += [0, -40.0, 0]
    box = (ids == 0) & ~grown(ids == 1, 6)
    shaded = box & (np.abs(photo(at_rest(scene)).astype(int) - photo(away)).max(2) > 10)
    assert shaded.sum() > 100
    rgb = scene.photo.rgb.copy()
    rgb[box] = photo(away)[box]
    scene = replace(scene, photo=Photo(rgb=rgb))
    still = Renderer.of(scene, plain(scene.camera)).beside_photo(scene, BALL_ONLY)
    assert still is not None
    brighter = still.frame(away)[shaded].astype(int) - rgb[shaded]
    assert np.abs(brighter).mean() < 5, brighter.mean()


def test_a_frame_beside_the_photo_does_not_depend_on_those_before() -> None:
    scene, renderer, _ = photographed()
    still = renderer.beside_photo(scene, BALL_ONLY)
    fresh = Renderer.of(scene, plain(scene.camera)).beside_photo(scene, BALL_ONLY)
    assert still is not None and fresh is not None
    T = at_rest(scene)
    for k in range(5):
        T = T.copy()
        T[1, :3, 3] += [0.03, -0.02 * k, 0.02]
        last = still.frame(T)
    assert np.array_equal(last, fresh.frame(T))


def test_a_background_in_another_light_is_not_mixed_with_the_photo() -> None:
    scene, _, _ = photographed()
    other = np.full_like(scene.photo.rgb, [30, 200, 60])
    assert Renderer.of(scene, other).beside_photo(scene, BALL_ONLY) is None


def test_what_flies_past_the_camera_is_cut_at_the_near_plane() -> None:
    scene = table()
    poses = at_rest(scene)
    poses[0] = pose(rotation_from_vector([0.3, 0.2, 0.1]), OBLIQUE.center + np.array([0.02, 0.05, -0.03]))
    renderer = Renderer.of(scene, plain(), config=replace(PLAIN, samples=1))
    drawn = renderer.frame(poses)
    moved = [replace(o, T_world_object=T) for o, T in zip(scene.objects, poses, strict=True)]
    ids = rasterizer.render(moved, OBLIQUE, near=PLAIN.near).ids
    assert (ids == 0).mean() > 0.3
    assert np.array_equal((drawn != GREY).any(2), ids >= 0)


def test_trembling_is_not_motion_and_poses_are_smooth() -> None:
    scene = table()
    renderer = Renderer.of(scene, plain(), config=SHADOWS)
    still = renderer.frame(at_rest(scene))
    trembled = at_rest(scene)
    trembled[:, :3, 3] += 1e-6
    assert np.array_equal(renderer.frame(trembled), still)
    moved = at_rest(scene)
    moved[1, 0, 3] += 0.0005  # a tenth of a pixel
    step = np.abs(renderer.frame(moved).astype(int) - still)
    assert 0 < step.max() < 90
    assert (step > 0).any(2).mean() < 0.3


def test_a_side_view_needs_a_background_of_its_size_only() -> None:
    scene = big_table()
    side = camera_at(np.array([1.0, 0.3, 0.4]), np.array([0.1, 0, 0.1]))
    drawn = Renderer.of(scene, plain(side), camera=side, config=SHADOWS).frame(at_rest(scene))
    again = Renderer.of(scene, plain(scene.camera), config=SHADOWS).seen_from(side, plain(side))
    assert np.array_equal(again.frame(at_rest(scene)), drawn)
    assert drawn.shape == (72, 96, 3)
    assert (drawn != GREY).any()
    with pytest.raises(InputError, match="background"):
        Renderer.of(scene, plain(side))
    with pytest.raises(InputError, match="poses"):
        Renderer.of(scene, plain(scene.camera), config=PLAIN).frame(at_rest(scene)[:2])


def test_a_scene_without_objects_is_its_background() -> None:
    scene = scene_of([], [])
    assert np.array_equal(Renderer.of(scene, plain()).frame(np.zeros((0, 4, 4))), plain())


def test_what_the_photo_shows_in_front_hides_objects() -> None:
    """A post of the photo between the camera and the table: what goes behind it is hidden, what goes before it is not,
    and no frame depends on those before."""
    scene = table()
    poses = at_rest(scene)
    background = plain()
    background[:, 40:60] = (20, 30, 90)
    depth = np.full(background.shape[:2], np.inf, np.float32)
    drawn = Renderer.of(scene, background, config=PLAIN).frame(poses)
    post = np.zeros(depth.shape, np.bool_)
    post[:, 40:60] = True
    covered = post & (drawn != background).any(2)
    assert covered.sum() > 100, "something is seen before the post"
    depth[post] = 0.05
    before = Renderer.of(scene, background, config=PLAIN, kept=depth)
    assert np.array_equal(before.frame(poses)[post], background[post])
    assert np.array_equal(before.frame(poses)[~post], drawn[~post])
    depth[post] = 50.0
    assert np.array_equal(Renderer.of(scene, background, config=PLAIN, kept=depth).frame(poses), drawn)
    depth[post] = 0.05
    walked = Renderer.of(scene, background, config=PLAIN, kept=depth)
    for step in walk(4):
        frame = walked.frame(step)
    assert np.array_equal(frame, Renderer.of(scene, background, config=PLAIN, kept=depth).frame(step))


# --- the colours of the photo's camera ------------------------------------------------------------------------------


def seen_by_another_camera(M: Array, noise: float = 0.02) -> tuple[Evidence, Array]:
    """Samples of four objects in patches of one colour each, through a camera that mixes colours by ``M`` (3, 3) and
    exposes each object otherwise."""
    rng = np.random.default_rng(3)
    count, each = 120, 12
    group = np.repeat(np.arange(count) % 4, each)
    lit = np.repeat(rng.uniform(0.02, 0.8, (count, 3)), each, axis=0)
    photo = rng.uniform(0.5, 1.5, 4)[group][:, None] * (lit @ M.T) * rng.normal(1, noise, lit.shape)
    points = np.repeat(rng.uniform(-1, 1, (count, 3)), each, axis=0)
    return Evidence.of([(group, lit, photo, points, np.tile(UP, (len(group), 1)))]), lit


def test_the_colours_of_another_camera_are_found() -> None:
    M = np.array([[0.75, 0.2, 0.05], [0.1, 0.8, 0.1], [0.05, 0.25, 0.7]])
    found = colour_mix(*seen_by_another_camera(M), objects=4, side=0.01)
    assert found is not None and found[1] > 0.5
    assert np.abs(found[0] - M).max() < 0.04 and np.allclose(found[0].sum(1), 1)


def test_where_no_colours_are_mixed_nothing_is_made_of_it() -> None:
    assert colour_mix(*seen_by_another_camera(np.diag([0.8, 1.0, 1.3]), noise=0.2), objects=4, side=0.01) is None


@given(st.floats(0.03, 1.0, exclude_max=True), *(st.floats(0.03, 1.0) for _ in range(3)))
def test_a_new_shadow_is_never_darker_than_it_is_drawn(rest: float, shown: float, a: float, b: float) -> None:
    """Where the model has a deep shadow at rest and the photo none, channels lost most of their light: cyan ground."""
    light: Any = cast(Any, ground_light).py_func
    stays, left = max(rest, a), max(rest, a) * b
    before, now = light(stays, stays, rest, shown), light(left, stays, rest, shown)
    assert light(rest, rest, rest, shown) == pytest.approx(shown)
    assert 0 <= now <= before + 1e-12 and before - now <= (stays - left) + 1e-12


@example(1.0, 0.5)
@given(st.floats(0.03, 1.0), st.floats(0.03, 1.0))
def test_where_nothing_is_hidden_at_rest_the_ground_keeps_the_light_that_arrives(left: float, shown: float) -> None:
    """Nothing drawn there explains how dark the photo is: it is no shadow that an object could take away with it."""
    assert cast(Any, ground_light).py_func(left, 1.0, 1.0, shown) == pytest.approx(left)


def test_a_shadow_on_a_red_thing_has_the_ratio_of_red_in_all_channels() -> None:
    """Its green and blue are a few levels. Table that the photo shows there turned cyan."""
    before, now = np.array([[111, 12, 14]], np.uint8), np.array([[70, 11, 11]], np.uint8)
    ratio = light_ratio(now, before)[0]
    assert ratio[0] == pytest.approx(0.38, abs=0.03) and np.abs(ratio - ratio[0]).max() < 0.1
    grey = np.full((1, 3), 120, np.uint8)
    assert light_ratio(grey, grey + np.uint8(30))[0] == pytest.approx(linear(120 / 255) / linear(150 / 255))
