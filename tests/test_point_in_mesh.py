"""Ray crossings against the solid angle, and the places where a careless ray test fails."""

from __future__ import annotations

import manifold3d as mf
import numpy as np
from numpy.typing import NDArray

from f3sr.core.transforms import Array, rotation_from_vector
from f3sr.metrics.point_in_mesh import winding_number
from scenes import box_mesh


def solid_angle(points: Array, vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Generalised winding number (van Oosterom and Strackee 1983): slow, and without any case to miss."""
    numbers = np.empty(len(points))
    for k, p in enumerate(points):
        a, b, c = (vertices[faces[:, i]] - p for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        over = np.einsum("ij,ij->i", a, np.cross(b, c))
        under = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        numbers[k] = np.arctan2(over, under).sum() / (2 * np.pi)
    return numbers


def surface(solid: mf.Manifold) -> tuple[Array, NDArray[np.int32]]:
    mesh = solid.to_mesh()
    return np.asarray(mesh.vert_properties[:, :3], float), np.asarray(mesh.tri_verts, np.int32)


def test_agrees_with_the_solid_angle_on_turned_shells_and_rings() -> None:
    rng = np.random.default_rng(0)
    ring = mf.CrossSection.circle(0.3, 24).translate([1.0, 0]).revolve(48)
    hollow = mf.Manifold.sphere(1.0, 40) - mf.Manifold.sphere(0.7, 40)
    for solid in (ring, hollow, ring + hollow.translate([0.9, 0, 0])):
        vertices, faces = surface(solid)
        vertices = vertices @ rotation_from_vector(rng.normal(size=3)).T
        points = rng.uniform(vertices.min(0), vertices.max(0), (400, 3))
        expected = np.round(solid_angle(points, vertices, faces)).astype(int)
        assert 0 < expected.sum() < len(points)
        assert np.array_equal(winding_number(points, vertices, faces), expected)


def test_rays_through_edges_and_corners_count_once() -> None:
    mesh = box_mesh((2, 2, 2))
    across = np.linspace(-1.5, 1.5, 13)  # on the diagonals and corners of both triangles of a side
    points = np.array([[x, s * x, z] for x in across for s in (-1, 0, 1) for z in (-2.0, -0.5, 0.0, 0.5, 2.0)])
    expected = np.all(np.abs(points) < 1, axis=1)
    clear = np.all(np.abs(np.abs(points) - 1) > 1e-9, axis=1)
    assert np.array_equal(winding_number(points, *mesh.welded)[clear], expected[clear])


def test_overlapping_shells_wind_twice() -> None:
    vertices, faces = box_mesh((2, 2, 2)).welded
    both = np.concatenate([vertices, vertices + 0.5])
    number = winding_number(
        np.array([[0.3, 0.2, 0.1], [-0.8, -0.7, -0.6], [9.0, 0, 0]]), both, np.vstack([faces, faces + 8])
    )
    assert number.tolist() == [2, 1, 0]


def test_no_points() -> None:
    assert len(winding_number(np.empty((0, 3)), *box_mesh().welded)) == 0
