"""Convex proxies: they cover the mesh, keep cavities open and flats flat, and survive failing workers."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import replace
from queue import SimpleQueue
from threading import Event

import manifold3d as mf
import numpy as np
import pytest

import forked
from f3sr.contact import compounds
from f3sr.contact.polytopes import Polytope
from f3sr.core.mesh import ConvexPart, Mesh, solid_properties
from f3sr.errors import InputError
from f3sr.proxies import ProxyConfig, decompose, decompose_all, decomposing, joins, worker
from f3sr.proxies.config import CutConfig
from f3sr.proxies.cut_volumes import LAYER, FirstLook, SimplifiedSurface, bulk_of_sides
from f3sr.proxies.cuts import clipped
from f3sr.proxies.fit import excess
from f3sr.proxies.hulls import distinct, hull_of
from f3sr.proxies.parts import SHEET, several, subject_of, thickened
from f3sr.proxies.simplify import simplified_outward
from f3sr.proxies.surface import NearestTriangles, samples_of, surroundings
from f3sr.proxies.unit_frame import TURNS, in_unit_frame
from f3sr.proxies.worker import ProxyWorker
from f3sr.runtime import subprocesses
from f3sr.runtime.machine import ONE_THREAD
from waiting import children, grandchildren, is_running, soon

QUICK = ProxyConfig(tolerance=0.012, max_parts=24, cuts=CutConfig(target_faces=600, samples=2000, surplus=1.5))
GREEDY = ProxyConfig(tolerance=0.0005, max_parts=256, cuts=CutConfig(samples=100_000))
"""With it a bowl takes 20 s."""


def box_mesh(size=(1.0, 1.0, 1.0), center=(0.0, 0.0, 0.0)):
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    part = ConvexPart.hull_of(signs * np.array(size) / 2 + center)
    return Mesh(vertices=part.vertices, faces=part.faces)


def prism_mesh(outline, height=1.0):
    """A solid over a counter-clockwise outline (n, 2) that is star-shaped about its first point."""
    n = len(outline)
    bottom, top = np.column_stack([outline, np.zeros(n)]), np.column_stack([outline, np.full(n, height)])
    fan = [(0, i, i + 1) for i in range(1, n - 1)]
    faces = [(a, c, b) for a, b, c in fan] + [(a + n, b + n, c + n) for a, b, c in fan]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, j + n), (i, j + n, i + n)]
    return Mesh(vertices=np.vstack([bottom, top]), faces=np.array(faces, np.int32))


def revolved(profile, sides=24):
    """A closed surface of revolution about z of a profile (n, 2) of radius and height, from axis to axis."""
    profile = np.asarray(profile, float)
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    rings = [[(r * np.cos(w), r * np.sin(w), z) for w in angles] for r, z in profile[1:-1]]
    vertices = np.array([(0, 0, profile[0, 1]), *(p for ring in rings for p in ring), (0, 0, profile[-1, 1])])
    last, faces = len(vertices) - 1, []
    for i in range(sides):
        j = (i + 1) % sides
        faces.append((0, 1 + j, 1 + i))
        for k in range(len(rings) - 1):
            a, b = 1 + k * sides, 1 + (k + 1) * sides
            faces += [(a + i, a + j, b + j), (a + i, b + j, b + i)]
        top = 1 + (len(rings) - 1) * sides
        faces.append((last, top + i, top + j))
    return Mesh(vertices=vertices, faces=np.array(faces, np.int32))


L_SHAPE = prism_mesh(np.array([(0.3, 0.3), (0.3, 1), (0, 1), (0, 0), (1, 0), (1, 0.3)]), 0.5)
CAN = revolved([(0, 0), (0.4, 0), (0.4, 1), (0, 1)])
WAVE = np.linspace(0, np.pi / 2, 8)
BOWL = revolved(
    [(0, 0), (0.3, 0), *((0.3 + 0.7 * np.sin(w), 0.6 * (1 - np.cos(w))) for w in WAVE[1:])]
    + [((0.3 + 0.7 * np.sin(w)) * 0.93, 0.05 + 0.55 * (1 - np.cos(w))) for w in WAVE[::-1]]
    + [(0, 0.05)]
)


def ball(radius, center):
    rng = np.random.default_rng(0)
    points = rng.normal(size=(60, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    return [Polytope.of(ConvexPart.hull_of(points + center))]


def body(proxy):
    return [Polytope.of(part) for part in proxy.parts]


def distance_outside(proxy, points):
    """Of points (n, 3): how far each lies outside the part that covers it best."""
    beyond = [(points @ p.normals.T - p.offsets).max(1) for p in body(proxy)]
    return np.min(beyond, axis=0)


def turned(rng):
    """A random rotation (3, 3)."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def surface_points(mesh, n=2000):
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=n)]]
    return np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), n), corners)


@pytest.fixture(scope="module")
def cache(shared_folder):
    """One for all processes of a run: nothing is decomposed twice."""
    return shared_folder / "proxies"


@pytest.fixture(scope="module")
def bowl(cache):
    return decompose(BOWL, QUICK, cache_dir=cache)


@pytest.fixture(autouse=True)
def quick_start(monkeypatch):
    """Workers are forks of a process that has imported f3sr, and live on as any worker."""
    monkeypatch.setattr(worker, "started", forked.started)


@pytest.fixture
def no_subprocess(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a subprocess was started")

    monkeypatch.setattr(subprocess, "Popen", refuse)
    monkeypatch.setattr(worker, "started", refuse)


# One hull


def test_a_box_stays_a_box(cache, no_subprocess):
    proxy = decompose(box_mesh((3, 1, 2), (5, 6, 7)), cache_dir=cache)
    (part,) = proxy.parts
    assert (proxy.method, len(part.vertices), len(part.faces)) == ("hull", 8, 12)
    assert part.volume == pytest.approx(6, rel=1e-6)
    assert proxy.inflation == pytest.approx(1, rel=1e-6)
    assert proxy.outside < 1e-9


def test_a_turned_noisy_box_keeps_its_six_flats(cache):
    rng = np.random.default_rng(0)
    x = np.linspace(-0.5, 0.5, 9)
    grid = np.array([(a, b, c) for a in x for b in x for c in x if max(map(abs, (a, b, c))) == 0.5])
    part = ConvexPart.hull_of(grid + 1e-4 * rng.normal(size=grid.shape))
    proxy = decompose(Mesh(vertices=part.vertices, faces=part.faces), cache_dir=cache)
    assert len(proxy.parts[0].vertices) == 8


def test_a_can_stands_on_an_exact_flat(cache, no_subprocess):
    (part,) = decompose(CAN, cache_dir=cache).parts
    assert part.vertices[:, 2].min() == pytest.approx(0, abs=1e-7)
    polytope = Polytope.of(part)
    assert polytope.normals[:, 2].min() == pytest.approx(-1, abs=1e-9)
    assert 20 <= len(polytope.normals) - 2 <= 34


def test_a_simplified_hull_contains_the_exact_one_and_is_thin():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(800, 3)) * [1, 0.6, 0.3]
    points /= 2 * np.linalg.norm(points / [1, 0.6, 0.3], axis=1, keepdims=True)
    exact = ConvexPart.hull_of(points)
    for most in (12, 36):
        part = simplified_outward(points, ProxyConfig(cuts=CutConfig(loose_tolerance=0.2)), most=most)
        polytope = Polytope.of(part)
        assert len(polytope.normals) <= most
        assert (points @ polytope.normals.T - polytope.offsets).max() < 1e-9
        assert part.volume < exact.volume * (1 + 8 / most)


def test_facets_that_meet_at_a_small_angle_make_no_spike():
    """A strip of .28 x .01, arched below, that becomes an edge at its end: one plane below it meets the top at .35."""
    along = np.linspace(0, 0.28, 9)
    points = np.array([(x, y, z) for y in along for x in (0, 0.01) for z in (0, -0.0018 * (1 - (y / 0.28) ** 2))])
    part = simplified_outward(points, ProxyConfig())
    allowed = ProxyConfig().cuts.loose_tolerance
    assert (part.vertices.max(0) <= points.max(0) + allowed).all()
    assert (part.vertices.min(0) >= points.min(0) - allowed).all()
    polytope = Polytope.of(part)
    assert (points @ polytope.normals.T - polytope.offsets).max() < 1e-9


def test_a_sheet_gets_a_thickness(cache):
    sheet = Mesh(
        vertices=np.array([(0, 0, 0), (1, 0, 0), (1, 2, 0), (0, 2, 0.0)]),
        faces=np.array([(0, 1, 2), (0, 2, 3)], np.int32),
    )
    proxy = decompose(sheet, cache_dir=cache)
    assert proxy.method == "hull"
    assert 0 < np.ptp(proxy.parts[0].vertices[:, 2]) < 0.02
    assert proxy.inflation is None


# Several parts


def test_an_l_shape_is_two_boxes_and_stays_open(cache):
    proxy = decompose(L_SHAPE, QUICK, cache_dir=cache)
    assert proxy.method == "cuts"
    assert len(proxy.parts) == 2
    assert distance_outside(proxy, surface_points(L_SHAPE)).max() < 1e-7
    assert proxy.inflation == pytest.approx(1, abs=0.01)
    assert not compounds.collide(ball(0.15, (0.6, 0.6, 0.25)), body(proxy))


def crate(wall=0.05):
    """A box of 1 x .8 x .5 without a lid."""
    outer, inner = mf.Manifold.cube((1, 0.8, 0.5)), mf.Manifold.cube((1 - 2 * wall, 0.8 - 2 * wall, 0.5))
    return mesh_of(outer - inner.translate((wall, wall, wall)))


def mug():
    """A cup of radius .4 and height 1 with walls and floor of .04 and a handle."""
    body = mf.Manifold.cylinder(1, 0.4, 0.4, 48) - mf.Manifold.cylinder(1, 0.36, 0.36, 48).translate((0, 0, 0.04))
    ring = mf.Manifold.revolve(mf.CrossSection.circle(0.04, 12).translate((0.22, 0)), 24).rotate((90, 0, 0))
    handle = ring.translate((0.42, 0, 0.5)) - mf.Manifold.cylinder(2, 0.385, 0.385, 48)
    return mesh_of(body + handle)


def mesh_of(solid):
    mesh = solid.to_mesh()
    return Mesh(vertices=np.asarray(mesh.vert_properties[:, :3], float), faces=np.asarray(mesh.tri_verts, np.int32))


@pytest.fixture(scope="module")
def cup(cache):
    return decompose(mug(), cache_dir=cache)


def lowest_of_a_dropped_ball(proxy, radius, at, height):
    x, y = at
    pole = ball(radius, (x, y, height))
    rest = compounds.free_travel(pole, body(proxy), (0, 0, -1))
    return min(p.vertices[:, 2].min() for p in pole) - rest


def test_a_crate_is_five_boxes_with_an_exact_floor(cache):
    mesh = crate()
    proxy = decompose(mesh, cache_dir=cache)
    assert len(proxy.parts) <= 8
    assert proxy.inflation == pytest.approx(1, abs=0.03)
    assert distance_outside(proxy, surface_points(mesh)).max() < 1e-6 * mesh.diagonal
    for at in ((0.5, 0.4), (0.2, 0.2), (0.8, 0.6)):
        assert lowest_of_a_dropped_ball(proxy, 0.1, at, 1.0) == pytest.approx(0.05, abs=0.005 * mesh.diagonal)


@pytest.mark.slow
def test_a_mug_holds_a_ball_on_its_visual_floor(cup):
    mesh = mug()
    assert cup.method == "cuts" and not cup.decisions
    assert distance_outside(cup, surface_points(mesh)).max() < 1e-6 * mesh.diagonal
    assert lowest_of_a_dropped_ball(cup, 0.15, (0.0, 0.0), 1.5) == pytest.approx(0.04, abs=0.005 * mesh.diagonal)
    for wall in ((1, 0, 0), (0, 1, 0), (-0.6, 0.8, 0)):
        inside = ball(0.1, (0, 0, 0.5))
        reach = max(float((p.vertices @ wall).max()) for p in inside)
        travel = compounds.free_travel(inside, body(cup), wall)
        assert travel + reach == pytest.approx(0.36, abs=0.01 * mesh.diagonal)
    assert not compounds.collide(ball(0.05, (0.5, 0, 0.5)), body(cup)), "a finger fits through the handle"
    assert cup.excess.floor is not None and cup.excess.floor < 0.005


def test_a_bowl_is_covered_and_stays_a_container(bowl):
    assert bowl.method == "cuts"
    assert bowl.outside < 1e-7
    assert distance_outside(bowl, surface_points(BOWL)).max() < 1e-6 * BOWL.diagonal
    assert len(bowl.parts) <= QUICK.max_parts
    for x in (0, 0.2, -0.3):
        assert not compounds.collide(ball(0.1, (x, 0, 0.3)), body(bowl))
    assert compounds.collide(ball(0.1, (0, 0, 0.1)), body(bowl))
    assert lowest_of_a_dropped_ball(bowl, 0.1, (0, 0), 0.5) == pytest.approx(0.05, abs=0.005 * BOWL.diagonal)


def test_all_parts_of_a_bowl_end_in_its_base(bowl):
    lowest = np.array([part.vertices[:, 2].min() for part in bowl.parts])
    assert lowest.min() == pytest.approx(0, abs=1e-6)
    touching = [p for p in body(bowl) if p.bounds[0, 2] < 1e-6]
    flat = np.concatenate([p.vertices[p.vertices[:, 2] < 1e-6] for p in touching])
    assert np.ptp(flat[:, 0]) > 0.5 and np.ptp(flat[:, 1]) > 0.5
    assert np.all((lowest < 1e-6) | (lowest > 0.005)), "no part ends a little above the base"


def test_a_closed_void_is_no_cavity(cache):
    """What nothing can get into is not kept open."""
    hollow = mesh_of(mf.Manifold.cube((1, 1, 1)) - mf.Manifold.cube((0.8, 0.8, 0.8)).translate((0.1, 0.1, 0.1)))
    proxy = decompose(hollow, QUICK, cache_dir=cache)
    assert len(proxy.parts) == 1
    assert any(d.choice == "parts larger than the mesh are kept" for d in proxy.decisions), "1.4 times its volume"


def test_single_layers_of_triangles_get_a_thickness(cache):
    """A box without a lid whose walls are sheets: no piece of it has a volume."""
    x = np.array([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)], float)
    quads = [(0, 2, 6, 4), (0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    mesh = Mesh(vertices=x, faces=faces)
    proxy = decompose(mesh, QUICK, cache_dir=cache)
    assert proxy.method == "cuts"
    assert distance_outside(proxy, surface_points(mesh)).max() < 1e-6
    assert not compounds.collide(ball(0.3, (0.5, 0.5, 0.5)), body(proxy))


# The pieces of it


@pytest.mark.parametrize("extent", [(0.3, 0.2, 0), (1e-4, 3e-5, 0), (1e-4, 0, 0), (0, 0, 0)])
def test_scraps_of_surface_get_a_hull_of_a_sheets_thickness(extent):
    """A cut may leave one triangle, of any size, on its side."""
    R = turned(np.random.default_rng(1))
    points = np.array([(0, 0, 0), (1, 0, 0), (0.2, 1, 0)]) * extent @ R.T + (0.1, 0.2, 0.3)
    hull = hull_of(thickened(points))
    assert hull is not None
    width = np.ptp(hull.corners @ R, axis=0)
    assert (width >= 0.9 * SHEET).all() and (width <= np.maximum(extent, 0) + 2 * SHEET).all()


def test_clipped_triangles_keep_their_area_and_their_side():
    rng = np.random.default_rng(0)
    triangles = rng.normal(size=(500, 3, 3))
    u = np.array([0.6, 0, 0.8])
    below, above = clipped(triangles, u, 0.1, 0.0)
    assert (below @ u).max() <= 0.1 + 1e-12 and (above @ u).min() >= 0.1 - 1e-12
    assert area(below) + area(above) == pytest.approx(area(triangles))
    reaching = clipped(triangles, u, 0.1, 0.05)
    assert area(reaching[0]) + area(reaching[1]) > area(triangles)


def area(triangles):
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def box_bulk(size):
    a, b, c = size
    return a * b * c + LAYER * 2 * (a * b + b * c + c * a)


def test_a_first_look_at_a_box_is_exact(seeds=20):
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        size, R = rng.uniform(0.02, 0.5, 3), turned(rng)
        box = box_mesh(size)
        look = FirstLook.at(SimplifiedSurface.of((box.vertices @ R.T)[box.faces]), np.zeros((0, 3)), 0.0)
        shares = np.array([0.2, 0.5, 0.9])
        for k in range(3):
            sides = [[np.where(np.arange(3) == k, s, 1) * size for s in (x, 1 - x)] for x in shares]
            wanted = [sum(map(box_bulk, pair)) for pair in sides]
            assert look.bulks(R[:, k], (shares - 0.5) * size[k]) == pytest.approx(wanted, rel=1e-9)
        assert look.whole == pytest.approx(box_bulk(size), rel=1e-9)


def test_a_first_look_comes_near_the_hulls_from_below(seeds=20):
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        stretch = np.diag(rng.uniform(0.05, 0.5, 3)) @ turned(rng)
        body = revolved([(0, -1), *rng.uniform((0.3, -0.9), (1, 0.9), (6, 2)), (0, 1)], sides=16)
        core = rng.uniform(-0.2, 0.2, (50, 3)) @ stretch
        outline = SimplifiedSurface.of((body.vertices @ stretch)[body.faces])
        u = turned(rng)[0]
        offsets = np.quantile(outline.corners @ u, (0.2, 0.4, 0.7))
        exact = np.array([bulk_of_sides(outline, core, u, o, 0.02) for o in offsets])
        found = FirstLook.at(outline, core, 0.02).bulks(u, offsets)
        assert (found <= exact * (1 + 1e-9)).all() and (found > 0.9 * exact).all()


def test_a_first_look_at_a_single_point_sees_no_volume():
    look = FirstLook.at(SimplifiedSurface.of(np.full((2, 3, 3), 0.1)), np.zeros((0, 3)), 0.0)
    assert look.whole == 0


def test_points_without_repetitions_are_all_points():
    rng = np.random.default_rng(0)
    points = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], float)
    given = points[rng.integers(len(points), size=500)]
    found, where = distinct(given)
    assert np.array_equal(found[where], given)
    assert len(found) == len(np.unique(given, axis=0))


def test_what_is_looked_at_late_changes_no_join(monkeypatch):
    bowl = in_unit_frame(BOWL)[:2]
    late = several(*bowl, QUICK)
    monkeypatch.setattr(joins, "FEW", 1)
    early = several(*bowl, QUICK)
    assert late.joins == early.joins and len(late.joins) == len(late.parts) - 1
    assert all(np.array_equal(p.vertices, q.vertices) for p, q in zip(late.parts, early.parts, strict=True))


def test_open_space_ends_at_walls_and_narrow_slots():
    vertices, faces, _ = in_unit_frame(crate())
    around = surroundings(vertices, faces)
    up = np.array([[0, 0, 1.0]])
    floor = np.array([[0.0, 0.0, vertices[:, 2].min() + 0.05 / crate().diagonal]])
    assert around.is_reached(floor, up, 0.03).all()
    assert not around.is_reached(floor, -up, 0.03).any(), "the floor itself is solid"
    assert not len(around.core), "walls this thin have no core"


def test_the_excess_is_what_a_lid_stands_off():
    mesh = crate()
    vertices, faces, _ = in_unit_frame(mesh)
    around = surroundings(vertices, faces)
    hull = ConvexPart.hull_of(vertices)
    found = excess([hull], NearestTriangles.on(vertices, faces), around, 0.03)
    # The lid's middle is .35 from the two long walls and .45 from the floor.
    assert found.largest == pytest.approx(0.35 / mesh.diagonal, rel=0.05)
    assert found.at[2] == pytest.approx(vertices[:, 2].max())
    assert 0 < found.mean < found.most <= found.largest


def test_distances_to_a_surface_are_exact():
    cube = box_mesh()
    nearest = NearestTriangles.on(cube.vertices, cube.faces)
    points = np.array([(0, 0, 0.75), (1, 1, 0), (1, 1, 1), (0.5, 0.1, 0.2), (0, 0, 0.4)])
    assert nearest.distance(points) == pytest.approx([0.25, np.sqrt(0.5), np.sqrt(0.75), 0, 0.1])


def test_only_what_faces_the_opening_is_a_floor():
    vertices, faces, T = in_unit_frame(mug())
    subject = subject_of(vertices, faces, ConvexPart.hull_of(vertices), ProxyConfig())
    heavy = subject.samples.weight > 2
    up = T[2, :3] / np.linalg.norm(T[2, :3])
    assert heavy.any() and (subject.samples.normals[heavy] @ up > 0.8).all()
    bar = box_mesh((1, 0.2, 0.2))
    vertices, faces, _ = in_unit_frame(bar)
    plain = subject_of(vertices, faces, ConvexPart.hull_of(vertices), ProxyConfig())
    assert (plain.samples.weight == 1).all()


def test_samples_are_spread_by_area():
    cube = box_mesh((1, 2, 3))
    found = samples_of(cube.vertices[cube.faces], 6000)
    share = (np.abs(found.normals[:, 0]) > 0.5).mean()
    assert share == pytest.approx(12 / 22, abs=0.001)
    assert (np.abs(np.abs(found.points) - [0.5, 1, 1.5]).min(1) < 1e-12).all()


# The same again


def test_unit_and_place_do_not_matter(cache, bowl, no_subprocess):
    """The same asset in millimetres and elsewhere is the same cache entry."""
    moved = BOWL.with_vertices(1000 * BOWL.vertices + [300.0, -20, 7])
    proxy = decompose(moved, QUICK, cache_dir=cache)
    assert np.allclose(proxy.excess.at, 1000 * np.array(bowl.excess.at) + [300, -20, 7], atol=1e-4)
    for part, same in zip(proxy.parts, bowl.parts, strict=True):
        assert np.allclose(part.vertices, 1000 * same.vertices + [300, -20, 7], atol=1e-4)


def lopsided():
    """A box of 1 x .8 x .5 with a pit that is nowhere in its middle: no turn maps it onto itself."""
    return mesh_of(mf.Manifold.cube((1, 0.8, 0.5)) - mf.Manifold.cube((0.7, 0.4, 0.5)).translate((0.05, 0.3, 0.1)))


@pytest.fixture(scope="module")
def pit(cache):
    return decompose(lopsided(), QUICK, cache_dir=cache)


def test_axes_and_order_of_a_file_do_not_matter(cache, pit, no_subprocess):
    """The same asset, its axes permuted and turned round, vertices and triangles in another order, is the same cache
    entry: its parts lie where they did."""
    mesh, rng = lopsided(), np.random.default_rng(0)
    assert pit.method == "cuts" and len(pit.parts) > 2
    for A in TURNS:
        order = rng.permutation(len(mesh.vertices))
        faces = np.argsort(order)[rng.permutation(mesh.faces)]
        stored = Mesh(vertices=(mesh.vertices @ A.T)[order], faces=np.roll(faces, rng.integers(3), axis=1))
        proxy = decompose(stored, QUICK, cache_dir=cache)
        assert np.allclose(np.array(proxy.excess.at) @ A, pit.excess.at, atol=1e-12)
        assert np.allclose(A.T @ proxy.solid.inertia @ A, pit.solid.inertia, atol=1e-12)
        for part, same in zip(proxy.parts, pit.parts, strict=True):
            assert np.allclose(part.vertices @ A, same.vertices, atol=1e-12)


def test_the_same_bytes_twice(tmp_path):
    first, second = (decompose(crate(), QUICK, cache_dir=tmp_path / name) for name in "ab")
    assert len(first.parts) == len(second.parts) >= 5
    assert (first.inflation, first.outside, first.excess) == (second.inflation, second.outside, second.excess)
    for a, b in zip(first.parts, second.parts, strict=True):
        assert a.vertices.tobytes() == b.vertices.tobytes()
        assert a.faces.tobytes() == b.faces.tobytes()


# Failures and the cache


def test_a_worker_over_its_limit_falls_back_and_is_not_cached(tmp_path):
    proxy = decompose(BOWL, replace(GREEDY, cpu_limit_s=1), cache_dir=tmp_path, about=3)
    assert proxy.cut_short
    assert proxy.method == "hull-fallback"
    assert proxy.decisions[0].fallback
    assert "processor time" in proxy.decisions[0].reason
    assert {d.about for d in proxy.decisions} == {3}
    assert not list(tmp_path.iterdir())


def test_a_worker_over_its_wall_limit_is_killed(tmp_path):
    proxy = decompose(BOWL, replace(QUICK, wall_limit_s=0.05), cache_dir=tmp_path)
    assert proxy.cut_short
    assert "killed after 0.05 s" in proxy.decisions[0].reason


def split(worker, mesh):
    return worker.split(*in_unit_frame(mesh)[:2])


def same_parts(one, other):
    return all(a.vertices.tobytes() == b.vertices.tobytes() for a, b in zip(one.parts, other.parts, strict=True))


@pytest.fixture
def at_work():
    """A worker that has split a mesh, with its answer."""
    with ProxyWorker(QUICK) as worker:
        yield worker, split(worker, L_SHAPE)


def test_a_mesh_over_its_limit_takes_nothing_from_the_others():
    with ProxyWorker(replace(GREEDY, cpu_limit_s=1)) as worker:
        before, over, after = (split(worker, mesh) for mesh in (L_SHAPE, BOWL, L_SHAPE))
    assert over.cut_short and "1 s of processor time" in over.reason
    assert before.fitted and after.fitted and same_parts(before.fitted, after.fitted)


def test_a_worker_answers_alike_in_any_order():
    meshes = [L_SHAPE, crate()]
    with ProxyWorker(QUICK) as one, ProxyWorker(QUICK) as other:
        forth = [split(one, mesh).fitted for mesh in meshes]
        back = [split(other, mesh).fitted for mesh in reversed(meshes)]
    for a, b in zip(forth, reversed(back), strict=True):
        assert same_parts(a, b) and (a.excess, a.joins) == (b.excess, b.joins)


def test_a_failure_ends_the_process_of_its_mesh_alone(at_work):
    worker, first = at_work
    process = worker.running.process
    bad = worker.split(np.full((4, 3), np.nan), np.array([[0, 1, 2]], np.int32))
    assert bad.reason.startswith("failed: ") and not bad.cut_short
    assert same_parts(split(worker, L_SHAPE).fitted, first.fitted)
    assert worker.running.process is process and process.poll() is None


def test_a_worker_that_is_gone_is_replaced(at_work):
    worker, first = at_work
    worker.running.process.kill()
    while not (answer := split(worker, L_SHAPE)).fitted:
        assert answer.cut_short
    assert same_parts(answer.fitted, first.fitted)


def test_a_worker_that_cannot_start_says_why(monkeypatch):
    monkeypatch.setattr(worker, "config_json", lambda _: "no JSON")
    with ProxyWorker(QUICK) as broken:
        answer = split(broken, L_SHAPE)
    assert answer.reason.startswith("failed: ") and not answer.cut_short


def test_a_worker_that_is_called_off_is_killed_at_once_with_its_work():
    cancelled = Event()
    with ThreadPoolExecutor() as pool:

        def wait():
            with ProxyWorker(GREEDY, cancelled) as worker:
                started.put(worker)
                split(worker, BOWL)

        started = SimpleQueue()
        waiting = pool.submit(wait)
        process = started.get()
        while process.running is None or not children(process.running.process.pid):
            time.sleep(0.01)
        ours = [process.running.process.pid, *children(process.running.process.pid)]
        cancelled.set()
        began = time.monotonic()
        with pytest.raises(CancelledError):
            waiting.result()
    assert soon(lambda: not any(map(is_running, ours)))
    assert len(ours) == 2 and time.monotonic() - began < 2


def test_what_is_made_beside_a_block_ends_with_it():
    with decomposing([BOWL, BOWL], GREEDY) as made:
        while not (ours := grandchildren(os.getpid())):
            time.sleep(0.01)
    began = time.monotonic()
    with pytest.raises(CancelledError):
        made()
    assert soon(lambda: not any(map(is_running, ours)))
    assert time.monotonic() - began < 2


def test_what_fails_beside_a_block_is_raised_where_the_result_is_asked_for(no_subprocess):
    empty = Mesh(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int32))
    with decomposing([empty], QUICK) as made, pytest.raises(InputError, match="mesh of object 0"):
        made()


def test_workers_fork_with_everything_imported_and_before_any_thread():
    code = """
import os, sys
from test_proxies import L_SHAPE, QUICK, in_unit_frame, several, worker
mesh = in_unit_frame(L_SHAPE)[:2]
before = set(sys.modules)
worker.load()
assert len(os.listdir("/proc/self/task")) == 1
loaded = set(sys.modules)
worker.packed(several(*mesh, QUICK))
assert set(sys.modules) == loaded, set(sys.modules) - loaded
"""
    environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


def pile(count, size):
    """Tetrahedra here and there in the unit cube."""
    rng = np.random.default_rng(0)
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1.0)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.int32)
    vertices = [corners * size + rng.uniform(0, 1 - size, 3) for _ in range(count)]
    return Mesh(vertices=np.concatenate(vertices), faces=np.concatenate([faces + 4 * k for k in range(count)]))


def test_a_pile_of_pieces_is_covered_in_bounded_time(tmp_path):
    mesh = pile(40, 0.3)
    proxy = decompose(mesh, QUICK, cache_dir=tmp_path)
    assert proxy.method == "cuts" and proxy.outside < 1e-7 and len(proxy.parts) <= QUICK.max_parts
    assert list(tmp_path.iterdir()), "nothing was cut short, so it is kept"


def test_scattered_triangles_are_covered(tmp_path):
    rng = np.random.default_rng(0)
    vertices = rng.uniform(size=(100, 3))
    faces = np.array([rng.choice(100, 3, replace=False) for _ in range(60)], np.int32)
    mesh = Mesh(vertices=vertices, faces=faces)
    proxy = decompose(mesh, QUICK, cache_dir=tmp_path)
    assert proxy.method in ("hull", "cuts")
    assert distance_outside(proxy, surface_points(mesh)).max() < 1e-6 * mesh.diagonal


@pytest.mark.parametrize(
    ("code", "words"),
    [(1, "MemoryError\n"), (1, "numpy._ArrayMemoryError: 9 GiB\n"), (-6, "what():  std::bad_alloc\n")],
)
def test_what_a_lack_of_memory_left_is_not_kept(code, words, tmp_path, monkeypatch):
    """Another run may have it."""
    monkeypatch.setattr(ProxyWorker, "split", lambda *_: worker.explained(code, words, QUICK))
    proxy = decompose(L_SHAPE, QUICK, cache_dir=tmp_path)
    assert proxy.cut_short and "out of memory" in proxy.decisions[0].reason
    assert not list(tmp_path.iterdir())


def test_a_crash_leaves_one_hull_and_says_so(tmp_path, monkeypatch):
    def crash(*_):
        return worker.explained(-6, "", QUICK)

    monkeypatch.setattr(ProxyWorker, "split", crash)
    proxy = decompose(L_SHAPE, QUICK, cache_dir=tmp_path)
    assert proxy.method == "hull-fallback" and len(proxy.parts) == 1
    assert not proxy.cut_short
    assert proxy.decisions[0].fallback and "crashed with SIGABRT" in proxy.decisions[0].reason
    assert distance_outside(proxy, surface_points(L_SHAPE)).max() < 1e-7


def test_a_large_mesh_reaches_the_worker_and_its_answer_us(tmp_path, monkeypatch):
    """More than a pipe holds, to a worker that starts as a new interpreter does: slowly."""
    monkeypatch.setattr(worker, "started", subprocesses.started)
    vertices, faces = L_SHAPE.vertices, L_SHAPE.faces
    for _ in range(5):
        from trimesh.remesh import subdivide

        vertices, faces = subdivide(vertices, faces)
    mesh = Mesh(vertices=vertices, faces=faces.astype(np.int32))
    assert mesh.vertices.nbytes > 200_000
    assert decompose(mesh, replace(QUICK, wall_limit_s=60), cache_dir=tmp_path).method == "cuts"


def test_a_cache_hit_starts_nothing(cache, bowl, no_subprocess):
    again, box = decompose_all([BOWL, box_mesh()], QUICK, cache_dir=cache, ids=[4, 7])
    assert again.method == bowl.method
    assert again.inflation == bowl.inflation
    assert all(a.vertices.tobytes() == b.vertices.tobytes() for a, b in zip(again.parts, bowl.parts, strict=True))
    assert [d.about for d in box.decisions] == [7]


def test_a_damaged_cache_entry_is_written_anew(tmp_path):
    mesh = box_mesh()
    decompose(mesh, cache_dir=tmp_path)
    (entry,) = tmp_path.iterdir()
    good = entry.read_bytes()
    for bad in (b"", b"not a zip", good[: len(good) // 2]):
        entry.write_bytes(bad)
        assert len(decompose(mesh, cache_dir=tmp_path).parts[0].vertices) == 8
        assert entry.read_bytes() == good
    assert list(tmp_path.iterdir()) == [entry]


@pytest.mark.parametrize(
    ("vertices", "faces", "found"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), "0 faces"),
        (np.eye(3), np.zeros((0, 3)), "0 faces"),
        (
            np.array([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]]),
            np.array([[0, 1, 2]]),
            "1 vertices that are not finite",
        ),
        (np.ones((3, 3)), np.array([[0, 1, 2]]), "one point"),
    ],
)
def test_what_has_no_surface_is_refused_first(tmp_path, no_subprocess, vertices, faces, found):
    mesh = Mesh(vertices=vertices, faces=faces.astype(np.int32))
    with pytest.raises(InputError, match=found):
        decompose_all([box_mesh(), mesh], cache_dir=tmp_path)


def test_the_mass_of_an_open_mesh_comes_with_its_proxies() -> None:
    """In the mesh's frame and unit."""
    block = mesh_of(mf.Manifold.cube((3, 2, 1)).translate((5, 0, 0)))
    open_block = replace(block, faces=block.faces[1:])
    proxy = decompose(open_block)
    known, from_mesh = solid_properties(open_block, proxy.parts)
    assert not from_mesh and 0 < known.volume < 6.1
    assert proxy.solid.volume == pytest.approx(known.volume, rel=1e-5)
    assert proxy.solid.center == pytest.approx(known.center, abs=1e-4)
    assert proxy.solid.inertia == pytest.approx(known.inertia, rel=1e-4, abs=1e-4)
