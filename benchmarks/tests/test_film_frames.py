"""Frames of a film that the benchmark expects are those that the film has."""

from __future__ import annotations

from fractions import Fraction

import pytest

import film
from f3sr.film.footage import footage
from f3sr.film.studio import FilmConfig
from f3sr.goals.sequence import simulate
from f3sr.goals.verify import verify
from plans import plan_of
from scenes import box, scene_of


@pytest.mark.parametrize("offsets", [[], [{"id": 0, "translation": (0.0, 0.0, 0.2)}]], ids=["as it is", "lifted"])
def test_frames_are_those_of_the_footage(offsets: list[dict[str, object]]):
    scene, config = scene_of(box(0)), FilmConfig()
    plan = plan_of(scene, offsets=offsets)
    rollout = simulate(scene, plan)
    verdict = verify(scene, plan, rollout)
    shown = footage(
        scene, plan, rollout, verdict, Fraction(1), opening=config.opening, closing=config.closing
    ).rollout.time
    assert film.frames_of(plan.model_dump(), len(rollout.time)) == len(shown) > len(rollout.time)
    assert film.are_even(list(shown))
