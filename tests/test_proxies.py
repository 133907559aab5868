"""Convex proxies: they cover the mesh, keep cavities open and flats flat, and survive failing workers."""

from __future__ import annotations

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from f3sr import contact, proxies
from f3sr.contact import Polytope
from f3sr.errors import InputError
from f3sr.mesh import ConvexPart, Mesh
from f3sr.proxies import ProxyConfig, decompose, decompose_all

QUICK = ProxyConfig(target_faces=600, threshold=0.1, shell_threshold=0.1, shell_parts=24)


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


def surface_points(mesh, n=2000):
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces[rng.integers(len(mesh.faces), size=n)]]
    return np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), n), corners)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("proxies")


@pytest.fixture(scope="module")
def bowl(cache):
    return decompose(BOWL, QUICK, cache_dir=cache)


@pytest.fixture
def no_subprocess(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a subprocess was started")

    monkeypatch.setattr(subprocess, "Popen", refuse)


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
        part = proxies.simplified_outward(points, ProxyConfig(max_hull_faces=most))
        polytope = Polytope.of(part)
        assert len(polytope.normals) <= most
        assert (points @ polytope.normals.T - polytope.offsets).max() < 1e-9
        assert part.volume < exact.volume * (1 + 8 / most)


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


def test_an_l_shape_is_covered_and_stays_open(cache):
    proxy = decompose(L_SHAPE, QUICK, cache_dir=cache)
    assert proxy.method == "coacd"
    assert len(proxy.parts) >= 2
    assert distance_outside(proxy, surface_points(L_SHAPE)).max() < 1e-7
    assert proxy.inflation == pytest.approx(1, abs=0.05)
    assert not contact.collide(ball(0.15, (0.6, 0.6, 0.25)), body(proxy))


def test_a_bowl_is_covered_and_stays_a_container(bowl):
    assert bowl.method == "coacd"
    assert bowl.outside < 1e-7
    assert distance_outside(bowl, surface_points(BOWL)).max() < 1e-7
    assert len(bowl.parts) <= QUICK.shell_parts
    for x in (0, 0.2, -0.3):
        assert not contact.collide(ball(0.1, (x, 0, 0.3)), body(bowl))
    assert contact.collide(ball(0.1, (0, 0, 0.1)), body(bowl))
    dropped = contact.free_travel(ball(0.1, (0, 0, 0.5)), body(bowl), (0, 0, -1))
    assert dropped == pytest.approx(0.3, abs=0.06)


def test_all_parts_of_a_bowl_end_in_its_base(bowl):
    lowest = np.array([part.vertices[:, 2].min() for part in bowl.parts])
    assert lowest.min() == pytest.approx(0, abs=1e-6)
    touching = [p for p in body(bowl) if p.bounds[0, 2] < 1e-6]
    assert max(np.ptp(p.vertices[p.vertices[:, 2] < 1e-6][:, 0]) for p in touching) > 0.2


def test_pieces_grow_to_cover_and_no_sliver_bridges_them():
    """Two pieces that lie inside the two ends of a long bar: each grows to its end, both to the middle."""
    bar = box_mesh((1, 0.1, 0.1))
    ends = [box_mesh((0.44, 0.08, 0.08), (x, 0, 0)).vertices for x in (-0.25, 0.25)]
    grown = proxies.covering(ends, bar.vertices, bar.faces, ProxyConfig())
    left, right = (ConvexPart.hull_of(points) for points in grown)
    assert left.vertices[:, 0].max() == pytest.approx(0, abs=0.05)
    assert right.vertices[:, 0].min() == pytest.approx(0, abs=0.05)
    outside = [(surface_points(bar) @ p.normals.T - p.offsets).max(1) for p in map(Polytope.of, (left, right))]
    assert np.min(outside, axis=0).max() < 1e-12


def test_unit_and_place_do_not_matter(cache, bowl, no_subprocess):
    """The same asset in millimetres and elsewhere is the same cache entry."""
    moved = BOWL.with_vertices(1000 * BOWL.vertices + [300.0, -20, 7])
    proxy = decompose(moved, QUICK, cache_dir=cache)
    for part, same in zip(proxy.parts, bowl.parts, strict=True):
        assert np.allclose(part.vertices, 1000 * same.vertices + [300, -20, 7], atol=1e-4)


def test_the_same_bytes_twice(tmp_path):
    first, second = (decompose(L_SHAPE, QUICK, cache_dir=tmp_path / name) for name in "ab")
    for a, b in zip(first.parts, second.parts, strict=True):
        assert a.vertices.tobytes() == b.vertices.tobytes()
        assert a.faces.tobytes() == b.faces.tobytes()


# Failures and the cache


def test_a_worker_over_its_limit_falls_back_and_is_not_cached(tmp_path):
    greedy = replace(QUICK, cpu_limit_s=1, mcts_iterations=2000, target_faces=4000, resolution=10_000)
    greedy = replace(greedy, vhacd_voxels=20_000_000)
    proxy = decompose(BOWL, greedy, cache_dir=tmp_path, about=3)
    assert proxy.cut_short
    assert proxy.method == "hull-fallback"
    assert [d.fallback for d in proxy.decisions] == [True, True, True]
    assert "processor time" in proxy.decisions[0].reason
    assert {d.about for d in proxy.decisions} == {3}
    assert not list(tmp_path.iterdir())


def test_a_worker_over_its_wall_limit_is_killed(tmp_path):
    proxy = decompose(BOWL, replace(QUICK, wall_limit_s=0.05), cache_dir=tmp_path)
    assert proxy.cut_short
    assert "killed after 0.05 s" in proxy.decisions[0].reason


def pile(count, size):
    """Tetrahedra here and there in the unit cube."""
    rng = np.random.default_rng(0)
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1.0)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.int32)
    vertices = [corners * size + rng.uniform(0, 1 - size, 3) for _ in range(count)]
    return Mesh(vertices=np.concatenate(vertices), faces=np.concatenate([faces + 4 * k for k in range(count)]))


def test_a_pile_of_pieces_is_not_given_to_coacd(tmp_path, monkeypatch):
    tried = []
    run = proxies._run_worker

    def note(method, *rest):
        tried.append(method)
        return run(method, *rest)

    monkeypatch.setattr(proxies, "_run_worker", note)
    proxy = decompose(pile(40, 0.3), replace(QUICK, vhacd_voxels=20_000), cache_dir=tmp_path)
    assert tried == ["vhacd"] and proxy.method == "vhacd" and proxy.outside < 1e-7
    assert [(d.fallback, d.reason) for d in proxy.decisions] == [(True, "as scattered as 40 loose pieces")]
    assert list(tmp_path.iterdir()), "the choice is the same in every run, so it is kept"


def test_crumbs_do_not_make_a_body_a_pile():
    crumbs = pile(100, 0.005)
    vertices = np.concatenate([BOWL.vertices, crumbs.vertices])
    faces = np.concatenate([BOWL.faces, crumbs.faces + len(BOWL.vertices)])
    assert proxies._is_no_body(vertices, faces, QUICK) is None


def test_a_dozen_scattered_triangles_are_no_body():
    """CoACD is lost for two minutes in as few as these."""
    rng = np.random.default_rng(0)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array([rng.choice(8, 3, replace=False) + 8 * k for k in range(12)], np.int32)
    vertices = np.tile(corners, (12, 1)) + rng.normal(0, 1e-3, (96, 3))
    assert proxies._is_no_body(vertices, faces, QUICK)


def test_triangles_that_share_corners_but_no_edges_are_no_body():
    rng = np.random.default_rng(0)
    vertices = rng.uniform(size=(100, 3))
    faces = np.array([rng.choice(100, 3, replace=False) for _ in range(300)], np.int32)
    assert "not shared by two" in (proxies._is_no_body(vertices, faces, QUICK) or "")
    assert proxies._is_no_body(CAN.vertices, CAN.faces, QUICK) is None


def test_a_crash_of_coacd_falls_back_to_vhacd(tmp_path, monkeypatch):
    run = proxies._run_worker

    def crash_first(method, *rest):
        if method == "coacd":
            return proxies._explain(-6, "", rest[2])
        return run(method, *rest)

    monkeypatch.setattr(proxies, "_run_worker", crash_first)
    proxy = decompose(L_SHAPE, replace(QUICK, vhacd_voxels=20_000), cache_dir=tmp_path)
    assert proxy.method == "vhacd"
    assert not proxy.cut_short
    assert [(d.fallback, d.reason) for d in proxy.decisions] == [(True, "crashed with SIGABRT")]
    assert distance_outside(proxy, surface_points(L_SHAPE)).max() < 1e-7


def test_a_large_mesh_reaches_the_worker_and_its_answer_us(tmp_path):
    """More than a pipe holds, to a worker that starts slowly."""
    vertices, faces = L_SHAPE.vertices, L_SHAPE.faces
    for _ in range(5):
        from trimesh.remesh import subdivide

        vertices, faces = subdivide(vertices, faces)
    mesh = Mesh(vertices=vertices, faces=faces.astype(np.int32))
    assert mesh.vertices.nbytes > 200_000
    assert decompose(mesh, replace(QUICK, wall_limit_s=60), cache_dir=tmp_path).method == "coacd"


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


def test_a_crumpled_mesh_of_few_triangles_is_known_beforehand() -> None:
    from f3sr.proxies import _crossed_share, _is_no_body
    from scenes import box_mesh

    vertices, faces = box_mesh().welded
    assert _crossed_share(vertices, faces) == 0 and _is_no_body(vertices, faces, ProxyConfig()) is None
    shuffled = np.random.default_rng(1).normal(0, 0.05, vertices.shape)
    assert _crossed_share(shuffled, faces) > 0.3
    assert "pierced" in (_is_no_body(shuffled, faces, ProxyConfig()) or "")
