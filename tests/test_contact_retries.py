"""Objects brought to rest from other poses: what slides with a guessed friction, and what is told of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.contact_retries import ContactRetries
from f3sr.core.transforms import pose, rotation_about
from f3sr.pipeline_config import Config, with_shared_settings
from f3sr.scene import GROUND, Scene, SceneObject, Support
from f3sr.vision import rasterizer
from scenes import box, scene_of


def leaning(id: int, sign: int, *, degrees: float = 60.0) -> SceneObject:
    """One of two planks that lean on each other in the plane y = 0, with a label that tells wood's friction of .5."""
    long, thin = 0.18, 0.008
    R, a = rotation_about([0, 1, 0], sign * np.radians(degrees)), np.radians(degrees)
    at = [
        sign * (long * np.cos(a) / 2 + thin * np.sin(a) / 2 + 1e-4),
        0,
        (long * np.sin(a) + thin * np.cos(a)) / 2 + 2e-4,
    ]
    plank = box(id, size=(long, 0.05, thin), label="plank")
    on_ground = (Support(id=GROUND, share=1.0),)
    return replace(plank, T_world_object=pose(R, at), friction=0.5, supports=on_ground, supported_by=GROUND)


@pytest.fixture
def planks() -> Scene:
    scene = scene_of(leaning(0, -1), leaning(1, 1))
    ids = rasterizer.render(scene.objects, scene.camera).ids
    return scene.with_objects(*(replace(o, mask=ids == o.id) for o in scene))


@pytest.mark.parametrize("source", ["label", "given"])
def test_what_leans_in_the_photo_gets_the_friction_that_holds_it_unless_somebody_gave_one(planks: Scene, source: str):
    scene = planks.with_objects(*(replace(o, material_source=source) for o in planks))
    retries = ContactRetries(config=with_shared_settings(Config()))
    after = retries.balanced(scene, start=scene, moving=frozenset({0, 1}))
    assert not after.restless and min(after.ious.values()) > 0.98
    raised = source == "label"
    assert [o.friction for o in after.scene] == [0.8 if raised else 0.5] * 2
    assert all(("would slide" in o.material_reason) == raised for o in after.scene)
