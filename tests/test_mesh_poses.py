"""Laws of poses by masks, and of readings of given poses: turning a mesh file changes nothing but what is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.backends.protocols import Axis, ProducedMesh, PromptedImage, ReadPose
from f3sr.core.mesh import Mesh
from f3sr.core.transforms import Array, pose, quaternion_from_rotation, rotation_about, rotation_angle, transform
from f3sr.io import sam3d
from f3sr.mesh_poses.pose_by_mask import MaskedPhoto
from f3sr.mesh_poses.posed_meshes import AXES, posed_meshes, upright
from f3sr.mesh_poses.read_poses import is_clear, judged_readings
from f3sr.scene import Geometry, Instance, Photo
from f3sr.vision import rasterizer
from folders import boxes, camera
from scenes import box, box_mesh, chair

RANDOM = np.random.default_rng(4)


def seen(yaw: float, *, hidden: bool = False) -> tuple[PromptedImage, Geometry, Array, Array]:
    """A photo of a chair of .3 m with this yaw, the geometry, K and the chair's true pose in the camera."""
    eye, mesh = camera(), chair()
    T = pose(rotation_about([0, 0, 1], yaw), [0.0, 0.05, 0.0])
    low = 0.3 * float(mesh.bounds[0, 2])
    T[2, 3] = -low
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


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize(("up", "turn"), [("+y", 0.0), ("+y", 2.0), ("+z", -1.2), ("-x", 3.0)])
@pytest.mark.parametrize("yaw", [0.4, -2.1])
def test_the_pose_is_found_whatever_the_axes_of_the_file(up: Axis, turn: float, yaw: float, told: bool):
    if not told and up == "-x":
        pytest.skip("an axis that nobody uses must be told")
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


def test_a_turn_that_fits_as_well_is_told():
    image, geometry, K, _ = seen(0.4, hidden=True)
    meshes = {0: ProducedMesh(mesh=chair(), up="+z"), 1: ProducedMesh(mesh=box_mesh((0.8, 0.5, 1.2)), up="+z")}
    made = posed_meshes(image, geometry, K, meshes)
    assert "it fits as well" in made[1].told, "half a turn of a box without a texture"
    assert "it fits as well" not in made[0].told


@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
@pytest.mark.parametrize("is_row", [True, False])
@pytest.mark.parametrize("frame", list(sam3d.PRODUCERS_CAMERAS))
@pytest.mark.parametrize("local", list(sam3d.LOCALS))
def test_every_convention_is_read_from_the_masks(order: str, is_row: bool, frame: str, local: str):
    image, geometry, K, T_true = seen(0.7)
    mesh = in_file(chair(), "+y", 0.3)
    # x_camera = F Q A v + F t for the vertices v of the file: Q is the rotation that the producer writes down.
    R = T_true[:3, :3] @ rotation_about([0, 0, 1], -0.3) @ sam3d.LOCAL_FROM_GLB
    F, A = sam3d.PRODUCERS_CAMERAS[frame].matrix, sam3d.LOCALS[local].matrix
    Q = F.T @ R @ A.T
    w, x, y, z = quaternion_from_rotation(Q.T if is_row else Q)
    quaternion = [w, x, y, z] if order == "wxyz" else [x, y, z, w]
    poses = sam3d.readings(quaternion, F.T @ T_true[:3, 3], [0.3] * 3)
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=mesh, up="+y", poses=poses)})[0]
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    assert np.abs(found - transform(T_true, 0.3 * chair().vertices)).max() < 1e-6
    judged = judged_readings(MaskedPhoto.of(image, geometry, K), {0: ProducedMesh(mesh=mesh, poses=poses)})
    assert is_clear([judged[0], *(j for j in judged[1:] if not same(j.poses[0].object, judged[0].poses[0].object))])


def same(a: object, b: object) -> bool:
    T, S = (o.T_world_object for o in (a, b))
    return bool(rotation_angle(T[:3, :3].T @ S[:3, :3]) < 1e-6 and np.allclose(T, S))


def test_poses_that_show_nothing_of_the_masks_are_not_believed():
    image, geometry, K, T_true = seen(0.4)
    wrong = ReadPose(reading="nonsense", T_camera_mesh=pose(t=[5.0, 0, 1]), scale=0.3)
    made = posed_meshes(image, geometry, K, {0: ProducedMesh(mesh=chair(), up="+z", poses=(wrong,))})[0]
    assert "pose by its mask" in made.told
    found = transform(made.T_camera_object, made.scale * made.mesh.vertices)
    assert np.linalg.norm(found - transform(T_true, 0.3 * chair().vertices), axis=1).max() < 0.02


def test_without_depth_things_stand_on_what_is_below_them_in_the_picture():
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
    made = posed_meshes(image, geometry, eye.K, {o.id: ProducedMesh(mesh=o.mesh, up="+z") for o in things})
    for o in things:
        world = eye.T_world_camera @ made[o.id].T_camera_object
        found = transform(world, made[o.id].scale * made[o.id].mesh.vertices)
        low, true = found.min(0)[2], o.bounds_world[0, 2]
        assert abs(low - true) < 0.006, f"{o.label} stands at {low:.3f} m instead of {true:.3f}"
        assert np.linalg.norm((found.min(0) + found.max(0)) / 2 - o.bounds_world.mean(0)) < 0.02
