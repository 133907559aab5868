"""Edits: laws of what they move and what they leave, undo to the byte, hostile lists, and the command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.cli.main import main
from f3sr.core.transforms import rotation_angle
from f3sr.delivery import deliver
from f3sr.edits import (
    EditOutcome,
    EditSession,
    deliver_edited,
    edit_of,
    edit_session,
    edited_document,
    edited_files,
    edits_json,
    read_edits,
    write_edited,
)
from f3sr.edits.edit_list import MAX_EDITS, edits_digest
from f3sr.errors import InputError, OutputError
from f3sr.physics.mujoco_model import body_of
from f3sr.pipeline import Reconstruction
from f3sr.scene import GROUND, Scene, SceneObject
from f3sr.scene_package.package import Package, read_package, write_package
from resting_boxes import resting_boxes

NEAR = 1e-3
"""[m] by which physics moves what rests where it is put."""


@pytest.fixture(scope="module", autouse=True)
def measured_once() -> Iterator[None]:
    """Every session begins by measuring its scene: sessions of one package share that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(edit_session, "_measured_base", cache(edit_session._measured_base))
        yield


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return resting_boxes(tmp_path_factory.mktemp("packages") / "table")


@pytest.fixture
def relabelled(package: Package, tmp_path: Path) -> Path:
    """An edited package that a test may break."""
    folder = tmp_path / "edited"
    shutil.copytree(_relabelled(package), folder)
    return folder


@cache
def _relabelled(package: Package) -> Path:
    session = session_after(package, {"kind": "label", "id": 2, "to": "a"})
    return write_edited(session, package.folder.with_name("relabelled"))


@pytest.fixture(scope="module")
def untouched(package: Package) -> EditSession:
    """A session that no test adds to."""
    return EditSession(package)


def edit(kind: str, scene: Scene, id: int, **values: Any):
    return edit_of({"kind": kind, "id": id, "label": scene[id].label, **values})


def session_after(package: Package, *edits: Mapping[str, Any]) -> EditSession:
    """A session with edits of objects by the labels that they have then."""
    session = EditSession(package)
    for given in edits:
        session.add(edit(scene=session.scene, **given))
    return session


def away(a: SceneObject, b: SceneObject) -> float:
    """Distance [m] between the middles of an object in two scenes."""
    return float(np.linalg.norm(a.bounds_world.mean(0) - b.bounds_world.mean(0)))


def turned(a: SceneObject, b: SceneObject) -> float:
    return rotation_angle(a.T_world_object[:3, :3] @ b.T_world_object[:3, :3].T)


def require_rest(outcome: EditOutcome) -> None:
    assert outcome.done
    assert outcome.measures.N_cross == 0
    assert outcome.measures.D_max_cm < 0.1


def told(outcome: EditOutcome) -> str:
    return "; ".join(d.choice for d in outcome.decisions if d.fallback)


# --- laws -------------------------------------------------------------------------------------------------------------


def test_without_edits_the_document_is_the_package_s_own(package: Package, untouched: EditSession):
    files = dict(edited_files(untouched))
    assert files["scene.json"] == (package.folder / "scene.json").read_bytes()
    assert not [name for name in files if name.startswith(("unedited", "edits"))]


def test_what_is_moved_and_moved_back_rests_where_it_was(package: Package):
    there, back = {"by": (0.1, 0.05, 0.0)}, {"by": (-0.1, -0.05, 0.0)}
    session = session_after(package, {"kind": "move", "id": 2, **there}, {"kind": "move", "id": 2, **back})
    require_rest(session.outcome)
    assert away(session.scene[2], package.scene[2]) < NEAR
    assert not told(session.outcome)


def test_only_what_is_touched_moves(package: Package):
    """Not by a bit: the others are the very same values, and have the same records."""
    session = session_after(package, {"kind": "move", "id": 2, "by": (0.05, 0.0, 0.0)})
    assert session.outcome.moved == {2}
    assert all(session.scene[id] is package.scene[id] for id in (0, 1, 3))
    before, now = (edited.objects for edited in (package.document, edited_document(session)))
    assert [a == b for a, b in zip(before, now, strict=True)] == [True, True, False, True]


def test_an_object_takes_along_what_it_carries(package: Package):
    session = session_after(package, {"kind": "move", "id": 0, "by": (0.0, 0.2, 0.0)})
    require_rest(session.outcome)
    for id in (0, 1):
        shift = session.scene[id].bounds_world.mean(0) - package.scene[id].bounds_world.mean(0)
        np.testing.assert_allclose(shift, [0, 0.2, 0], atol=NEAR)
    assert session.scene[1].supported_by == 0


@pytest.mark.parametrize("degrees", [360.0, -360.0, 0.0])
def test_a_whole_turn_is_none(package: Package, degrees: float):
    session = session_after(package, {"kind": "turn", "id": 2, "axis": (0.3, 0.2, 0.5), "degrees": degrees})
    require_rest(session.outcome)
    assert away(session.scene[2], package.scene[2]) < NEAR
    assert turned(session.scene[2], package.scene[2]) < 1e-3


def test_a_turn_about_the_vertical_turns_as_asked(package: Package):
    session = session_after(package, {"kind": "turn", "id": 0, "axis": (0, 0, 1), "degrees": 40.0})
    require_rest(session.outcome)
    for id in (0, 1):
        assert np.degrees(turned(session.scene[id], package.scene[id])) == pytest.approx(40, abs=0.5)
    assert not told(session.outcome)


def test_what_is_put_into_the_air_falls_and_that_is_told(package: Package):
    outcome = session_after(package, {"kind": "move", "id": 2, "by": (0.0, 0.1, 0.032)}).outcome
    require_rest(outcome)
    assert told(outcome) == "edit 1: moved to rest, 3.2 cm below where it was put"
    assert outcome.scene[2].supported_by == GROUND


def test_what_is_put_into_another_object_is_parted_from_it(package: Package):
    """By the shorter way: it slid in from the side, so it goes back to that side."""
    brick, tall = (package.scene[id].bounds_world.mean(0) for id in (2, 3))
    into = tuple(map(float, tall - brick + [0.06, 0, brick[2] - tall[2]]))
    outcome = session_after(package, {"kind": "move", "id": 2, "by": into}).outcome
    require_rest(outcome)
    assert "beside where it was put" in told(outcome)
    assert away(outcome.scene[3], package.scene[3]) < NEAR
    assert outcome.scene[2].supported_by == GROUND


def test_what_is_put_onto_another_object_stays_there(package: Package):
    crate, tall = package.scene[1].bounds_world, package.scene[2].bounds_world
    by = tuple(map(float, (tall.mean(0) - crate.mean(0)) * [1, 1, 0] + [0, 0, tall[1, 2] - crate[0, 2] + 0.01]))
    outcome = session_after(package, {"kind": "move", "id": 1, "by": by}).outcome
    require_rest(outcome)
    assert outcome.scene[1].supported_by == 2
    assert outcome.scene[0] is not package.scene[0] or outcome.scene[0].supported_by == GROUND


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_an_object_is_scaled_about_its_foot_and_its_load_keeps_its_size(package: Package, factor: float):
    outcome = session_after(package, {"kind": "scale", "id": 0, "factor": factor}).outcome
    require_rest(outcome)
    before, now = package.scene[0].bounds_world, outcome.scene[0].bounds_world
    np.testing.assert_allclose(np.ptp(now, axis=0), factor * np.ptp(before, axis=0), atol=NEAR)
    np.testing.assert_allclose(now.mean(0)[:2], before.mean(0)[:2], atol=NEAR)
    assert outcome.scene[1].size == pytest.approx(package.scene[1].size, abs=NEAR)
    assert outcome.scene[1].supported_by == 0


def test_what_touches_nothing_is_deleted_alone(package: Package):
    session = session_after(package, {"kind": "delete", "id": 2})
    assert session.outcome.moved == set()
    assert [o.id for o in session.scene] == [0, 1, 3]
    assert all(o is package.scene[o.id] for o in session.scene)
    (excluded,) = edited_document(session).excluded
    assert (excluded.mask, excluded.reason) == (package.scene[2].mask_name, "deleted by edit 1")


def test_what_a_deleted_object_carried_falls_to_what_is_below(package: Package):
    outcome = session_after(package, {"kind": "delete", "id": 0}).outcome
    require_rest(outcome)
    assert told(outcome) == "edit 1: fell too, to 8.0 cm below where it was"
    assert outcome.scene[1].supported_by == GROUND
    assert all(0 not in (r.subject, r.object) for r in outcome.scene.graph.relations)


def test_a_fixed_object_hangs_where_its_support_is_deleted(package: Package):
    session = session_after(package, {"kind": "fix", "id": 1}, {"kind": "delete", "id": 0})
    require_rest(session.outcome)
    assert np.array_equal(session.scene[1].T_world_object, package.scene[1].T_world_object)
    assert session.scene[1].supported_by is None
    assert not told(session.outcome)


def test_the_last_object_is_not_deleted(package: Package):
    session = session_after(package, *({"kind": "delete", "id": id} for id in (0, 1, 2, 3)))
    assert not session.outcome.done
    assert [o.id for o in session.scene] == [3]
    edited_document(session)


@pytest.mark.parametrize("on", [GROUND, 0, 2])
def test_an_object_is_put_onto_a_support(package: Package, on: int):
    session = session_after(package, {"kind": "support", "id": 3 if on != GROUND else 1, "on": on})
    require_rest(session.outcome)
    assert session.scene[3 if on != GROUND else 1].supported_by == on


def test_onto_the_ground_along_the_viewing_ray_no_silhouette_changes(package: Package):
    outcome = session_after(package, {"kind": "support", "id": 1, "on": GROUND}).outcome
    camera, before, now = package.scene.camera, package.scene[1], outcome.scene[1]
    (a, _), (b, _) = (camera.project(o.vertices_world) for o in (before, now))
    np.testing.assert_allclose(a, b, atol=1.0)
    assert now.size < before.size or away(before, now) > 0.05


def test_an_object_is_not_put_onto_what_it_carries(package: Package):
    session = session_after(package, {"kind": "support", "id": 0, "on": 1})
    assert not session.outcome.done
    assert "object 1 rests on object 0 itself" in session.outcome.decisions[0].reason
    assert session.scene is package.scene


def test_what_hangs_on_something_unseen_is_told_again_until_it_has_a_support(package: Package):
    on_unseen = package.scene.with_objects(package.scene[1].on_something_unseen())
    session = session_after(replace(package, scene=on_unseen), {"kind": "move", "id": 3, "by": (0.02, 0.0, 0.0)})
    assert [d.about for d in session.report.decisions if "still fixed" in d.choice and d.fallback] == [1]
    session.add(edit("support", session.scene, 1, on=GROUND))
    require_rest(session.outcome)
    assert (session.scene[1].mobility, session.scene[1].carriers) == ("dynamic", [GROUND])
    assert "edit 2: physics moves it again" in [d.choice for d in session.outcome.decisions]
    assert not any("still fixed" in d.choice for d in session.report.decisions)


def test_who_fixes_what_hangs_on_something_unseen_agrees_and_is_told_no_more(package: Package):
    on_unseen = package.scene.with_objects(package.scene[1].on_something_unseen())
    session = session_after(replace(package, scene=on_unseen), {"kind": "fix", "id": 1})
    assert session.scene[1].mobility_source == "given"
    assert not any(d.fallback for d in session.report.decisions)


def test_what_the_user_fixed_stays_fixed_on_a_support(package: Package):
    session = session_after(package, {"kind": "fix", "id": 3}, {"kind": "support", "id": 3, "on": 0})
    assert (session.scene[3].mobility, session.scene[3].mobility_source) == ("fixed", "given")


def test_materials_are_the_user_s_and_say_so(package: Package):
    session = session_after(
        package,
        {"kind": "material", "id": 2, "density": 800.0},
        {"kind": "material", "id": 2, "friction": 0.3},
        {"kind": "material", "id": 2, "mass": 0.6},
    )
    o = session.scene[2]
    assert body_of(o).mass == pytest.approx(0.6)
    assert o.material_source == "given"
    assert o.material_reason == "friction 0.3 given by edit 2; mass 0.6 kg given by edit 3"
    assert np.array_equal(o.T_world_object, package.scene[2].T_world_object)
    record = edited_document(session).objects[2]
    assert record.mass == pytest.approx(0.6)
    assert record.friction == 0.3


def test_a_material_moves_nothing_that_rests_all_the_same(package: Package):
    outcome = session_after(package, {"kind": "material", "id": 1, "density": 5000.0, "friction": 0.4}).outcome
    require_rest(outcome)
    for id in (0, 1):
        assert np.array_equal(outcome.scene[id].T_world_object, package.scene[id].T_world_object)


def test_a_mass_that_no_matter_has_is_not_applied(package: Package):
    session = session_after(package, {"kind": "material", "id": 2, "mass": 5000.0})
    assert not session.outcome.done
    assert "kg/m3" in session.outcome.decisions[0].reason


def test_a_size_at_which_no_body_has_its_inertia_is_not_applied(package: Package):
    edits = [{"kind": "scale", "id": 1, "factor": 0.05}] * 2
    session = session_after(package, *edits)
    assert not session.outcome.done
    edited_document(session)


def test_a_fixed_object_stays_where_it_is_put(package: Package):
    session = session_after(package, {"kind": "fix", "id": 2}, {"kind": "move", "id": 2, "by": (0.0, 0.1, 0.2)})
    require_rest(session.outcome)
    np.testing.assert_allclose(
        session.scene[2].bounds_world.mean(0) - package.scene[2].bounds_world.mean(0), [0, 0.1, 0.2], atol=1e-12
    )
    assert session.scene[2].supported_by is None
    session.add(edit("release", session.scene, 2))
    require_rest(session.outcome)
    assert session.scene[2].supported_by == GROUND
    assert "20.0 cm below" in told(session.outcome)


def test_fixed_and_released_nothing_has_moved(package: Package):
    session = session_after(package, {"kind": "fix", "id": 0}, {"kind": "release", "id": 0})
    for o in package.scene:
        assert np.array_equal(session.scene[o.id].T_world_object, o.T_world_object)
    assert session.scene[0].mobility == "dynamic"


def test_what_is_edited_has_no_uncertainty_of_the_photo(package: Package):
    session = session_after(
        package, {"kind": "move", "id": 2, "by": (0.05, 0, 0)}, {"kind": "label", "id": 3, "to": "a"}
    )
    assert [o.id for o in edited_document(session).objects if o.uncertainty is None] == [2]


def test_an_edit_is_for_the_label_that_the_object_has(package: Package):
    session = session_after(package, {"kind": "label", "id": 2, "to": "loaf"})
    assert session.scene[2].label == "loaf"
    stale = edit_of({"kind": "delete", "id": 2, "label": "brick"})
    outcome = session.add(stale)
    assert not outcome.done
    assert outcome.decisions[0].reason == "object 2 is 'loaf' here, the edit was made for 'brick'"
    assert outcome.decisions[0].fallback
    assert session.add(edit_of({"kind": "delete", "id": 2, "label": "loaf"})).done


def test_edits_are_applied_in_order(package: Package):
    """What has left its carrier does not fall when that is deleted."""
    moved = {"kind": "move", "id": 1, "by": (0.3, -0.2, 0.0)}
    one = session_after(package, moved, {"kind": "delete", "id": 0})
    other = session_after(package, {"kind": "delete", "id": 0}, moved)
    assert away(one.scene[1], other.scene[1]) < 5 * NEAR
    assert "fell" not in told(one.outcome)
    assert "fell" in told(other.outcomes[1])


@pytest.mark.parametrize("seed", range(3))
def test_after_random_edits_nothing_crosses_and_what_does_not_rest_is_told(package: Package, seed: int):
    rng, session = np.random.default_rng(seed), EditSession(package)
    for _ in range(5):
        before = session.scene
        id = int(rng.choice([o.id for o in before]))
        by, axis = (tuple(map(float, rng.uniform(-1, 1, 3) * size)) for size in (0.2, 1.0))
        asked = (
            edit("move", before, id, by=by),
            edit("turn", before, id, axis=axis, degrees=float(rng.uniform(-180, 180))),
            edit("support", before, id, on=int(rng.choice([GROUND, *(o.id for o in before if o.id != id)]))),
        )
        outcome = session.add(asked[rng.integers(3)])
        assert outcome.measures.N_cross == 0
        assert outcome.measures.D_max_cm < 0.1 or "not at rest" in told(outcome)
        assert outcome.done or outcome.scene is before
        assert all((outcome.scene[o.id] is o) == (o.id not in outcome.moved) for o in before)


# --- undo, bytes ------------------------------------------------------------------------------------------------------

SEVERAL: tuple[dict[str, Any], ...] = (
    {"kind": "move", "id": 2, "by": (0.02, 0.0, 0.1)},
    {"kind": "scale", "id": 0, "factor": 1.2},
    {"kind": "delete", "id": 3},
)


def written(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


@pytest.mark.slow
def test_undo_gives_the_bytes_of_before(package: Package, tmp_path: Path):
    session, states = EditSession(package), list[dict[str, bytes]]()
    for given in SEVERAL:
        states.append(dict(edited_files(session)))
        session.add(edit(scene=session.scene, **given))
    last = dict(edited_files(session))
    folder = write_edited(session, tmp_path / "edited")
    assert written(folder) == last
    assert (folder / "edits.json").read_bytes() == edits_json(session.edits)
    again = EditSession.open(folder)
    write_edited(again, folder)
    assert written(folder) == last
    for state in reversed(states):
        session.undo()
        assert dict(edited_files(session)) == state
    while again.can_undo:
        again.undo()
    assert dict(edited_files(again)) == states[0]
    while again.can_redo:
        again.redo()
    assert dict(edited_files(again)) == last


def test_a_new_edit_forgets_what_was_undone(package: Package):
    session = session_after(package, {"kind": "label", "id": 2, "to": "a"})
    session.undo()
    session.add(edit("label", session.scene, 2, to="b"))
    assert not session.can_redo
    with pytest.raises(InputError, match="redo: found nothing undone"):
        session.redo()
    session.undo()
    with pytest.raises(InputError, match="undo: found no edit"):
        session.undo()


def test_provenance_names_the_edits_and_what_they_are_of(package: Package):
    session = session_after(package, {"kind": "label", "id": 2, "to": "a"})
    document = edited_document(session)
    said = {"count": 1, "sha256": edits_digest(session.edits), "of": session.unedited.digest}
    assert document.provenance["edits"] == said
    assert document.metrics["mIoU_visible"] == session.outcome.measures.mIoU_visible


def test_an_edited_package_is_not_lost_to_a_new_run(package: Package, relabelled: Path):
    with pytest.raises(OutputError, match=r"holds edits; --edits .*edits.json applies them again"):
        write_package(package.scene, relabelled)
    write_package(package.scene, relabelled, overwrite=True)


def test_a_fresh_run_has_the_edits_of_its_package(whole: Reconstruction, tmp_path: Path):
    package = read_package(deliver(whole, tmp_path / "fresh"))
    o = package.scene.objects[0]
    edits = [edit("move", package.scene, o.id, by=(0.02, 0.01, 0.05))]
    folder, session = deliver_edited(whole, edits, tmp_path / "edited")
    here = edited_document(EditSession(package, edits))
    assert session.outcome.done
    assert [r.T_world_object for r in edited_document(session).objects] == [r.T_world_object for r in here.objects]
    assert read_package(folder).document == edited_document(session)
    page = (folder / "report.html").read_text()
    assert "edit 1: moved to rest" in page


# --- lists from outside -----------------------------------------------------------------------------------------------

MOVE = {"kind": "move", "id": 2, "label": "brick", "by": [0, 0, 0.1]}
HOSTILE = [
    ("[]", "an object with version, edits"),
    ("{", "no valid JSON"),
    ('{"version": 1, "version": 1, "edits": []}', "the key 'version' twice"),
    ({"version": 2, "edits": []}, "version = 2"),
    ({"version": True, "edits": []}, "found version: True; accepted: a whole number"),
    ({"version": "1", "edits": []}, "found version: '1'; accepted: a whole number"),
    ({"version": 1}, "no edits"),
    ({"version": 1, "edits": [], "more": 1}, "an unknown more = 1"),
    ({"version": 1, "edits": {}}, "edits = {}"),
    ({"version": 1, "edits": [MOVE] * (MAX_EDITS + 1)}, f"at most {MAX_EDITS} items"),
    ({"version": 1, "edits": [{**MOVE, "kind": "fly"}]}, "accepted: kind move, turn"),
    ({"version": 1, "edits": [{k: v for k, v in MOVE.items() if k != "kind"}]}, "edits.0 without a kind"),
    ({"version": 1, "edits": [{k: v for k, v in MOVE.items() if k != "label"}]}, "no edits.0.move.label"),
    ({"version": 1, "edits": [{**MOVE, "factor": 2}]}, "an unknown edits.0.move.factor"),
    ({"version": 1, "edits": [{**MOVE, "id": -1}]}, "edits.0.move.id = -1"),
    ({"version": 1, "edits": [{**MOVE, "id": "2"}]}, "edits.0.move.id = '2'"),
    ({"version": 1, "edits": [{**MOVE, "id": 2.0}]}, "edits.0.move.id = 2.0"),
    ({"version": 1, "edits": [{**MOVE, "label": "a" * 301}]}, "at most 300 characters"),
    ({"version": 1, "edits": [{**MOVE, "label": 3}]}, "edits.0.move.label = 3"),
    ({"version": 1, "edits": [{**MOVE, "by": [0, 0]}]}, "edits.0.move.by.2"),
    ({"version": 1, "edits": [{**MOVE, "by": [0, 0, 101]}]}, "less than or equal to 100"),
    ({"version": 1, "edits": [{**MOVE, "by": [0, 0, "1"]}]}, "edits.0.move.by.2 = '1'"),
    ({"version": 1, "edits": [{**MOVE, "by": [0, 0, True]}]}, "edits.0.move.by.2 = True"),
    ('{"version": 1, "edits": [{"kind": "move", "id": 2, "label": "", "by": [0, 0, NaN]}]}', "NaN is no JSON number"),
    ('{"version": 1, "edits": [{"kind": "move", "id": 2, "label": "", "by": [0, 0, 1e999]}]}', "edits.0.move.by.2"),
    ({"version": 1, "edits": [{"kind": "turn", "id": 2, "label": "", "axis": [0, 0, 0], "degrees": 1}]}, "a direction"),
    ({"version": 1, "edits": [{"kind": "turn", "id": 2, "label": "", "axis": [0, 0, 1], "degrees": 361}]}, "360"),
    ({"version": 1, "edits": [{"kind": "scale", "id": 2, "label": "", "factor": 0}]}, "0.05"),
    ({"version": 1, "edits": [{"kind": "scale", "id": 2, "label": "", "factor": 21}]}, "20"),
    ({"version": 1, "edits": [{"kind": "support", "id": 2, "label": "", "on": 2}]}, "object 2 on itself"),
    ({"version": 1, "edits": [{"kind": "support", "id": 2, "label": "", "on": -2}]}, "-1"),
    ({"version": 1, "edits": [{"kind": "material", "id": 2, "label": ""}]}, "no property"),
    ({"version": 1, "edits": [{"kind": "material", "id": 2, "label": "", "density": 1, "mass": 1}]}, "both density"),
    ({"version": 1, "edits": [{"kind": "material", "id": 2, "label": "", "density": 1e9}]}, "25000"),
    ({"version": 1, "edits": [{"kind": "material", "id": 2, "label": "", "friction": -0.1}]}, "0"),
    ({"version": 1, "edits": [{"kind": "label", "id": 2, "label": "", "to": ""}]}, "edits.0.label.to"),
    ({"version": 1, "edits": [{"kind": "label", "id": 2, "label": "", "to": "a\x1b[31m"}]}, "not printable"),
]


@pytest.mark.parametrize(("given", "said"), HOSTILE)
def test_what_is_no_list_of_edits_is_one_clear_error(given: Any, said: str, tmp_path: Path):
    file = tmp_path / "edits.json"
    file.write_text(given if isinstance(given, str) else json.dumps(given))
    with pytest.raises(InputError) as caught:
        read_edits(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: found ")
    assert "; accepted: " in message
    assert said in message


def test_a_list_is_read_as_it_is_written(tmp_path: Path):
    file = tmp_path / "edits.json"
    edits = (
        edit_of(MOVE),
        edit_of({"kind": "material", "id": 0, "label": 'a "b"\n', "mass": 0.1}),
        edit_of({"kind": "delete", "id": 1, "label": ""}),
    )
    for some in (edits, ()):
        file.write_bytes(edits_json(some))
        assert read_edits(file) == some


def test_an_edit_of_a_page_is_checked(package: Package):
    with pytest.raises(InputError, match=r"edit: found move\.by = 3"):
        edit_of({"kind": "move", "id": 2, "label": "brick", "by": 3})
    with pytest.raises(InputError, match="edit: found"):
        edit_of("delete all")


def test_an_unknown_object_is_told(untouched: EditSession, package: Package):
    outcome = EditSession(package, [edit_of({**MOVE, "id": 9})]).outcome
    assert not outcome.done
    assert outcome.scene is package.scene
    assert outcome.decisions[0].reason == "no object 9; the scene has 0, 1, 2, 3"
    assert outcome.measures == untouched.outcome.measures


# --- the command ------------------------------------------------------------------------------------------------------


def test_the_command_edits_a_package_and_goes_on(package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    first.write_bytes(edits_json([edit("move", package.scene, 2, by=(0.0, 0.1, 0.05))]))
    second.write_bytes(edits_json([edit("delete", package.scene, 3)]))
    out = tmp_path / "out"
    assert main(["edit", str(package.folder), "--edits", str(first), "-o", str(out)]) == 0
    assert "fallback in edit (object 2): edit 1: moved to rest, 5.0 cm below" in capsys.readouterr().out
    assert main(["edit", str(out), "--edits", str(second), "-o", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [(e["number"], e["kind"], e["done"]) for e in said["edits"]] == [(1, "move", True), (2, "delete", True)]
    assert said["edited"]["n"] == 3
    edited = read_package(out)
    assert [o.id for o in edited.scene] == [0, 1, 2]
    assert read_edits(out / "edits.json") == (*read_edits(first), *read_edits(second))
    report = json.loads((out / "report.json").read_bytes())
    assert report["stages"][-1]["stage"] == "edit"

    assert main(["edit", str(out / "unedited"), "--edits", str(first), "-o", str(out)]) == 0
    assert [o.id for o in read_package(out).scene] == [0, 1, 2, 3]


@pytest.mark.slow
def test_a_run_with_edits_keeps_them_and_one_without_is_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out, quick = tmp_path / "out", ["--skip", "align,refine,uncertainty,inpaint"]
    assert main(["reconstruct", str(folder), "-o", str(out), *quick]) == 0
    o = read_package(out).scene.objects[0]
    wanted = tmp_path / "edits.json"
    wanted.write_bytes(edits_json([edit_of({"kind": "label", "id": o.id, "label": o.label, "to": "thing"})]))
    assert main(["edit", str(out), "-o", str(tmp_path / "edited"), "--edits", str(wanted)]) == 0
    assert main(["reconstruct", str(folder), "-o", str(out), *quick, "--edits", str(wanted), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["edited"]["n"] == len(read_package(out).scene.objects)
    assert (out / "scene.json").read_bytes() == (tmp_path / "edited" / "scene.json").read_bytes()
    assert main(["reconstruct", str(folder), "-o", str(out), *quick]) == 1
    assert f"holds edits; --edits {out / 'edits.json'} applies them again" in capsys.readouterr().err
    assert read_package(out).scene[o.id].label == "thing"


def test_an_edited_package_without_its_past_is_refused(relabelled: Path):
    (relabelled / "unedited" / "scene.json").unlink()
    with pytest.raises(InputError, match="unedited"):
        EditSession.open(relabelled)


@pytest.mark.parametrize("name", ["report.html", "unedited", "edits.json", "unedited/report.json"])
def test_no_link_leads_out_of_an_edited_package(relabelled: Path, tmp_path: Path, name: str):
    """Its files are copied to where it is written: a stranger's package must not fetch others of the user's."""
    if name == "report.html":
        shutil.rmtree(relabelled / "unedited")
        (relabelled / "edits.json").unlink()
    elsewhere = tmp_path / "elsewhere"
    (relabelled / name).rename(elsewhere)
    (relabelled / name).symlink_to(elsewhere)
    with pytest.raises(InputError, match=r"leaves the package|outside"):
        EditSession.open(relabelled)


@pytest.mark.parametrize("text", ["[]", '{"stages": 1}', '{"a": 1e999}', "{"])
def test_a_report_that_cannot_go_on_is_one_clear_error(package: Package, tmp_path: Path, text: str):
    folder = tmp_path / "package"
    shutil.copytree(package.folder, folder)
    (folder / "report.json").write_text(text)
    with pytest.raises(InputError, match=r"report\.json: found .*; accepted: the report\.json of an f3sr package"):
        EditSession.open(folder)


def test_a_list_that_is_missing_is_exit_code_2(package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out"
    assert main(["edit", str(package.folder), "--edits", str(tmp_path / "no.json"), "-o", str(out)]) == 2
    assert "no.json" in capsys.readouterr().err
    assert not out.exists()


def test_without_any_edit_nothing_is_opened(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(EditSession, "open", lambda *args, **more: pytest.fail("the package was opened"))
    (tmp_path / "none.json").write_bytes(edits_json([]))
    for given in ([], ["--edits", str(tmp_path / "none.json")]):
        assert main(["edit", str(package.folder), "-o", str(tmp_path / "out"), *given]) == 2
        assert "--edits: found none, and none in the package" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["edit", str(tmp_path / "nowhere"), "-o", str(tmp_path / "out")]) == 2
    assert "nowhere: found nothing there" in capsys.readouterr().err
