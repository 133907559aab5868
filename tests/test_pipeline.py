"""The whole way on a tiny folder: ids, skips, order, determinism, the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from f3sr import pipeline
from f3sr.core.mesh import Mesh
from f3sr.errors import InputError
from f3sr.io import inputs
from f3sr.pipeline import SKIPPABLE, Reconstruction, reconstruct
from f3sr.pipeline_config import Config
from f3sr.play.goal_loop import replay_plan, simulate_goal
from f3sr.proxies import ProxyConfig, decomposing
from f3sr.runtime.result_store import Store
from f3sr.scene import SceneGraph
from f3sr.scene_package.package import read_package, write_package
from f3sr.stages.evaluate import evaluate
from folders import write_folder
from scenes import visible_iou

IDS = [(2, "02_big_box.png"), (5, "05_small_box.png"), (7, "07_tall_box.png")]


def test_the_result_rests_free_and_looks_like_the_photo(whole: Reconstruction):
    assert whole.evaluation is not None and whole.evaluation.direct is not None
    ours, direct = whole.evaluation.result, whole.evaluation.direct
    assert ours.N_cross == 0 and ours.K_max_J < 3e-4 and ours.D_max_cm < 0.05 and ours.gap_pct < 1
    assert ours.mIoU_visible > max(0.9, direct.mIoU_visible)
    assert {o.id: o.supported_by for o in whole.scene} == {2: -1, 5: 2, 7: -1}


def test_ids_and_masks_survive_every_stage(given: inputs.Inputs, whole: Reconstruction):
    for scene in (whole.direct, whole.scene):
        assert [(o.id, o.mask_name) for o in scene] == IDS
        for o, i in zip(scene, given.instances, strict=True):
            assert np.array_equal(o.mask, i.mask) and o.label == i.label
            assert np.array_equal(o.mesh.faces, given.assets[o.id].mesh.faces)
        assert np.array_equal(scene.photo.rgb, given.photo.rgb)


@pytest.mark.parametrize("skip", [s for s in SKIPPABLE if s not in ("evaluate", "refine")])
def test_each_skipped_stage_leaves_a_valid_scene(given: inputs.Inputs, stages: Store, skip: str):
    quick = replace(Config(), refine=replace(Config().refine, rounds=0))
    result = reconstruct(given, quick, skip=[skip, "evaluate"], store=stages)
    assert [(o.id, o.mask_name) for o in result.scene] == IDS
    assert all(o.parts and np.isfinite(o.T_world_object).all() for o in result.scene)
    assert skip not in [r.stage for r in result.reports]
    assert visible_iou(result.scene) > 0.2


@pytest.mark.parametrize("skip", ["align", "align-objects", "separate", "settle"])
def test_what_was_skipped_does_not_come_back(given: inputs.Inputs, stages: Store, skip: str):
    result = reconstruct(given, skip=[skip, "evaluate"], store=stages)
    stages = [r.stage for r in result.reports]
    assert "refine" not in stages and ({"close", "coarsen"} <= set(stages)) == (skip != "settle")


def test_everything_skipped_is_direct_composition(given: inputs.Inputs):
    result = reconstruct(given, skip=[s for s in SKIPPABLE if s != "level"])
    assert all(np.array_equal(o.T_world_object, result.direct[o.id].T_world_object) for o in result.scene)


@pytest.mark.parametrize("skip", [SKIPPABLE, [s for s in SKIPPABLE if s != "decompose"]])
def test_proxies_are_begun_early_where_they_are_neither_skipped_nor_stored(
    given: inputs.Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, skip: list[str]
):
    begun: list[ProxyConfig] = []

    def counted(meshes: list[Mesh], config: ProxyConfig) -> Any:
        begun.append(config)
        return decomposing(meshes, config)

    monkeypatch.setattr(pipeline, "decomposing", counted)
    for _ in range(2):
        reconstruct(given, skip=skip, store=Store(tmp_path))
    assert len(begun) == ("decompose" not in skip)


def test_linear_algebra_takes_one_thread_whatever_was_set(given: inputs.Inputs):
    """So sums are the same on every machine; afterwards the setting is back."""
    inside: list[int] = []

    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    skip = [stage for stage in SKIPPABLE if stage != "level"]
    with threadpool_limits(2, user_api="blas"):
        reconstruct(given, skip=skip, seen=lambda *_: inside.extend(threads()))
        assert set(threads()) == {2}
    assert inside and set(inside) == {1}


def test_unknown_stages_are_refused(given: inputs.Inputs):
    with pytest.raises(InputError, match="polish"):
        reconstruct(given, skip=["polish"])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda _: reconstruct("table"), "inputs: found a path; accepted: f3sr.read_inputs(...)"),
        (lambda _: reconstruct(Path("table")), "inputs: found a path; accepted: f3sr.read_inputs(...)"),
        (lambda given: reconstruct(given, skip="refine"), "skip: found a text; accepted: a list of names"),
        (lambda _: inputs.read("table", ignore="ground"), "ignore: found a text; accepted: a list of names"),
        (lambda _: evaluate("table", None), "scene: found a path; accepted: f3sr.read_package(...).scene"),
        (
            lambda given: evaluate(given, None),
            "scene: found a value of type Inputs; accepted: f3sr.read_package(...).scene",
        ),
        (lambda _: simulate_goal("table", "push the box"), "package: found a path; accepted: f3sr.read_package(...)"),
        (lambda _: replay_plan(Path("table"), None), "package: found a path; accepted: f3sr.read_package(...)"),
    ],
)
def test_an_argument_of_another_kind_is_refused_by_name(given: inputs.Inputs, call: Any, message: str):
    with pytest.raises(InputError) as caught:
        call(given)
    assert str(caught.value) == message


def test_values_are_told_in_a_line(given: inputs.Inputs, whole: Reconstruction, tmp_path: Path):
    size = f"{given.photo.width}x{given.photo.height}"
    assert repr(given) == f"Inputs(3 masks, {size})"
    assert repr(whole.scene) == f"Scene(3 objects, {size})"
    assert repr(whole) == f"Reconstruction(3 objects, {size}, {len(whole.outcomes)} stages)"
    assert repr(whole.scene[2]) == f"SceneObject(2, {whole.scene[2].label!r})"
    out = write_package(replace(whole.scene, objects=whole.scene.objects[:1], graph=SceneGraph()), tmp_path / "out")
    assert repr(read_package(out)) == f"Package('{out}', 1 object, {size})"


def test_order_of_masks_and_names_of_files_change_nothing(whole: Reconstruction, tmp_path: Path):
    folder = tmp_path / "input"
    write_folder(folder, perturb=0.06, seed=3)
    document = json.loads((folder / "assets/poses.json").read_text())
    document["objects"].reverse()
    for o in document["objects"]:
        new = f"x{o['mesh']}"
        (folder / "assets" / o["mesh"]).rename(folder / "assets" / new)
        o["mesh"] = new
    (folder / "assets/poses.json").write_text(json.dumps(document))
    again = reconstruct(inputs.read(folder), skip=["evaluate"])
    for o in again.scene:
        assert np.array_equal(o.T_world_object, whole.scene[o.id].T_world_object)
        assert o.scale == whole.scene[o.id].scale


def test_motion_notes_add_up_to_the_way_from_input_to_result(whole: Reconstruction):
    for o in whole.scene:
        scale = np.prod([m.scale for m in o.motion])
        assert o.scale == pytest.approx(whole.direct[o.id].scale * scale)
        assert {m.stage for m in o.motion} <= {"align", "separate", "settle", "close", "coarsen"}


def test_reports_carry_units_and_reasons(whole: Reconstruction):
    assert [r.stage for r in whole.reports] == [
        "assemble", "level", "align", "relate", "decompose", "separate", "settle", "close", "refine",
        "coarsen", "describe", "uncertainty", "inpaint", "evaluate",
    ]  # fmt: skip
    for report in whole.reports:
        assert all(np.isfinite(m.after) for m in report.measures)
        assert all(d.choice and d.reason for d in report.decisions)
