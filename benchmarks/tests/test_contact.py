"""Laws of the contact benchmarks' own parts: the report's recipe, what counts as unstable, settings by name, scenes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ablation
import baseline
import contact as bench
import contact_report as report
import damping
import scan_things
import stress
import stress_judged as judged
import stress_scenes
import stress_things as things
from f3sr import pipeline
from f3sr.contact import compounds
from f3sr.contact.polytopes import Polytope
from f3sr.core.transforms import pose, rotation_about
from f3sr.pipeline_config import Config
from f3sr.report import Report
from f3sr.scene import GROUND, Scene
from scenes import box, box_stack_scene, scene_of


def overlaps(scene: Scene) -> bool:
    bodies = [[Polytope.of(p) for p in o.colliders_world] for o in scene]
    return any(compounds.collide(a, b) for i, a in enumerate(bodies) for b in bodies[:i])


# --- the report's recipe --------------------------------------------------------------------------------------------


def test_lift_is_the_least_that_parts_and_takes_what_rests_on_it() -> None:
    sunk = box_stack_scene(3)
    sunk = sunk.with_objects(*(replace(o, T_world_object=pose(t=[0, 0, -0.02]) @ o.T_world_object) for o in sunk))
    parted = report.separate(sunk)
    lifts = [float(b.bounds_world[0, 2] - a.bounds_world[0, 2]) for a, b in zip(sunk, parted, strict=True)]
    assert lifts == pytest.approx([0.02 + report.GAP] * 3, abs=2e-3)
    assert not overlaps(parted)


def test_what_floats_is_never_lowered() -> None:
    floating = scene_of(box(1, at=(0, 0, 0.2)))
    assert report.separate(floating)[1].bounds_world[0, 2] == pytest.approx(0.15)


def test_unrelated_overlaps_are_pushed_by_half_along_the_line_of_middles() -> None:
    scene = scene_of(box(1, at=(0, 0, 0.05)), box(2, at=(0.06, 0, 0.05)))
    parted = report.separate(scene)
    moves = [parted[k].middle - scene[k].middle for k in (1, 2)]
    assert moves[0] == pytest.approx([-(0.04 + report.GAP) / 2, 0, 0], abs=1e-6)
    assert moves[1] == pytest.approx(-moves[0], abs=1e-9)


def test_a_supported_object_is_left_behind_by_a_push() -> None:
    on_top = replace(box(3, size=(0.04, 0.04, 0.04), at=(0.06, 0, 0.1205)), supported_by=2)
    scene = scene_of(box(1, at=(0, 0, 0.05)), box(2, at=(0.06, 0, 0.05)), on_top)
    parted = report.separate(scene)
    assert parted[2].bounds_world[0, 0] > scene[2].bounds_world[0, 0] + 0.01
    assert parted[3].bounds_world[0, 0] == pytest.approx(scene[3].bounds_world[0, 0])


def test_its_physics_brings_a_box_down() -> None:
    settled = report.settle(scene_of(box(1, at=(0, 0, 0.06))))
    assert settled[1].bounds_world[0, 2] == pytest.approx(0, abs=1e-3)


# --- what counts as unstable ----------------------------------------------------------------------------------------


def test_a_box_at_rest_is_stable_and_one_over_the_edge_is_not() -> None:
    stable = damping.outcome(box_stack_scene(2), None)
    assert (stable["objects"], stable["unstable"]) == (2, 0)
    upper = replace(box(2, size=(0.1, 0.1, 0.1), at=(0.07, 0, 0.1505)), supported_by=1)
    falls = damping.outcome(scene_of(box(1, at=(0, 0, 0.05)), upper), None)
    assert falls["toppled"] >= 1 and falls["unstable"] >= 1


def test_tilt_leaves_out_the_vertical_and_slide_the_supports_own_move() -> None:
    scene = box_stack_scene(2)
    turned = replace(scene[1], T_world_object=pose(rotation_about([0, 0, 1], 1.0)) @ scene[1].T_world_object)
    assert damping.tilt(scene[1], turned) == pytest.approx(0, abs=1e-6)
    together = {o.id: replace(o, T_world_object=pose(t=[0.3, 0, 0]) @ o.T_world_object) for o in scene}
    assert damping.slide(scene[1], together, scene) == pytest.approx(0, abs=1e-6)
    alone = {**together, 0: scene[0]}
    assert damping.slide(scene[1], alone, scene) == pytest.approx(0.3 / 0.09, rel=1e-3)


def test_the_chart_shows_the_rates(tmp_path: Path) -> None:
    from PIL import Image

    damping.chart({"with damping": 2.0, "without damping": 20.0}, tmp_path / "a.png")
    pixels = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    blue, red = (np.count_nonzero((pixels == c).all(-1)) for c in ((0x3B, 0x6F, 0xB5), (0xC4, 0x56, 0x3D)))
    assert 8 * blue < red < 12 * blue


# --- the ablation ---------------------------------------------------------------------------------------------------


def test_settings_are_changed_by_their_names() -> None:
    assert ablation.configured(Config(), {"refine.rounds": 0}).refine.rounds == 0
    with pytest.raises(AttributeError, match="no setting wrong"):
        ablation.configured(Config(), {"align.wrong": 0})


def test_every_row_that_is_not_optional_can_be_run() -> None:
    for name, variant in ablation.ROWS.items():
        assert ablation.there_is(variant, name) or variant.optional
        assert {*variant.skip, *variant.instead} <= set(pipeline.SKIPPABLE)


def test_what_runs_in_place_of_a_stage_is_never_stored(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lifted(scene: Scene, _: object) -> tuple[Scene, Report]:
        return scene.with_objects(*(o.moved(pose(t=[0, 0, 1]), stage="test", reason="") for o in scene)), Report(
            stage="align"
        )

    def no_store() -> None:
        raise AssertionError("the store is used")

    product = pipeline.align
    monkeypatch.setattr(bench.Store, "default", no_store)
    skip = tuple(s for s in pipeline.SKIPPABLE if s not in ("level", "align"))
    found = ablation.run(folder, ablation.Variant(instead={"align": lifted}, skip=skip))
    for o in found.scene:
        assert o.bounds_world[0, 2] - found.direct[o.id].bounds_world[0, 2] == pytest.approx(1)
    assert pipeline.align is product


def test_rows_of_other_code_are_measured_anew(tmp_path: Path) -> None:
    kept = bench.Kept(tmp_path / "rows.json")
    kept.add("a", {"x": 1.0})
    assert bench.Kept(tmp_path / "rows.json").rows == {"a": {"x": 1.0}}
    assert bench.Kept(tmp_path / "rows.json", again=True).rows == {}
    (tmp_path / "rows.json").write_text(json.dumps({"code": "other", "rows": {"a": {"x": 1.0}}}))
    assert bench.Kept(tmp_path / "rows.json").rows == {}


# --- stress ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", ["tower", "planks", "overlaps", "dining", "shelf"])
def test_a_case_is_the_same_twice_and_starts_apart(case: str) -> None:
    first, second = (things.CASES[case](np.random.default_rng(1)) for _ in range(2))
    for a, b in zip(first.items, second.items, strict=True):
        assert np.array_equal(a.T_start, b.T_start)
    low = [float((item.T_start[:3, :3] @ p.T).T[:, 2].min() + item.at[2]) for item in first.items
           for p in item.shape.parts]  # fmt: skip
    assert min(low) > -1e-3, "nothing starts in the floor"


def test_places_of_scattered_scans_are_apart() -> None:
    places = np.array(scan_things.apart(np.random.default_rng(1), 8, half=0.25, gap=0.17))
    distances = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(8, 1)]
    assert places.shape == (8, 2) and np.abs(places).max() <= 0.25 and distances.min() > 0.17


def test_bounds_are_told_by_measure() -> None:
    row = dict.fromkeys(stress.BOUNDS, 0) | {"left_scene": [], "unnamed": [], "fixed": 0}
    assert list(stress.misses("a", row)) == []
    assert [line.split()[1] for line in stress.misses("a", row | {"unnamed": [[1, 2]], "gap_pct": 3.0})] == [
        "gap_pct",
        "unnamed",
    ]
    assert list(stress.misses("a", row | {"gap_pct": 3.0, "fixed": 1})) == []
    assert "FAILED" in next(stress.misses("a", {"failed": "killed"}))


def test_what_carries_most_may_be_missed() -> None:
    assert stress_scenes.most_carrying([0, 1, 2], [(1, 0), (2, 0), (2, 1), (0, -1), (3, 1)]) == 0
    assert stress_scenes.most_carrying([1, 2], [(1, 0), (2, 0), (2, 1)]) == 1
    assert stress_scenes.most_carrying([0], [(0, -1)]) is None


def test_containers_are_held_against_their_baseline() -> None:
    expected = baseline.read(stress.CONTAINERS_FILE)["containers"]
    assert len(expected.scenes) == sum(stress.CONTAINERS.values())
    rows = {name: {m: e.value for m, e in expected.measures.items()} for name in expected.scenes}
    assert not baseline.compare(expected, stress.means(rows)).problems
    rows["in_bowl_0"]["mIoU_visible"], rows["in_crate_0"]["mIoU_visible"] = 0.687, 0.53
    [problem] = baseline.compare(expected, stress.means(rows)).problems
    assert problem.startswith("mIoU_visible")


def test_a_decision_names_a_pair_by_their_ids() -> None:
    said = {"choice": "still overlaps object 12 after separation", "reason": "no free place found", "about": 3}
    assert judged.names(said, 3, 12) and judged.names(said, 12, 3)
    assert not judged.names(said, 3, 1) and not judged.names(said, 2, 12)


def test_what_goes_far_has_left_the_scene() -> None:
    start = scene_of(box(1, at=(0, 0, 0.05)), box(2, at=(0.4, 0, 0.05)))
    assert not judged.is_outside(np.array([0.45, 0, 0.0]), start)
    assert judged.is_outside(np.array([0.9, 0, 0.0]), start)
    gone = start.with_objects(replace(start[2], T_world_object=pose(t=[1.4, 0, 0.05])))
    assert judged.travels(gone, start)[2] == pytest.approx(1.0 / start.diagonal)
    assert start[1].supported_by == GROUND
