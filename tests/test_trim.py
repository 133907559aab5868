"""Parts cut back where they are touched: they come near there, hold what they held, and grow nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.proxies import trim
from f3sr.proxies.trim import MeshSurface, Near
from scenes import ball_mesh, dish_mesh

NEAR = Near(tolerance=2e-4, radius=0.01, reach=0.05)


def around_ball(radius: float = 0.05) -> ConvexPart:
    """A dodecahedron-like polytope of 12 facets that touch a ball."""
    phi = (1 + np.sqrt(5)) / 2
    normals = np.array([[0, a, b * phi] for a in (-1, 1) for b in (-1, 1)])
    normals = np.concatenate([normals, np.roll(normals, 1, 1), np.roll(normals, 2, 1)]) / np.hypot(1, phi)
    from scipy.spatial import HalfspaceIntersection

    halfspaces = np.column_stack([normals, np.full(12, -radius)])
    return ConvexPart.hull_of(HalfspaceIntersection(halfspaces, np.zeros(3)).intersections)


def outside(parts: tuple[ConvexPart, ...], points: np.ndarray) -> float:
    """How far the worst of some points lies outside all parts."""
    beyond = [(points @ p.normals.T - p.offsets).max(1) for p in map(Polytope.of, parts)]
    return float(np.min(beyond, axis=0).max())


def surface_points(mesh: Mesh, count: int = 3000) -> np.ndarray:
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=count)]]
    return np.concatenate([mesh.vertices, np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), count), corners)])


def touched(
    mesh: Mesh, parts: tuple[ConvexPart, ...], x: np.ndarray, *, most: int = 8
) -> tuple[tuple[ConvexPart, ...], float, float]:
    """The parts trimmed at the place nearest to x, and how far they stand off there before and after."""
    surface = MeshSurface.of(mesh)
    there = trim.place_near(surface, parts, x, NEAR)
    assert there is not None
    less = trim.trimmed(surface, parts, there, NEAR, most=most)
    return less, there.off, trim.place_on(surface, less, there.point, there.outward).off


@pytest.mark.parametrize("seed", range(6))
def test_a_ball_comes_through_the_corner_of_its_polytope(seed: int):
    mesh, coarse = ball_mesh(0.05), around_ball()
    rng = np.random.default_rng(seed)
    corner = coarse.vertices[rng.integers(len(coarse.vertices))]
    less, before, after = touched(mesh, (coarse,), 0.9 * corner + 0.001 * rng.normal(size=3))
    assert before > 0.005 and after <= NEAR.tolerance
    assert len(less) == 1, "a bulge needs no split"
    assert outside(less, surface_points(mesh)) < 1e-8
    assert outside((coarse,), less[0].vertices) < 1e-8, "it grows nowhere"


@pytest.mark.parametrize("seed", range(4))
def test_a_hollow_is_split_where_it_is_touched(seed: int):
    mesh = dish_mesh()
    whole = ConvexPart.hull_of(mesh.vertices)
    rng = np.random.default_rng(seed)
    x = np.array([*rng.uniform(-0.03, 0.03, 2), 0.009])
    less, before, after = touched(mesh, (whole,), x)
    assert before > 0.01 and after <= NEAR.tolerance
    assert 2 <= len(less) <= 4
    assert outside(less, surface_points(mesh)) < 1e-8
    assert all(outside((whole,), p.vertices) < 1e-7 for p in less), "coplanar triangles become one plane"
    assert sum(p.volume for p in less) < 1.1 * whole.volume


@pytest.mark.parametrize("most", [1, 2, 3, 4])
def test_a_hollow_is_split_into_no_more_parts_than_allowed(most: int):
    mesh = dish_mesh()
    whole = ConvexPart.hull_of(mesh.vertices)
    less, before, after = touched(mesh, (whole,), np.array([0.0, 0.0, 0.009]), most=most)
    assert len(less) <= most and outside(less, surface_points(mesh)) < 1e-8
    assert after <= NEAR.tolerance if len(less) > 1 else (after, less) == (before, (whole,))


def test_where_no_more_parts_are_allowed_no_split_is_sought_and_bulges_are_still_cut(monkeypatch: pytest.MonkeyPatch):
    """A crumpled mesh of 17 objects asked for 4,000 splits that were thrown away: 74 s."""
    monkeypatch.setattr(trim, "_best_split", lambda *_: pytest.fail("sought"))
    dish, ball, coarse = dish_mesh(), ball_mesh(0.05), around_ball()
    whole = ConvexPart.hull_of(dish.vertices)
    assert touched(dish, (whole,), np.array([0.0, 0.0, 0.009]), most=1)[0] == (whole,)
    less, before, after = touched(ball, (coarse,), 0.9 * coarse.vertices[0], most=1)
    assert before > 0.005 and after <= NEAR.tolerance and len(less) == 1


def test_what_is_not_in_the_way_stays_the_same_value():
    mesh = ball_mesh(0.05)
    far = ConvexPart.hull_of(mesh.vertices[mesh.vertices[:, 2] > 0.01])
    less, _, _ = touched(mesh, (far, around_ball()), 0.06 * np.array([0.0, 0.6, -0.8]))
    assert less[0] is far
    fits = (ConvexPart.hull_of(mesh.vertices),)
    again, before, _ = touched(mesh, fits, np.array([0.0, 0.0, -0.06]))
    assert before <= 1e-6 and again[0] is fits[0]


def test_the_same_touch_gives_the_same_bytes():
    mesh = dish_mesh()
    whole = ConvexPart.hull_of(mesh.vertices)
    first, second = (touched(mesh, (whole,), np.array([0.01, 0.02, 0.009]))[0] for _ in range(2))
    assert [p.vertices.tobytes() for p in first] == [p.vertices.tobytes() for p in second]


def test_the_unit_of_the_asset_does_not_matter():
    x = np.array([0.01, 0.02, 0.009])
    small = dish_mesh()
    large = small.with_vertices(1000 * small.vertices)
    parts = touched(small, (ConvexPart.hull_of(small.vertices),), x)[0]
    surface, whole = MeshSurface.of(large), (ConvexPart.hull_of(large.vertices),)
    there = trim.place_near(surface, whole, 1000 * x, NEAR.scaled(1000))
    assert there is not None
    scaled = trim.trimmed(surface, whole, there, NEAR.scaled(1000), most=8)
    assert [len(p.vertices) for p in scaled] == [len(p.vertices) for p in parts]
    assert sum(p.volume for p in scaled) == pytest.approx(1e9 * sum(p.volume for p in parts), rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_point_is_that_of_all_samples(seed: int):
    mesh = dish_mesh()
    x = np.random.default_rng(seed).uniform(-0.06, 0.06, 3)
    nearest = MeshSurface.of(mesh).nearest(x, 1.0)
    assert nearest is not None
    distances = np.linalg.norm(surface_points(mesh, 40_000) - x, axis=1)
    assert np.linalg.norm(nearest - x) <= distances.min() + 1e-12
    assert np.linalg.norm(nearest - x) == pytest.approx(distances.min(), abs=2e-4)


def test_a_part_of_a_sheet_is_left_as_it_is():
    """What holds but a flat piece of the mesh has no hull to be cut back to."""
    mesh = dish_mesh()
    flat = ConvexPart.hull_of(np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-0.5, 0.5)]))
    sheet = Mesh(vertices=np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), faces=np.array([[0, 1, 2]], np.int32))
    surface = MeshSurface.of(sheet)
    there = trim.place_on(surface, (flat,), np.array([0.2, 0.2, 0.0]), np.array([0.0, 0.0, 1.0]))
    less = trim.trimmed(surface, (flat,), there, NEAR, most=8)
    assert there.off == pytest.approx(0.5) and outside(less, sheet.vertices) < 1e-8 and mesh is not sheet


@pytest.mark.parametrize("seed", range(4))
def test_a_half_cuts_only_what_its_plane_crosses(seed: int):
    """What was clipped by the part's facets is not clipped by them again: rounding would split it without end."""
    rng = np.random.default_rng(seed)
    triangles = rng.normal(size=(36, 3, 3))
    held = trim._Held.of(ConvexPart.hull_of(triangles.reshape(-1, 3)), triangles, 5.0)
    for _ in range(8):
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        offset = float(normal @ held.part.vertices.mean(0)) + 1.0
        height = held.triangles @ normal - offset
        crossed = int(((height > 0).any(1) & (height <= 0).any(1)).sum())
        half = held.half(normal, offset)
        if half is None:
            return
        assert len(half.triangles) <= len(held.triangles) + crossed
        held = half


def test_what_physics_would_refuse_is_no_part():
    """MuJoCo takes no mesh of less than 1e-15 m3."""
    from scenes import box_mesh

    cube = box_mesh((0.2, 0.2, 0.2)).hull
    slip = -0.1 + 1e-9
    assert trim.less(cube, np.array([0, 0, 1.0]), slip, 0.35) is None
    layer = trim.less(cube, np.array([0, 0, 1.0]), -0.1 + 1e-5, 0.35)
    assert layer is not None and layer.volume == pytest.approx(4e-7, rel=1e-6)
