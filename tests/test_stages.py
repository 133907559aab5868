"""What every stage promises, on small scenes with known truth."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from f3sr.contact.stabilize import BalanceConfig
from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Mesh
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, invert_pose, pose, rotation_about, rotation_from_vector
from f3sr.io import inputs
from f3sr.metrics.measures import full_silhouette, measure
from f3sr.scene import GROUND, Geometry, Photo, Relation, Scene, SceneGraph, SceneObject, Support
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.align.config import FacetConfig, SearchConfig
from f3sr.stages.assemble import AssembleConfig, as_given, assemble
from f3sr.stages.decompose import decompose
from f3sr.stages.evaluate import direct_composition, evaluate
from f3sr.stages.level import LevelConfig, level
from f3sr.stages.separate import SeparateConfig, separate
from f3sr.stages.separate.overlaps import lift_out
from f3sr.stages.separate.placement import Placement
from f3sr.stages.settle import settle
from f3sr.vision import rasterizer
from folders import boxes, camera, to_depth, write_folder
from scenes import box, box_mesh, box_stack_scene, measured, scene_of, visible_iou


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """An exact input, assembled."""
    folder = tmp_path_factory.mktemp("exact") / "input"
    write_folder(folder)
    return assemble(as_given(inputs.read(folder)))[0]


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Assets off by 6%, levelled."""
    folder = tmp_path_factory.mktemp("wrong") / "input"
    write_folder(folder, perturb=0.06, seed=3)
    return level(assemble(as_given(inputs.read(folder)))[0])[0]


GAP = SeparateConfig().clearance


def moved_world(scene: Scene, T: np.ndarray) -> Scene:
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object) for o in scene)
    return replace(scene, objects=objects, camera=scene.camera.moved(T @ scene.camera.T_world_camera))


# --- assemble -----------------------------------------------------------------------------------------------


def test_assembled_assets_project_onto_their_masks(exact: Scene):
    assert visible_iou(exact) == 1


def test_assets_in_another_unit_come_to_the_depth_of_the_geometry(exact: Scene, tmp_path):
    import json

    write_folder(tmp_path / "input")
    poses = tmp_path / "input/assets/poses.json"
    document = json.loads(poses.read_text())
    for o in document["objects"]:
        o["translation"] = [10 * x for x in o["translation"]]
        o["scale"] = [10 * x for x in o["scale"]]
    poses.write_text(json.dumps(document))
    scene, outcome = assemble(as_given(inputs.read(tmp_path / "input")))
    moved = [d for d in outcome.decisions if "viewing rays" in d.choice]
    assert [(d.about, d.fallback) for d in moved] == [(o.id, True) for o in exact]
    assert all("times the geometry's" in d.reason for d in moved)
    for o in scene:
        assert o.scale == pytest.approx(exact[o.id].scale, rel=0.02)
    assert visible_iou(scene) > 0.98


def test_only_a_mesh_at_another_depth_moves_along_its_rays(tmp_path: Path):
    write_folder(tmp_path / "input")
    given = as_given(inputs.read(tmp_path / "input"))
    o, far = given.objects[1], 1.5 * AssembleConfig().max_depth_ratio
    for factor, told in ((1.0, False), (1.1, False), (far, True), (1 / far, True)):
        away = o.moved(given.camera.homothety(factor), scale=factor, stage="test", reason="test")
        scene, outcome = assemble(given.with_objects(*(away if i.id == o.id else i for i in given)))
        rays = [d for d in outcome.decisions if "viewing rays" in d.choice]
        assert [(d.about, d.fallback) for d in rays] == [(o.id, True)] * told
        assert scene[o.id].scale == pytest.approx(o.scale if told else factor * o.scale, rel=0.02)


# --- level --------------------------------------------------------------------------------------------------


def test_what_is_given_overrules_the_label_and_the_rest_is_the_label_s(folder: Path):
    names = [i.name for i in inputs.read(folder).instances]
    for old, new in zip(names, ("02_wooden_spoon.png", "05_thing.png", "07_tennis_ball.png"), strict=True):
        (folder / "masks" / old).rename(folder / "masks" / new)
        poses = folder / "assets/poses.json"
        poses.write_text(poses.read_text().replace(old.removesuffix(".png"), new.removesuffix(".png")))
    objects = [{"id": 7, "density": 300.0, "mobility": "fixed"}, {"id": 2, "friction": 0.9, "reason": "sticky"}]
    (folder / "materials.json").write_text(json.dumps({"objects": objects}))
    scene, outcome = assemble(as_given(inputs.read(folder)), AssembleConfig(ground_friction=0.3))
    spoon, thing, tennis = scene
    assert (spoon.material, spoon.density, spoon.friction) == ("wood", 650, 0.9)
    assert spoon.material_reason == "sticky; the label 'wooden spoon'"
    assert (thing.material, thing.density, thing.friction) == ("unknown", 600, 0.6)
    assert (tennis.density, tennis.friction, tennis.restitution, tennis.mobility) == (300, 0.7, 0.74, "fixed")
    assert [o.material_source for o in scene] == ["label", "default", "given"]
    assert scene.ground.friction == 0.3
    (told,) = (d for d in outcome.decisions if d.choice.startswith("materials"))
    assert told.fallback and "thing" in told.choice and "600 kg/m3" in told.reason
    assert [d.about for d in outcome.decisions if d.choice.startswith("fixed as given") and d.fallback] == [7]
    (folder / "materials.json").write_text(json.dumps({"objects": [{"id": 5, "material": "steel"}]}))
    steel = as_given(inputs.read(folder))[5]
    assert (steel.material, steel.density, steel.material_source) == ("steel", 5000, "given")
    by_label, _ = assemble(as_given(inputs.read(folder, ignore=["materials"])))
    assert [o.material_source for o in by_label] == ["label", "default", "label"] and by_label[7].density == 400


def test_level_finds_the_true_camera(exact: Scene):
    scene, outcome = level(exact)
    up = scene.camera.T_world_camera[:3, :3].T @ [0, 0, 1]
    true_up = camera().T_world_camera[:3, :3].T @ [0, 0, 1]
    assert np.degrees(np.arccos(up @ true_up)) < 0.01
    assert scene.camera.center[2] == pytest.approx(camera().center[2], abs=1e-4)
    assert outcome.report.value("ground residual") < 0.1 and scene.ground.confidence > 0.99


def test_level_changes_no_pixel(exact: Scene):
    before = rasterizer.render(exact.objects, exact.camera)
    scene, _ = level(exact)
    after = rasterizer.render(scene.objects, scene.camera)
    assert np.mean(before.ids != after.ids) < 1e-3


def true_up() -> Array:
    """Up in the camera's axes (3,)."""
    return camera().T_world_camera[:3, :3].T @ [0.0, 0.0, 1.0]


def with_another_focal_length(exact: Scene, factor: float) -> Scene:
    """What a network delivers that takes the focal length for ``factor`` times the true one: the same picture and
    depths, points and assets placed and sized accordingly, the normals as they are."""
    camera, up = exact.camera.zoomed(factor), true_up()
    points = exact.geometry.points / np.array([factor, factor, 1], np.float32)
    objects = []
    for o in exact:
        T = camera.T_camera_world @ o.T_world_object
        T[:2, 3] /= factor
        objects.append(replace(o, T_world_object=camera.T_world_camera @ T, scale=o.scale / factor))
    geometry = replace(exact.geometry, points=points, normals=np.broadcast_to(up.astype(np.float32), points.shape))
    return replace(exact, camera=camera, geometry=geometry, objects=tuple(objects))


@pytest.mark.parametrize("factor", [0.95, 1.04])
def test_normals_tell_a_wrong_focal_length_and_the_tilt_that_comes_with_it(exact: Scene, factor: float):
    wrong = with_another_focal_length(exact, factor)
    scene, outcome = level(wrong)
    up = scene.camera.T_world_camera[:3, :3].T @ [0, 0, 1]
    assert np.degrees(np.arccos(np.clip(up @ true_up(), -1, 1))) < 0.2
    assert scene.camera.K[0, 0] == pytest.approx(camera().K[0, 0], rel=0.012)
    assert any(d.choice.startswith("focal length") for d in outcome.decisions)
    assert visible_iou(scene) > 0.98
    for o in scene:
        assert o.scale == pytest.approx(exact[o.id].scale, rel=0.015)
    assert 0 < scene.ground.tilt_error < np.radians(0.6) and np.isinf(scene.ground.height_error)
    trusted, outcome = level(wrong, LevelConfig(focal_sigma=0.0))
    assert np.array_equal(trusted.camera.K, wrong.camera.K)
    assert not any(d.choice.startswith("focal length") for d in outcome.decisions)


def test_a_focal_length_far_from_the_given_one_is_not_believed_and_told(exact: Scene):
    wrong = with_another_focal_length(exact, 1.4)
    scene, outcome = level(wrong)
    assert np.array_equal(scene.camera.K, wrong.camera.K)
    (told,) = (d for d in outcome.decisions if d.choice.startswith("focal length"))
    assert told.fallback and "kept" in told.choice


def test_without_normals_an_estimate_keeps_its_focal_length_and_knows_no_error(exact: Scene):
    wrong = with_another_focal_length(exact, 1.04)
    scene, _ = level(replace(wrong, geometry=replace(wrong.geometry, normals=None)))
    assert np.array_equal(scene.camera.K, wrong.camera.K)
    assert np.isinf([scene.ground.tilt_error, scene.ground.height_error]).all()
    told, _ = level(replace(wrong, geometry=replace(wrong.geometry, normals=None, up_error=0.03)))
    assert told.ground.tilt_error == 0.03, "unless it tells that"


def test_only_a_sensor_measures_the_height_of_the_ground(exact: Scene, tmp_path: Path):
    estimated, _ = level(exact)
    assert np.isinf(estimated.ground.height_error)
    write_folder(tmp_path / "input")
    to_depth(tmp_path / "input")
    measured, outcome = level(assemble(as_given(inputs.read(tmp_path / "input")))[0])
    assert 0 < measured.ground.height_error < 1e-3 and 0 < measured.ground.tilt_error < np.radians(0.1)
    assert outcome.report.value("ground height error") == pytest.approx(1000 * measured.ground.height_error)


def test_the_camera_is_on_the_upper_side_of_the_ground_and_a_photo_upside_down_is_told(exact: Scene):
    """A camera turned by half a turn about its axis sees the same scene; up is where the visible side faces."""
    points = exact.geometry.points * np.array([-1, -1, 1], np.float32)
    turned = replace(
        exact,
        geometry=replace(exact.geometry, points=points),
        objects=tuple(
            replace(o, T_world_object=pose(rotation_about([0, 1, 0], np.pi)) @ o.T_world_object) for o in exact
        ),
    )
    levelled, outcome = level(turned)
    assert any("upside down" in d.choice and d.fallback for d in outcome.decisions)
    assert levelled.camera.center[2] > 0
    expected, outcome = level(exact)
    assert not outcome.report.fallbacks
    assert np.allclose([o.bounds_world[:, 2] for o in levelled], [o.bounds_world[:, 2] for o in expected], atol=1e-4)


def test_a_ground_that_is_not_flat_is_a_fallback(exact: Scene):
    assert exact.geometry is not None and exact.ground_mask is not None
    assert not any(d.fallback for d in level(exact)[1].decisions)
    points = exact.geometry.points.copy()
    points[::2] *= 1.2  # half of the rows lie on another plane
    _, told = level(replace(exact, geometry=replace(exact.geometry, points=points)))
    (decision,) = (d for d in told.decisions if d.choice.startswith("ground plane from"))
    assert decision.fallback and re.match(r"5\d % of \d+ points lie on it", decision.reason)


def test_without_any_ground_the_lowest_vertex_is_the_ground(exact: Scene):
    nothing = Geometry(points=np.zeros((4, 4, 3)), valid=np.zeros((4, 4), bool))
    scene, outcome = level(replace(exact, geometry=nothing))
    assert min(o.bounds_world[0, 2] for o in scene) == pytest.approx(0, abs=1e-9)
    assert outcome.report.fallbacks


# --- align --------------------------------------------------------------------------------------------------


def test_align_recovers_perturbed_assets(wrong: Scene):
    scene, outcome = align(wrong)
    assert visible_iou(wrong) < 0.9
    assert visible_iou(scene) > 0.95
    assert all(m.after >= m.before - 0.02 for m in outcome.measures if m.before is not None)


def test_align_of_a_heavy_mesh_is_that_of_its_outline_and_keeps_the_mesh(wrong: Scene):
    import trimesh

    from f3sr.core.mesh import Mesh

    def heavy(o):
        v, f = o.mesh.vertices, o.mesh.faces
        for _ in range(5):
            v, f = trimesh.remesh.subdivide(v, f)
        return replace(o, mesh=Mesh(vertices=v, faces=f))

    big = wrong.with_objects(*(heavy(o) for o in wrong))
    scene, _ = align(big, AlignConfig(search=SearchConfig(max_faces=1000), camera=False))
    light, _ = align(wrong, AlignConfig(camera=False))
    assert all(o.mesh is big[o.id].mesh for o in scene)
    assert visible_iou(scene) == pytest.approx(visible_iou(light), abs=0.02)


def test_align_leaves_a_perfect_scene_almost_alone(exact: Scene):
    levelled, _ = level(exact)
    scene, _ = align(levelled)
    assert visible_iou(scene) > 0.97


def test_align_never_accepts_what_the_picture_does_not_like(wrong: Scene):
    scene, _ = align(wrong, AlignConfig(search=SearchConfig(iterations=2), facets=FacetConfig(enabled=False)))
    assert visible_iou(scene) >= visible_iou(wrong)


# --- separate and settle ------------------------------------------------------------------------------------


def overlapping_stack() -> Scene:
    """The upper box sunk 2 cm into the lower, the lower 1 cm into the ground, a third 1 cm into its side."""
    low = box(0, size=(0.2, 0.2, 0.1), at=(0, 0, 0.04))
    up = replace(box(1, size=(0.08, 0.08, 0.08), at=(0.01, 0, 0.11)), supported_by=0)
    side = box(2, size=(0.1, 0.1, 0.1), at=(0.14, 0, 0.05))
    return scene_of(low, up, side)


@pytest.mark.parametrize("rays", [0.0, 0.1])
def test_separate_leaves_contact_but_no_overlap(rays: float):
    scene, outcome = separate(overlapping_stack(), SeparateConfig(max_ray_scale=rays))
    assert outcome.report.value("overlapping pairs") == 0
    low, up, side = scene
    assert low.bounds_world[0, 2] == pytest.approx(GAP, abs=1e-5)
    assert up.bounds_world[0, 2] == pytest.approx(low.bounds_world[1, 2] + GAP, abs=1e-4)
    assert measure(scene).N_cross == 0
    assert side.bounds_world[0, 0] - low.bounds_world[1, 0] == pytest.approx(GAP, abs=1e-4)


@pytest.mark.parametrize("error", [np.inf, 0.0004, 0.0])
def test_the_ground_moves_by_no_more_than_the_error_of_its_height(error: float):
    sunken = scene_of(*(box(k, at=(0.2 * k, 0, 0.03)) for k in range(3)))
    scene, _ = separate(replace(sunken, ground=replace(sunken.ground, height_error=error)))
    moved = float(scene.camera.center[2] - sunken.camera.center[2])
    assert moved == pytest.approx(min(0.02 + GAP, error), abs=1e-9)
    assert all(o.bounds_world[0, 2] == pytest.approx(GAP, abs=1e-5) for o in scene)


def matched(scene: Scene) -> Scene:
    """The scene ten times as fine, with every object's own silhouette as its mask."""
    camera = scene.camera.resized(640, 480)
    objects = tuple(replace(o, mask=full_silhouette(o, camera)) for o in scene)
    return replace(scene, camera=camera, objects=objects, photo=Photo(rgb=np.zeros((480, 640, 3), np.uint8)))


def test_moving_along_viewing_rays_changes_no_silhouette():
    before = matched(overlapping_stack())
    layout = Placement(before)
    layout.along_rays(tuple(o.id for o in before), 0.96)
    after = layout.moved_scene()
    for o in after:
        assert np.mean(full_silhouette(o, after.camera) != before[o.id].mask) < 1e-4
        assert o.scale == pytest.approx(0.96 * before[o.id].scale)


def test_what_sinks_into_its_support_comes_out_along_viewing_rays():
    low, up = box(0, size=(0.2, 0.2, 0.1), at=(0, 0, 0.045)), box(1, size=(0.08, 0.08, 0.08), at=(0.01, 0, 0.125))
    before = matched(scene_of(low, replace(up, supported_by=0, supports=(Support(id=0),))))
    after, _ = separate(before)
    for o in after:
        assert np.mean(full_silhouette(o, after.camera) != before[o.id].mask) < 2e-3
    assert after[1].scale != 1


@pytest.mark.parametrize("missing", [0, 1])
def test_what_misses_its_mask_moves_rather_than_what_matches_it(missing: int):
    scene = matched(scene_of(box(0, at=(-0.04, 0, 0.0503)), box(1, at=(0.04, 0, 0.0503))))
    both = separate(scene)[1].travel
    assert both[0] == pytest.approx(both[1], rel=0.1)
    one = scene.with_objects(replace(scene[missing], mask=np.roll(scene[missing].mask, 20, axis=0)))
    travel = separate(one)[1].travel
    assert travel[missing] > 5 * travel[1 - missing]


def test_what_overlaps_beside_its_main_support_goes_aside_not_up():
    """.04 m into its neighbour: also resting on it would mean lifting it by .06 m."""
    first, second = box(0, at=(0, 0, 0.05)), box(1, size=(0.06, 0.06, 0.06), at=(0.04, 0, 0.03))
    also = replace(second, supports=(Support(id=GROUND, share=0.6), Support(id=0, share=0.4)))
    scene, outcome = separate(scene_of(first, also), SeparateConfig(max_ray_scale=0.0))
    assert outcome.report.value("overlapping pairs") == 0
    assert scene[1].bounds_world[0, 2] == pytest.approx(GAP, abs=1e-5)
    assert [d.about for d in outcome.decisions if d.choice.startswith("beside object 0")] == [1]
    assert scene[1].supports == (Support(id=GROUND),)


def crate(id: int, *, width: float = 0.3, height: float = 0.12, wall: float = 0.02) -> SceneObject:
    """An open box on the ground, its walls and floor a convex part each."""
    middle, side = height / 2, (width - wall) / 2
    boards = [
        ((width, width, wall), (0, 0, wall / 2)),
        *(((wall, width, height), (x, 0, middle)) for x in (-side, side)),
        *(((width, wall, height), (0, y, middle)) for y in (-side, side)),
    ]
    hulls = [ConvexPart.hull_of(box_mesh(size).vertices + np.array(at)) for size, at in boards]
    starts = np.cumsum([0, *(len(h.vertices) for h in hulls)])
    mesh = Mesh(
        vertices=np.concatenate([h.vertices for h in hulls]),
        faces=np.concatenate([h.faces + k for h, k in zip(hulls, starts, strict=False)]),
    )
    return replace(box(id), mesh=mesh, T_world_object=pose(t=[0, 0, GAP]), parts=tuple(hulls))


@pytest.mark.parametrize("side", [(0.095, 0), (-0.095, 0), (0, 0.11), (0.095, 0.095)])
def test_what_reaches_into_the_wall_of_its_container_moves_inwards_and_not_onto_the_rim(side: tuple[float, float]):
    content = replace(box(1, size=(0.08, 0.08, 0.08), at=(*side, 0.062)), supported_by=0, supports=(Support(id=0),))
    from_above = pose(rotation_about([1, 0, 0], -0.8), [0, -0.9, 0.9]) @ T_UP_FROM_CAMERA
    K = np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]])
    camera = Camera(width=640, height=480, K=K, T_world_camera=from_above)
    objects = tuple(replace(o, mask=np.zeros((480, 640), bool)) for o in (crate(0), content))
    scene = Scene(photo=Photo(rgb=np.zeros((480, 640, 3), np.uint8)), camera=camera, objects=objects)
    scene, outcome = separate(measured(scene, "estimate"))
    assert outcome.report.value("overlapping pairs") == 0
    assert scene[1].bounds_world[0, 2] == pytest.approx(scene[0].bounds_world[0, 2] + 0.02 + GAP, abs=2e-3)
    assert np.linalg.norm(scene[1].bounds_world.mean(0)[:2] - side) < 0.04


def test_what_is_said_to_be_inside_but_stands_beside_is_parted():
    scene = scene_of(box(0), box(1, at=(0.06, 0, 0.05)))
    relation = Relation(subject=1, predicate="inside", object=0, confidence=1.0, evidence="test")
    after, outcome = separate(replace(scene, graph=SceneGraph(relations=(relation,), source="test")))
    assert outcome.report.value("overlapping pairs") == 0
    assert after[1].bounds_world[0, 2] == pytest.approx(GAP, abs=1e-4)


def interlocked() -> Scene:
    """Two crates, each with a wall through the other's floor: no short move parts them."""
    first, second = crate(0), crate(1)
    return scene_of(
        first, second.moved(pose(t=[0.05, 0.02, 0.04]), stage="test", reason=""), box(2, at=(0.05, 0.02, 0.12))
    )


def test_what_cannot_be_parted_is_lifted_and_told():
    """With what it carries; of two bodies the higher one, and nothing that is fixed."""
    scene = interlocked()
    scene = scene.with_objects(replace(scene[2], supported_by=1, supports=(Support(id=1),)))
    layout = Placement(scene)
    told = lift_out(layout, SeparateConfig())
    assert not layout.collisions()
    assert [d.about for d in told] == [1] and all(d.fallback for d in told)
    rises = [layout.moved_scene()[id].bounds_world[0, 2] - scene[id].bounds_world[0, 2] for id in (0, 1, 2)]
    assert rises[0] == pytest.approx(GAP, abs=1e-9) or rises[0] == 0
    assert rises[1] == pytest.approx(rises[2]) and rises[1] > 0.02


def test_what_is_fixed_is_not_lifted():
    scene = interlocked()
    held = Placement(scene.with_objects(*(replace(o, mobility="fixed") for o in scene)))
    assert not lift_out(held, SeparateConfig()) and held.collisions()
    below = Placement(scene.with_objects(replace(scene[1], mobility="fixed")))
    told = lift_out(below, SeparateConfig())
    assert 1 not in {d.about for d in told} and not below.collisions()


def test_plain_lift_is_exact_and_carries_the_stack():
    scene, _ = separate(overlapping_stack(), SeparateConfig(max_ray_scale=0.0))
    moved = {o.id: o.T_world_object[:3, 3] - overlapping_stack()[o.id].T_world_object[:3, 3] for o in scene}
    assert moved[0][2] == pytest.approx(0.01 + GAP, abs=1e-7)
    assert moved[1][2] == pytest.approx(0.03 + 2 * GAP, abs=1e-6)
    assert moved[1][:2] == pytest.approx(moved[0][:2], abs=1e-12), "what rests on an object goes with it"


def test_floating_objects_come_down_onto_their_support():
    floating = replace(box(1, size=(0.05, 0.05, 0.05), at=(0, 0, 0.2)), supported_by=0)
    scene, _ = separate(scene_of(box(0), floating), SeparateConfig(max_ray_scale=0.0))
    assert scene[1].bounds_world[0, 2] == pytest.approx(0.1 + 2 * GAP, abs=1e-5)


def overhanging(by: float) -> Scene:
    """A box on another, the middle of the upper one ``by`` [m] beyond the edge of the lower."""
    up = replace(box(1, size=(0.1, 0.1, 0.1), at=(0.05 + by, 0, 0.15)), supported_by=0)
    return scene_of(box(0), up)


def test_what_would_fall_by_a_little_is_shifted_until_it_rests():
    before = overhanging(0.004)
    assert settle(before)[0][1].motion[-1].rotation > 0.5
    scene, outcome = separate(before, SeparateConfig(max_ray_scale=0.0))
    margin = next(m for m in outcome.measures if m.name == "stability margin")
    assert margin.before is not None and margin.before < 0 < margin.after
    assert any(d.about == 1 and "shifted by" in d.choice for d in outcome.decisions)
    assert np.linalg.norm(settle(scene)[0][1].T_world_object[:3, 3] - scene[1].T_world_object[:3, 3]) < 1e-3


def test_a_stability_margin_that_nobody_asks_for_is_not_reported():
    _, outcome = separate(scene_of(box(0)), margin=False)
    assert outcome.margin is None
    assert [m.name for m in outcome.report.measures if m.about is None] == ["overlapping pairs", "ground moved"]


def test_what_no_shift_holds_is_told():
    config = SeparateConfig(max_ray_scale=0.0, balancing=BalanceConfig(max_shift=0.05))
    scene, outcome = separate(overhanging(0.04), config)
    assert any(d.about == 1 and "left to physics" in d.choice for d in outcome.decisions)
    assert scene[1].T_world_object[0, 3] == pytest.approx(0.09, abs=1e-9)


def test_fixed_objects_do_not_move():
    scene = overlapping_stack()
    fixed = replace(scene[2], mobility="fixed")
    after, _ = separate(scene.with_objects(fixed))
    assert np.array_equal(after[2].T_world_object, fixed.T_world_object)


def test_order_of_ids_does_not_matter_to_separation():
    scene = overlapping_stack()
    names = {0: 9, 1: 4, 2: 1}
    renamed = [replace(o, id=names[o.id], supported_by=names.get(o.supported_by, o.supported_by)) for o in scene]
    other = replace(scene, objects=tuple(sorted(renamed, key=lambda o: o.id)))
    a, b = separate(scene)[0], separate(other)[0]
    for o in a:
        assert np.allclose(o.T_world_object, b[names[o.id]].T_world_object, atol=1e-6)


def test_settle_brings_a_tilted_box_to_rest_and_says_how_far():
    tilted = box(0, at=(0, 0, 0.08), R=rotation_about([1, 0, 0], 0.2))
    scene, outcome = settle(scene_of(tilted))
    assert outcome.report.value("at rest") == 1
    assert scene[0].bounds_world[0, 2] == pytest.approx(0, abs=6e-4)
    assert scene[0].motion[-1].stage == "settle" and scene[0].motion[-1].rotation == pytest.approx(0.2, abs=0.02)
    result = measure(scene)
    assert result.K_max_J < 5e-5 and result.D_max_cm < 0.02, "pushed apart to the protocol's margin, no more"


def test_decompose_covers_every_vertex(wrong: Scene):
    scene, outcome = decompose(wrong)
    assert measure(scene).proxy_out_pct < 1e-6
    assert all(m.after == 1 for m in outcome.measures if m.name == "convex parts")


# --- laws over stages -----------------------------------------------------------------------------------------


def test_rotating_the_world_changes_no_image(wrong: Scene):
    T = pose(rotation_from_vector([0.4, -1.0, 2.0]), [3, -2, 1])
    turned = moved_world(wrong, T)
    a, b = (rasterizer.render(s.objects, s.camera) for s in (wrong, turned))
    assert np.mean(a.ids != b.ids) < 1e-3
    back = moved_world(turned, invert_pose(T))
    assert np.allclose(back[2].T_world_object, wrong[2].T_world_object, atol=1e-9)


def test_level_does_not_depend_on_the_provisional_world(exact: Scene):
    T = pose(T_UP_FROM_CAMERA[:3, :3] @ rotation_from_vector([0.1, 0.2, 0.3]))
    a, b = level(exact)[0], level(moved_world(exact, T))[0]
    assert a.camera.center[2] == pytest.approx(b.camera.center[2], abs=1e-9)
    for o in a:
        assert o.bounds_world[:, 2] == pytest.approx(b[o.id].bounds_world[:, 2], abs=1e-6)


def test_direct_composition_is_the_input_with_its_lowest_vertex_on_the_ground(wrong: Scene):
    direct = direct_composition(wrong, decompose(wrong)[0])
    assert min(o.bounds_world[0, 2] for o in direct) == pytest.approx(0, abs=1e-12)
    assert visible_iou(direct) == pytest.approx(visible_iou(wrong), abs=1e-3)
    both = evaluate(box_stack_scene(), None)
    assert both.direct is None and both.result.n == 3


def test_boxes_of_the_test_folder_are_at_rest():
    scene = scene_of(*boxes())
    assert measure(scene).N_cross == 0


def test_supports_after_settling_are_what_really_carries():
    """A beam across two blocks, claimed to lie on the ground, and a box beside, claimed to lie on the beam."""
    left, right = (box(k, size=(0.1, 0.1, 0.1), at=(x, 0, 0.0504)) for k, x in ((0, -0.2), (1, 0.2)))
    beam = box(2, size=(0.6, 0.08, 0.04), at=(0.05, 0, 0.1212))
    beside = replace(box(3, at=(0, 0.4, 0.0504)), supported_by=2)
    scene, outcome = settle(scene_of(left, right, beam, beside))
    shares = {s.id: s.share for s in scene[2].supports}
    # Levers: the centre is .25 m from the left block's middle and .15 m from the right one's.
    assert scene[2].supported_by == 1 and set(shares) == {0, 1}
    assert shares[1] == pytest.approx(0.625, abs=0.07)
    assert scene[3].supported_by == GROUND and [s.id for s in scene[0].supports] == [GROUND]
    assert any("rests on object 1, not on the ground" in d.choice for d in outcome.decisions)


def test_what_moves_when_it_is_released_is_a_fallback():
    resting, hanging = box(0, at=(0, 0, 0.05)), box(1, at=(0.4, 0, 0.06))
    assert not evaluate(scene_of(resting), None).report.fallbacks
    (told,) = evaluate(scene_of(resting, hanging), None).report.fallbacks
    assert told.choice == "kept although it moves when it is released"
    way = re.search(r"travels by (\S+) mm in 5 s, of 1 mm", told.reason)
    assert way and float(way[1]) == pytest.approx(10, abs=0.5), "the box falls by 10 mm, less the margins"


def test_a_release_that_is_lost_is_a_fallback_too():
    measured = evaluate(scene_of(box(0, at=(0, 0, 0.05))), None)
    lost = replace(measured, result=replace(measured.result, D_max_cm=float("nan")))
    assert lost.report.fallbacks
