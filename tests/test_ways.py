"""Crowded objects come into contact by moves in space where lifts and horizontal moves would lose their masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.contact import crowds
from f3sr.contact.compounds import collide, placed
from f3sr.core.camera import Camera
from f3sr.core.mesh import ConvexPart, Mesh, union
from f3sr.core.transforms import T_UP_FROM_CAMERA, Array, pose, rotation_about
from f3sr.metrics.measures import visible_ious
from f3sr.scene import GROUND, Photo, Scene, SceneObject, Support
from f3sr.stages.separate import SeparateConfig, separate
from f3sr.stages.separate.placement import Placement
from f3sr.stages.separate.support_contact import seat
from scenes import box, box_mesh, measured, scene_of

CLEARANCE = SeparateConfig().clearance


def on(o: SceneObject, id: int) -> SceneObject:
    return replace(o, supports=(Support(id=id),), supported_by=id)


@pytest.fixture
def on_its_neighbours() -> Scene:
    """A box lies on two others on a tray and sinks into them by 2 mm; it is said to rest on the tray."""
    tray = box(0, size=(0.4, 0.3, 0.02), at=(0, 0, 0.01))
    left, right = (on(box(k, size=(0.08, 0.08, 0.08), at=(x, 0, 0.06)), 0) for k, x in ((1, -0.06), (2, 0.06)))
    top = on(box(3, size=(0.1, 0.08, 0.06), at=(0, 0, 0.128)), 0)
    return measured(scene_of(tray, left, right, top), "estimate")


def test_what_lies_on_its_neighbours_is_not_lowered_through_them(on_its_neighbours: Scene):
    after, outcome = separate(on_its_neighbours)
    assert outcome.overlaps[1] == 0
    assert np.mean(list(visible_ious(after).values())) > 0.9
    moved = [o.T_world_object[:3, 3] - on_its_neighbours[o.id].T_world_object[:3, 3] for o in after]
    assert np.linalg.norm(moved, axis=1).max() < 0.01
    assert any("in space" in d.choice for d in outcome.decisions)


def pot(id: int, T: Array, *, carrier: int = GROUND) -> SceneObject:
    """A pot of twelve walls and a bottom, 28 cm wide at its rim."""
    sides, (bottom, top, height, wall) = 12, (0.0722, 0.14, 0.074, 0.006)
    a = 2 * np.pi * np.arange(sides + 1) / sides
    low, high, low_inside, high_inside = (
        np.c_[r * np.cos(a), r * np.sin(a), np.full(sides + 1, z)]
        for r, z in ((bottom, 0), (top, height), (bottom - wall, 0), (top - wall, height))
    )
    walls = [
        ConvexPart.hull_of(np.concatenate([ring[k : k + 2] for ring in (low, high, low_inside, high_inside)]))
        for k in range(sides)
    ]
    floor = ConvexPart.hull_of(np.concatenate([low, low + np.array([0, 0, wall])]))
    parts = (*walls, floor)
    vertices, faces = union(parts)
    mesh = Mesh(vertices=vertices, faces=np.asarray(faces, np.int32))
    return on(replace(box(id), mesh=mesh, parts=parts, T_world_object=T), carrier)


def nested(inner: Array) -> Scene:
    """A pot in a pot, of which only a rim shows."""
    scene = scene_of(pot(0, np.eye(4)), pot(1, inner, carrier=0))
    K = np.array([[600.0, 0, 160], [0, 600, 120], [0, 0, 1]])
    T = pose(rotation_about([1, 0, 0], -0.45), [0, -0.9, 0.5]) @ T_UP_FROM_CAMERA
    photo, mask = Photo(rgb=np.zeros((240, 320, 3), np.uint8)), np.zeros((240, 320), np.bool_)
    seen = replace(
        scene,
        photo=photo,
        camera=Camera(width=320, height=240, K=K, T_world_camera=T),
        objects=tuple(replace(o, mask=mask) for o in scene),
    )
    return measured(seen, "estimate")


def test_what_is_nested_does_not_leave_its_place_along_a_viewing_ray():
    """Along viewing rays its silhouette would stay, but what it hides would not."""
    after, outcome = separate(nested(pose(rotation_about([-0.03, -0.008, -0.007], 0.032), [0.004, 0, 0.021])))
    assert outcome.overlaps[1] == 0
    assert any("near their places" in d.choice for d in outcome.decisions)
    assert min(visible_ious(after).values()) > 0.9


def test_what_came_hidden_by_what_it_overlaps_may_lose_what_it_would_show(monkeypatch: pytest.MonkeyPatch):
    """A pot that came too far and sunk shows nothing. What it shows after lifts is a gain, and too little."""
    scene = nested(pose(rotation_about([-0.05, -0.008, -0.007], 0.082), [0.004, 0, 0.015]))
    came = scene[1].moved(scene.camera.homothety(1.02), scale=1.02, stage="test", reason="")
    sunk, reaches = scene.with_objects(came), set[float]()

    def noted(layout: Placement, config: SeparateConfig, **options: bool) -> None:
        reaches.add(config.max_ray_scale)
        seat(layout, config, **options)

    monkeypatch.setattr("f3sr.stages.separate.ways.seat", noted)
    after, _ = separate(sunk)
    was, now = (np.mean([*visible_ious(s).values()]) for s in (sunk, after))
    assert was < now < 0.95
    assert reaches == {SeparateConfig().max_ray_scale, min(reaches)} and len(reaches) == 2


def test_a_group_that_keeps_its_masks_goes_by_lifts(on_its_neighbours: Scene):
    _, outcome = separate(replace(on_its_neighbours, objects=on_its_neighbours.objects[:3]))
    assert not any("in space" in d.choice for d in outcome.decisions)


def cubes(*at: tuple[float, float, float]):
    part = box_mesh((0.1, 0.1, 0.1)).hull
    return {k: placed([part], pose(t=t)) for k, t in enumerate(at)}


def test_a_crowd_parts_through_the_nearest_sides():
    """The upper cube leaves upwards, although horizontal moves would be free too, and both share the way."""
    bodies = cubes((0, 0, 0.2), (0, 0.03, 0.296))
    found = crowds.spread(bodies, dict.fromkeys(bodies, np.eye(3)), clearance=CLEARANCE)
    assert found.solved
    up = (0.004 + CLEARANCE) / 2
    np.testing.assert_allclose(found.shifts[0], [0, 0, -up], atol=1e-6)
    np.testing.assert_allclose(found.shifts[1], [0, 0, up], atol=1e-6)
    assert found.cost == pytest.approx(2 * up**2, rel=1e-4)


def test_what_has_no_weight_stays_and_nothing_sinks_into_the_ground():
    bodies = cubes((0, 0, 0.049), (0, 0, 0.148))
    found = crowds.spread(bodies, {1: np.eye(3)}, clearance=CLEARANCE)
    assert set(found.shifts) == {1}
    np.testing.assert_allclose(found.shifts[1], [0, 0, 0.001 + CLEARANCE], atol=1e-6)
    alone = crowds.spread({0: bodies[0]}, {0: np.eye(3)}, clearance=CLEARANCE)
    np.testing.assert_allclose(alone.shifts[0], [0, 0, 0.001 + CLEARANCE], atol=1e-6)


def test_moves_that_are_cheap_are_preferred():
    """Two cubes that overlap as much along x as along y part along the cheaper axis."""
    bodies = cubes((0, 0, 0.2), (0.096, 0.096, 0.2))
    found = crowds.spread(bodies, dict.fromkeys(bodies, np.diag([1.0, 100.0, 1.0])), clearance=CLEARANCE)
    assert abs(found.shifts[1][1]) < 1e-6 < found.shifts[1][0]


def test_a_floor_of_many_parts_is_left_upwards():
    """Each part alone could be left sideways, into the next one."""
    tile = box_mesh((0.02, 0.02, 0.02)).hull
    floor = [tile.moved(pose(t=[0.02 * i, 0.02 * j, 0.01])) for i in range(-5, 6) for j in range(-5, 6)]
    bodies = {0: placed(floor, np.eye(4)), 1: placed([box_mesh((0.07, 0.07, 0.07)).hull], pose(t=[0.003, 0, 0.051]))}
    found = crowds.spread(bodies, {1: np.eye(3)}, clearance=CLEARANCE)
    assert found.solved
    np.testing.assert_allclose(found.shifts[1], [0, 0, 0.004 + CLEARANCE], atol=1e-5)
    assert not collide(bodies[0], bodies[1].moved(pose(t=found.shifts[1])))
