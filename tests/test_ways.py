"""Crowded objects come into contact by moves in space where lifts and horizontal moves would lose their masks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.contact import crowds
from f3sr.contact.compounds import collide, placed
from f3sr.core.transforms import pose
from f3sr.metrics.measures import visible_ious
from f3sr.scene import Scene, SceneObject, Support
from f3sr.stages.separate import SeparateConfig, separate
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
