"""What alignment finds again of scenes that were rendered from known places, and when it lets things be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from f3sr.core.camera import Camera
from f3sr.core.mesh import Mesh
from f3sr.core.resampling import resample
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose, rotation_about, rotation_angle
from f3sr.metrics.measures import visible_ious
from f3sr.scene import Geometry, Photo, Scene, SceneObject
from f3sr.stages.align import AlignConfig, align
from f3sr.stages.align.comparison import ObjectEvidence
from f3sr.stages.align.config import (
    AppearanceConfig,
    CameraConfig,
    DepthConfig,
    FacetConfig,
    OrientationConfig,
    TiltConfig,
)
from f3sr.stages.align.object_pose import align_object
from f3sr.vision import rasterizer
from f3sr.vision.crop import sampled, window_around
from f3sr.vision.motion_params import ObjectFreedom
from f3sr.vision.occlusion import Occluders, comparable_region
from f3sr.vision.photometric import Appearance
from f3sr.vision.silhouette import iou

WIDTH, HEIGHT = 320, 240
K = np.array([[300.0, 0, 158], [0, 300, 121], [0, 0, 1]])
CAMERA = Camera(
    width=WIDTH, height=HEIGHT, K=K,
    T_world_camera=pose(rotation_about([1, 0, 0], -0.45), [0, -0.9, 0.5]) @ T_UP_FROM_CAMERA,
)  # fmt: skip
OBJECTS_ONLY = AlignConfig(camera=False)
PLAIN = replace(
    OBJECTS_ONLY,
    tilt=TiltConfig(enabled=False),
    appearance=AppearanceConfig(enabled=False),
    orientations=OrientationConfig(enabled=False),
    facets=FacetConfig(enabled=False),
    depth=DepthConfig(enabled=False),
)
"""Equations 8 and 9 without any extension."""


def painted(shape: trimesh.Trimesh, *, rounds: int = 3) -> Mesh:
    """A finely split mesh with a pattern that looks different from every side."""
    for _ in range(rounds):
        shape = shape.subdivide()
    v = np.asarray(shape.vertices)
    x, y, z = (v / np.ptp(v, axis=0)).T
    waves = np.stack([np.sin(9 * x + 4 * y), np.sin(8 * y - 5 * z + 1), np.sin(7 * z + 6 * x + 2)], axis=1)
    return Mesh(
        vertices=v, faces=np.asarray(shape.faces, np.int32), vertex_colors=(127 + 120 * waves).round().astype(np.uint8)
    )


CAN = painted(trimesh.creation.cylinder(0.06, 0.14, sections=48))
BALL = painted(trimesh.creation.icosphere(subdivisions=2, radius=0.07), rounds=2)
BOX = painted(trimesh.creation.box((0.10, 0.16, 0.12)), rounds=5)
HAMMER = painted(
    trimesh.util.concatenate(
        [
            trimesh.creation.box((0.2, 0.02, 0.03)),
            trimesh.creation.box((0.03, 0.08, 0.05)).apply_translation((0.1, 0.01, 0.01)),
        ]
    ),
    rounds=4,
)
"""Different from every side, and thin: a wrong start does not even touch its mask."""

FENCE_GAP = 0.05
FENCE = painted(
    trimesh.util.concatenate([
        trimesh.creation.box((4 * FENCE_GAP, 0.012, 0.012)).apply_translation((0, 0, 0.02)),
        *(trimesh.creation.box((0.012, 0.012, 0.14)).apply_translation((k * FENCE_GAP, 0, 0)) for k in range(-2, 3)),
    ]),
)  # fmt: skip


def thing(id: int, mesh: Mesh, at: tuple[float, float, float], *, yaw: float = 0.3) -> SceneObject:
    return SceneObject(
        id=id, label="thing", mask_name=f"{id:02d}.png", mask=np.zeros((HEIGHT, WIDTH), bool), mesh=mesh,
        T_world_object=pose(rotation_about([0, 0, 1], yaw), at),
    )  # fmt: skip


def photographed(*objects: SceneObject) -> Scene:
    """The scene with the photo, the masks and the geometry that its camera would see."""
    fragments = rasterizer.render(objects, CAMERA)
    rgb = (255 * rasterizer.shade(fragments, objects)).round().astype(np.uint8)
    seen = np.isfinite(fragments.depth)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    depth = np.where(seen, fragments.depth, 0)
    points = np.stack([(x - K[0, 2]) / K[0, 0] * depth, (y - K[1, 2]) / K[1, 1] * depth, depth], axis=-1)
    return Scene(
        photo=Photo(rgb=rgb), camera=CAMERA, geometry=Geometry(points=points.astype(np.float32), valid=seen),
        objects=tuple(replace(o, mask=fragments.ids == o.id) for o in objects),
    )  # fmt: skip


def three_things() -> Scene:
    return photographed(
        thing(0, BOX, (-0.15, 0, 0.06)), thing(1, CAN, (0.0, 0.12, 0.07)), thing(2, BALL, (0.15, 0, 0.07))
    )


def disturbed(o: SceneObject, axis: Array, angle: float, *, shift: float = 0.0, scale: float = 1.0) -> SceneObject:
    """Turned and scaled about its middle, and shifted along the picture."""
    R, middle = rotation_about(axis, angle), o.bounds_world.mean(0)
    T = pose(R, middle - R @ (scale * middle) + shift * CAMERA.T_world_camera[:3, 0])
    return o.moved(T, scale=scale, stage="test", reason="disturbed")


def turn_between(a: SceneObject, b: SceneObject) -> float:
    """[deg]"""
    return float(np.degrees(rotation_angle(a.T_world_object[:3, :3] @ b.T_world_object[:3, :3].T)))


def aligned(scene: Scene, o: SceneObject, config: AlignConfig = OBJECTS_ONLY) -> SceneObject:
    return align(scene.with_objects(o), config)[0][o.id]


UP = np.array([0.0, 0, 1])
SIDEWAYS = np.array([1.0, 0, 0])


def test_the_report_s_freedom_finds_shift_yaw_and_scale() -> None:
    scene = photographed(thing(0, BOX, (0, 0, 0.06)))
    wrong = disturbed(scene[0], UP, np.radians(12), shift=0.02, scale=1.08)
    found = aligned(scene, wrong, PLAIN)
    assert turn_between(found, scene[0]) < 2
    assert found.scale == pytest.approx(1, abs=0.01)
    assert np.linalg.norm(found.bounds_world.mean(0) - scene[0].bounds_world.mean(0)) < 0.004


@pytest.mark.parametrize("mesh", [CAN, BALL], ids=["can", "ball"])
def test_the_photo_s_detail_tells_what_a_silhouette_is_blind_to(mesh: Mesh) -> None:
    scene = photographed(thing(0, mesh, (0, 0, 0.07)))
    wrong = disturbed(scene[0], UP, np.radians(25), shift=0.01)
    assert turn_between(aligned(scene, wrong), scene[0]) < 3
    assert turn_between(aligned(scene, wrong, PLAIN), scene[0]) > 10


def test_a_can_that_lies_is_turned_about_its_own_axis() -> None:
    lying = disturbed(thing(0, CAN, (0, 0, 0.06)), SIDEWAYS, np.pi / 2)
    scene = photographed(lying)
    wrong = disturbed(scene[0], lying.T_world_object[:3, 2], np.radians(24))
    assert turn_between(aligned(scene, wrong), scene[0]) < 4


def test_tilt_is_found_only_where_it_is_switched_on() -> None:
    scene = photographed(thing(0, BOX, (0, 0, 0.06)))
    wrong = disturbed(scene[0], SIDEWAYS, np.radians(6))
    no_facet = replace(OBJECTS_ONLY, facets=FacetConfig(enabled=False))
    assert turn_between(aligned(scene, wrong, no_facet), scene[0]) < 1.5
    assert turn_between(aligned(scene, wrong, replace(PLAIN)), scene[0]) > 4


def test_a_tilted_box_is_stood_on_its_facet() -> None:
    scene = photographed(thing(0, BOX, (0, 0, 0.06)))
    wrong = disturbed(scene[0], SIDEWAYS, np.radians(6))
    found = aligned(scene, wrong, replace(PLAIN, facets=FacetConfig()))
    assert found.T_world_object[2, 2] == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize(
    ("has_detail", "axis", "degrees"),
    [
        *((True, "z", 90), (True, "z", 180), (True, "x", 180), (True, "y", 180)),
        *((False, "z", 90), (False, "x", 180)),
    ],
    ids=lambda v: {True: "painted", False: "plain"}[v] if isinstance(v, bool) else str(v),
)
def test_an_object_that_came_the_wrong_way_round_is_found_in_every_orientation(
    has_detail: bool, axis: str, degrees: float
) -> None:
    mesh = HAMMER if has_detail else replace(HAMMER, vertex_colors=None)
    scene = photographed(thing(0, mesh, (0, 0.05, 0.025)))
    wrong = disturbed(scene[0], np.eye(3)["xyz".index(axis)], np.radians(degrees), shift=0.01, scale=0.95)
    assert turn_between(aligned(scene, wrong), scene[0]) < 3
    if degrees == 180:
        unsearched = replace(OBJECTS_ONLY, orientations=OrientationConfig(enabled=False))
        assert turn_between(aligned(scene, wrong, unsearched), scene[0]) > 30


def test_what_was_turned_is_fitted_again_as_it_may_lean_too() -> None:
    scene = photographed(thing(0, HAMMER, (0, 0, 0.04)))
    wrong = disturbed(disturbed(scene[0], UP, np.pi), SIDEWAYS, 0.2)
    assert turn_between(aligned(scene, wrong), scene[0]) < 3


@pytest.mark.parametrize("stretch", [(1.15, 1, 1), (1, 1.6, 1), (1, 1, 1.5)], ids=["longer", "wider", "higher"])
def test_a_wrong_shape_is_no_reason_for_another_orientation(stretch: tuple[float, float, float]) -> None:
    scene = photographed(thing(0, HAMMER, (0, 0.05, 0.025)))
    wrong = replace(scene[0], mesh=replace(HAMMER, vertices=HAMMER.vertices * stretch))
    found, report = align(scene.with_objects(wrong), OBJECTS_ONLY)
    assert any("another orientation" in d.choice for d in report.decisions)
    assert turn_between(found[0], scene[0]) < 20


def test_distance_comes_from_the_geometry() -> None:
    scene = photographed(thing(0, BALL, (0, 0, 0.07)))
    T = CAMERA.homothety(1.08)
    wrong = scene[0].moved(T, scale=1.08, stage="test", reason="farther, and as large to the eye")
    found = aligned(scene, wrong)
    assert found.scale == pytest.approx(1, abs=0.01)
    blind = align(replace(scene.with_objects(wrong), geometry=None), OBJECTS_ONLY)[0][0]
    assert blind.scale == pytest.approx(1.08, abs=0.02)


def test_a_geometry_that_does_not_know_moves_nothing() -> None:
    scene = photographed(thing(0, BALL, (0, 0, 0.07)))
    assert scene.geometry
    noise = np.random.default_rng(0).uniform(0.7, 1.5, scene.geometry.valid.shape)[..., None]
    vague = replace(scene, geometry=replace(scene.geometry, points=(scene.geometry.points * noise).astype(np.float32)))
    _, outcome = align(vague, OBJECTS_ONLY)
    assert not [d for d in outcome.decisions if "distance: accepted" in d.choice]
    assert any("does not tell its distance" in d.choice for d in outcome.decisions)


def _seen_by(scene: Scene, camera: Camera) -> Scene:
    return replace(scene, camera=camera, geometry=None)


def test_a_camera_that_is_off_is_found_again() -> None:
    scene = three_things()
    T = pose(rotation_about([0.3, 1, 0.2], np.radians(0.8)), [0.01, -0.008, 0.006])
    wrong = _seen_by(scene, CAMERA.moved(CAMERA.T_world_camera @ T))
    found, outcome = align(wrong, AlignConfig(objects=False))
    assert outcome.report.value("mean mask IoU") > 0.97
    assert np.linalg.norm(found.camera.center - CAMERA.center) < 0.01


@pytest.mark.parametrize("error", [np.inf, np.radians(1), 1e-4])
def test_the_camera_tilts_only_where_the_ground_is_less_sure_than_the_objects(error: float) -> None:
    """Three objects, whose poses lean by six degrees, tell gravity to three and a half."""
    scene = three_things()
    T = pose(rotation_about([1, 0, 0], 0.01) @ rotation_about([0, 0, 1], 0.01), [0.004, 0, 0.004])
    off = _seen_by(scene, scene.camera.moved(T @ scene.camera.T_world_camera))
    off = replace(off, ground=replace(off.ground, tilt_error=error, height_error=error), geometry=None)
    found, _ = align(off, AlignConfig(objects=False))
    before, after = off.camera.T_world_camera[2, :3], found.camera.T_world_camera[2, :3]
    turned = float(np.arccos(np.clip(before @ after, -1, 1)))
    assert found.camera is not off.camera, "the step was accepted"
    assert turned > 1e-3 if np.isinf(error) else turned < 1e-9


def test_a_focal_length_that_is_off_is_found_where_that_is_switched_on() -> None:
    scene = three_things()
    wrong = _seen_by(scene, CAMERA.zoomed(1.05))
    still = AlignConfig(objects=False, camera_step=CameraConfig(translation=1e-6, rotation=1e-6))
    assert align(wrong, still)[0].camera.K[0, 0] == wrong.camera.K[0, 0]
    found, _ = align(wrong, replace(still, camera_step=replace(still.camera_step, focal=True)))
    assert found.camera.K[0, 0] == pytest.approx(CAMERA.K[0, 0], rel=0.005)


def test_a_camera_that_the_geometry_contradicts_is_not_taken() -> None:
    """Objects that came too large ask for a camera farther away, which their depths speak against."""
    scene = three_things()
    grown = scene.with_objects(
        *(o.moved(pose(t=-0.08 * o.bounds_world.mean(0)), scale=1.08, stage="test", reason="") for o in scene)
    )
    seen, outcome = align(grown, AlignConfig(objects=False))
    assert seen.camera is grown.camera
    assert "camera: rolled back" in [d.choice for d in outcome.decisions]
    unknown, _ = align(replace(grown, geometry=None), AlignConfig(objects=False))
    assert unknown.camera is not grown.camera


# --- what came far from its mask -----------------------------------------------------------------------------------

FAR = {
    "a third": (0.35, (0, 0, 0), False),
    "beside the other one's": (1.3, (0.35, 0, 0), True),
    "ten times as large": (10.0, (0, 0, 0), True),
    "behind the camera": (1.0, (0, -1.4, 0.4), True),
    "outside of the picture": (1.0, (-3.0, 0, 0), True),
}
"""Factor on the size, shift [m], and whether it is sought at its mask from there."""


@pytest.mark.parametrize("way", FAR)
def test_what_came_far_from_its_mask_is_found(way: str) -> None:
    factor, shift, is_told = FAR[way]
    scene = photographed(thing(0, BOX, (-0.2, 0.1, 0.06)), thing(1, CAN, (0.1, 0, 0.07)))
    far = disturbed(scene[0], UP, 0.1, scale=factor).moved(pose(t=np.array(shift)), stage="test", reason="")
    after, outcome = align(scene.with_objects(far))
    assert visible_ious(after)[0] > 0.97
    assert visible_ious(after)[1] > 0.97
    assert np.linalg.norm(after[0].middle - scene[0].middle) < 0.01
    assert after[0].scale == pytest.approx(1, abs=0.05)
    sought = [d for d in outcome.decisions if d.about == 0 and d.fallback]
    assert bool(sought) == is_told
    assert all("sought at its mask" in d.choice for d in sought)


@pytest.mark.parametrize(("hidden_at", "width", "gaps"), [(0.1, 0.12, -1), (-0.06, 0.14, 1), (-0.06, 0.14, 0.8)])
def test_a_fence_that_is_hidden_in_part_and_off_by_a_gap_is_found(hidden_at: float, width: float, gaps: float) -> None:
    """Each shift by a gap is a local minimum, and the centroid of what shows is not the fence's."""
    fence, board = thing(0, FENCE, (0, 0.1, 0.07), yaw=0.15), painted(trimesh.creation.box((width, 0.02, 0.2)))
    scene = photographed(fence, thing(1, board, (hidden_at, -0.05, 0.1), yaw=0))
    after, outcome = align(scene.with_objects(disturbed(scene[0], UP, 0.08, shift=gaps * FENCE_GAP)), OBJECTS_ONLY)
    assert visible_ious(after)[0] > 0.93
    assert np.linalg.norm(after[0].middle - fence.middle) < 0.02
    assert not any(d.fallback for d in outcome.decisions)


def test_objects_off_their_masks_say_nothing_of_the_camera() -> None:
    scene = photographed(thing(0, BOX, (-0.2, 0.1, 0.06)), thing(1, CAN, (0.1, 0, 0.07)))
    away = scene[0].moved(pose(t=np.array([0.3, 0, 0])), stage="test", reason="")
    after, _ = align(scene.with_objects(away), AlignConfig(objects=False))
    assert np.allclose(after.camera.T_world_camera, CAMERA.T_world_camera, atol=2e-3)
    alone = replace(scene, objects=(away,))
    after, outcome = align(alone, AlignConfig(objects=False))
    assert after.camera is alone.camera
    assert [(d.choice, d.fallback) for d in outcome.decisions] == [("camera: stays as it came", True)]


# --- what cannot be aligned ----------------------------------------------------------------------------------------


def test_a_mask_of_something_else_leaves_an_object_as_it_came_and_is_told() -> None:
    scene = photographed(thing(0, BOX, (-0.25, 0.1, 0.06)), thing(1, CAN, (0.1, 0, 0.07)))
    noise = np.random.default_rng(0).random((HEIGHT, WIDTH)) < 0.05
    bad, other = replace(scene[0], mask=noise), disturbed(scene[1], UP, 0.0, shift=0.02)
    after, outcome = align(scene.with_objects(bad, other), OBJECTS_ONLY)
    assert np.array_equal(after[0].T_world_object, bad.T_world_object)
    assert after[0].scale == bad.scale
    assert any(d.about == 0 and d.fallback and "do not show the same thing" in d.reason for d in outcome.decisions)
    assert np.linalg.norm(after[1].middle - scene[1].middle) < 0.005


def test_an_object_that_nearer_ones_hide_stays_as_it_came() -> None:
    near, far = thing(0, BOX, (0, -0.2, 0.06)), thing(1, CAN, (0, 0.3, 0.07))
    scene = photographed(near, far)
    hidden = replace(scene[1], mask=scene[0].mask)
    after, outcome = align(scene.with_objects(hidden), OBJECTS_ONLY)
    assert np.array_equal(after[1].T_world_object, hidden.T_world_object)
    assert any(d.about == 1 and d.fallback and "nearer objects hide" in d.reason for d in outcome.decisions)


@pytest.mark.parametrize("way", [(0.02, -0.08, 0), (0.05, -0.1, -0.02), (-0.06, -0.06, 0)])
def test_what_hides_an_object_by_error_does_not_keep_it_from_its_mask(way: tuple[float, float, float]) -> None:
    """A book with another on it came too large and before its place on a desk, which does not hide it."""
    desk, book, cover = (
        thing(id, painted(trimesh.creation.box(size)), (0, 0, z))
        for id, size, z in ((0, (0.5, 0.4, 0.04), 0.02), (1, (0.16, 0.12, 0.04), 0.06), (2, (0.13, 0.09, 0.001), 0.08))
    )
    scene = photographed(desk, book, cover)
    came = scene[1].moved(pose(t=np.array(way)), scale=1.25, stage="test", reason="")
    hiding = Occluders(nearer=[scene[0], scene[2]], in_part=[])

    def found(scene: Scene) -> tuple[float, list[str]]:
        valid = comparable_region(came, hiding, scene)
        view = ObjectEvidence(scene=scene, hiding=hiding, valid=valid, textured=came.mesh)
        o, told = align_object(came, view, PLAIN)
        shown = rasterizer.render([scene[0], o, scene[2]], CAMERA).ids == o.id
        return iou(shown, o.mask), [d.choice for d in told]

    (unknown, _), (measured, told) = found(replace(scene, geometry=None)), found(scene)
    assert measured > unknown + 0.2
    assert "compared as if any other object but object 0 might hide it" in told


@pytest.mark.parametrize("ground", [True, False])
def test_what_something_without_a_mask_hides_is_found_as_with_the_mask_and_told(ground: bool) -> None:
    """A can behind a box that nobody outlined; the geometry shows the ground around them, or nothing there."""
    scene = photographed(thing(0, BOX, (-0.04, -0.12, 0.06)), thing(1, CAN, (0.02, 0.0, 0.07)))
    whole = rasterizer.render([scene[1]], CAMERA).ids == 1
    geometry = _over_ground(scene) if ground else scene.geometry
    came = scene[1].moved(pose(t=np.array([0.01, 0.005, 0])), scale=0.95, stage="test", reason="")
    bare, told = align(replace(scene, objects=(came,), geometry=geometry), OBJECTS_ONLY)
    assert iou(rasterizer.render([bare[1]], CAMERA).ids == 1, whole) > 0.97
    assert [d.about for d in told.decisions if "is not compared" in d.choice] == [1]
    both, told = align(replace(scene.with_objects(came), geometry=geometry), OBJECTS_ONLY)
    assert iou(rasterizer.render([both[1]], CAMERA).ids == 1, whole) > 0.97
    assert not [d for d in told.decisions if "is not compared" in d.choice]


def _over_ground(scene: Scene) -> Geometry:
    """The scene's geometry with the ground z = 0 where nothing is before it."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1], np.ones_like(x)], axis=-1)
    down = -rays @ CAMERA.T_world_camera[2, :3]
    assert scene.geometry and (down > 0).all(), "the ground is everywhere"
    points = np.where(
        scene.geometry.valid[..., None], scene.geometry.points, rays * (CAMERA.center[2] / down)[..., None]
    )
    return Geometry(points=points.astype(np.float32), valid=np.ones_like(scene.geometry.valid))


def test_an_object_that_fits_stays_where_others_are_believed_to_hide_less_of_it() -> None:
    """A box before a can: compared as if nothing hid the can, only a smaller one fits what shows of it."""
    scene = photographed(thing(0, BOX, (-0.04, -0.12, 0.06)), thing(1, CAN, (0.02, 0.0, 0.07)))
    silhouette = rasterizer.render([scene[1]], CAMERA).ids == 1
    assert np.mean(scene[0].mask[silhouette]) > 0.2, "the box hides much of the can"
    nothing = Occluders(nearer=[], in_part=[])
    view = ObjectEvidence(scene=scene, hiding=nothing, valid=np.ones((HEIGHT, WIDTH), np.bool_), textured=scene[1].mesh)
    o, told = align_object(scene[1], view, OBJECTS_ONLY)
    assert o is scene[1] and [d.choice for d in told] == ["stays, as any other object may hide it"]


def bowls(count: int, apart: float) -> Scene:
    """Bowls in each other."""
    ring = np.array(
        [(0, 0), (0.072, 0), (0.128, 0.04), (0.16, 0.1), (0.157, 0.1), (0.125, 0.043), (0.072, 0.003), (0, 0.003)]
    )
    bowl = painted(trimesh.creation.revolve(ring, sections=40), rounds=1)
    return photographed(*(thing(k, bowl, (0, 0, 0.001 + apart * k)) for k in range(count)))


@pytest.mark.slow
def test_a_bowl_that_leans_is_stood_upright_though_another_one_hides_most_of_it() -> None:
    scene = bowls(2, 0.02)
    found = aligned(scene, disturbed(scene[0], SIDEWAYS, 0.65))
    assert np.degrees(np.arccos(found.T_world_object[2, 2])) < 2


def test_bowls_in_bowls_find_their_places() -> None:
    """Three that came off by centimetres. Of the middle one a rim shows."""
    scene = bowls(3, 0.03)
    ways = (
        (0.055, -0.014, (-0.028, -0.029, 0.019)),
        (0.165, 0.006, (0.014, 0.003, 0.026)),
        (0.126, -0.03, (0.021, -0.028, 0.014)),
    )
    came = (
        disturbed(o, UP, yaw, shift=shift).moved(pose(t=np.array(way)), stage="test", reason="")
        for o, (yaw, shift, way) in zip(scene, ways, strict=True)
    )
    found, _ = align(scene.with_objects(*came), OBJECTS_ONLY)
    assert min(visible_ious(found).values()) > 0.95


def test_a_chair_whose_legs_miss_their_mask_is_turned_where_it_stands() -> None:
    """A board hides much of it, so neither its centroid nor its area tells where it is."""
    seat = [trimesh.creation.box(size).apply_translation(at) for size, at in (
        ((0.16, 0.14, 0.015), (0, 0, 0.15)), ((0.16, 0.012, 0.12), (0, 0.064, 0.21)),
    )]  # fmt: skip
    legs = [
        trimesh.creation.box((0.012, 0.012, 0.15)).apply_translation((x, y, 0.075))
        for x in (-0.07, 0.07)
        for y in (-0.06, 0.06)
    ]
    chair = painted(trimesh.util.concatenate([*seat, *legs]), rounds=2)
    board = painted(trimesh.creation.box((0.294, 0.01, 0.123)), rounds=1)
    scene = photographed(thing(0, chair, (0, 0.1, 0), yaw=4.86), thing(1, board, (-0.021, -0.1, 0.219), yaw=0))
    turned = disturbed(scene[0], UP, -0.873, shift=0.025, scale=0.932)
    blind = replace(OBJECTS_ONLY, appearance=AppearanceConfig(enabled=False))
    assert turn_between(aligned(scene, disturbed(turned, SIDEWAYS, -0.032), blind), scene[0]) < 2


def test_a_chair_that_fits_its_mask_is_turned_where_its_depths_contradict_the_geometry() -> None:
    """Boards hide its left and its top: turned by 100 degrees what shows of it looks the same."""
    parts = [((0.2, 0.2, 0.02), (0, 0, 0)), ((0.2, 0.02, 0.22), (0, 0.09, 0.11))]
    parts += [((0.02, 0.02, 0.2), (x, y, -0.1)) for x in (-0.09, 0.09) for y in (-0.09, 0.09)]
    solids = [trimesh.creation.box(size).apply_translation(at) for size, at in parts]
    board, post = (painted(trimesh.creation.box(size), rounds=1) for size in ((0.6, 0.02, 0.1), (0.21, 0.02, 0.3)))
    scene = photographed(
        thing(0, painted(trimesh.util.concatenate(solids), rounds=2), (0, 0.25, 0.2), yaw=0.4),
        thing(1, board, (0, 0, 0.244), yaw=0), thing(2, post, (0, -0.06, 0.1), yaw=0),
    )  # fmt: skip
    assert turn_between(aligned(scene, disturbed(scene[0], UP, -1.8, shift=-0.05)), scene[0]) < 15


@pytest.mark.parametrize(("mesh", "height"), [(CAN, 0.07), (BOX, 0.06)], ids=["can", "box"])
@pytest.mark.parametrize(("axis", "angle"), [(UP, np.pi), (UP, 1.9), (SIDEWAYS, np.pi)], ids=str)
def test_detail_tells_sides_that_look_alike(mesh: Mesh, height: float, axis: Array, angle: float) -> None:
    scene = photographed(thing(0, mesh, (0.05, 0, height)))
    came = disturbed(scene[0], axis, angle, shift=0.01, scale=1.05)
    assert turn_between(came, scene[0]) > 100
    assert turn_between(aligned(scene, came), scene[0]) < 3


def test_detail_that_is_no_worse_turns_nothing() -> None:
    """The photo shows another print than the mesh has: no side is like it."""
    scene = photographed(thing(0, CAN, (0.05, 0, 0.07)))
    other = replace(CAN, vertex_colors=np.random.default_rng(0).integers(0, 255, CAN.vertex_colors.shape, np.uint8))
    came = replace(disturbed(scene[0], UP, 0.05), mesh=other)
    assert turn_between(aligned(scene, came), scene[0]) < 45


def test_no_object_gets_a_worse_silhouette() -> None:
    scene = three_things()
    _, outcome = align(scene)
    most = AlignConfig().facets.loss
    assert all(m.after >= m.before - most for m in outcome.measures if m.before is not None and m.about is not None)


def test_what_the_border_of_the_photo_cuts_is_not_squeezed_into_it() -> None:
    whole = thing(0, BOX, (-0.54, 0.05, 0.06))
    scene = photographed(whole)
    assert scene[0].mask[:, 0].any(), "the box is cut by the left border"
    found = aligned(scene, disturbed(scene[0], UP, np.radians(4), shift=0.01), PLAIN)
    assert found.scale == pytest.approx(1, abs=0.03)
    assert np.linalg.norm(found.bounds_world.mean(0) - whole.bounds_world.mean(0)) < 0.015


def test_a_search_narrower_than_its_step_still_looks_to_both_sides() -> None:
    scene = photographed(thing(0, CAN, (0, 0, 0.07)))
    narrow = replace(OBJECTS_ONLY, appearance=AppearanceConfig(search=0.02, step=0.1))
    assert turn_between(aligned(scene, disturbed(scene[0], UP, 0.1), narrow), scene[0]) < 2


# --- laws ------------------------------------------------------------------------------------------------------------


def test_camera_and_world_moved_together_change_nothing() -> None:
    """But for the boxes along the world's axes that bounds are shares of."""
    scene = photographed(thing(0, BOX, (-0.1, 0, 0.06)), thing(1, CAN, (0.1, 0.1, 0.07)))
    wrong = scene.with_objects(*(disturbed(o, UP, 0.15, shift=0.01) for o in scene))
    T = pose(rotation_about(UP, 1.1), [0.3, -0.2, 0])
    objects = tuple(o.moved(T, stage="test", reason="") for o in wrong)
    turned = replace(wrong, camera=CAMERA.moved(T @ CAMERA.T_world_camera), objects=objects)
    for a, b in zip(align(wrong, OBJECTS_ONLY)[0], align(turned, OBJECTS_ONLY)[0], strict=True):
        assert np.allclose(T @ [*a.bounds_world.mean(0), 1], [*b.bounds_world.mean(0), 1], atol=5e-4)
        assert turn_between(a.moved(T, stage="test", reason=""), b) < 2


def test_the_order_of_ids_changes_nothing() -> None:
    places = [(BOX, (-0.1, 0, 0.06)), (CAN, (0.1, 0.1, 0.07))]
    scene = photographed(*(thing(k, m, at) for k, (m, at) in enumerate(places)))
    swapped = photographed(*(thing(k, m, at) for k, (m, at) in enumerate(reversed(places))))
    first, second = (
        align(s.with_objects(*(disturbed(o, UP, 0.15) for o in s)), OBJECTS_ONLY)[0] for s in (scene, swapped)
    )
    for id in (0, 1):
        assert np.allclose(first[id].T_world_asset, second[1 - id].T_world_asset, atol=1e-12)


# --- parts -----------------------------------------------------------------------------------------------------------


def test_the_appearance_s_gradient_is_that_of_central_differences() -> None:
    scene = photographed(thing(0, BALL, (0, 0, 0.07)))
    o = scene[0]
    window = window_around(o, CAMERA, 160)
    appearance = Appearance.of(scene.photo, CAMERA, window, sampled(o.mask, CAMERA, window, fill=False))
    freedom = ObjectFreedom(
        anchor=o.bounds_world.mean(0),
        basis=CAMERA.T_world_camera[:3, :2],
        reach=np.array([0.02, 0.02, 0.3, 0.3, 0.3, 0.2]),
    )

    def at(u: Array) -> SceneObject:
        T, s = freedom.similarity(u)
        return o.moved(T, scale=s, stage="test", reason="")

    u, h = np.array([0.1, -0.1, 0.15, -0.1, 0.1, 0.1]), 0.04
    velocities = freedom.velocities(u, CAMERA)
    found = appearance.mismatch(at(u), velocities)
    expected = np.array([
        (appearance.mismatch(at(u + h * e), velocities).value - appearance.mismatch(at(u - h * e), velocities).value)
        for e in np.eye(6)
    ]) / (2 * h)  # fmt: skip
    turns = slice(2, 5)  # the others also move the region that is compared, which the gradient takes as fixed
    assert np.allclose(found.gradient[turns], expected[turns], rtol=0.05, atol=0.01)
    assert np.linalg.norm(found.gradient - expected) < 0.2 * np.linalg.norm(expected)
    assert found.value == pytest.approx(1 - appearance.correlation(at(u)))
    assert appearance.correlation(o) > 0.98
    assert np.linalg.eigvalsh(found.curvature).min() > -1e-9


@pytest.mark.parametrize(
    ("shares", "alignments"), [((0.0, 0.0), 1), ((0.002, 0.004), 1), ((0.3, 0.3), 2), ((0.3, 0.0), 3)]
)
def test_what_is_compared_elsewhere_once_objects_are_aligned_is_aligned_again(
    shares: tuple[float, float], alignments: int, monkeypatch: pytest.MonkeyPatch
):
    """One object; after each alignment a share of its mask is found to be hidden."""
    scene = photographed(thing(0, BOX, (0, 0, 0.06)))
    rows, left = np.nonzero(scene[0].mask)[0], [0.0, *shares]

    def compared(o: SceneObject, *_: object) -> Array:
        valid = np.ones_like(o.mask)
        valid[: np.quantile(rows, left.pop(0)).astype(int)] = False
        return valid

    monkeypatch.setattr("f3sr.stages.align.comparable_region", compared)
    _, outcome = align(scene, PLAIN)
    fits = [d.choice for d in outcome.decisions if "object: " in d.choice]
    assert [c.startswith("again, ") for c in fits] == [False, True, True][:alignments]


def test_a_mask_that_is_lost_at_the_working_resolution_is_aligned_once_like_any_other():
    """Every other column of the photo is read at half of its width; the mask has the columns between."""
    scene = photographed(thing(0, BOX, (0, 0, 0.06)))
    coarse = replace(PLAIN, resolution=WIDTH // 2)
    read = resample(np.arange(WIDTH)[None], WIDTH // 2, 1)[0]
    between = np.setdiff1d(np.arange(WIDTH), read)
    mask = np.zeros_like(scene[0].mask)
    mask[:, between[len(between) // 2]] = scene[0].mask[:, WIDTH // 2]
    assert mask.any() and not resample(mask, WIDTH // 2, HEIGHT // 2).any()
    _, outcome = align(scene.with_objects(replace(scene[0], mask=mask)), coarse)
    assert [d.about for d in outcome.decisions if d.choice.startswith("again")] == []
