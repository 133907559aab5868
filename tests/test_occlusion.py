"""Where an object is compared with its mask: not where something nearer hides it, as the photo's geometry shows."""

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.mesh import Mesh
from f3sr.core.transforms import pose
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Geometry, SceneObject
from f3sr.vision import rasterizer
from f3sr.vision.occlusion import behind_the_photo, comparable_region, nearer_objects, occluders, visible_region
from f3sr.vision.regions import parts_alike, shrunk
from folders import photographed
from scenes import box, box_mesh, scene_of


def test_regions_of_nearer_objects_are_left_out():
    near, far = box(0, at=(0.0, -0.2, 0.05)), box(1, at=(0.0, 0.2, 0.05))
    scene = scene_of(near, far)
    valid = {id: visible_region(scene[id], nearer) for id, nearer in nearer_objects(scene).items()}
    assert valid[0].all()
    assert not valid[1][near.mask].any() and valid[1][~near.mask].all()


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_order_is_that_of_the_photo_s_geometry_whatever_distance_a_pose_came_with(share: float):
    scene = photographed(box(0, at=(0, -0.1, 0.05)), box(1, size=(0.1, 0.1, 0.2), at=(0.03, 0.1, 0.1)))
    came = scene[1].moved(scene.camera.homothety(share), scale=share, stage="test", reason="")
    nearer = nearer_objects(scene.with_objects(came))
    assert [p.id for p in nearer[1]] == [0] and not nearer[0]


@pytest.mark.parametrize("depth", [-0.002, 0.002, 0.004])
def test_the_photo_orders_what_nearly_meets_in_depth(depth: float):
    """A plate on another one, of which a wrong pose has sunk the upper by a ``depth`` [m] below the lower one's top."""
    lower = box(0, size=(0.2, 0.2, 0.01), at=(0, 0, 0.005))
    upper = box(1, size=(0.12, 0.12, 0.01), at=(0, 0, 0.015))
    sunk = upper.moved(pose(t=np.array([0, 0, -0.01 - depth])), stage="test", reason="")
    scene = photographed(lower, upper)
    wrong = replace(scene.with_objects(replace(sunk, mask=scene[1].mask)), geometry=None)
    nearer = nearer_objects(wrong)
    assert [p.id for p in nearer[0]] == [1] and not nearer[1]


@pytest.mark.parametrize(("share", "first"), [(0.6, 1), (1.0, 0)])
def test_the_photo_orders_what_the_geometry_sees_at_several_distances(share: float, first: int):
    """A wall behind a box. In some of the wall's pixels the geometry shows a surface far before it."""
    wall, near = box(0, size=(0.3, 0.05, 0.3), at=(0, 0.08, 0.15)), box(1, at=(0, -0.05, 0.05))
    scene = photographed(wall, near)
    columns = np.flatnonzero(scene[0].mask.any(0))
    left = np.zeros_like(scene[0].mask)
    left[:, : columns[0] + round(share * (1 + columns[-1] - columns[0]))] = True
    assert scene.geometry
    points = np.where((scene[0].mask & left)[..., None], 0.6 * scene.geometry.points, scene.geometry.points)
    wrong = replace(scene, geometry=replace(scene.geometry, points=points.astype(np.float32)))
    found = occluders(wrong)
    assert [p.id for p in found[1 - first].nearer] == [first] and not found[first].nearer


def test_what_is_sunk_deep_is_behind():
    lower = box(0, size=(0.2, 0.2, 0.01), at=(0, 0, 0.105))
    scene = photographed(lower, box(1, size=(0.12, 0.12, 0.01), at=(0, 0, 0.115)))
    sunk = scene[1].moved(pose(t=np.array([0, 0, -0.04])), stage="test", reason="")
    nearer = nearer_objects(replace(scene.with_objects(sunk), geometry=None))
    assert not nearer[0] and [p.id for p in nearer[1]] == [0]


def test_the_near_wall_of_a_box_may_hide_what_is_in_it_and_its_far_wall_may_not():
    wall = box_mesh((0.3, 0.005, 0.1))
    low, high = (replace(wall, vertices=wall.vertices + np.array([0, y, 0.05])) for y in (-0.1, 0.1))
    faces = np.concatenate([low.faces, high.faces + len(low.vertices)])
    both = Mesh(vertices=np.concatenate([low.vertices, high.vertices]), faces=faces)
    scene = photographed(replace(box(0, at=(0, 0, 0)), mesh=both), box(1, size=(0.06, 0.06, 0.16), at=(0, 0, 0.08)))
    found = occluders(scene)
    assert not found[1].nearer and [p.id for p, _ in found[1].in_part] == [0] and [p.id for p in found[0].nearer] == [1]
    hidden = found[1].pixels(*scene[1].mask.shape)
    near = full_silhouette(replace(scene[0], mesh=low), scene.camera) & scene[0].mask
    far = scene[0].mask & ~near
    assert near.any() and far.any() and (hidden & near).sum() > 0.9 * near.sum() and not (hidden & far).any()
    assert not (comparable_region(scene[1], found[1], scene) & hidden).any()


@pytest.mark.parametrize("depth", [0.005, 0.015])
def test_a_support_into_which_a_wrong_pose_is_sunk_hides_nothing(depth: float):
    scene = photographed(
        box(0, size=(0.2, 0.2, 0.04), at=(0, 0, 0.02)), box(1, size=(0.08, 0.08, 0.1), at=(0, 0, 0.09))
    )
    sunk = scene[1].moved(pose(t=np.array([0, 0, -depth])), stage="test", reason="")
    assert not occluders(scene.with_objects(sunk))[1].in_part


@pytest.mark.parametrize("rows", [10, 4, 1])
def test_where_the_geometry_shows_something_before_an_object_it_is_hidden_and_where_depth_goes_on_it_is_not(rows: int):
    fruit = box(0)
    mine, other = (np.zeros_like(fruit.mask) for _ in range(2))
    mine[20 - rows : 20, 20:40], other[20:40, 20:40] = True, True
    # Below the fruit a wall is seen on the left, 3 cm before it; on the right what it stands on comes nearer slowly.
    points = np.ones((*mine.shape, 3), np.float32)
    points[20:, :30, 2] = 0.97
    points[20:, 30:, 2] -= np.linspace(0, 0.004, len(points) - 20, dtype=np.float32)[:, None]
    geometry = Geometry(points=points, valid=np.ones_like(mine))
    hidden = behind_the_photo(mine, [other], geometry, scene_of(fruit).camera)
    wall = other.copy()
    wall[:, 30:] = False
    assert not (hidden & ~wall).any()
    below = slice(20, 20 + rows)
    assert np.array_equal(hidden[below, 20:30], wall[below, 20:30])


@pytest.mark.parametrize("height", [0.08, 0.11, 0.14])
@pytest.mark.parametrize("away", [0.02, 0.06])
def test_all_of_an_object_that_a_wall_hides_is_left_out_however_far_down_the_wall_goes(height: float, away: float):
    # The wall's depth grows downwards, beyond that of the object's upper end.
    wall = box(0, size=(0.3, 0.005, 0.1), at=(0, -0.1, 0.05))
    brick = box(1, size=(0.05, 0.05, height), at=(0.02, away - 0.0725, height / 2))
    scene = photographed(wall, brick)
    alone = full_silhouette(brick, scene.camera)
    assert scene.geometry
    hidden = behind_the_photo(scene[1].mask, [scene[0].mask], scene.geometry, scene.camera)
    missed = alone & ~scene[1].mask & ~hidden
    assert np.count_nonzero(scene[1].mask) > 300
    assert np.count_nonzero(missed) < 0.02 * np.count_nonzero(alone)


@pytest.mark.parametrize("away", [0.02, 0.06])
def test_a_wall_that_no_mask_shows_hides_an_object_as_one_with_a_mask_and_the_ground_before_it_does_not(away: float):
    wall = box(0, size=(0.3, 0.005, 0.1), at=(0, -0.1, 0.05))
    brick = box(1, size=(0.05, 0.05, 0.14), at=(0.02, away - 0.0725, 0.07))
    scene = photographed(wall, brick, on_ground=True)
    assert scene.geometry
    hidden = behind_the_photo(scene[1].mask, [scene[0].mask], scene.geometry, scene.camera)
    also = behind_the_photo(scene[1].mask, [], scene.geometry, scene.camera)
    alone = full_silhouette(brick, scene.camera)
    missed = alone & hidden & ~also
    assert np.count_nonzero(alone & hidden) > 300 and np.count_nonzero(missed) < 0.01 * np.count_nonzero(alone & hidden)
    assert not (also & ~scene[0].mask).any()


@pytest.mark.parametrize("away", [-0.02, 0.0, 0.02])
def test_what_stands_on_an_object_without_a_mask_hides_it_down_to_where_they_touch(away: float):
    """There it is as near as the object itself."""
    lower, upper = (
        box(0, size=(0.2, 0.2, 0.04), at=(0, 0, 0.02)), box(1, size=(0.1, 0.06, 0.12), at=(0.02, away, 0.1))
    )  # fmt: skip
    scene = photographed(lower, upper, on_ground=True)
    assert scene.geometry
    hidden = behind_the_photo(scene[0].mask, [], scene.geometry, scene.camera)
    beyond = full_silhouette(lower, scene.camera) & ~scene[0].mask
    assert np.count_nonzero(beyond) > 500 and np.count_nonzero(beyond & ~hidden) < 0.02 * np.count_nonzero(beyond)
    assert not (hidden & ~scene[1].mask).any()


def test_a_seam_between_masks_hides_nothing():
    """The border of a wall that its mask misses."""
    wall = box(0, size=(0.3, 0.005, 0.1), at=(0, -0.1, 0.05))
    scene = photographed(wall, box(1, size=(0.05, 0.05, 0.14), at=(0.02, 0.02, 0.07)), on_ground=True)
    narrow = shrunk(scene[0].mask, 2)
    assert scene.geometry
    hidden = behind_the_photo(scene[1].mask, [narrow], scene.geometry, scene.camera)
    assert hidden.any() and not (hidden & ~narrow).any()


def test_what_an_object_stands_on_does_not_hide_it():
    below = box(0, size=(0.1, 0.1, 0.2), at=(0, 0, 0.1))
    above = box(1, size=(0.06, 0.06, 0.06), at=(0, 0, 0.23))
    scene = photographed(below, above)
    depth = rasterizer.render([below, above], scene.camera).depth
    front = scene[0].mask & (depth > depth[scene[1].mask].max())
    assert scene.geometry
    hidden = behind_the_photo(scene[1].mask, [scene[0].mask], scene.geometry, scene.camera)
    assert front.any() and not (hidden & front).any()


def test_what_hides_an_object_is_found_anew_for_other_masks_cameras_and_geometries_and_never_for_another_pose():
    wall = box(0, size=(0.3, 0.005, 0.1), at=(0, -0.1, 0.05))
    brick = box(1, size=(0.05, 0.05, 0.14), at=(0.02, 0.02, 0.07))
    scene = photographed(wall, brick)
    brick, wall, geometry = scene[1], scene[0], scene.geometry
    assert geometry

    def hidden(brick: SceneObject = brick, wall: SceneObject = wall, geometry: Geometry = geometry, turn: float = 0):
        T = np.diag([1.0, np.cos(turn), np.cos(turn), 1])
        T[1, 2], T[2, 1] = -np.sin(turn), np.sin(turn)
        return behind_the_photo(brick.mask, [wall.mask], geometry, scene.camera.moved(T))

    first = hidden()
    assert first.any()
    first[:] = False  # the caller's own
    again = hidden(brick.moved(np.eye(4) * [1.1, 1.1, 1.1, 1], scale=1.1, stage="test", reason=""))
    assert again.any() and np.array_equal(again, hidden())
    left = np.arange(wall.mask.shape[1]) < np.flatnonzero(brick.mask.any(0)).mean()
    assert not np.array_equal(hidden(replace(brick, mask=brick.mask & left)), again)
    half = hidden(wall=replace(wall, mask=wall.mask & left))
    assert not np.array_equal(half, again) and np.count_nonzero(half ^ again) < 0.01 * np.count_nonzero(again)
    flat = replace(geometry, points=geometry.points / geometry.points[..., 2:].clip(1e-3))
    assert not hidden(geometry=flat).any()
    assert not np.array_equal(hidden(turn=np.pi / 2), again)


@pytest.mark.parametrize("shape", [(0, 0), (0, 4), (3, 4)])
def test_nothing_has_no_parts(shape: tuple[int, int]):
    """An object beside the photo has an empty window."""
    found = parts_alike(np.zeros(shape, bool), np.zeros((*shape, 3)), 0.5)
    assert found.shape == shape and not found.any()
