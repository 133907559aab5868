"""Volumes, inertia and hulls against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from f3sr.core.mesh import (
    ConvexPart,
    Mesh,
    is_closed,
    mass_properties,
    signed_volume,
    solid_properties,
    surface_flaws,
    union,
)
from f3sr.core.transforms import pose, rotation_about
from scenes import box_mesh


def of(m: trimesh.Trimesh) -> Mesh:
    return Mesh(vertices=m.vertices, faces=m.faces)


def test_a_hull_for_which_memory_is_lacking_is_not_said_to_be_flat(monkeypatch: pytest.MonkeyPatch):
    from scipy.spatial import QhullError

    def full(*_: object, **__: object) -> None:
        raise QhullError("QH6082 qhull error (qh_memalloc): insufficient memory to allocate 880 bytes")

    monkeypatch.setattr("scipy.spatial.ConvexHull", full)
    with pytest.raises(MemoryError):
        ConvexPart.hull_of(box_mesh((1, 1, 1)).vertices)


def test_box_mass_properties_are_the_textbook_ones():
    a, b, c = 0.2, 0.3, 0.5
    m = trimesh.creation.box((a, b, c))
    m.apply_translation([1, 2, 3])
    p = mass_properties(np.asarray(m.vertices), np.asarray(m.faces, np.int32))
    volume = a * b * c
    assert p.volume == pytest.approx(volume)
    assert np.allclose(p.center, [1, 2, 3])
    expected = volume / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    assert np.allclose(p.inertia, expected)


def test_mass_properties_agree_with_trimesh_on_a_rotated_torus():
    m = trimesh.creation.torus(0.3, 0.1)
    m.apply_transform(pose(rotation_about([1, 2, 3], 0.7), [0.4, -1, 2]))
    ours = mass_properties(np.asarray(m.vertices), np.asarray(m.faces, np.int32))
    assert ours.volume == pytest.approx(m.volume)
    assert np.allclose(ours.center, m.center_mass)
    assert np.allclose(ours.inertia, m.moment_inertia, atol=1e-9)


def test_texture_seams_do_not_open_a_solid():
    split = box_mesh(textured=True)
    assert len(split.vertices) == 36 and not is_closed(split.faces)
    assert split.is_solid and len(split.welded[0]) == 8


def test_inside_out_and_open_meshes_are_not_solid():
    m = box_mesh()
    assert not Mesh(vertices=m.vertices, faces=m.faces[:, ::-1]).is_solid
    assert not Mesh(vertices=m.vertices, faces=m.faces[1:]).is_solid


def test_open_meshes_take_their_mass_from_the_union_of_parts():
    m = box_mesh((1, 1, 1))
    half = ConvexPart.hull_of(m.vertices * [0.5, 1, 1])
    whole = ConvexPart.hull_of(m.vertices)
    open_mesh = Mesh(vertices=m.vertices, faces=m.faces[1:])
    properties, from_mesh = solid_properties(open_mesh, [half, whole])
    assert not from_mesh and properties.volume == pytest.approx(1, rel=1e-5)


def test_union_counts_an_overlap_once():
    a = ConvexPart.hull_of(box_mesh((1, 1, 1)).vertices)
    b = a.moved(pose(t=[0.5, 0, 0]))
    vertices, faces = union([a, b])
    assert mass_properties(vertices, faces).volume == pytest.approx(1.5, rel=1e-5)


def test_hull_faces_point_outward_and_flat_points_are_refused():
    points = np.random.default_rng(0).normal(size=(50, 3))
    hull = ConvexPart.hull_of(points)
    assert hull.volume > 0 and is_closed(hull.faces)
    with pytest.raises(ValueError, match="no volume"):
        ConvexPart.hull_of(points * [1, 1, 0])


def test_values_are_read_only():
    m = box_mesh()
    with pytest.raises(ValueError, match="read-only"):
        m.vertices[0] = 0


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return Mesh(
        vertices=np.concatenate([m.vertices for m in meshes]),
        faces=np.concatenate([m.faces + s for m, s in zip(meshes, starts, strict=False)]),
    )


def test_a_layer_within_another_counts_no_space_twice():
    outer, inner = box_mesh((1, 1, 1)), box_mesh((0.5, 0.5, 0.5))
    hollow = Mesh(vertices=inner.vertices, faces=inner.faces[:, ::-1])
    beside = inner.with_vertices(inner.vertices + np.array([2, 0, 0]))
    hull = [ConvexPart.hull_of(outer.vertices)]
    for other, volume, from_mesh in ((inner, 1.0, False), (hollow, 0.875, True), (beside, 1.125, True)):
        properties, used_mesh = solid_properties(joined(outer, other), hull)
        assert used_mesh == from_mesh and properties.volume == pytest.approx(volume, rel=1e-5)
    assert surface_flaws(joined(outer, inner)).layers and not surface_flaws(joined(outer, beside)).layers


def test_flaws_are_counted():
    m = box_mesh()
    assert str(surface_flaws(m)) == "facing inward"  # no flaw found: what else keeps it from being a solid
    doubled = surface_flaws(
        Mesh(vertices=m.vertices, faces=np.concatenate([m.faces, m.faces[:2], m.faces[:1, [0, 0, 1]]]))
    )
    assert (doubled.doubled, doubled.degenerate, doubled.open, doubled.shared) == (2, 1, 0, 5)
    assert surface_flaws(Mesh(vertices=m.vertices, faces=m.faces[1:])).open == 3
    turned = np.concatenate([m.faces[:1, ::-1], m.faces[1:]])
    assert surface_flaws(Mesh(vertices=m.vertices, faces=turned)).turned == 3


def test_unused_vertices_go_and_triangles_stay():
    m = box_mesh(textured=True)
    stray = Mesh(
        vertices=np.concatenate([[[9, 9, 9]], m.vertices, [[7, 7, 7]]]),
        faces=m.faces + 1,
        uv=np.concatenate([[[0, 0]], m.uv, [[0, 0]]]),
        materials=m.materials,
    )
    used = stray.without_unused()
    assert np.array_equal(used.vertices, m.vertices) and np.array_equal(used.uv, m.uv)
    assert np.array_equal(used.faces, m.faces) and m.without_unused() is m


def test_a_surface_that_no_body_could_have_is_no_solid() -> None:
    """A crumpled box: closed, of positive volume, but crossing itself so that a principal moment is negative."""
    box = box_mesh()
    vertices, faces = box.welded
    for seed in range(2000):
        crumpled = vertices + np.random.default_rng(seed).normal(0, 0.1, vertices.shape)
        moments = np.linalg.eigvalsh(mass_properties(crumpled, faces).inertia)
        if signed_volume(crumpled, faces) > 0 and moments[0] < 0:
            mesh = Mesh(vertices=crumpled, faces=faces)
            assert not mesh.is_solid and surface_flaws(mesh).layers
            return
    pytest.fail("no such box was found")


@pytest.mark.parametrize("seed", range(8))
def test_hulls_of_points_with_near_twins_are_closed(seed: int):
    """Slivers between twins have no area, so that rounding says where they face."""
    rng = np.random.default_rng(seed)
    for gap in np.geomspace(1e-16, 1e-9, 40):
        points = rng.standard_normal((30, 3))
        points /= np.linalg.norm(points, axis=1)[:, None]
        twins = np.concatenate([points, points + gap * rng.standard_normal(points.shape)])
        hull = ConvexPart.hull_of(0.05 * twins[twins[:, 2] > -0.3] + 1.0)
        edges = np.concatenate([hull.faces[:, [0, 1]], hull.faces[:, [1, 2]], hull.faces[:, [2, 0]]]).tolist()
        assert sorted(edges) == sorted([b, a] for a, b in edges)
        assert hull.volume > 0


def test_a_hull_with_a_facet_a_hair_wide_is_no_sheet():
    """Qhull stops at these points, which a cut through a scan left: two and three of them are near twins."""
    points = np.array(
        [
            [1.1094749090573, -0.2671262789157, -1.1708353530705],
            [1.1094749159699, -0.2671262849671, -1.1708353516575],
            [1.1163385246368, -0.2730338405761, -1.1713704950875],
            [1.1163386172416, -0.2730339175783, -1.1713705542081],
            [1.1163387001105, -0.2730339803442, -1.171370725005],
            [1.1136983042532, -0.2626792934102, -1.3263267502793],
            [1.1119427512086, -0.2974212731999, -1.231610864969],
        ]
    )
    assert ConvexPart.hull_of(points).volume == pytest.approx(5.5605e-6, rel=1e-3)


def test_the_hull_of_a_sheet_is_refused():
    for sheet in (np.zeros((0, 3)), np.eye(3), np.random.default_rng(0).random((50, 3)) * [1, 1, 0]):
        with pytest.raises(ValueError, match="span no volume"):
            ConvexPart.hull_of(sheet)
