"""Laws of poses by masks, and of readings of given poses: turning a mesh file changes nothing but what is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.backends.protocols import Axis, GivenPose, ProducedMesh, PromptedImage
from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh, union
from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_about, transform
from f3sr.io.pose_conventions import CAMERAS, FILE_AXES, GLTF_FROM_Z_UP, SignedAxes
from f3sr.mesh_poses.candidate_places import CandidatePlaces
from f3sr.mesh_poses.placed_by_reading import placed_by_reading
from f3sr.mesh_poses.pose_by_mask import FoundPose, MaskedPhoto
from f3sr.mesh_poses.posed_meshes import posed_meshes
from f3sr.mesh_poses.poses_by_masks import AXES, RankedPoses, upright
from f3sr.scene import Geometry, Instance, Photo, SceneObject
from f3sr.vision import rasterizer
from folders import boxes, camera
from scenes import box, box_mesh, chair

RANDOM = np.random.default_rng(4)


def seen(
    yaw: float, *, hidden: bool = False, mesh: Mesh | None = None, tilt: float = 0.0
) -> tuple[PromptedImage, Geometry, Array, Array]:
    """A photo of a chair, or another mesh, of .3 m with this yaw, the geometry, K and its true pose in the camera."""
    eye, mesh = camera(), mesh or chair()
    T = pose(rotation_about([0, 0, 1], yaw) @ rotation_about([0, 1, 0], tilt), [0.0, 0.05, 0.0])
    T[2, 3] = -0.3 * float((mesh.vertices @ T[:3, :3].T)[:, 2].min())
    true = replace(box(0, size=(1, 1, 1), at=(0, 0, 0)), mesh=mesh, T_world_object=T, scale=0.3)
    things = [true] + ([box(1, size=(0.08, 0.05, 0.12), at=(-0.06, -0.2, 0.06))] if hidden else [])
    fragments = rasterizer.render(things, eye)
    rows, columns = np.indices(fragments.ids.shape) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(eye.K).T
    table = -eye.center[2] / np.minimum((rays @ eye.T_world_camera[:3, :3].T)[..., 2], -1e-6)
    depth = np.where(np.isfinite(fragments.depth), fragments.depth, table)
    geometry = Geometry(points=rays * depth[..., None], valid=(depth > 0) & (depth < 5))
    photo = Photo(rgb=np.full((*fragments.ids.shape, 3), 120, np.uint8))
    instances = tuple(Instance(id=o.id, label="", name=f"{o.id}.png", mask=fragments.ids == o.id) for o in things)
    image = PromptedImage(photo=photo, instances=instances, ground_mask=fragments.ids == rasterizer.EMPTY)
    return image, geometry, eye.K, eye.T_camera_world @ T


def in_file(mesh: Mesh, up: Axis, turn: float) -> Mesh:
    """The mesh as a file whose ``up`` axis points up has it, with a yaw of its own."""
    turned = mesh.with_vertices(mesh.vertices @ rotation_about([0, 0, 1], turn).T)
    there = upright(Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], np.int32)), up).vertices.T
    return turned.with_vertices(turned.vertices @ there)


@pytest.mark.parametrize("up", AXES)
def test_upright_brings_an_axis_up(up: Axis):
    axis = Mesh(vertices=np.array([AXES[up], [0, 0, 0], [1, 1, 1]], float), faces=np.array([[0, 1, 2]], np.int32))
    assert np.allclose(upright(axis, up).vertices[0], [0, 0, 1])


@pytest.mark.parametrize(
    ("up", "turn", "told", "yaw"),
    [
        *(("+y", 0.0, True, 0.4), ("+y", 2.0, True, -2.1), ("+z", -1.2, True, 0.4), ("-x", 3.0, True, -2.1)),
        *(("+y", 2.0, False, 0.4), ("+z", -1.2, False, -2.1)),
    ],
)
def test_the_pose_is_found_whatever_the_axes_of_the_file(up: Axis, turn: float, told: bool, yaw: float):
    """An axis that nobody uses must be told."""
    image, geometry, K, T_true = seen(yaw)
    mesh = in_file(chair(), up, turn)
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=mesh, up=up if told else None)})[0]
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    true = transform(T_true, 0.3 * chair().vertices)
    assert np.linalg.norm(found - true, axis=1).max() < 0.02, "of a chair of .3 m, at 192 x 144 pixels"
    assert made.scale == pytest.approx(0.3, rel=0.03)


def test_what_hides_a_part_does_not_move_it():
    image, geometry, K, T_true = seen(0.4, hidden=True)
    meshes = {0: ProducedMesh(mesh=chair(), up="+z"), 1: ProducedMesh(mesh=box_mesh((0.8, 0.5, 1.2)), up="+z")}
    made = posed_meshes(image, geometry, K, meshes)[0]
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    assert np.linalg.norm(found - transform(T_true, 0.3 * chair().vertices), axis=1).max() < 0.03


def hammer() -> Mesh:
    """A long handle with a head at one end, which is no box's."""
    parts = [box_mesh((1.0, 0.08, 0.08)).hull, box_mesh((0.14, 0.4, 0.1)).hull.moved(pose(t=[0.43, 0.06, 0.0]))]
    vertices, faces = union(parts)
    return Mesh(vertices=vertices, faces=np.asarray(faces, np.int32))


def require_found(
    image: PromptedImage, geometry: Geometry, K: Array, T_true: Array, mesh: Mesh, *, within: float
) -> None:
    """Every vertex by masks and depths alone, within a distance [m] of where it is."""
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=mesh, up="+z")})[0]
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    assert np.linalg.norm(found - transform(T_true, 0.3 * mesh.vertices), axis=1).max() < within
    assert not made.doubted


@pytest.mark.parametrize(("yaw", "tilt"), [(1.3, 0.35), (-1.8, -0.3)])
def test_what_points_at_the_camera_is_as_long_as_the_depths_say(yaw: float, tilt: float):
    """Seen from 20 degrees off its long axis; by its mask alone it is half as long."""
    require_found(*seen(yaw, mesh=hammer(), tilt=tilt), hammer(), within=0.01)


@pytest.mark.parametrize("tilt", [0.45, -0.45])
def test_what_leans_is_found_by_its_depths(tilt: float):
    require_found(*seen(0.8, mesh=hammer(), tilt=tilt), hammer(), within=0.01)


def test_a_mesh_that_cannot_show_its_mask_is_doubted():
    image, geometry, K, _ = seen(0.4, mesh=hammer())
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=chair(), up="+z")})[0]
    assert made.doubted and "no pose shows what its mask shows" in made.told


def test_two_places_that_fit_alike_are_a_doubt_where_surfaces_differ():
    one = replace(box(0, size=(1, 1, 1), at=(0, 0, 0)), mesh=chair())
    turned = replace(one, T_world_object=pose(rotation_about([0, 0, 1], 1.5)))
    found = [
        FoundPose(object=o, side=0, iou=0.9, correlation=None, spread=0.0, missed=missed)
        for o, missed in ((one, 0.10), (one, 0.11), (turned, 0.12), (turned, 0.20))
    ]
    assert not RankedPoses(poses=(found[0], found[1], found[3]), object=one).doubt(), "the same, and one that is worse"
    assert "two poses fit alike, 86 degrees apart" in RankedPoses(poses=tuple(found), object=one).doubt()


def test_a_turn_that_fits_as_well_is_told():
    image, geometry, K, _ = seen(0.4, hidden=True)
    meshes = {0: ProducedMesh(mesh=chair(), up="+z"), 1: ProducedMesh(mesh=box_mesh((0.8, 0.5, 1.2)), up="+z")}
    made = posed_meshes(image, geometry, K, meshes)
    assert "it fits as well" in made[1].told, "half a turn of a box without a texture"
    assert "it fits as well" not in made[0].told


CONVENTIONS = [
    (order, vectors, frame, (GLTF_FROM_Z_UP, FILE_AXES)[(i + j + k) % 2])
    for i, order in enumerate(("wxyz", "xyzw"))
    for j, vectors in enumerate(("row", "column"))
    for k, frame in enumerate(("pytorch3d", "opencv", "blender"))
]
"""Half of all: every choice meets every other one."""


@pytest.mark.parametrize(("order", "vectors", "frame", "local"), CONVENTIONS)
def test_every_convention_of_a_producer_is_read_from_the_masks(order: str, vectors: str, frame: str, local: SignedAxes):
    image, geometry, K, T_true = seen(0.7)
    mesh = in_file(chair(), "+y", 0.3)
    # x_camera = F Q A v + F t for the vertices v of the file: Q is the rotation that the producer writes down.
    R = T_true[:3, :3] @ rotation_about([0, 0, 1], -0.3) @ GLTF_FROM_Z_UP.matrix
    F, A = CAMERAS[frame].matrix, local.matrix
    given = written(F.T @ R @ A.T, F.T @ T_true[:3, 3], 0.3, order=order, vectors=vectors)
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=mesh, up="+y", pose=given)})[0]
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    assert np.abs(found - transform(T_true, 0.3 * chair().vertices)).max() < 1e-6


def written(Q: Array, t: Array, scale: float, *, order: str = "wxyz", vectors: str = "row") -> GivenPose:
    """A rotation of columns Q (3, 3) and a place t (3,), as a producer writes them."""
    w, x, y, z = quaternion_from_rotation(Q.T if vectors == "row" else Q).tolist()
    right, down, forward = t.tolist()
    rotation = (w, x, y, z) if order == "wxyz" else (x, y, z, w)
    return GivenPose(rotation=rotation, translation=(right, down, forward), scale=scale)


def test_poses_that_show_nothing_of_the_masks_are_not_believed():
    image, geometry, K, T_true = seen(0.4)
    wrong = written(np.eye(3), np.array([5.0, 0, 1]), 0.3)
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=chair(), up="+z", pose=wrong)})[0]
    assert "pose by its mask" in made.told
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    assert np.linalg.norm(found - transform(T_true, 0.3 * chair().vertices), axis=1).max() < 0.02


@pytest.mark.parametrize(
    ("unit", "told"),
    [(1.0, ""), (1.7, ""), (0.01, "centimetres"), (0.001, "millimetres"), (100.0, "hundreds"), (1000.0, "thousands")],
)
def test_places_in_another_unit_take_the_geometry_s_and_a_larger_one_is_a_fallback(unit: float, told: str):
    """Larger places mean that the geometry is in a smaller unit, so that all of the scene has a wrong size."""
    image, geometry, K, T = seen(0.4)
    places = CandidatePlaces(
        ids=(0,),
        names=("as written",),
        R=T[None, None, :3, :3],
        t=T[None, None, :3, 3] / unit,
        scale=np.array([[0.3 / unit]]),
        own=np.eye(3)[None],
    )
    placed = placed_by_reading(MaskedPhoto.of(image, geometry, K), {0: chair()}, places, 0)
    factor = unit if told else 1.0
    assert placed.assets[0].scale == pytest.approx(0.3 * factor / unit)
    assert np.allclose(placed.assets[0].T_camera_object[:3, 3], T[:3, 3] * factor / unit)
    assert [(d.choice, d.fallback) for d in placed.decisions] == (
        [(f"assets: all places and sizes times {unit:g}", unit > 1)] if told else []
    )
    assert all(f"in {told} they agree" in d.reason for d in placed.decisions)
    assert all(("is it in a smaller unit?" in d.reason) is (unit > 1) for d in placed.decisions)


def on_a_ground() -> tuple[PromptedImage, Geometry, list[SceneObject], Camera]:
    """Boxes before a camera that knows the ground only."""
    eye, things = camera(), boxes()
    ids = rasterizer.visible_ids(things, eye)
    rows, columns = np.indices(ids.shape) + 0.5
    rays = np.stack([columns, rows, np.ones_like(rows)], -1) @ np.linalg.inv(eye.K).T
    down = (rays @ eye.T_world_camera[:3, :3].T)[..., 2]
    points = rays * (-eye.center[2] / np.minimum(down, -1e-3))[..., None]
    geometry = Geometry(points=points, valid=down < -0.05, source="ground")
    image = PromptedImage(
        photo=Photo(rgb=np.full((*ids.shape, 3), 120, np.uint8)),
        instances=tuple(Instance(id=o.id, label="", name=f"{o.id}.png", mask=ids == o.id) for o in things),
        ground_mask=ids == rasterizer.EMPTY,
    )
    return image, geometry, things, eye


def test_without_depth_things_stand_on_what_is_below_them_in_the_picture():
    image, geometry, things, eye = on_a_ground()
    made = posed_meshes(image, geometry, eye.K, {o.id: ProducedMesh(mesh=o.mesh, up="+z") for o in things})
    for o in things:
        world = eye.T_world_camera @ made[o.id].T_camera_object
        found = transform(world, made[o.id].scale * made[o.id].mesh.vertices)
        low, true = found.min(0)[2], o.bounds_world[0, 2]
        assert abs(low - true) < 0.006, f"{o.label} stands at {low:.3f} m instead of {true:.3f}"
        assert np.linalg.norm((found.min(0) + found.max(0)) / 2 - o.bounds_world.mean(0)) < 0.02


@pytest.mark.parametrize("factor", [0.7, 1.6])
def test_posed_meshes_stand_on_the_ground_where_nothing_else_is_known(factor: float):
    """The unit of a producer's places is not that of a ground whose distance was guessed."""
    image, geometry, things, eye = on_a_ground()
    meshes = dict[int, ProducedMesh]()
    for o in things:
        T = eye.T_camera_world @ o.T_world_object
        F = CAMERAS["pytorch3d"].matrix
        given = written(F.T @ T[:3, :3] @ GLTF_FROM_Z_UP.matrix.T, factor * F.T @ T[:3, 3], factor * o.scale)
        meshes[o.id] = ProducedMesh(mesh=o.mesh, pose=given)
    made = posed_meshes(image, geometry, eye.K, meshes)
    for o in things:
        world = eye.T_world_camera @ made[o.id].T_camera_object
        found = transform(world, made[o.id].scale * made[o.id].mesh.vertices)
        assert np.abs(found.min(0) - o.bounds_world[0]).max() < 0.003
