"""Vertex colours as a texture: what is sampled and drawn is what the vertices' colours show, and nothing bleeds."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from f3sr.core.camera import Camera
from f3sr.core.mesh import Material, Mesh
from f3sr.core.srgb import linear, srgb
from f3sr.core.transforms import Array, pose
from f3sr.exporters.colour_atlas import AtlasConfig, ColourAtlas, bake_colours
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.mjcf import Mjcf
from f3sr.io.mesh_files import load_mesh
from f3sr.rendering import textures
from f3sr.rendering.config import RenderConfig
from f3sr.rendering.layers import Things
from f3sr.rendering.surface_kernels import nearest_faces, seen_at
from f3sr.scene import SceneObject
from f3sr.scene_package.package import read_package, write_package
from f3sr.vision import rasterizer
from scenes import ball_mesh, box, scene_of

LEVELS = 2.0
"""Largest difference of samples from the interpolation of the vertices' colours [levels of 255]."""


def coloured(mesh: Mesh, kind: str, seed: int = 0) -> Mesh:
    """A mesh with colours of a kind: smooth and gentle ones, print with sharp edges, any, or one a triangle."""
    rng, v = np.random.default_rng(seed), mesh.vertices / np.abs(mesh.vertices).max()
    if kind == "smooth":
        colours = 127.5 + 127 * np.sin(4 * v + [0, 1, 2])
    elif kind == "gentle":
        colours = 127.5 + 60 * np.sin(2 * v + [0, 1, 2])
    elif kind == "print":
        colours = np.where(np.sin(9 * v[:, :1]) > 0, [255.0, 240, 250], [10, 0, 40])
    elif kind == "any":
        colours = rng.integers(0, 256, v.shape).astype(float)
    else:
        colours = np.repeat(rng.integers(0, 256, (len(mesh.faces), 3)), 3, axis=0).astype(float)
        mesh = Mesh(
            vertices=mesh.vertices[mesh.faces].reshape(-1, 3), faces=np.arange(3 * len(mesh.faces)).reshape(-1, 3)
        )
    return replace(mesh, vertex_colors=colours.astype(np.uint8))


def baked(mesh: Mesh, config: AtlasConfig | None = None) -> ColourAtlas:
    assert mesh.vertex_colors is not None
    atlas = bake_colours(mesh.vertices, mesh.faces, mesh.vertex_colors, config)
    assert atlas is not None
    return atlas


def sampled(texture: Array, uv: Array) -> Array:
    """Bilinear samples (n, 3) of a texture (h, w, 3) at uv (n, 2), v upwards, as graphics cards take them."""
    h, w = texture.shape[:2]
    x, y = uv[:, 0] * w - 0.5, (1 - uv[:, 1]) * h - 0.5
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    s, t = (x - i)[:, None], (y - j)[:, None]
    at = [texture[(j + b) % h, (i + a) % w] for a, b in ((0, 0), (1, 0), (0, 1), (1, 1))]
    return (1 - s) * (1 - t) * at[0] + s * (1 - t) * at[1] + (1 - s) * t * at[2] + s * t * at[3]


def halved(texture: Array) -> Array:
    h, w = texture.shape[:2]
    return texture.reshape(h // 2, 2, w // 2, 2, -1).mean((1, 3))


def off(mesh: Mesh, atlas: ColourAtlas, level: int, count: int = 40_000) -> Array:
    """Differences (n,) [levels] of samples from the interpolation at random places of the triangles."""
    rng = np.random.default_rng(1)
    face = rng.integers(len(mesh.faces), size=count)
    weights = rng.dirichlet(np.ones(3), count)
    weights[:300] = np.eye(3)[rng.integers(3, size=300)]  # corners
    assert mesh.vertex_colors is not None
    exact = (weights[:, :, None] * linear(mesh.vertex_colors[mesh.faces[face]] / 255)).sum(1)
    uv = (weights[:, :, None] * atlas.uv[atlas.uv_faces[face]]).sum(1)
    texture = linear(atlas.texture / 255)
    for _ in range(level):
        texture = halved(texture)
    return 255 * np.abs(srgb(np.clip(sampled(texture, uv), 0, 1)) - srgb(exact)).max(1)


@pytest.mark.parametrize("kind", ["smooth", "print", "any", "patches"])
def test_samples_are_the_interpolation_of_the_vertices_colours(kind: str):
    mesh = coloured(ball_mesh(0.1), kind)
    errors = off(mesh, baked(mesh), 0)
    assert (errors <= LEVELS).mean() >= 0.99 and np.median(errors) < 1


@pytest.mark.parametrize("kind", ["gentle", "patches"])
def test_nothing_bleeds_at_half_the_size(kind: str):
    """Neighbours in the atlas have any other colour; the mean of four texels holds none of it."""
    mesh = coloured(ball_mesh(0.1), kind)
    assert (off(mesh, baked(mesh), 1) <= LEVELS).mean() >= 0.99


def test_two_triangles_share_a_cell_only_where_it_shows_both():
    """A square whose colours bend along its diagonal has two cells; a plane of colours has one."""
    square = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    for winding in ([[0, 1, 2], [3, 2, 1]], [[0, 1, 2], [3, 1, 2]], [[1, 2, 0], [1, 3, 2]]):
        faces = np.array(winding, np.int32)
        plane = np.array([[40, 90, 30]] * 4, np.uint8)
        even = baked(Mesh(vertices=square, faces=faces, vertex_colors=plane))
        assert len(even.uv) == 4
        bent = np.array([[200, 200, 200], [60, 60, 60], [60, 60, 60], [200, 200, 200]], np.uint8)
        mesh = Mesh(vertices=square, faces=faces, vertex_colors=bent)
        assert len(baked(mesh).uv) == 6 and off(mesh, baked(mesh), 0, 2000).max() < LEVELS
        slanted = srgb(np.array([[0.2] * 3, [0.3] * 3, [0.35] * 3, [0.45] * 3]))
        mesh = Mesh(vertices=square, faces=faces, vertex_colors=np.rint(255 * slanted).astype(np.uint8))
        assert len(baked(mesh).uv) == 4 and off(mesh, baked(mesh), 0, 2000).max() < LEVELS


def test_equal_calls_and_other_numbers_of_vertices_show_the_same():
    mesh = coloured(ball_mesh(0.1), "smooth")
    one, again = baked(mesh), baked(mesh)
    assert np.array_equal(one.texture, again.texture) and np.array_equal(one.uv, again.uv)
    assert mesh.vertex_colors is not None
    split = Mesh(
        vertices=mesh.vertices[mesh.faces].reshape(-1, 3),
        faces=np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        vertex_colors=mesh.vertex_colors[mesh.faces].reshape(-1, 3),
    )
    assert np.array_equal(baked(split).texture, one.texture), "vertices of equal place and colour are one"


def test_the_longest_side_is_kept():
    mesh = coloured(ball_mesh(0.1), "any")
    full = baked(mesh)
    assert max(full.texture.shape) > 160
    flat = baked(mesh, AtlasConfig(longest=160))
    assert max(flat.texture.shape) <= 160
    assert mesh.vertex_colors is not None
    means = linear(mesh.vertex_colors / 255)[mesh.faces].mean(1)
    shown = sampled(linear(flat.texture / 255), flat.uv[flat.uv_faces[:, 0]])
    assert 255 * np.abs(srgb(shown) - srgb(means)).max() <= 1, "one colour a triangle"
    assert bake_colours(mesh.vertices, mesh.faces, mesh.vertex_colors, AtlasConfig(longest=16)) is None


# --- drawn ----------------------------------------------------------------------------------------------------------


def drawn(mesh: Mesh, distance: float, side: int) -> tuple[Array, NDArray[np.int32], Array]:
    """Unlit colours (n, 3) in linear light of the pixels that show a mesh, the faces (side, side) they show, and the
    cosines (n,) at which these are seen."""
    o = SceneObject(
        id=0, label="", mask_name="", mask=np.ones((1, 1), bool), mesh=mesh, T_world_object=pose(t=[0, 0, distance])
    )
    K = np.array([[side, 0, side / 2], [0, side, side / 2], [0, 0, 1.0]])
    camera = Camera(width=side, height=side, K=K, T_world_camera=np.eye(4))
    things = Things.of([o], RenderConfig())
    view = things.seen_by(camera, o.T_world_object[None], 1e-3)
    face, nearness = np.full((side, side), -1, np.int32), np.zeros((side, side), np.float32)
    nearest_faces(view.points, things.shapes.faces, 0, len(mesh.faces), False, 1e-3, 0, side, face, nearness)
    pixels = rasterizer.fixed(np.argwhere(face >= 0), np.int64)
    albedo, place, normal = (np.empty((len(pixels), 3)) for _ in range(3))
    seen_at(things.shapes, things.textures, view, 1e-3, pixels, rasterizer.fixed(face, np.int32), albedo, place, normal)
    return albedo, face, np.abs((normal * place).sum(1)) / np.linalg.norm(place, axis=1)


def with_texture(mesh: Mesh, atlas: ColourAtlas) -> Mesh:
    return Mesh(
        vertices=mesh.vertices[mesh.faces].reshape(-1, 3),
        faces=np.arange(3 * len(mesh.faces)).reshape(-1, 3),
        uv=atlas.uv[atlas.uv_faces].reshape(-1, 2),
        materials=(Material(texture=atlas.texture),),
    )


@pytest.mark.parametrize(
    ("kind", "rings", "side"), [("smooth", 32, 400), ("print", 32, 400), ("any", 32, 400), ("gentle", 64, 80)]
)
def test_the_baked_mesh_is_drawn_as_the_coloured_one(kind: str, rings: int, side: int, monkeypatch: pytest.MonkeyPatch):
    """As other programs draw it: our renderer would fill texels beside triangles, for charts with dark borders. The
    last is drawn between level 0 and level 1. What is seen at over 70 degrees is drawn from coarser levels."""
    monkeypatch.setattr(textures, "_drawn", lambda mesh, material, size: np.ones(size, np.bool_))
    mesh = coloured(ball_mesh(0.1, rings), kind)
    (exact, faces, cosines), (shown, same, _) = (drawn(m, 0.3, side) for m in (mesh, with_texture(mesh, baked(mesh))))
    open = cosines > np.cos(np.radians(70))
    assert np.array_equal(faces, same) and open.sum() > 2000
    errors = 255 * np.abs(srgb(np.clip(shown[open], 0, 1)) - srgb(exact[open])).max(1)
    assert (errors <= LEVELS).mean() >= 0.99


# --- in MuJoCo ------------------------------------------------------------------------------------------------------


def painted_object() -> SceneObject:
    o = box(3)
    return replace(o, mesh=coloured(ball_mesh(0.05), "smooth"), parts=(ball_mesh(0.05).hull,))


def test_scene_xml_shows_the_colours_of_vertices(tmp_path: Path):
    """By MuJoCo's own reading: at every corner its texture has that vertex's colour."""
    o = painted_object()
    out = write_package(scene_of(o), tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    (geom,) = [k for k in range(model.ngeom) if "visual" in model.geom(k).name]
    material, mesh = model.geom_matid[geom], model.geom_dataid[geom]
    (texture,) = {int(t) for t in np.asarray(model.mat_texid[material]).ravel() if t >= 0}
    h, w, channels = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    start = int(model.tex_adr[texture])
    image = np.asarray(model.tex_data)[start : start + h * w * channels].reshape(h, w, channels)
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corners = np.asarray(model.mesh_facetexcoord)[first : first + count]
    uv = np.asarray(model.mesh_texcoord)[int(model.mesh_texcoordadr[mesh]) :][corners].reshape(-1, 2)
    shown = sampled(image.astype(float), uv * [1, -1] + [0, 1])  # MuJoCo's v points down
    assert o.mesh.vertex_colors is not None and count == len(o.mesh.faces)
    assert np.abs(shown - o.mesh.vertex_colors[o.mesh.faces].reshape(-1, 3)).max() <= LEVELS
    assert np.allclose(model.mat_rgba[material], 1)


def test_the_package_keeps_the_mesh_as_it_is(tmp_path: Path):
    o = painted_object()
    out = write_package(scene_of(o), tmp_path / "out")
    kept = load_mesh(out / "meshes/03.glb")
    assert np.array_equal(kept.vertex_colors, o.mesh.vertex_colors) and np.array_equal(kept.faces, o.mesh.faces)
    assert all(m.texture is None for m in kept.materials)
    again = read_package(out).scene.objects[0].mesh
    assert np.array_equal(again.vertex_colors, o.mesh.vertex_colors)


def test_one_colour_needs_no_texture_and_a_texture_keeps_the_mean_of_its_colours():
    red = np.tile(np.array([200, 20, 10], np.uint8), (len(ball_mesh(0.05).vertices), 1))
    plain = replace(painted_object(), mesh=replace(ball_mesh(0.05), vertex_colors=red))
    files = dict(Mjcf().files(ExportedScene.of(scene_of(plain))))
    assert not [name for name in files if name.endswith(".png")]
    material = re.search(rb'<material name="[^"]*visual[^"]*" rgba="([^"]+)"', files["scene.xml"])
    assert material and np.allclose([float(x) for x in material[1].split()], [200 / 255, 20 / 255, 10 / 255, 1])
    textured = box(3, textured=True)
    both = replace(textured, mesh=coloured(textured.mesh, "smooth"))
    assert both.mesh.vertex_colors is not None
    files = dict(Mjcf().files(ExportedScene.of(scene_of(both))))
    material = re.search(rb'<material name="[^"]*visual[^"]*" rgba="([^"]+)"', files["scene.xml"])
    assert material
    mean = both.mesh.vertex_colors[np.unique(both.mesh.faces)].mean(0) / 255
    assert np.allclose([float(x) for x in material[1].split()][:3], mean)
