"""Steps with the contacts of near parts only, against steps of the whole model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from f3sr.core.transforms import pose, rotation_about
from f3sr.physics.mujoco_model import DEFAULT_PHYSICS, MjSpec, build_spec, compiled, engine
from f3sr.physics.near_pairs import PAUSE, NearPairs
from f3sr.scene import SceneObject
from made_scenes import FAMILIES, objects_of
from scenes import box


def dropped(family: str, height: float, seed: int = 0) -> list[SceneObject]:
    """Objects of a family at random heights and tilts; the first one is fixed."""
    rng = np.random.default_rng(seed)
    objects = objects_of(FAMILIES[family](rng))
    for k, o in enumerate(objects):
        T = pose(rotation_about(rng.normal(size=3), height * rng.uniform()), [0, 0, height * rng.uniform()])
        mobility = "fixed" if k == 0 and height else o.mobility
        objects = (*objects[:k], replace(o, T_world_object=T @ o.T_world_object, mobility=mobility), *objects[k + 1 :])
    return list(objects)


def spec_of(objects: list[SceneObject]) -> MjSpec:
    return build_spec(objects, DEFAULT_PHYSICS)


@pytest.mark.parametrize("height", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_states_are_those_of_the_whole_model(family: str, height: float) -> None:
    objects = dropped(family, height)
    whole, near = compiled(spec_of(objects)), NearPairs(spec_of(objects), DEFAULT_PHYSICS)
    a, b = engine().MjData(whole), engine().MjData(near.model)
    contacts = 0
    for _ in range(400):
        engine().mj_step(whole, a)
        near.step(b)
        assert a.ncon == b.ncon and np.array_equal(a.qpos, b.qpos)
        contacts += a.ncon
    assert contacts


def test_a_stack_at_rest_is_stepped_with_one_list() -> None:
    objects = [box(0, at=(0, 0, 0.05)), box(1, at=(0, 0, 0.15))]
    near = NearPairs(spec_of(objects), DEFAULT_PHYSICS)
    data = engine().MjData(near.model)
    for _ in range(2 * PAUSE):
        near.step(data)
    pairs = {(int(a), int(b)) for a, b in zip(near.model.pair_geom1, near.model.pair_geom2, strict=True)}
    assert pairs == {(0, 0), (0, 1), (1, 2)} and not near.model.geom_contype.any()


def test_while_things_fall_all_parts_are_tested() -> None:
    objects = [box(0, at=(0, 0, 1.0))]
    near = NearPairs(spec_of(objects), DEFAULT_PHYSICS)
    data = engine().MjData(near.model)
    for _ in range(PAUSE):
        near.step(data)
    assert near.model.geom_contype.all()


def test_a_state_that_is_not_finite_is_stepped_as_the_whole_model() -> None:
    near = NearPairs(spec_of([box(0)]), DEFAULT_PHYSICS)
    data = engine().MjData(near.model)
    near.step(data)
    data.qpos[0] = np.nan
    near.step(data)
    assert near.model.geom_contype.all()
