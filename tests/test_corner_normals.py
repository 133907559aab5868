"""Smooth normals against a slow readable twin, and the laws of edges, seams and turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core import corner_normals as module
from f3sr.core.corner_normals import CREASE, FAN, corner_normals
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, rotation_about
from scenes import box_mesh


def rough(seed: int, side: int = 8) -> Mesh:
    """A bumpy height field: some edges turn by more than the crease, some by less."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(side, dtype=float), np.arange(side, dtype=float))
    vertices = np.column_stack([x.ravel(), y.ravel(), 0.6 * rng.random(side * side)])
    k = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    faces = np.concatenate([np.column_stack([k, k + 1, k + side]), np.column_stack([k + 1, k + side + 1, k + side])])
    return Mesh(vertices=vertices, faces=faces.astype(np.int32))


def slow(mesh: Mesh, crease: float) -> Array:
    """The definition, corner by corner."""
    places, place = mesh.weld
    faces = place[mesh.faces]
    a, b, c = (places[faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    unit = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    out = np.zeros((len(faces), 3, 3))
    for f, corners in enumerate(faces):
        for k, v in enumerate(corners):
            around = [g for g in np.flatnonzero((faces == v).any(1)) if g == f or unit[f] @ unit[g] > np.cos(crease)]
            out[f, k] = flat[around].sum(0)
    return out / np.linalg.norm(out, axis=2, keepdims=True)


@pytest.mark.parametrize("crease", [0.1, CREASE, 3.0])
@pytest.mark.parametrize("pairs", [7, 500_000])
def test_they_are_what_the_definition_says(crease: float, pairs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PAIRS", pairs)
    for seed in range(3):
        found = corner_normals(rough(seed), crease)
        assert found.dtype == np.float32 and np.allclose(found, slow(rough(seed), crease), atol=1e-6)


def test_a_box_has_sharp_edges_and_a_fine_cylinder_is_round() -> None:
    box = box_mesh()
    a, b, c = (box.vertices[box.faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    assert np.allclose(corner_normals(box), (flat / np.linalg.norm(flat, axis=1, keepdims=True))[:, None], atol=1e-6)
    for sides, round_ in ((12, True), (8, False)):
        angle = 2 * np.pi * np.arange(sides) / sides
        ring = np.column_stack([np.cos(angle), np.sin(angle)])
        k, after = np.arange(sides), np.roll(np.arange(sides), -1)
        walls = np.column_stack([k, after, k + sides]), np.column_stack([after, after + sides, k + sides])
        faces = np.concatenate(walls)
        tube = Mesh(
            vertices=np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (0.0, 1.0)]),
            faces=faces.astype(np.int32),
        )
        outward = np.concatenate([np.column_stack([ring, np.zeros(sides)])] * 2)[faces]
        # Two or one triangles of a side meet at a vertex, so a mean by area leans, by less than half a side.
        assert (np.einsum("ijk,ijk->ij", corner_normals(tube), outward).min() > 0.98) == round_


def test_texture_seams_and_turns_do_not_matter() -> None:
    mesh = rough(4)
    own = np.arange(3 * len(mesh.faces), dtype=np.int32).reshape(-1, 3)
    seamed = Mesh(vertices=mesh.vertices[mesh.faces].reshape(-1, 3), faces=own)
    assert np.array_equal(corner_normals(seamed), corner_normals(mesh))
    R = rotation_about([1.0, 2, 3], 1.1)
    turned = corner_normals(replace(mesh, vertices=mesh.vertices @ R.T))
    assert np.allclose(turned, corner_normals(mesh) @ R.T, atol=1e-6)


def test_the_tip_of_a_wide_fan_stays_sharp_and_costs_little() -> None:
    sides = 20_000
    assert sides > FAN  # all pairs at the tip would be 4e8
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(sides)])
    faces = np.column_stack([np.full(sides, sides), np.arange(sides), np.roll(np.arange(sides), -1)])
    cone = Mesh(vertices=np.concatenate([ring, [[0, 0, 2.0]]]), faces=faces.astype(np.int32))
    a, b, c = (cone.vertices[cone.faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    assert np.allclose(corner_normals(cone)[:, 0], flat / np.linalg.norm(flat, axis=1, keepdims=True), atol=1e-6)


def test_faces_without_area_have_none_and_disturb_no_other() -> None:
    mesh = rough(5)
    more = replace(mesh, faces=np.concatenate([mesh.faces, [[0, 0, 1]]]).astype(np.int32), face_material=None)
    assert np.array_equal(corner_normals(more)[:-1], corner_normals(mesh))
    assert not corner_normals(more)[-1, 2].any() or np.isclose(np.linalg.norm(corner_normals(more)[-1, 2]), 1)
