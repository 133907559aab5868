"""The z-buffer against analytic images, against laws, and against a slow ray caster."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import Material, Mesh
from f3sr.core.transforms import Array, pose, rotation_from_vector, transform
from f3sr.scene import SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.rasterizer import EMPTY, Fragments, rasterize, render, shade, silhouette, strips, visible_ids

SHARED = Path(__file__).parents[2] / "shared"
NEAR = 0.05
K = np.array([[90.0, 0.7, 47.3], [0, 85.0, 30.9], [0, 0, 1]])
WIDTH, HEIGHT = 96, 64
QUAD = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def rays(K: Array, width: int, height: int) -> Array:
    """(height, width, 3) camera directions with z = 1 through the pixel centres."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    return np.asarray(np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T, np.float64)


def cast(vertices: Array, faces: NDArray[Any], K: Array, width: int, height: int, near: float) -> Any:
    """Face (-1 for none), depth and barycentrics of the nearest triangle, after Moeller and Trumbore."""
    d = rays(K, width, height)
    face, depth, bary = np.full(d.shape[:2], -1), np.full(d.shape[:2], np.inf), np.zeros(d.shape)
    for i, (a, b, c) in enumerate(vertices[faces]):
        p = np.cross(d, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            det = p @ (b - a)
            wb = (p @ -a) / det
            q = np.cross(-a, b - a)
            wc, z = d @ q / det, (c - a) @ q / det
            hit = (wb >= 0) & (wc >= 0) & (wb + wc <= 1) & (z >= near) & (z < depth)
        face[hit], depth[hit] = i, z[hit]
        bary[hit] = np.stack([1 - wb - wc, wb, wc], -1)[hit]
    return face, depth, bary


def soup(seed: int, n: int = 300, *, low: float = -1.0, large: float = 0.0) -> tuple[Array, NDArray[np.int32]]:
    """Random triangles of all sizes, many of which cross the near plane or lie behind the camera."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform([-3, -2, low], [3, 2, 6], (n, 1, 3))
    vertices = centers + rng.normal(size=(n, 3, 3)) * 10 ** rng.uniform(-2, large, (n, 1, 1))
    return vertices.reshape(-1, 3), np.arange(3 * n, dtype=np.int32).reshape(-1, 3)


def draw(
    vertices: Array,
    faces: NDArray[Any],
    K: Array = K,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
    near: float = NEAR,
) -> Fragments:
    """The id of a face is its index."""
    return rasterize(vertices, faces, np.arange(len(faces)), K, width, height, near=near)


def unproject(pixels: Any, z: Any, K: Array = K) -> Array:
    """Camera points (n, 3) at pixels (n, 2) and depths z."""
    pixels = np.asarray(pixels, float)
    return np.c_[pixels, np.ones(len(pixels))] @ np.linalg.inv(K).T * np.broadcast_to(z, len(pixels))[:, None]


def on_plane(pixels: Any, normal: Array, offset: float, K: Array = K) -> Array:
    """Camera points (n, 3) where the rays through ``pixels`` meet the plane normal . x = offset."""
    d = unproject(pixels, 1.0, K)
    return d * (offset / (d @ normal))[:, None]


def grid(n: int) -> tuple[Array, NDArray[np.int32]]:
    """Places (., 2) in the unit square, irregular inside, and the 2 n^2 triangles between them."""
    rng = np.random.default_rng(n)
    at = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 2), -1)
    at[1:-1, 1:-1] += rng.uniform(-0.3, 0.3, (n - 1, n - 1, 2)) / n
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.c_[i, i + 1, i + n + 2], np.c_[i, i + n + 2, i + n + 1]])
    return at.reshape(-1, 2), faces.astype(np.int32)


def same(a: Fragments, b: Fragments) -> bool:
    return all(getattr(a, f).tobytes() == getattr(b, f).tobytes() for f in ("face", "depth", "bary", "ids"))


# Analytic


def test_a_square_covers_exactly_the_pixel_centres_inside_it():
    corners = np.array([[10.4, 7.6], [30.6, 7.6], [30.6, 20.4], [10.4, 20.4]])
    fragments = draw(unproject(corners, 2.0), QUAD)
    expected = np.zeros((HEIGHT, WIDTH), bool)
    expected[8:20, 10:31] = True  # centres 10.5 ... 30.5 and 8.5 ... 19.5
    assert np.array_equal(fragments.ids >= 0, expected)
    assert np.array_equal(silhouette(unproject(corners, 2.0), QUAD, K, WIDTH, HEIGHT), expected)
    np.testing.assert_allclose(fragments.depth[expected], 2.0, rtol=1e-14)


def test_empty_pixels_say_so():
    fragments = draw(unproject([[10, 10], [20, 10], [10, 20]], 1.0), QUAD[:1])
    empty = fragments.face < 0
    assert empty.any() and not empty.all()
    assert (fragments.ids[empty] == EMPTY).all() and np.isinf(fragments.depth[empty]).all()
    assert (fragments.bary[empty] == 0).all() and (fragments.face[empty] == -1).all()


def test_depth_of_a_slanted_plane():
    normal, offset = np.array([0.2, -0.25, -0.8]), -2.0
    fragments = draw(on_plane([[-5, -5], [110, -4], [111, 70], [-6, 71]], normal, offset), QUAD)
    expected = offset / (rays(K, WIDTH, HEIGHT) @ normal)
    np.testing.assert_allclose(fragments.depth, expected, rtol=0, atol=1e-9)


def test_barycentrics_are_perspective_correct():
    vertices, faces = soup(4, low=1)
    fragments = draw(vertices, faces)
    hit = fragments.face >= 0
    points = np.einsum("nk,nkj->nj", fragments.bary[hit], vertices[faces[fragments.face[hit]]])
    seen = rays(K, WIDTH, HEIGHT)[hit] * fragments.depth[hit][:, None]
    assert hit.mean() > 0.5
    np.testing.assert_allclose(points, seen, atol=2e-6)
    np.testing.assert_allclose(fragments.bary[hit].sum(-1), 1, atol=1e-6)


def test_of_equally_near_faces_the_first_wins():
    corners = unproject([[10.2, 7.1], [30.3, 7.4], [15.6, 20.2]], 2.0)
    twice = np.array([[0, 1, 2], [0, 1, 2]], np.int32)
    fragments = rasterize(corners, twice, [5, 3], K, WIDTH, HEIGHT)
    assert set(np.unique(fragments.ids)) == {EMPTY, 5}


def test_both_sides_are_drawn_and_degenerate_triangles_are_not():
    corners = unproject([[10.2, 7.1], [30.3, 7.4], [15.6, 20.2]], 2.0)
    front, back = (draw(corners, np.array([f], np.int32)) for f in ([0, 1, 2], [0, 2, 1]))
    assert (front.ids == 0).any() and np.array_equal(front.ids, back.ids)
    flat = np.concatenate([corners, [corners[:2].mean(0)], [[np.nan] * 3]])
    degenerate = np.array([[0, 1, 1], [2, 2, 2], [0, 1, 4]], np.int32)
    assert (draw(flat, degenerate).ids == EMPTY).all()
    assert not silhouette(flat, degenerate, K, WIDTH, HEIGHT).any()


def test_nothing_draws_nothing():
    nothing = draw(np.empty((0, 3)), np.empty((0, 3), np.int32))
    assert nothing.ids.shape == (HEIGHT, WIDTH) and (nothing.ids == EMPTY).all()
    camera = Camera(width=4, height=3, K=K, T_world_camera=pose())
    assert shade(render([], camera), []).shape == (3, 4, 3)


# Laws


@pytest.mark.parametrize("n", [7, 60])
def test_tessellation_changes_neither_mask_nor_depth(n: int):
    normal, offset = np.array([0.2, -0.25, -0.8]), -2.0
    corners = on_plane([[4.3, 3.2], [90.1, 8.7], [80.9, 60.4], [9.6, 55.8]], normal, offset)
    at, faces = grid(n)
    u, v = at.T[..., None]
    a, b, c, d = corners
    along_a_plane = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    plain, fine = draw(corners, QUAD), draw(along_a_plane, faces)
    assert len(np.unique(fine.face)) > min(n * n, 500)
    assert np.array_equal(plain.face >= 0, fine.face >= 0)
    hit = plain.face >= 0
    np.testing.assert_allclose(plain.depth[hit], fine.depth[hit], atol=1e-9)


@pytest.mark.parametrize("step", [1.0, 0.5, 1 / 3, 0.1])
def test_no_cracks_where_edges_run_through_pixel_centres(step: float):
    """A sheet whose vertices and edges fall on pixel centres, or miss them by rounding only."""
    n = 40
    at, faces = grid(n)
    at = np.round(at * n) * step + 5.5
    vertices = unproject(at, 1 + at @ [0.01, 0.02])
    inside = np.s_[6 : int(5 + n * step), 6 : int(5 + n * step)]
    assert (draw(vertices, faces).face[inside] >= 0).all()
    assert silhouette(vertices, faces, K, WIDTH, HEIGHT)[inside].all()


def test_no_cracks_between_slivers_around_a_vertex():
    angles = np.sort(np.random.default_rng(0).uniform(0, 2 * np.pi, 3000))
    rim = np.c_[np.cos(angles), np.sin(angles)] * 25 + [47.5, 31.5]
    vertices = unproject(np.concatenate([[[47.5, 31.5]], rim]), 3.0)
    i = np.arange(3000)
    faces = np.c_[np.zeros(3000, int), 1 + i, 1 + (i + 1) % 3000].astype(np.int32)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    disc = np.hypot(x - 47.5, y - 31.5)
    mask = silhouette(vertices, faces, K, WIDTH, HEIGHT)
    assert mask[disc < 24.9].all() and not mask[disc > 25].any()


def test_turning_world_and_camera_together_changes_no_ids():
    objects = [solid(3, at=[0.1, 0.2, 2.0]), solid(0, at=[-0.4, 0.0, 2.6]), solid(8, at=[0.5, -0.3, 2.2])]
    camera = Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=pose())
    T = pose(rotation_from_vector([0.5, -2.0, 1.1]), [3.0, -7.0, 11.0])
    turned = [o.moved(T, stage="test", reason="turn") for o in objects]
    before = render(objects, camera)
    after = render(turned, camera.moved(T @ camera.T_world_camera))
    assert set(np.unique(before.ids)) == {EMPTY, 0, 3, 8}
    assert np.array_equal(before.ids, after.ids)
    hit = before.ids >= 0
    np.testing.assert_allclose(before.depth[hit], after.depth[hit], atol=1e-12)


def test_order_of_objects_does_not_matter():
    objects = [solid(3, at=[0.1, 0.2, 2.0]), solid(0, at=[-0.4, 0.0, 2.6]), solid(8, at=[0.5, -0.3, 2.2])]
    camera = Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=pose())
    one, other = render(objects, camera), render(objects[::-1], camera)
    assert one.ids.tobytes() == other.ids.tobytes() and one.depth.tobytes() == other.depth.tobytes()
    assert np.array_equal(shade(one, objects), shade(other, objects[::-1]))


def test_order_of_faces_and_number_of_threads_change_no_byte():
    vertices, faces = soup(1, 500)
    ids = np.arange(len(faces), dtype=np.int32)
    one = rasterize(vertices, faces, ids, K, WIDTH, HEIGHT, threads=1)
    assert len(np.unique(one.ids)) > 50
    order = np.random.default_rng(2).permutation(len(faces))
    shuffled = rasterize(vertices, faces[order], ids[order], K, WIDTH, HEIGHT, threads=1)
    assert one.ids.tobytes() == shuffled.ids.tobytes() and one.bary.tobytes() == shuffled.bary.tobytes()
    assert one.depth.tobytes() == shuffled.depth.tobytes()
    mask = silhouette(vertices, faces, K, WIDTH, HEIGHT, threads=1)
    for threads in (2, 3, 8, 1000):
        assert same(one, rasterize(vertices, faces, ids, K, WIDTH, HEIGHT, threads=threads))
        assert np.array_equal(mask, silhouette(vertices, faces, K, WIDTH, HEIGHT, threads=threads))


def test_strips_together_are_the_whole_picture():
    objects = [solid(4, at=[-0.1, 0.02, 1.0]), solid(9, at=[0.05, -0.03, 1.2])]
    whole = render(objects, CAMERA)
    for pixels in (1, 7 * CAMERA.width, 10**9):
        found = list(strips(objects, CAMERA, pixels=pixels))
        assert [rows.start for rows, _ in found] == [0, *(rows.stop for rows, _ in found[:-1])]
        for name in ("face", "depth", "bary", "ids"):
            together = np.concatenate([getattr(fragments, name) for _, fragments in found])
            assert together.tobytes() == getattr(whole, name).tobytes()
    assert len(np.unique(whole.ids)) == 3
    assert np.array_equal(visible_ids(objects, CAMERA), whole.ids)


def test_equal_input_in_any_layout_compiles_no_second_kernel():
    vertices, faces = soup(1, 50)
    one = draw(vertices, faces)
    vertices.setflags(write=False)
    other = draw(np.asfortranarray(vertices), faces.astype(np.int64)[:, ::-1][:, ::-1], near=NEAR)
    assert same(one, other)
    assert np.array_equal(silhouette(vertices.tolist(), faces.tolist(), K, 8, 8, near=1), draw_mask_at_1(vertices))
    for kernel in ("project", "_cover", "_nearest"):
        assert len(getattr(rasterizer, kernel).signatures) == 1


def draw_mask_at_1(vertices: Array) -> NDArray[np.bool_]:
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    return rasterize(vertices, faces, np.zeros(len(faces)), K, 8, 8, near=1.0).face >= 0


@pytest.mark.parametrize("near", [NEAR, 0.7])
@pytest.mark.parametrize("behind", [1, 2])
def test_crossing_the_near_plane_is_as_if_clipped_by_hand(behind: int, near: float):
    if behind == 1:
        a, b, c = np.array([[0.3, 0.9, -0.4], [-1.2, 0.6, 2.0], [1.1, -0.8, 3.0]])
    else:
        a, b, c = np.array([[0.1, -0.1, 1.5], [-1.2, 0.6, -0.7], [1.1, 0.8, -0.2]])

    def cut(p: Array, q: Array) -> Array:
        return p + (near - p[2]) / (q[2] - p[2]) * (q - p)

    clipped = np.array([cut(a, b), b, c, cut(a, c)] if behind == 1 else [a, cut(a, b), cut(a, c)])
    whole = draw(np.array([a, b, c]), QUAD[:1], near=near)
    by_hand = draw(clipped, QUAD[: len(clipped) - 2], near=near / 2)
    assert 0.05 < (whole.face >= 0).mean() < 0.95
    assert np.array_equal(whole.face >= 0, by_hand.face >= 0)
    hit = whole.face >= 0
    np.testing.assert_allclose(whole.depth[hit], by_hand.depth[hit], rtol=1e-9)
    assert np.array_equal(silhouette(np.array([a, b, c]), QUAD[:1], K, WIDTH, HEIGHT, near=near), hit)


def test_the_floor_under_the_camera_reaches_to_the_horizon_of_its_near_plane():
    floor = np.array([[-1e3, 1, -1e3], [1e3, 1, -1e3], [1e3, 1, 1e3], [-1e3, 1, 1e3]])
    fragments = draw(floor, QUAD)
    d = rays(K, WIDTH, HEIGHT)
    with np.errstate(divide="ignore"):
        z = 1 / d[..., 1]
    seen = (z > NEAR) & (z < 1e3)
    assert np.array_equal(fragments.face >= 0, seen)
    np.testing.assert_allclose(fragments.depth[seen], z[seen], rtol=1e-9)


@pytest.mark.parametrize("left, top", [(500, -300), (-2000, 900)])
def test_a_far_off_centre_K_is_a_crop_of_a_larger_image(left: int, top: int):
    """Both images look at the same part of the scene: far aside of the principal point."""
    vertices, faces = soup(5)
    aside = np.linalg.inv(K) @ [left + 48.0, top + 32.0, 1]
    vertices = vertices + vertices[:, 2:] * (aside / aside[2] - [0, 0, 1])
    shifted = K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
    crop = draw(vertices, faces, shifted)
    large = draw(
        vertices,
        faces,
        K + np.array([[0, 0, 60 - left], [0, 0, 40 - top], [0, 0, 0]]),
        width=WIDTH + 120,
        height=HEIGHT + 80,
    )
    part = np.s_[40 : 40 + HEIGHT, 60 : 60 + WIDTH]
    assert len(np.unique(crop.face)) > 50
    assert np.array_equal(crop.face, large.face[part])
    hit = crop.face >= 0
    np.testing.assert_allclose(crop.depth[hit], large.depth[part][hit], rtol=1e-8)


# Differential


@pytest.mark.parametrize("seed, near", [(0, NEAR), (1, NEAR), (2, 1.0), (3, 2.0)])
def test_equals_a_ray_caster(seed: int, near: float):
    vertices, faces = soup(seed)
    z = vertices[faces][..., 2]
    assert ((z.min(1) < near) & (z.max(1) > near)).sum() > 10
    face, depth, bary = cast(vertices, faces, K, WIDTH, HEIGHT, near)
    fragments = draw(vertices, faces, near=near)
    assert np.array_equal(fragments.face, face)
    hit = face >= 0
    np.testing.assert_allclose(fragments.depth[hit], depth[hit], rtol=1e-9)
    np.testing.assert_allclose(fragments.bary[hit], bary[hit], atol=1e-6)
    assert np.array_equal(fragments.ids, np.where(hit, face, EMPTY))


@pytest.mark.parametrize("seed, near", [(10, NEAR), (11, NEAR), (12, 1.0), (13, 2.0)])
def test_silhouette_equals_a_ray_caster(seed: int, near: float):
    vertices, faces = soup(seed, 25, large=0.5)
    face, _, _ = cast(vertices, faces, K, WIDTH, HEIGHT, near)
    assert 0.01 < (face >= 0).mean() < 0.99
    assert np.array_equal(silhouette(vertices, faces, K, WIDTH, HEIGHT, near=near), face >= 0)


# Colours


def scene_object(id: int, mesh: Mesh, T: Array | None = None) -> SceneObject:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    return SceneObject(id=id, label="", mask_name="", mask=mask, mesh=mesh, T_world_object=pose() if T is None else T)


def solid(id: int, *, at: list[float]) -> SceneObject:
    """A coloured tetrahedron, turned by its id."""
    vertices = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.3
    faces = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)
    colors = np.random.default_rng(id).integers(0, 256, (4, 3), np.uint8)
    mesh = Mesh(vertices=vertices, faces=faces, vertex_colors=colors)
    return scene_object(id, mesh, pose(rotation_from_vector([0.3 * id + 0.1, 0.5, 0.2]), at))


def poster(**appearance: Any) -> SceneObject:
    """An upright rectangle over the pixels 8 ... 88 x 4 ... 60; uv (0, 0) is at its bottom left."""
    corners = unproject([[8, 60], [88, 60], [88, 4], [8, 4]], 2.0)
    uv: Any = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    appearance = {"uv": uv, **appearance}
    return scene_object(1, Mesh(vertices=corners, faces=QUAD, **appearance))


CAMERA = Camera(width=WIDTH, height=HEIGHT, K=K, T_world_camera=pose())


def picture(shown: SceneObject, **options: Any) -> Array:
    return shade(render([shown], CAMERA), [shown], **options)


@pytest.mark.parametrize("filter", ["nearest", "bilinear"])
def test_a_texture_lands_the_right_way_up(filter: Any):
    texture = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    image = picture(poster(materials=(Material(texture=texture),)), filter=filter)
    for pixel, texel in (((18, 28), (0, 0)), ((18, 68), (0, 1)), ((46, 28), (1, 0)), ((46, 68), (1, 1))):
        np.testing.assert_allclose(image[pixel], texture[texel] / 255, atol=0.03)  # beside a texel's middle
    assert (image[:4] == 0).all() and (image[:, :8] == 0).all()


def test_bilinear_is_exact_on_a_ramp_and_wraps():
    texture = np.repeat(np.array([[0, 40, 80, 120]], np.uint8)[..., None], 3, 2)
    image = picture(poster(materials=(Material(texture=texture),)))[30, 8:88, 0] * 255
    position = (np.arange(80) + 0.5) / 80 * 4 - 0.5  # in texels
    expected = np.interp(position, [-1, 0, 1, 2, 3, 4], [120, 0, 40, 80, 120, 0])
    np.testing.assert_allclose(image, expected, atol=1e-3)


def test_a_texture_repeats():
    texture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    plain = poster(materials=(Material(texture=texture),))
    assert plain.mesh.uv is not None
    moved = poster(materials=(Material(texture=texture),), uv=plain.mesh.uv + np.array([3, -2]))
    np.testing.assert_allclose(picture(plain), picture(moved), atol=1e-4)


def test_nearest_equals_the_referee():
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (37, 53, 3), np.uint8)
    shown = poster(materials=(Material(texture=texture),), uv=rng.uniform(-2, 3, (4, 2)))
    fragments = render([shown], CAMERA)
    hit = fragments.face >= 0
    assert shown.mesh.uv is not None
    corners = shown.mesh.uv[shown.mesh.faces[fragments.face[hit]]]
    u, v = np.einsum("nk,nkj->jn", fragments.bary[hit].astype(float), corners)
    x = np.clip((u % 1) * 53, 0, 52).astype(int)
    y = np.clip((1 - v % 1) * 37, 0, 36).astype(int)
    image = shade(fragments, [shown], filter="nearest")
    assert len(np.unique(y)) > 30 and len(np.unique(x)) > 45
    np.testing.assert_allclose(image[hit], texture[y, x] / 255, atol=1e-12)


def test_vertex_colours_are_interpolated():
    colors = np.array([[0, 0, 0], [255, 0, 0], [255, 0, 255], [0, 0, 255]], np.uint8)
    image = picture(poster(vertex_colors=colors, uv=None))
    x, y = (np.arange(80) + 0.5) / 80, (np.arange(56) + 0.5) / 56
    np.testing.assert_allclose(image[4:60, 8:88, 0], np.broadcast_to(x, (56, 80)), atol=1e-5)
    np.testing.assert_allclose(image[4:60, 8:88, 2], np.broadcast_to(1 - y[:, None], (56, 80)), atol=1e-5)
    assert (image[..., 1] == 0).all()


def test_base_colour_texture_and_vertex_colour_multiply():
    texture = np.full((2, 2, 3), [255, 51, 102], np.uint8)
    colors = np.full((4, 3), [51, 255, 102], np.uint8)
    material = Material(base_color=(0.5, 0.25, 1.0), texture=texture)
    image = picture(poster(materials=(material,), vertex_colors=colors))
    np.testing.assert_allclose(image[30, 40], [0.5 * 0.2, 0.25 * 0.2, 0.4 * 0.4], atol=1e-6)


def test_a_texture_without_uv_is_not_shown():
    material = Material(base_color=(0.5, 0.25, 1.0), texture=np.zeros((2, 2, 3), np.uint8))
    np.testing.assert_allclose(picture(poster(materials=(material,), uv=None))[30, 40], [0.5, 0.25, 1.0])


def test_several_materials_and_objects():
    materials = (
        Material(base_color=(1, 0, 0)),
        Material(base_color=(0, 1, 0)),
        Material(base_color=(0, 0, 1)),
    )
    back = poster(materials=materials, face_material=np.array([2, 1], np.int32), uv=None)
    near = replace(solid(4, at=[0, 0, 1.2]), mesh=replace(solid(4, at=[0, 0, 0]).mesh, vertex_colors=None))
    objects = [near, back]
    fragments = render(objects, CAMERA)
    image = shade(fragments, objects)
    assert (fragments.ids == 4).any()
    assert (image[fragments.ids == 4] == 1).all()
    for face, color in ((0, [0, 0, 1]), (1, [0, 1, 0])):
        seen = fragments.face == len(near.mesh.faces) + face
        assert seen.any() and (image[seen] == color).all()


# Given data


def test_the_true_scene_covers_its_masks():
    folder = SHARED / "data/scenes/dev_00_stack"
    if not folder.exists():
        pytest.skip(f"{folder} is not here")
    trimesh, Image = pytest.importorskip("trimesh"), pytest.importorskip("PIL.Image")
    truth = json.loads((folder / "truth.json").read_text())
    width, height = truth["image_size"]
    camera = Camera(
        width=width, height=height, K=np.array(truth["K"]), T_world_camera=np.array(truth["T_world_camera"])
    )
    objects: list[SceneObject] = []
    for o in truth["objects"]:
        loaded = trimesh.load(SHARED / f"data/objects/{o['model']}.glb", force="mesh", process=False)
        mesh = Mesh(vertices=loaded.vertices, faces=loaded.faces)
        objects.append(scene_object(o["index"], mesh, np.array(o["T_world_object"])))
    fragments = render(objects, camera)
    for o, path in zip(objects, sorted((folder / "masks").glob("*.png")), strict=True):
        mask, seen = np.asarray(Image.open(path).convert("L")) > 0, fragments.ids == o.id
        assert (mask & seen).sum() / (mask | seen).sum() > 0.97, path.name
        alone = silhouette(transform(camera.T_camera_world, o.vertices_world), o.mesh.faces, camera.K, width, height)
        assert alone[seen].all()
