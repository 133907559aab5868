"""Arguments of another kind to f3sr's public functions: one clear error of its own, and nothing is written."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import f3sr
from f3sr.play.goal_loop import Refusal
from f3sr.scene_package.package import Package
from goal_scene import goal_package

GOAL = "push the can 10 cm to the left"
_session = cache(f3sr.EditSession)
FOLDERS: dict[str, Callable[[Any], object]] = {
    "load": f3sr.load,
    "read_package": f3sr.read_package,
    "read_inputs": f3sr.read_inputs,
    "EditSession.open": f3sr.EditSession.open,
}
KINDS: dict[str, tuple[str, Callable[[Package, Path, Any], object]]] = {
    "simulate_goal": ("goal", lambda c, out, x: f3sr.simulate_goal(c, x)),
    "simulate_goal of no package": ("package", lambda c, out, x: f3sr.simulate_goal(x, GOAL)),
    "simulate_goal by words": ("language", lambda c, out, x: f3sr.simulate_goal(c, GOAL, language=x or 0)),
    "replay_plan": ("plan", lambda c, out, x: f3sr.replay_plan(c, x)),
    "success_rate": ("plan", lambda c, out, x: f3sr.success_rate(x, [c.scene])),
    "export_package": ("package", lambda c, out, x: f3sr.export_package(x, out, ["glb"])),
    "export_package to nowhere": ("out", lambda c, out, x: f3sr.export_package(c, x, ["glb"])),
    "export_package of a format": ("formats", lambda c, out, x: f3sr.export_package(c, out, [x])),
    "export_package of formats": ("formats", lambda c, out, x: f3sr.export_package(c, out, x)),
    "sample_scenes": ("count", lambda c, out, x: f3sr.sample_scenes(c, x)),
    "sample_scenes by a seed": ("seed", lambda c, out, x: f3sr.sample_scenes(c, 1, seed=x)),
    "deliver": ("result", lambda c, out, x: f3sr.deliver(x, out)),
    "certify": ("package", lambda c, out, x: f3sr.certify(x, out)),
    "certify by clients": ("clients", lambda c, out, x: f3sr.certify(c, out, clients=[x])),
    "film_played": ("package", lambda c, out, x: f3sr.film_played(x, x)),
    "film": ("played", lambda c, out, x: f3sr.Studio.of(c).film(x)),
    "write_package": ("scene", lambda c, out, x: f3sr.write_package(x, out)),
    "write_package to nowhere": ("out", lambda c, out, x: f3sr.write_package(c.scene, x)),
    "write_played": ("played", lambda c, out, x: f3sr.write_played(x, out)),
    "write_edited": ("session", lambda c, out, x: f3sr.write_edited(x, out)),
    "EditSession.add": ("edit", lambda c, out, x: _session(c).add(x)),
    "read_edits": ("file", lambda c, out, x: f3sr.read_edits(x)),
    "find": ("segmentation back end", lambda c, out, x: f3sr.SEGMENTERS.find(x)),
    **{name: ("folder", lambda c, out, x, call=call: call(x)) for name, call in FOLDERS.items()},
}
"""What an error names, and the call that makes it."""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("arguments") / "package")


@pytest.mark.parametrize("value", [None, 1.5, [5], {5: 5}], ids=str)
@pytest.mark.parametrize("name", KINDS)
def test_a_value_of_another_kind_is_one_clear_error(name: str, value: Any, package: Package, tmp_path: Path) -> None:
    where, call = KINDS[name]
    with pytest.raises(f3sr.InputError, match=f"^{where}: found .*; accepted: ."):
        call(package, tmp_path / "out", value)
    assert not list(tmp_path.iterdir())


def test_whole_numbers_of_numpy_are_counts(package: Package) -> None:
    for count in (np.int64(0), 0):  # no number of samples, but a number
        with pytest.raises(f3sr.InputError, match="count: found 0; accepted: from 1 to"):
            f3sr.sample_scenes(package, count)


def test_a_refused_goal_is_not_filmed_nor_written(package: Package, tmp_path: Path) -> None:
    refusal = f3sr.simulate_goal(package, "paint the can")
    assert isinstance(refusal, Refusal)
    for call in (f3sr.Studio.of(package).film, lambda played: f3sr.write_played(played, tmp_path / "out")):
        with pytest.raises(f3sr.InputError, match="played: found a value of type Refusal; accepted: a played goal"):
            call(refusal)


@pytest.mark.parametrize("value", [5, [5], {}, b"x"], ids=str)
def test_an_environment_names_its_argument(value: Any, package: Package) -> None:
    pytest.importorskip("gymnasium")
    from f3sr.env.scene_env import SceneEnv

    for options in ({"package": None}, {"package": value}, {"package": package, "samples": value}):
        with pytest.raises(f3sr.InputError, match=f"{list(options)[-1]}: found a value of type .*; accepted: a path"):
            SceneEnv(**options)
