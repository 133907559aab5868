"""Laws of the silhouette integrals: values, derivatives against central differences, and a search that arrives."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt

from f3sr.core.camera import Camera
from f3sr.core.levenberg_marquardt import Local, minimise
from f3sr.core.transforms import Array, pose, rotation_from_vector, transform
from f3sr.vision import rasterizer, silhouette_integrals
from f3sr.vision.motion_params import CameraFreedom, ObjectFreedom

R = rotation_from_vector([0.5, 0.3, 0.2])
RING = trimesh.creation.torus(0.3, 0.1, major_sections=48, minor_sections=24)
BOX = trimesh.creation.box((0.5, 0.3, 0.4))
MESHES = {
    "ring": (np.asarray(RING.vertices)[:, [0, 2, 1]] @ R.T + [0, 0, 0.1], np.asarray(RING.faces, np.int32)),
    "box": (np.asarray(BOX.vertices) @ R.T, np.asarray(BOX.faces, np.int32)),
}


def camera(pixels: int) -> Camera:
    """1.5 m away, a little off the middle."""
    K = np.array([[1.1 * pixels, 0, 0.5 * pixels], [0, 1.1 * pixels, 0.48 * pixels], [0, 0, 1]])
    forward = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return Camera(width=pixels, height=pixels, K=K, T_world_camera=pose(forward, [0.03, -1.5, 0.02]))


def fields(mask: np.ndarray) -> silhouette_integrals.Fields:
    """Those of the report's loss against a mask."""
    outside, inside = distance_transform_edt(~mask), distance_transform_edt(mask)
    leak = 1 / max(mask.shape)
    return silhouette_integrals.Fields(
        valid=np.ones(mask.shape, np.float32),
        mismatch=(1 - 2.0 * mask + leak * outside).astype(np.float32),
        stiffness=(1 / np.maximum(outside + inside, 1) + leak * ~mask).astype(np.float32),
    )


class Problem:
    """One mesh, moved, against the mask of the mesh where it is."""

    def __init__(self, name: str, pixels: int) -> None:
        self.vertices, self.faces = MESHES[name]
        self.camera, self.edges = camera(pixels), silhouette_integrals.unique_edges(self.faces)
        self.freedom = ObjectFreedom(
            anchor=self.vertices.mean(0),
            basis=self.camera.T_world_camera[:3, :2],
            reach=np.array([0.3, 0.3, 0.6, 0.3, 0.3, 0.3]),
        )
        self.mask = self.silhouette(np.zeros(6))
        self.fields = fields(self.mask)

    def points(self, u: Array) -> Array:
        T, s = self.freedom.similarity(u)
        return self.camera.to_camera(transform(T, s * self.vertices))

    def silhouette(self, u: Array) -> np.ndarray:
        c = self.camera
        return rasterizer.silhouette(self.points(u), self.faces, c.K, c.width, c.height)

    def integrals(self, u: Array) -> silhouette_integrals.Integrals:
        velocities = self.freedom.velocities(u, self.camera)
        return silhouette_integrals.integrate(
            self.points(u), self.edges, self.silhouette(u), self.camera.K, self.fields, velocities, near=rasterizer.NEAR
        )

    def objective(self, u: Array) -> Local:
        found = self.integrals(u)
        area = np.count_nonzero(self.mask)
        return Local(
            value=1 + found.value[silhouette_integrals.MISMATCH] / area,
            gradient=found.gradient[silhouette_integrals.MISMATCH] / area,
            curvature=found.curvature / area,
        )


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize(("pixels", "tolerance"), [(256, 0.04), (512, 0.015), (1024, 0.01)])
def test_gradients_are_those_of_central_differences(name: str, pixels: int, tolerance: float) -> None:
    problem = Problem(name, pixels)
    u, h = np.array([0.2, -0.1, 0.3, 0.1, -0.2, 0.15]), 6 / pixels
    values = [[problem.integrals(u + sign * h * e).value for sign in (1, -1)] for e in np.eye(6)]
    expected = np.array([(a - b) / (2 * h) for a, b in values]).T
    found = problem.integrals(u).gradient
    for k in range(5):
        assert np.linalg.norm(found[k] - expected[k]) < tolerance * np.linalg.norm(expected[k]), k


def test_areas_are_right_to_a_fraction_of_a_pixel() -> None:
    """A square that faces the camera, anywhere between the pixels."""
    edges = silhouette_integrals.unique_edges(np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    for side, shift in ((20.0, 0.0), (20.3, 0.17), (17.71, 0.63)):
        corners = np.array([[0, 0], [side, 0], [side, side], [0, side]]) + 5 + shift
        points = np.column_stack([corners, np.ones(4)])
        mask = rasterizer.silhouette(points, np.array([[0, 1, 2], [0, 2, 3]], np.int32), np.eye(3), 40, 40)
        ones = np.ones((40, 40), np.float32)
        found = silhouette_integrals.integrate(
            points, edges, mask, np.eye(3), silhouette_integrals.Fields(valid=ones, mismatch=ones, stiffness=ones),
            np.zeros((0, 3, 4)), near=0.1,
        )  # fmt: skip
        area = found.value[silhouette_integrals.AREA]
        assert area == pytest.approx(side**2, abs=1.0)
        middle = found.value[[silhouette_integrals.MOMENT_X, silhouette_integrals.MOMENT_Y]] / area
        assert middle == pytest.approx(np.full(2, 5 + shift + side / 2), abs=0.05)


def test_the_camera_and_the_world_moved_together_change_nothing() -> None:
    problem = Problem("ring", 256)
    u = np.array([0.2, -0.1, 0.3, 0.0, 0.0, 0.15])
    before = problem.integrals(u)
    T = pose(rotation_from_vector([0, 0, 1.0]), [0.4, -0.3, 0])
    problem.vertices = transform(T, problem.vertices)
    problem.camera = problem.camera.moved(T @ problem.camera.T_world_camera)
    problem.freedom = ObjectFreedom(
        anchor=transform(T, problem.freedom.anchor),
        basis=T[:3, :3] @ problem.freedom.basis,
        reach=problem.freedom.reach,
    )
    after = problem.integrals(u)
    assert np.allclose(before.value, after.value, rtol=1e-6)
    assert np.allclose(before.gradient[:, [0, 1, 2, 5]], after.gradient[:, [0, 1, 2, 5]], rtol=1e-5, atol=1e-3)


def test_tessellation_changes_next_to_nothing() -> None:
    problem = Problem("box", 256)
    coarse = problem.integrals(np.full(6, 0.1))
    finer = trimesh.remesh.subdivide(*trimesh.remesh.subdivide(problem.vertices, problem.faces))
    problem.vertices, problem.faces = np.asarray(finer[0]), np.asarray(finer[1], np.int32)
    problem.edges = silhouette_integrals.unique_edges(problem.faces)
    fine = problem.integrals(np.full(6, 0.1))
    assert np.allclose(coarse.value, fine.value, rtol=1e-9)
    assert np.allclose(coarse.gradient, fine.gradient, rtol=1e-6, atol=1e-6)


def test_the_camera_s_velocities_are_those_of_its_points() -> None:
    freedom = CameraFreedom(camera=camera(64), center=np.array([0.1, 0.2, 1.4]), reach=np.full(6, 0.3))
    X, u, h = np.array([[0.3, 0.2, 0.1]]), np.linspace(-0.5, 0.6, 6), 1e-5
    at = freedom.at(u).to_camera(X)[0]
    for k, e in enumerate(np.eye(6)):
        expected = (freedom.at(u + h * e).to_camera(X) - freedom.at(u - h * e).to_camera(X))[0] / (2 * h)
        assert np.allclose(freedom.velocities(u)[k] @ [*at, 1], expected, atol=1e-8)


def test_a_longer_focal_length_moves_pixels_as_its_velocity_says() -> None:
    freedom = CameraFreedom(camera=camera(64), center=np.array([0.1, 0.2, 1.4]), reach=np.full(7, 0.3))
    X, u, h = np.array([[0.3, 0.2, 0.1]]), np.linspace(-0.5, 0.6, 7), 1e-6
    e = np.eye(7)[6]
    expected = (freedom.at(u + h * e).project(X)[0] - freedom.at(u - h * e).project(X)[0])[0] / (2 * h)
    here = freedom.at(u)
    x, y, z = here.to_camera(X)[0]
    dx, dy, dz = freedom.velocities(u)[6] @ [x, y, z, 1]
    assert dz == 0
    assert np.allclose([here.K[0, 0] * dx / z, here.K[1, 1] * dy / z], expected, rtol=1e-6)


@pytest.mark.parametrize("name", MESHES)
def test_a_search_finds_the_mask_again(name: str) -> None:
    problem = Problem(name, 256)
    start = np.array([0.25, -0.2, 0.3, 0.0, 0.0, -0.3])
    free = np.array([1.0, 1, 1, 0, 0, 1])
    found = minimise(problem.objective, start, bounds=(-free, free), iterations=40)
    both = problem.silhouette(found.x)
    assert (both & problem.mask).sum() / (both | problem.mask).sum() > 0.98


def test_a_search_stays_in_its_box() -> None:
    """The nearest corner of a paraboloid whose middle lies outside."""
    middle = np.array([2.0, -3.0, 0.25])

    def bowl(x: Array) -> Local:
        d = x - middle
        return Local(value=float(d @ d), gradient=2 * d, curvature=2 * np.eye(3))

    found = minimise(bowl, np.zeros(3), bounds=(-np.ones(3), np.ones(3)))
    assert np.allclose(found.x, [1, -1, 0.25], atol=1e-3)


def soup() -> tuple[Array, np.ndarray]:
    """Long and short triangles."""
    rng = np.random.default_rng(3)
    sizes = rng.choice([0.02, 0.1, 0.6], (300, 1, 1))
    corners = rng.uniform(-0.7, 0.7, (300, 1, 3)) + sizes * rng.normal(size=(300, 3, 3))
    return corners.reshape(-1, 3), np.arange(900, dtype=np.int32).reshape(-1, 3)


def ball() -> tuple[Array, np.ndarray]:
    """Most of its edges project far inside its outline."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32)


@pytest.mark.parametrize(("shape", "shift"), [(soup, 0.0), (soup, 0.4), *((ball, s) for s in np.linspace(0, 0.6, 13))])
@pytest.mark.parametrize(("width", "height"), [(97, 64), (8, 200), (1, 9), (161, 161)])
def test_edges_that_are_sorted_out_cross_no_outline(shape, shift: float, width: int, height: int) -> None:
    vertices, faces = shape()
    points, edges = vertices + np.array([shift, -0.3 * shift, 1.2]), silhouette_integrals.unique_edges(faces)
    K = np.array([[160.0, 0, width / 2], [0, 160, height / 2], [0, 0, 1]])
    mask = rasterizer.silhouette(points, faces[::3] if shape is soup else faces, K, width, height)
    pixels, inverse_depth = np.empty((len(points), 2)), np.empty(len(points))
    silhouette_integrals._project(points, K, rasterizer.NEAR, pixels, inverse_depth)
    chosen = silhouette_integrals._at_outline(pixels, inverse_depth, edges, mask)
    assert len(chosen) < len(edges)
    for upright in (False, True):
        (cells, crossed, place), (few, by, at) = (
            silhouette_integrals._outline(pixels, inverse_depth, e, mask, upright=upright) for e in (edges, chosen)
        )
        assert np.array_equal(cells, few) and np.array_equal(place, at)
        assert np.array_equal(edges[crossed], chosen[by])
