"""Exact contact: known boxes, an independent Minkowski hull and an LP on seeded hulls, and laws."""

from __future__ import annotations

import time
import warnings

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

from f3sr.contact import compounds, horizontal_moves, polytopes
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import pose, rotation_about

UP = np.array([0.0, 0, 1])
SEEDS = range(25)


def box(size=(1.0, 1.0, 1.0), center=(0.0, 0.0, 0.0)):
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return Polytope.of(ConvexPart.hull_of(signs * np.array(size) / 2 + center))


def random_hull(rng, n=None, spread=0.4):
    points = rng.normal(size=(n or rng.integers(4, 30), 3)) * rng.uniform(0.2, 1, 3)
    return Polytope.of(ConvexPart.hull_of(points + rng.normal(size=3) * spread))


def random_body(rng, parts=4):
    return [random_hull(rng, spread=1.0) for _ in range(parts)]


def random_direction(rng):
    u = rng.normal(size=3)
    return u / np.linalg.norm(u)


def cube_with_a_sliver():
    """A unit cube; between its front y = 0 and its top z = 1 lies a triangle of no height, along their edge."""
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4)]
    faces = [t for a, b, c, d in squares for t in ((a, b, c), (a, c, d))]
    faces += [(1, 5, 8), (8, 5, 7), (8, 7, 3), (8, 3, 1)]
    return ConvexPart(vertices=np.array([*corners, [0.5, 0, 1]], float), faces=np.array(faces, np.int32))


def cube_with_a_double_corner(near, far):
    """A unit cube whose corner (1, 1, 1) is there twice, as rounding makes it; two triangles of no area lie between.

    ``near``, ``far``: at which of the six triangles around the corner its second copy begins and ends."""
    corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    around = [6, 4, 5, 1, 3, 2]
    faces = [(0, 1, 3), (0, 3, 2), (0, 4, 5), (0, 5, 1), (0, 2, 6), (0, 6, 4)]
    faces += [(around[k], 8 if near <= k < far else 7, around[(k + 1) % 6]) for k in range(6)]
    faces += [(8, around[near], 7), (7, around[far % 6], 8)]
    return ConvexPart(vertices=np.array([*corners, [1, 1, 1]], float), faces=np.array(faces, np.int32))


def minkowski_planes(a, b):
    """The oracle: hull of all differences b - a, as normals and offsets; a + x overlaps b iff x is inside."""
    differences = (b.vertices[None] - a.vertices[:, None]).reshape(-1, 3)
    equations = ConvexHull(differences).equations
    return equations[:, :3], -equations[:, 3]


def lp_interval(a, b, u):
    """The oracle by linear programming: extremes of t with a + t u touching b, or None."""
    na, nb = len(a.vertices), len(b.vertices)
    equal = np.zeros((5, na + nb + 1))
    equal[:3, :na], equal[:3, na:-1], equal[:3, -1] = a.vertices.T, -b.vertices.T, u
    equal[3, :na] = equal[4, na:-1] = 1
    ends = []
    for sign in (1, -1):
        cost = np.zeros(na + nb + 1)
        cost[-1] = sign
        bounds = [(0, None)] * (na + nb) + [(None, None)]
        solution = linprog(cost, A_eq=equal, b_eq=[0, 0, 0, 1, 1], bounds=bounds, method="highs")
        if not solution.success:
            return None
        ends.append(solution.x[-1])
    return ends


# Known answers


def test_a_box_has_six_facets_and_twelve_edges():
    cube = box()
    assert (len(cube.vertices), len(cube.normals), len(cube.edge_starts)) == (8, 6, 12)
    assert np.allclose(cube.offsets, 0.5)


def test_vertices_without_a_face_change_nothing():
    rng = np.random.default_rng(5)
    hull = ConvexPart.hull_of(rng.normal(size=(12, 3)))
    for _ in range(300):
        place = rng.permutation(400)[: len(hull.vertices)]
        corners = np.zeros((400, 3))
        corners[place] = hull.vertices
        found = Polytope.of(ConvexPart(vertices=corners, faces=place[hull.faces].astype(np.int32)))
        assert len(found.normals) == len(hull.faces)
        assert found.edge_lengths.sum() == pytest.approx(Polytope.of(hull).edge_lengths.sum())


def test_facets_and_edges_obey_euler_on_random_hulls():
    for seed in SEEDS:
        p = random_hull(np.random.default_rng(seed), 40)
        assert len(p.vertices) - len(p.edge_starts) + len(p.normals) == 2
        left, right = p.edge_normals[:, 0], p.edge_normals[:, 1]
        assert (np.einsum("ij,ij->i", np.cross(left, right), p.edge_directions) > 0).all()


@pytest.mark.parametrize(("x", "depth"), [(0.9, 0.1), (0.5, 0.5), (0.0, 1.0), (1.0, 0.0), (1.2, -0.2)])
def test_depth_of_boxes(x, depth):
    assert polytopes.overlap_depth(box(), box(center=(x, 0, 0))) == pytest.approx(depth, abs=1e-15)


def test_interval_of_boxes():
    a, b = box(), box(center=(0.2, 0, 3))
    assert polytopes.forbidden_interval(a, b, UP) == pytest.approx((2, 4), abs=1e-8)
    assert polytopes.forbidden_interval(a, b, 2 * UP) == pytest.approx((1, 2), abs=1e-8)
    lo, hi = polytopes.forbidden_interval(a, b, (1.0, 0, 0))
    assert lo >= hi


def test_edge_against_edge():
    """Two boxes turned by 45 degrees about crossing axes touch with one edge each."""
    a = box().moved(pose(rotation_about([1, 0, 0], np.pi / 4)))
    b = box().moved(pose(rotation_about([0, 1, 0], np.pi / 4), [0, 0, np.sqrt(2) - 0.01]))
    assert polytopes.overlap_depth(a, b) == pytest.approx(0.01, abs=1e-12)
    assert compounds.smallest_shift([b], [a], UP) == pytest.approx(0.01, abs=1e-8)


def test_a_shift_passes_through_what_hangs_above():
    """A gap that is too low for the body is no place to stop; one that is high enough is."""
    body, floor = [box()], box(size=(5, 5, 1), center=(0, 0, -0.5))
    assert compounds.smallest_shift(body, [floor], UP) == pytest.approx(0.5, abs=1e-8)
    shelf = [floor, box(size=(5, 5, 0.2), center=(0, 0, 1.0))]
    assert compounds.smallest_shift(body, shelf, UP) == pytest.approx(1.6, abs=1e-8)
    high_shelf = [floor, box(size=(5, 5, 0.2), center=(0, 0, 1.2))]
    assert compounds.smallest_shift(body, high_shelf, UP) == pytest.approx(0.5, abs=1e-8)


def test_clearance_is_left_behind_only():
    body = [box()]
    assert compounds.smallest_shift(body, [box(center=(0, 0, -1.0))], UP, clearance=0.1) == pytest.approx(0.1)
    assert compounds.smallest_shift(body, [box(center=(0, 0, -1.04))], UP, clearance=0.1) == pytest.approx(0.06)
    assert compounds.smallest_shift(body, [box(center=(0, 0, -1.2))], UP, clearance=0.1) == 0
    assert compounds.smallest_shift(body, [box(center=(0, 0, 1.01))], UP, clearance=0.1) == 0


def test_free_travel():
    body = [box()]
    assert compounds.free_travel(body, [box(center=(3, 0, 0))], (1, 0, 0)) == pytest.approx(2, abs=1e-8)
    assert compounds.free_travel(body, [box(center=(-3, 0, 0))], (1, 0, 0)) == np.inf
    assert compounds.free_travel(body, [box(center=(0.5, 0, 0))], (1, 0, 0)) == 0


def test_a_horizontal_move_leaves_a_union_not_a_part():
    """Out of two overlapping walls at once: the way out of either alone would end in the other."""
    walls = [box(size=(1, 9, 1)), box(size=(1, 9, 1), center=(0.8, 0, 0))]
    body = [box(size=(0.2, 0.2, 0.2), center=(0.45, 0, 0))]
    move = compounds.smallest_horizontal_move(body, walls)
    assert move == pytest.approx([0.95, 0], abs=1e-8)
    assert np.allclose(compounds.smallest_horizontal_move(body, [box(center=(5, 0, 0))]), 0)


# Touching and nearly coincident bodies


def test_touching_is_no_collision():
    a, b = box(), box(center=(0, 0, 1))
    assert not compounds.collide([a], [b])
    assert not compounds.collide([a], [b.shifted((0, 0, -1e-10))])
    assert compounds.collide([a], [b.shifted((0, 0, -1e-6))])
    assert not compounds.collide([a], [b.shifted((0, 0, -1e-3))], tolerance=2e-3)
    assert compounds.smallest_shift([b], [a], UP) == 0


def test_what_rests_may_slide():
    R = rotation_about([1, 2, 3], 0.7)
    a, b = box().moved(pose(R)), box(center=(0, 0, 1)).moved(pose(R))
    assert compounds.free_travel([b], [a], R @ [1, 0, 0]) == np.inf
    assert compounds.free_travel([b], [a], R @ UP) == np.inf
    assert compounds.free_travel([b], [a], -R @ UP) == pytest.approx(0, abs=1e-8)


def test_identical_boxes():
    a = box().moved(pose(rotation_about([3, 1, 2], 1.1)))
    assert polytopes.overlap_depth(a, a) == pytest.approx(1)
    lo, hi = polytopes.forbidden_interval(a, a, UP)
    assert lo == pytest.approx(-hi)


@pytest.mark.parametrize("angle", [1e-3, 1e-6, 1e-9, 1e-12, 1e-15])
def test_nearly_parallel_boxes(angle):
    """The depth changes no faster than the turn: nearly parallel edges lose or invent no axis."""
    a, b = box(), box(center=(0.1, 0.2, 0.9)).moved(pose(rotation_about([1, 1, 1], angle)))
    assert polytopes.overlap_depth(a, b) == pytest.approx(0.1, abs=2 * angle + 1e-12)


def test_copies_shifted_by_almost_nothing():
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        a = random_hull(rng, 40)
        b = a.moved(pose(rotation_about(random_direction(rng), 1e-7), 1e-8 * rng.normal(size=3)))
        assert polytopes.overlap_depth(a, b) == pytest.approx(minkowski_planes(a, b)[1].min(), rel=1e-6)


@pytest.mark.parametrize("apart", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-11, 1e-13])
def test_corners_that_nearly_coincide_change_no_depth(apart: float):
    """Rounding decides the direction of an edge that short; its facets know it better."""
    doubled = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        a, b = random_hull(rng), random_hull(rng)
        corner = b.vertices[rng.integers(len(b.vertices))]
        twice = Polytope.of(ConvexPart.hull_of(np.vstack([b.vertices, corner + apart * random_direction(rng)])))
        doubled += len(twice.vertices) > len(b.vertices)
        depth, now = (max(0.0, polytopes.overlap_depth(a, c)) for c in (b, twice))
        assert now == pytest.approx(depth, abs=2 * apart + 1e-9)
    assert doubled > 25


# Against independent answers


def test_depth_against_the_minkowski_hull():
    overlaps = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        a, b = random_hull(rng), random_hull(rng)
        _, offsets = minkowski_planes(a, b)
        depth = polytopes.overlap_depth(a, b)
        assert (depth > 0) == (offsets.min() > 0)
        if depth > 0:
            overlaps += 1
            assert depth == pytest.approx(offsets.min(), abs=1e-9)
    assert 20 < overlaps < 58


def test_separation_is_that_of_the_best_facet_and_some_gap_where_less_is_enough():
    rng = np.random.default_rng(8)
    for _ in range(20):
        a, b = random_hull(rng), random_hull(rng).shifted(rng.uniform(-1.5, 1.5, 3))
        best = -polytopes.facets(a, b)[1].min()
        assert polytopes.separation(a, b) == pytest.approx(best)
        for enough in (-0.1, 0.1, 0.5):
            assert min(enough, polytopes.separation(a, b, enough)) == pytest.approx(min(enough, best))


def test_interval_against_linear_programming():
    found = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        a, b, u = random_hull(rng), random_hull(rng), random_direction(rng)
        expected = lp_interval(a, b, u)
        interval = polytopes.forbidden_interval(a, b, u)
        assert (interval[0] < interval[1]) == (expected is not None)
        if expected is not None:
            found += 1
            assert interval == pytest.approx(expected, abs=1e-6)
    assert found > 15


def test_horizontal_move_against_a_sweep_of_directions():
    """No direction has a shorter way out than the exact move, and one comes close to it."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        A, B = random_body(rng), random_body(rng)
        move = compounds.smallest_horizontal_move(A, B)
        length = np.linalg.norm(move)
        if length == 0:
            assert not compounds.collide(A, B)
            continue
        assert not compounds.collide([p.shifted([*move, 0]) for p in A], B)
        angles = np.linspace(0, 2 * np.pi, 180, endpoint=False)
        ways = [compounds.smallest_shift(A, B, (np.cos(w), np.sin(w), 0)) for w in angles]
        toward = compounds.smallest_shift(A, B, (*(move / length), 0))
        assert toward == pytest.approx(length, abs=1e-7)
        assert min(ways) >= length - 1e-7


# Laws


def test_moving_both_bodies_changes_nothing():
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        a, b, u = random_hull(rng), random_hull(rng), random_direction(rng)
        R = rotation_about(random_direction(rng), rng.uniform(0, 3))
        T = pose(R, rng.normal(size=3))
        moved_a, moved_b = a.moved(T), b.moved(T)
        depth = polytopes.overlap_depth(a, b)
        if depth > 0:
            assert polytopes.overlap_depth(moved_a, moved_b) == pytest.approx(depth, abs=1e-9)
        before = polytopes.forbidden_interval(a, b, u)
        after = polytopes.forbidden_interval(moved_a, moved_b, R @ u)
        assert after == pytest.approx(before, abs=1e-7)


def test_a_similarity_carries_facets_along():
    rng = np.random.default_rng(0)
    part = ConvexPart.hull_of(rng.normal(size=(20, 3)))
    T = pose(2.5 * rotation_about([1, 2, 3], 0.8), [1, 2, 3])
    moved, anew = Polytope.of(part).moved(T), Polytope.of(part.moved(T))
    for name in ("vertices", "normals", "offsets", "edge_starts", "edge_directions", "edge_lengths", "edge_normals"):
        assert np.allclose(getattr(moved, name), getattr(anew, name))


def test_swapping_the_bodies_negates_the_interval():
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        a, b, u = random_hull(rng), random_hull(rng), random_direction(rng)
        lo, hi = polytopes.forbidden_interval(b, a, u)
        assert polytopes.forbidden_interval(a, b, u) == pytest.approx((-hi, -lo), abs=1e-9)


def test_the_smallest_shift_is_free_and_smallest():
    moved = 0
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        A, B, u = random_body(rng), random_body(rng), random_direction(rng)
        t = compounds.smallest_shift(A, B, u)
        assert (t > 0) == compounds.collide(A, B)
        assert not compounds.collide([p.shifted((t + 1e-9) * u) for p in A], B)
        if t > 0:
            moved += 1
            assert compounds.collide([p.shifted((t - 1e-6) * u) for p in A], B)
            for s in rng.uniform(0, t - 1e-6, 5):
                assert compounds.collide([p.shifted(s * u) for p in A], B)
    assert moved > 10


def test_free_travel_ends_in_contact():
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        A, B, u = random_body(rng, 2), random_body(rng, 2), random_direction(rng)
        A = [p.shifted(-4 * u) for p in A]
        t = compounds.free_travel(A, B, u)
        if 0 < t < np.inf:
            assert not compounds.collide([p.shifted((t - 1e-9) * u) for p in A], B)
            assert compounds.collide([p.shifted((t + 1e-5) * u) for p in A], B)


def test_an_open_surface_is_refused():
    tetrahedron = ConvexPart.hull_of(np.vstack([np.zeros(3), np.eye(3)]))
    with pytest.raises(ValueError, match="not closed"):
        Polytope.of(ConvexPart(vertices=tetrahedron.vertices, faces=tetrahedron.faces[:3]))


def test_a_sliver_between_two_facets_does_not_make_them_one():
    polytope = Polytope.of(cube_with_a_sliver())
    sides = {tuple(np.round(n).astype(int)): d for n, d in zip(polytope.normals, polytope.offsets, strict=True)}
    low, high = {tuple(-n): 0.0 for n in np.eye(3, dtype=int)}, {tuple(n): 1.0 for n in np.eye(3, dtype=int)}
    assert sides == pytest.approx(low | high)
    assert polytopes.overlap_depth(polytope, box(center=(0.5, 0.5, 1.45))) == pytest.approx(0.05)


@pytest.mark.parametrize(("near", "far"), [(0, 2), (2, 4), (4, 6), (0, 4), (2, 6), (1, 3)])
def test_a_corner_that_is_there_twice_makes_no_edge(near, far):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        polytope = Polytope.of(cube_with_a_double_corner(near, far))
    assert all(np.isfinite(array).all() for array in polytope.packed)
    assert np.linalg.norm(polytope.edge_directions, axis=1) == pytest.approx(1)
    for center in ((0.5, 0.5, 1.45), (1.45, 0.5, 0.5), (1.3, 1.3, 1.3)):
        other = box(center=center).moved(pose(rotation_about([1, 1, 1], 0.3)))
        assert polytopes.overlap_depth(polytope, other) == pytest.approx(
            polytopes.overlap_depth(box(center=(0.5, 0.5, 0.5)), other)
        )


def polygon(rng: np.random.Generator) -> np.ndarray | None:
    """A convex polygon's sides (k, 3) around a random middle; None where they do not close."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 9)))
    if np.diff(np.r_[angles, angles[0] + 2 * np.pi]).max() > 0.95 * np.pi:
        return None
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    heights = rng.uniform(0.3, 1.5) * rng.uniform(0.5, 1, len(angles))
    return np.column_stack([normals, heights - normals @ rng.normal(scale=0.8, size=2)])


@pytest.mark.parametrize("seed", range(40))
def test_no_free_place_is_nearer(seed: int):
    """Not even without slack, where rounding puts crossings of sides into the polygons that they belong to."""
    rng = np.random.default_rng(seed)
    polygons = [p for p in (polygon(rng) for _ in range(12)) if p is not None]
    at = horizontal_moves.nearest_free(polygons, 0.0)

    def depth(x: np.ndarray) -> np.ndarray:
        return np.max([(x @ p[:, :2].T + p[:, 2]).min(-1) for p in polygons], axis=0)

    assert depth(at) < 1e-12 and (at.any() or depth(np.zeros(2)) <= 0)
    angles, radii = np.meshgrid(np.linspace(0, 2 * np.pi, 721), np.linspace(0, 0.9999, 60) * np.linalg.norm(at))
    nearer = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1).reshape(-1, 2)
    step = 2e-3 * np.linalg.norm(at)
    assert not at.any() or depth(nearer).min() > -step, "a grid sees no free place that is wider than its step"


def test_thousands_of_polygons_take_no_minutes():
    rng = np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, 9)[:-1]
    around = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    middles = rng.uniform(-1, 1, (4000, 2))
    polygons = [np.column_stack([around, 0.1 - around @ m]) for m in middles]
    start = time.process_time()
    at = horizontal_moves.nearest_free(polygons, 0.0)
    assert 0.8 < np.abs(at).max() < 1.2 and time.process_time() - start < 5


def compound_of(rng):
    return compounds.Compound.of(random_body(rng, parts=5))


@pytest.mark.parametrize("seed", range(5))
def test_a_compound_moves_as_its_parts_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body, T = compound_of(rng), pose(1.7 * rotation_about(random_direction(rng), 1.0), rng.normal(size=3))
    moved = body.moved(T).moved(pose(t=[0, 0, 0.5]))
    assert len(moved) == len(body) == 5
    for was, now in zip(body, moved, strict=True):
        expected = was.moved(T).shifted([0, 0, 0.5])
        for a, b in zip(expected.packed, now.packed, strict=True):
            assert np.allclose(a, b, atol=1e-12)
    boxes = np.array([p.bounds for p in moved])
    assert np.allclose(moved.boxes, boxes) and np.allclose(moved.bounds, [boxes[:, 0].min(0), boxes[:, 1].max(0)])
    assert moved.lowest == pytest.approx(boxes[:, 0, 2].min())


def test_some_parts_of_compounds_are_compounds() -> None:
    rng = np.random.default_rng(0)
    a, b = compound_of(rng), compound_of(rng)
    both = compounds.Compound.of([a, b])
    assert len(both) == 10 and len(both[7:]) == 3 and len(compounds.Compound.of([])) == 0
    assert np.array_equal(both.some([1, 6])[1].vertices, b[1].vertices)
    assert np.array_equal(both[-1].vertices, b[4].vertices)
    with pytest.raises(IndexError):
        both[10]


@pytest.mark.parametrize("seed", range(5))
def test_near_parts_are_those_without_a_wider_gap_along_a_face(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, reach = compound_of(rng), compound_of(rng), 0.1

    def gap(p: Polytope, q: Polytope) -> float:
        faces = len(p.normals) + len(q.normals)
        return -float(polytopes.facets(p, q)[1][:faces].min())

    expected = {
        (i, j)
        for i, p in enumerate(a)
        for j, q in enumerate(b)
        if ((p.bounds[0] - q.bounds[1] < reach) & (q.bounds[0] - p.bounds[1] < reach)).all() and gap(p, q) <= reach
    }
    assert set(map(tuple, compounds.near_parts(a, b, reach).tolist())) == expected


def test_nothing_is_free_of_everything() -> None:
    nothing, thing = compounds.placed([], np.eye(4)), compound_of(np.random.default_rng(1))
    assert not compounds.collide(thing, nothing)
    assert compounds.smallest_shift(thing, nothing, UP) == 0 and compounds.free_travel(thing, nothing, UP) == np.inf
