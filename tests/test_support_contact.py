"""What a depth sensor measures outweighs generated shapes: distances hold, and a footing supplies a short underside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.contact.footing import supplied
from f3sr.physics.settling import settle
from f3sr.scene import GeometrySource, Scene, SceneObject
from f3sr.stages.close import CloseConfig, lowered
from f3sr.stages.separate import SeparateConfig, separate
from scenes import box, measured, scene_of

CLEARANCE = SeparateConfig().clearance


def hanging(height: float, source: GeometrySource = "sensor") -> Scene:
    """A box whose underside is ``height`` over the ground where the sensor sees its other sides."""
    return measured(scene_of(box(0, size=(0.2, 0.2, 0.1), at=(0, 0, 0.05 + height))), source)


def lowest(o: SceneObject) -> float:
    return float(o.vertices_world[:, 2].min())


def test_a_short_underside_gets_a_footing_where_a_sensor_knows_the_place():
    after, outcome = separate(hanging(0.008))
    (o,) = after.objects
    assert 0.006 < lowest(o) < 0.008, "between what the picture and what the underside tells"
    assert supplied(o) == pytest.approx(lowest(o) - CLEARANCE, abs=1e-4)
    assert min(p.moved(o.T_world_asset).vertices[:, 2].min() for p in o.footing) == pytest.approx(CLEARANCE, abs=1e-5)
    assert [d.choice for d in outcome.decisions] == ["given a footing"]


@pytest.mark.parametrize("height", [0.001, 0.003])
def test_a_mesh_meets_its_support_where_that_costs_little_of_the_picture(height: float):
    """A gap would show, and no pixel speaks for it."""
    after, _ = separate(hanging(height))
    assert lowest(after[0]) == pytest.approx(CLEARANCE, abs=2e-5)
    assert supplied(after[0]) == 0


def test_it_rests_where_it_was_put_and_close_does_not_lower_it():
    after, _ = separate(hanging(0.008))
    (o,) = after.objects
    rested = settle([o]).T_world_object[0]
    assert rested[2, 3] == pytest.approx(o.T_world_object[2, 3], abs=5e-4)
    assert lowered(after, CloseConfig())[0] is o


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(hanging(0.008, "estimate"), id="an estimate does not know the place"),
        pytest.param(replace(hanging(0.008), geometry=None), id="no geometry"),
    ],
)
def test_without_a_sensor_the_object_comes_down(scene: Scene):
    after, _ = separate(scene)
    assert lowest(after[0]) == pytest.approx(CLEARANCE, abs=2e-5)
    assert supplied(after[0]) == 0


def test_what_sinks_in_is_lifted_whatever_measured_it():
    for source in ("sensor", "estimate"):
        after, _ = separate(hanging(-0.004, source))
        assert lowest(after[0]) == pytest.approx(CLEARANCE, abs=2e-5)


def test_of_two_that_overlap_the_one_at_its_measured_distance_stays():
    """Two boxes behind one another overlap along the viewing ray; the depth map shows where the front one is."""
    scene = scene_of(box(0, at=(0, -0.04, 0.05)), box(1, at=(0, 0.04, 0.05), size=(0.1, 0.1, 0.2)))
    seen = measured(scene, "sensor")
    ray = np.array([0.0, 1.0])
    moved = {}
    for noise in (0.0, 0.02):
        geometry = seen.geometry
        assert geometry is not None
        off = 1 + noise * np.random.default_rng(0).standard_normal(geometry.valid.shape)
        points = np.where((seen[1].mask)[..., None], geometry.points * off[..., None], geometry.points)
        after, _ = separate(replace(seen, geometry=replace(geometry, points=points.astype(np.float32))))
        moved[noise] = [float((after[k].T_world_object - seen[k].T_world_object)[:2, 3] @ ray) for k in (0, 1)]
    assert abs(moved[0.02][0]) < abs(moved[0.0][0]), "the front box moves less where the other's distance is unknown"
    assert abs(moved[0.02][1]) > abs(moved[0.0][1])
