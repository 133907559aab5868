"""Stored results: exact round trips, keys that name all they depend on, resumed runs equal to cold ones."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from f3sr import pipeline
from f3sr.core.mesh import ConvexPart
from f3sr.io import inputs
from f3sr.options import SKIPPABLE
from f3sr.physics.settling import SettleConfig
from f3sr.pipeline import Reconstruction, reconstruct
from f3sr.pipeline_config import Config
from f3sr.proxies import Excess
from f3sr.report import Outcome
from f3sr.runtime import scene_serialization
from f3sr.runtime.progress import silent
from f3sr.runtime.result_forms import PlainForm
from f3sr.runtime.result_store import Store, digest
from f3sr.runtime.stage_runner import Runner
from f3sr.scene import Motion
from f3sr.stages.decompose import Decomposed, ProxyFit
from f3sr.stages.evaluate import Evaluation
from f3sr.stages.settle import Settled, SettleStageConfig, settle
from folders import write_folder
from scenes import box_stack_scene, measured

STAGES = (
    *("assemble", "level", "align", "relate", "decompose", "separate", "settle", "close", "refine", "coarsen"),
    *("describe", "uncertainty", "evaluate", "inpaint"),
)


def test_a_scene_comes_back_exactly(tmp_path: Path):
    base = box_stack_scene()
    note = Motion(stage="test", translation=(0.1, 1 / 3, 0.0), rotation=0.7, scale=1.1, reason='ü "quoted"')
    foot = ConvexPart.hull_of(base[1].mesh.vertices - 1 / 7)
    moved = replace(base[1], scale=1 / 3, supported_by=None, motion=(note,), friction=0.123, footing=(foot,))
    changed = base.with_objects(moved)
    store = Store(tmp_path)
    store.save("key", *scene_serialization.pack(changed))
    found = store.load("key")
    assert found is not None
    scene = scene_serialization.unpack(base, *found)
    for a, b in zip(changed, scene, strict=True):
        assert np.array_equal(a.T_world_object, b.T_world_object) and a.scale == b.scale and a.motion == b.motion
        assert a.supported_by == b.supported_by and a.supports == b.supports and a.friction == b.friction
        assert all(np.array_equal(p.vertices, q.vertices) for p, q in zip(a.colliders, b.colliders, strict=True))
        assert len(a.footing) == len(b.footing)
    assert scene.graph == changed.graph and np.array_equal(scene.camera.T_world_camera, changed.camera.T_world_camera)


def test_a_zoomed_scene_comes_back_exactly():
    """`level` and `align` find the focal length: camera and geometry change with it."""
    base = measured(box_stack_scene(2), "estimate")
    assert base.geometry
    zoomed = replace(base, camera=base.camera.zoomed(1.07), geometry=base.geometry.zoomed(1.07))
    again = replace(
        zoomed, camera=zoomed.camera.zoomed(0.99), geometry=zoomed.geometry and zoomed.geometry.zoomed(0.99)
    )
    for origin, scene in ((base, zoomed), (base, again), (zoomed, again)):
        back = scene_serialization.unpack(origin, *scene_serialization.pack(scene))
        np.testing.assert_array_equal(back.camera.K, scene.camera.K)
        assert back.geometry and scene.geometry
        np.testing.assert_array_equal(back.geometry.points, scene.geometry.points)


def test_a_resumed_run_keeps_the_focal_length_that_level_found(shared_data: Path, tmp_path: Path):
    given = inputs.read(shared_data / "scenes" / "dev_07_scatter")
    store, others = Store(tmp_path), [stage for stage in SKIPPABLE if stage != "level"]
    cold, warm = (reconstruct(given, skip=others, store=store) for _ in range(2))
    assert "level" in warm.resumed
    assert cold.scene.camera.K[0, 0] != given.K[0, 0]
    np.testing.assert_array_equal(warm.scene.camera.K, cold.scene.camera.K)
    assert warm.scene.geometry and cold.scene.geometry
    np.testing.assert_array_equal(warm.scene.geometry.points, cold.scene.geometry.points)


def test_outcomes_come_back_exactly(whole: Reconstruction, tmp_path: Path):
    """Every value of every stage's outcome with its type, so that a resumed run writes the same bytes."""
    store = Store(tmp_path)
    assert {x.stage for x in whole.outcomes} == {*STAGES} - {"evaluate"} and whole.evaluation
    for value in (*whole.outcomes, whole.evaluation):
        form = PlainForm(type(value))
        store.save("key", *form.packed(value))
        found = store.load("key")
        assert found is not None and _text(form.unpacked(*found)) == _text(value)


def _text(value: Outcome | Evaluation) -> str:
    """1 and 1.0 differ in it."""
    return json.dumps(asdict(value), default=sorted)


def test_what_json_has_no_words_for_comes_back_too():
    drifts = {3: float("inf"), 1: float("nan"), 2: 1 / 3}
    fit = ProxyFit(
        parts=2, inflation=None, excess=Excess(mean=0.1, most=0.2, largest=0.3, at=(1.0, 2.0, 3.0)), outside=0.0
    )
    for outcome in (Settled(drifts=drifts, restless=frozenset({3, 1})), Decomposed(fits={7: fit})):
        form = PlainForm(type(outcome))
        found = form.unpacked(json.loads(json.dumps(form.packed(outcome)[0])), {})
        assert repr(found) == repr(outcome)


def test_a_skipped_stage_did_nothing():
    run = Runner("key", skip=["settle"], skippable=["settle"], store=None, progress=silent)
    scene = box_stack_scene()
    same, outcome = run.stage(Settled, settle, scene, SettleStageConfig())
    assert same is scene and outcome == Settled() and not outcome.restless and not run.outcomes


def test_damaged_and_missing_entries_are_none_and_made_anew(tmp_path: Path):
    store = Store(tmp_path)
    assert store.load("key") is None
    store.save("key", {"a": 1.5}, {"x": np.arange(3)})
    data = (tmp_path / "key.npz").read_bytes()
    for spoiled in (b"", data[: len(data) // 2], data.replace(b"1.5", b"9.5")):
        (tmp_path / "key.npz").write_bytes(spoiled)
        assert store.load("key") is None
    store.save("key", {"a": 1.5}, {"x": np.arange(3)})
    found = store.load("key")
    assert found is not None and found[0] == {"a": 1.5} and np.array_equal(found[1]["x"], [0, 1, 2])
    assert [p.name for p in tmp_path.iterdir()] == ["key.npz"]


def test_a_valid_archive_with_other_content_is_made_anew(given: inputs.Inputs, tmp_path: Path):
    """Of something else, of another stage, or the same but written by something else."""
    store, skip = Store(tmp_path), ["align", "refine", "evaluate", "inpaint"]
    cold = reconstruct(given, store=store, skip=skip)
    files = sorted(tmp_path.iterdir(), key=lambda p: p.stat().st_mtime_ns)
    np.savez(files[0], anything=np.zeros(3))
    files[1].write_bytes(files[2].read_bytes())
    with np.load(files[3]) as archive:
        np.savez(files[3], **archive)
    again = reconstruct(given, store=store, skip=skip)
    assert (
        again.resumed == ("relate", "separate", "settle", "close", "coarsen", "describe", "uncertainty")
        and again.reports == cold.reports
    )
    assert len(reconstruct(given, store=store, skip=skip).resumed) == len(cold.reports)


def test_a_store_without_a_folder_keeps_nothing():
    Store(None).save("key", {}, {})
    assert Store(None).load("key") is None


def test_a_store_that_cannot_write_keeps_nothing(tmp_path: Path):
    (tmp_path / "file").write_text("")
    store = Store(tmp_path / "file" / "below")
    store.save("key", {}, {})
    assert store.load("key") is None


def test_resumed_runs_give_exactly_what_cold_ones_give(given: inputs.Inputs, tmp_path: Path):
    store = Store(tmp_path)
    cold = reconstruct(given, store=store)
    assert cold.resumed == ()
    part_way = sorted(tmp_path.iterdir(), key=lambda p: p.stat().st_mtime_ns)[5:]
    for p in part_way:
        p.unlink()
    for expected in (STAGES[:5], STAGES):
        again = reconstruct(given, store=store)
        assert again.resumed == expected
        assert again.reports == cold.reports and again.evaluation == cold.evaluation
        assert again.outcomes == cold.outcomes
        for o in cold.scene:
            assert np.array_equal(o.T_world_object, again.scene[o.id].T_world_object)
            assert o.motion == again.scene[o.id].motion


def test_a_changed_setting_repeats_its_stage_and_what_follows(given: inputs.Inputs, tmp_path: Path):
    store = Store(tmp_path)
    quick = replace(Config(), refine=replace(Config().refine, rounds=0))
    reconstruct(given, quick, store=store, skip=["evaluate"])
    other = replace(quick, separate=replace(quick.separate, max_ray_scale=0.05))
    assert reconstruct(given, other, store=store, skip=["evaluate"]).resumed == (*STAGES[:5], "inpaint")
    assert reconstruct(given, quick, store=store, skip=["evaluate", "relate"]).resumed == (*STAGES[:3], "inpaint")


KINDS = {
    kind.stage: kind
    for kind in (
        *(pipeline.Assembled, pipeline.Levelled, pipeline.Aligned, pipeline.Related, pipeline.Decomposed),
        *(pipeline.Separated, pipeline.Settled, pipeline.Closed, pipeline.Refined, pipeline.Coarsened),
        *(pipeline.Described, pipeline.Uncertain),
    )
}


class Keys(Store):
    """Keeps nothing but the keys that it is asked for."""

    def __init__(self) -> None:
        super().__init__(None)
        self.asked: list[str] = []

    def load(self, key: str) -> None:
        self.asked.append(key)


@pytest.mark.parametrize("changed", [*STAGES[2:9]])
def test_keys_change_from_the_stage_on_whose_settings_change(
    changed: str, given: inputs.Inputs, monkeypatch: pytest.MonkeyPatch
):
    """``close``, ``refine`` and ``coarsen`` read settings of stages before them, so these are in their keys too."""
    field, value = {
        "align": ("max_yaw", 0.5), "relate": ("max_gap", 0.123), "decompose": ("max_parts", 7),
        "separate": ("max_ray_scale", 0.05), "settle": ("settling", SettleConfig(rounds=3)), "close": ("loss", 0.1),
        "refine": ("rounds", 1), "coarsen": ("worth", 0.5),
    }[changed]  # fmt: skip
    other = replace(Config(), **{changed: replace(getattr(Config(), changed), **{field: value})})
    assert equal_keys(other, given, monkeypatch) == [k < STAGES.index(changed) for k in range(12)]


def test_keys_change_from_refine_on_where_what_moves_cost_changes(
    given: inputs.Inputs, monkeypatch: pytest.MonkeyPatch
):
    """``refine`` and ``coarsen`` seek equilibria by the uncertainty of poses, whose stage comes after them."""
    other = replace(Config(), uncertainty=replace(Config().uncertainty, shape=0.03))
    assert equal_keys(other, given, monkeypatch) == [k < STAGES.index("refine") for k in range(12)]


def equal_keys(other: Config, given: inputs.Inputs, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Of every stage, in order, whether its key is that of the default settings; no stage does anything."""
    for name in STAGES[:12]:
        monkeypatch.setattr(pipeline, name, lambda scene, config, kind=KINDS[name], **_: (scene, kind()))
    runs = list[list[str]]()
    for chosen in (Config(), other):
        runs.append((keys := Keys()).asked)
        reconstruct(given, chosen, store=keys, skip=["evaluate", "inpaint"])
    return [a == b for a, b in zip(*runs, strict=True)]


def test_keys_name_every_byte_read(tmp_path: Path):
    write_folder(tmp_path / "a")
    write_folder(tmp_path / "b")
    key = inputs.read(tmp_path / "a").key
    assert inputs.read(tmp_path / "b").key == key, "the place does not matter"
    assert inputs.read(tmp_path / "a", ignore=["ground"]).key != key
    path = tmp_path / "b/assets/poses.json"
    path.write_bytes(path.read_bytes() + b" ")
    assert inputs.read(tmp_path / "b").key != key
    assert digest(1, "2") != digest("1", 2)
