"""Laws of bringing bodies to rest without a simulator: landing one after the other, and shifting what would fall."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import resting
import stacks
from bodies import GAP, block, body
from f3sr.contact import compounds
from f3sr.contact.static_bodies import bodies_of
from f3sr.contact.tipping import LandingConfig
from f3sr.physics import release


@pytest.mark.parametrize("seed", [4, 8, 12])
def test_tilted_stacks_lie_down_one_after_the_other_and_rest(seed: int) -> None:
    objects = stacks.stack(seed, spread=0.015, tilt=np.radians(3))
    found = resting.land_all(bodies_of(objects), {o.id: o.supported_by for o in objects})
    assert all(x.stands for x in found.landings.values())
    landed = [replace(o, T_world_object=found.motions[o.id] @ o.T_world_object) for o in objects]
    assert not any(
        compounds.collide(stacks.world_parts(a), stacks.world_parts(b)) for a in landed for b in landed if a.id < b.id
    )
    assert release.release(objects, seconds=1).D_max > 5e-3 > 1e-3 > release.release(landed, seconds=1).D_max


def test_rest_lands_and_shifts_until_all_stand() -> None:
    """Tilted bodies of which some would tip with what they carry: landing alone does not do, nor shifts alone."""
    objects = stacks.stack(14, spread=0.015, tilt=np.radians(3))
    bodies, supports = bodies_of(objects), {o.id: o.supported_by for o in objects}
    found = resting.rest(bodies, supports, LandingConfig(max_shift=0.15))
    assert not found.before.stands and found.after.stands and not found.tipped
    rested = [replace(o, T_world_object=found.motions[o.id] @ o.T_world_object) for o in objects]
    assert release.release(objects, seconds=1).D_max > 0.05
    assert release.release(rested, seconds=1).D_max < 1e-3


def test_rest_leaves_what_stands() -> None:
    bodies = [body(0, block(at=(0, 0, 0.05 + GAP))), body(1, block(at=(0, 0, 0.15 + 2 * GAP)))]
    found = resting.rest(bodies, {0: -1, 1: 0})
    assert all(np.allclose(T, np.eye(4), atol=1e-6) for T in found.motions.values()) and found.after.stands
