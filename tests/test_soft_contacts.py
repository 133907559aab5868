"""Soft contacts: what stands on stiff contacts only is seen to fall, and is delivered where it stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import Array, pose, rotation_about
from f3sr.metrics.contact_groups import SettledScene
from f3sr.physics.soft_contacts import soft_release
from f3sr.scene import Scene
from f3sr.stages import settle
from f3sr.stages.coarsen import SOFT_TRAVEL, CoarsenConfig, Coarsened, coarsen
from f3sr.vision import rasterizer
from scenes import box, box_mesh, box_stack_scene, scene_of

MARGINS = 3.2e-4
"""Distance [m] at which bodies rest."""


def rested(scene: Scene) -> SettledScene:
    after, outcome = settle.settle(scene)
    return SettledScene(scene=after, restless=outcome.restless)


def on_a_slope(slope: float, middle: float = 0.0) -> Scene:
    """A cube of 10 cm on a slab from -.5 to .5 m that rises along x. Its middle is at x = ``middle``."""
    lower, upper = box_mesh((1.0, 0.3, 0.3)), box_mesh((0.1, 0.1, 0.1))
    corners = lower.vertices - [0, 0, lower.vertices[:, 2].min()]
    top = (corners[:, 2] > 0)[:, None]
    slab = ConvexPart.hull_of(np.where(top, corners + corners[:, :1] * [0, 0, slope], corners))
    n: Array = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    R = np.column_stack([np.cross([0, 1, 0], n), [0, 1, 0], n])
    x = middle - 0.05 * n[0]
    at = np.array([x, 0, 0.3 + slope * x]) + n * (MARGINS - upper.vertices[:, 2].min())
    below = replace(box(0), mesh=lower, parts=(slab,), T_world_object=np.eye(4))
    above = replace(box(1), mesh=upper, parts=(upper.hull,), supported_by=0, T_world_object=pose(R, at))
    return rested(scene_of(below, above)).scene


def unmoved(scene: Scene, _moving: frozenset[int]) -> SettledScene:
    return SettledScene(scene=scene, restless=frozenset())


def coarsened(scene: Scene) -> tuple[Scene, Coarsened]:
    return coarsen(scene, CoarsenConfig(), made=scene, joins={}, settled=rested, balanced=unmoved)


def travel(before: Scene, after: Scene, id: int) -> float:
    return float(np.linalg.norm(after[id].bounds_world.mean(0) - before[id].bounds_world.mean(0)))


def test_what_stands_firmly_stays():
    scene = rested(box_stack_scene()).scene
    assert soft_release(scene.objects, SOFT_TRAVEL) == {}
    assert coarsened(scene)[1].decisions == ()


def test_what_creeps_over_an_edge_is_delivered_where_it_fell():
    """A middle 3 mm before the slab's edge: soft contacts creep by 6 mm."""
    scene = on_a_slope(0.5, middle=-0.497)
    assert not rested(scene).restless
    after, told = coarsened(scene)
    assert travel(scene, after, 1) > 0.02
    assert soft_release(after.objects, SOFT_TRAVEL) == {}
    assert [d.choice for d in told.decisions] == [f"moved by {1000 * travel(scene, after, 1):.0f} mm"]
    assert {m.stage for m in after[1].motion[len(scene[1].motion) :]} == {"coarsen"}


def test_what_would_fall_to_another_place_than_the_photo_shows_stays_and_is_told():
    scene = on_a_slope(0.5, middle=-0.497)
    ids = rasterizer.render(scene.objects, scene.camera).ids
    seen = scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))
    after, told = coarsened(seen)
    assert travel(seen, after, 1) < 1e-3
    assert [(d.about, d.choice, d.fallback) for d in told.decisions] == [(1, "stays", True)]


@pytest.mark.parametrize("slope", [0.1, 0.2, 0.4])
def test_creep_on_soft_contacts_grows_with_the_slope(slope: float):
    """By 12.4 mm in 5 s times its sine, beside .4 mm by which all sink."""
    scene = on_a_slope(slope)
    ends = soft_release(scene.objects, 1e-4)
    way = np.linalg.norm(ends[1][:3, 3] - scene[1].T_world_object[:3, 3])
    assert way == pytest.approx(0.0124 * np.sin(np.arctan(slope)) + 4.3e-4, rel=0.2)


def test_what_slides_wherever_it_is_stays_and_is_told():
    scene = on_a_slope(0.57)
    after, told = coarsened(scene)
    assert soft_release(scene.objects, SOFT_TRAVEL).keys() == {0, 1}
    assert travel(scene, after, 1) < 1e-3
    assert [(d.about, d.choice) for d in told.decisions] == [(1, "stays")]


@pytest.mark.parametrize(("rest", "stays"), [(0.009, False), (0.016, True)])
def test_what_creeps_by_millimetres_stays_where_it_would_rest_farther_off_the_photo(
    rest: float, stays: bool, monkeypatch: pytest.MonkeyPatch
):
    """Soft contacts move a beam by 9 mm. Where it then rests, it loses less than .05 of visible IoU, but maybe more."""
    scene = scene_of(box(0, size=(0.9, 0.1, 0.1), at=(0, 0.2, 0.05)))
    was = scene.camera
    camera = replace(was, width=10 * was.width, height=10 * was.height, K=was.K * [[10], [10], [1]])
    photo = replace(scene.photo, rgb=np.tile(scene.photo.rgb, (10, 10, 1)))
    beam = replace(scene[0], mask=rasterizer.render(scene.objects, camera).ids == 0)
    scene = replace(scene, photo=photo, camera=camera, objects=(beam,))

    def at(x: float) -> Array:
        return pose(t=np.array([x, 0, 0])) @ beam.T_world_object

    def settled(now: Scene) -> SettledScene:
        moved = now[0].T_world_object[0, 3] > 0
        return SettledScene(
            scene=now.with_objects(replace(now[0], T_world_object=at(rest if moved else 0.0))), restless=frozenset()
        )

    ends = [{0: at(0.009)}]

    def released(_objects: object, _far: float) -> dict[int, Array]:
        return ends.pop() if ends else {}

    monkeypatch.setattr("f3sr.stages.coarsen.soft_release", released)
    after, told = coarsen(scene, CoarsenConfig(), made=scene, joins={}, settled=settled, balanced=unmoved)
    assert after[0].T_world_object[0, 3] == pytest.approx(0.0 if stays else rest)
    assert [d.choice for d in told.decisions] == ["stays" if stays else "moved by 9 mm"]


def test_what_falls_lands_at_the_same_place_wherever_the_scene_is() -> None:
    """Euler's steps turn a body about its own origin; one at the scene's origin landed by centimetres elsewhere."""
    tipping = box(0, size=(0.1, 0.1, 0.4), at=(0, 0.3, 0.21), R=rotation_about([0, 1, 0], 0.35))
    landed = [
        soft_release([tipping.moved(pose(t=[d, 0, 0]), stage="settle", reason="")], 1e-2)[0][:3, 3] - [d, 0, 0]
        for d in (0.0, 3.0)
    ]
    assert np.allclose(*landed, rtol=0, atol=2e-3) and abs(landed[0][0]) > 0.1
