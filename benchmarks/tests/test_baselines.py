"""Laws of the two re-implemented baselines on boxes: what is known is found, overlaps end, and nothing is random."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from baselines import figure, pat3d, simulator, tabletopgen
from baselines.compare import as_seen, spread
from contact import overlapping
from f3sr.core.transforms import UP, Array, pose, rotation_about
from f3sr.metrics.measures import full_silhouette
from f3sr.scene import Geometry, Photo, Scene, SceneObject, Support
from f3sr.vision import rasterizer
from scenes import box, scene_of

SIZE = (0.2, 0.1, 0.15)


def seen(*objects: SceneObject) -> Scene:
    """Boxes with their own silhouettes as masks and their own depth as the geometry."""
    camera = scene_of().camera.resized(320, 240)
    objects = tuple(replace(o, mask=full_silhouette(o, camera)) for o in objects)
    depth = rasterizer.render(objects, camera).depth
    valid = np.isfinite(depth)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T
    points = (rays * np.where(valid, depth, 1.0)[..., None]).astype(np.float32)
    photo = Photo(rgb=np.full((camera.height, camera.width, 3), 128, np.uint8))
    geometry = Geometry(points=points, valid=valid)
    return Scene(photo=photo, camera=camera, objects=objects, geometry=geometry)


def on(o: SceneObject, carrier: int) -> SceneObject:
    return replace(o, supports=(Support(id=carrier),), supported_by=carrier)


def test_tabletopgen_finds_angle_size_and_place_of_a_box_from_its_mask() -> None:
    angle = 0.5
    scene = seen(box(0, size=SIZE, at=(0.05, 0.1, 0.075), R=rotation_about(UP, angle)))
    wrong = scene[0].moved(pose(rotation_about(UP, 0.9), [0.02, 0.05, 0.01]), scale=1.2, stage="test", reason="")
    found = tabletopgen.placed_alone(wrong, [], scene)
    forward = found.T_world_object[:3, 0]
    error = math.atan2(forward[1], forward[0]) - angle
    assert abs((error + math.pi / 2) % math.pi - math.pi / 2) < math.radians(1.5)  # half a turn changes no outline
    assert abs(found.scale / scene[0].scale - 1) < 0.02
    assert np.linalg.norm(found.middle - scene[0].middle) < 0.02 * found.size


def test_tabletopgen_completes_what_a_nearer_mask_hides() -> None:
    """Half of a box is hidden: its size is still found, as its given pose tells the hidden half."""
    scene = seen(box(0, size=SIZE, at=(0, 0.2, 0.075)))
    whole = scene[0].mask
    hidden = whole & (np.arange(whole.shape[1]) < np.flatnonzero(whole.any(0)).mean())
    front = replace(box(1), mask=hidden)
    o = replace(scene[0], mask=whole & ~hidden)
    crop = tabletopgen.crop_of(o, [front], scene)
    assert np.array_equal(crop.mask, tabletopgen.crop_of(scene[0], [], scene).mask)
    assert abs(tabletopgen.filling(o, crop).scale / o.scale - 1) < 0.02


def test_tabletopgen_stands_a_tilted_box_upright_about_its_middle() -> None:
    o = box(0, size=SIZE, at=(0, 0, 0.2), R=rotation_about([1, 2, 0], 0.3))
    upright = tabletopgen.canonical(o)
    assert np.allclose(np.abs(upright.T_world_object[2, :3]), [0, 0, 1])
    assert np.allclose(upright.middle, o.middle)


def test_tabletopgen_puts_boxes_on_each_other_and_keeps_the_top_view() -> None:
    scene = scene_of(box(0, at=(0, 0, 0.4)), on(box(1, at=(0.03, 0.01, -0.2)), 0))
    stacked = tabletopgen.stacked(scene)
    assert np.allclose([o.bounds_world[0, 2] for o in stacked], [0, 0.1])
    assert np.allclose(stacked[1].middle[:2], [0.03, 0.01])


def test_pat3d_ends_a_known_overlap() -> None:
    """Siblings that share three centimetres are parted by that and the gap; their middle stays."""
    scene = scene_of(box(0, at=(-0.035, 0, 0.05)), box(1, at=(0.035, 0, 0.05)))
    assert overlapping(scene) == [(0, 1)]
    prepared = pat3d.prepared(scene)
    a, b = (o.middle for o in prepared)
    assert overlapping(prepared) == []
    assert math.isclose(b[0] - a[0], 0.1 + pat3d.GAP * scene.diagonal, rel_tol=1e-3)
    assert np.allclose((a + b)[:2], 0, atol=1e-9)


def test_pat3d_starts_a_child_above_its_parent_and_takes_along_what_it_carries() -> None:
    scene = scene_of(box(0), on(box(1, at=(0, 0, 0.12)), 0), on(box(2, at=(0, 0, 0.2)), 1))
    prepared = pat3d.prepared(scene)
    assert overlapping(prepared) == []
    assert (np.diff([o.middle[2] for o in prepared]) >= 0.1).all()


def test_pat3d_rests_where_the_layout_says_and_nothing_is_random() -> None:
    """A child that the layout places over its parent's edge comes within the parent's box."""
    parent = box(0, size=(0.3, 0.3, 0.05), at=(0, 0, 0.025))
    scene = scene_of(parent, on(box(1, at=(0.12, 0, 0.1)), 0), box(2, at=(-0.4, 0, 0.08)))
    (rested, rounds), (again, _) = (pat3d.reconstruct(scene, rounds=3) for _ in range(2))
    assert [np.array_equal(a.T_world_object, b.T_world_object) for a, b in zip(rested, again, strict=True)] == [
        True
    ] * 3
    assert rounds[-1].loss <= rounds[0].loss
    assert min(r.loss for r in rounds) < 0.1 * rounds[0].loss
    assert overlapping(rested) == []
    assert rested[1].bounds_world[1, 0] < rested[0].bounds_world[1, 0] + 2e-3
    assert np.allclose(rested[2].middle, [-0.4, 0, 0.05], atol=2e-3)


def test_pat3d_measures_errors_from_the_layout_and_from_the_parents_box() -> None:
    layout = scene_of(box(0, size=(0.3, 0.3, 0.05)), on(box(1), 0), box(2))
    errors = pat3d.errors_of(layout, pat3d.moved(layout, {1: np.array([0.12, 0.03, 0.2]), 2: np.array([0.0, -0.2, 0])}))
    assert np.allclose(errors[0], 0)
    assert np.allclose(errors[1], [0.12, 0.03, 0])
    assert np.allclose(errors[2], [0, -0.2, 0])
    over_the_edge = scene_of(layout[0], on(box(1, at=(0.12, 0, 0.1)), 0))
    errors = pat3d.errors_of(over_the_edge, over_the_edge)
    assert np.allclose(errors[1], [0.12 + 0.05 - 0.15, 0, 0])  # the parent's box ends at .15


def test_a_box_that_is_let_go_stands_still_on_the_ground_without_a_bounce() -> None:
    rested = simulator.at_rest(scene_of(box(0, at=(0, 0, 0.15))))
    assert np.allclose(rested[0].T_world_object, pose(t=[0, 0, 0.05]), atol=1e-3)


def test_what_is_fixed_stays() -> None:
    scene = scene_of(replace(box(0, at=(0, 0, 0.3)), mobility="fixed"))
    assert np.array_equal(simulator.at_rest(scene)[0].T_world_object, scene[0].T_world_object)


def test_the_worst_scene_is_that_with_the_least_likeness_and_the_most_motion() -> None:
    rows = [{"f3sr": {"PSNR": p, "mIoU": p, "R_pen": p, "K_max_J": p, "D_max_cm": p}} for p in (1.0, 2.0, 9.0)]
    found = spread(rows)["f3sr"]
    assert (found["PSNR"], found["PSNR, worst"], found["mIoU, worst"]) == (2, 1, 1)
    assert (found["R_pen, worst"], found["D_max_cm, worst"], found["K_max_J"]) == (9, 9, 2)


def test_all_panels_of_the_figure_show_the_same_part() -> None:
    scene = seen(box(0, size=SIZE), box(1, at=(0.25, 0.2, 0.05)))
    scenes = {m: moved_by(scene, [0.02 * k, 0, 0]) for k, m in enumerate(figure.METHODS)}
    row = dict.fromkeys(("mIoU", "PSNR", "R_pen", "K_max_J", "D_max_cm"), 1.0)
    block = figure.Block(scenes=scenes, rows=dict.fromkeys(figure.METHODS, row), true=scene)
    left, right, top, bottom = figure.common_crop(block)
    for s in scenes.values():
        rows, columns = np.nonzero(rasterizer.visible_ids(s.objects, s.camera) != rasterizer.EMPTY)
        assert left <= columns.min() and columns.max() < right and top <= rows.min() and rows.max() < bottom
    assert figure.drawn(block, with_names=True).shape[1] == figure.WIDTH


def moved_by(scene: Scene, shift: Array | list[float]) -> Scene:
    return pat3d.moved(scene, {o.id: np.array(shift, float) for o in scene})


def test_the_truth_is_seen_by_another_camera_as_by_its_own() -> None:
    true = seen(box(0, size=SIZE), box(1, at=(0.25, 0.2, 0.05)))
    other = replace(true, camera=true.camera.moved(pose(rotation_about([1, 2, 3], 0.4), [0.3, -0.2, 0.5])))
    found = as_seen(true, other, 2.0)
    for o in found:
        assert np.allclose(
            other.camera.to_camera(o.vertices_world), true.camera.to_camera(true[o.id].vertices_world) / 2
        )
