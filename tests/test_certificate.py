"""Certificates: the rule on analytic motions, clients that crash, hang and lie, and MuJoCo itself."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from f3sr.certificate.certificate_document import as_plain
from f3sr.certificate.certificate_page import MEANINGS
from f3sr.certificate.certification import DOCUMENT, PAGE, certify
from f3sr.certificate.client_answers import BodyTold
from f3sr.certificate.clients_table import CLIENTS, ENGINES
from f3sr.certificate.rest_rule import CertificateConfig, Released, judged
from f3sr.cli.main import main
from f3sr.core.mesh import ConvexPart
from f3sr.core.transforms import quaternion_from_rotation, rotation_about
from f3sr.errors import InputError, OutputError
from f3sr.exporters.export_names import export_name
from f3sr.exporters.grown_hulls import SHARPEST, grown
from f3sr.goals.scene_layout import SceneLayout
from f3sr.physics.mujoco_model import body_of
from f3sr.physics.settling import settle
from f3sr.proxies.hulls import beyond, planes
from f3sr.scene_package.package import Package, read_package, write_package
from labelled_boxes import labelled_boxes
from scenes import box, box_stack_scene, scene_of

CONFIG = CertificateConfig()
SHORT = CertificateConfig(seconds=0.3)


# --- the rule ---------------------------------------------------------------------------------------------------


def released(*, round: bool = False, fixed: bool = False) -> Released:
    body = replace(body_of(box(3, size=(0.1, 0.2, 0.3), at=(0.4, 0, 0.15), R=rotation_about([0, 0, 1.0], 0.3))))
    return Released(body=replace(body, fixed=fixed), round=round, size=0.37)


def told(o: Released, *, mass: float = 1.0, inertia: float = 1.0) -> BodyTold:
    rows = (inertia * o.body.inertia).tolist()
    return BodyTold(mass=mass * o.body.mass, center=tuple(o.body.center), inertia=tuple(map(tuple, rows)))  # type: ignore[arg-type]


def states(o: Released, *, way: Any = (0, 0, 0), turn: float = 0.0, axis: Any = (0, 0, 1.0)) -> list[Any]:
    """At rest, then moved so far by its centre of mass, turned about it, and back: a state per sample."""
    T = o.body.T_world_body
    center = T[:3, :3] @ o.body.center + T[:3, 3]
    found = list[Any]()
    for share in (0, 1, 0):
        R = rotation_about(axis, share * turn) @ T[:3, :3]
        place = center + share * np.array(way) - R @ o.body.center
        found.append((*map(float, place), *map(float, quaternion_from_rotation(R))))
    return found


@pytest.mark.parametrize(
    ("way", "turn", "round", "verdict"),
    [
        ((0, 0, 0), 0, False, "rests"),
        ((0.00099, 0, 0), 0, False, "rests"),
        ((0.00101, 0, 0), 0, False, "moves"),
        ((0, 0, -0.00101), 0, False, "moves"),
        ((0, 0, 0), 0.99, False, "rests"),
        ((0, 0, 0), 1.01, False, "moves"),
        ((0.03, 0, 0), 40, True, "rolls"),
        ((0.03, 0, 0), 40, False, "moves"),
        ((0.03, 0, -0.1), 40, True, "moves"),
    ],
)
def test_a_millimetre_and_a_degree_decide(way: Any, turn: float, round: bool, verdict: str) -> None:
    """Also where the object comes back: the farthest sample counts."""
    o = released(round=round)
    found = judged(o, states(o, way=way, turn=np.radians(turn)), told(o), CONFIG)
    assert found.verdict == verdict
    assert found.drift == pytest.approx(np.linalg.norm(way), abs=1e-12)
    assert found.turn == pytest.approx(np.radians(turn), abs=1e-7)


def test_a_turn_about_the_centre_of_mass_is_no_drift() -> None:
    o = released()
    found = judged(o, states(o, turn=0.01, axis=(0, 1.0, 0)), told(o), CONFIG)
    assert found.drift is not None and found.drift < 1e-12 and found.verdict == "rests"


@pytest.mark.parametrize(
    ("mass", "inertia", "verdict"),
    [(1 + 9e-7, 1, "rests"), (1 + 2e-6, 1, "differs"), (1, 1 + 9e-6, "rests"), (1, 1 + 2e-5, "differs")],
)
def test_masses_and_inertias_are_compared(mass: float, inertia: float, verdict: str) -> None:
    o = released()
    assert judged(o, states(o), told(o, mass=mass, inertia=inertia), CONFIG).verdict == verdict


def test_what_is_no_number_is_lost_and_never_at_rest() -> None:
    o = released(round=True)
    gone = states(o)
    gone[1] = (None, *gone[1][1:])
    assert judged(o, gone, told(o), CONFIG).verdict == "lost"
    short = states(o)
    short[1] = (*short[1][:3], 0.0, 0.0, 0.0, 0.5)
    assert judged(o, short, told(o), CONFIG).verdict == "lost"
    assert judged(o, states(o), None, CONFIG).verdict == "differs", "an engine that tells no mass"
    fixed = released(fixed=True)
    assert judged(fixed, states(fixed), None, CONFIG).verdict == "rests", "of what is fixed nobody asks"


def test_boxes_do_not_roll_and_what_lies_on_a_round_side_does() -> None:
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = 0.05 * np.stack([np.cos(angles), np.zeros(16), np.sin(angles)], axis=1)
    side = np.array([0, 0.1, 0])
    can = ConvexPart.hull_of(np.concatenate([ring + side, ring - side]))
    lying = replace(box(1, at=(0.5, 0, 0.05)), parts=(can,))
    layout = SceneLayout(scene_of(box(0, size=(0.1, 0.1, 0.1)), lying))
    assert not layout.can_roll(0) and layout.can_roll(1)


# --- grown parts ------------------------------------------------------------------------------------------------


def test_a_grown_box_is_the_box_with_every_face_further_out() -> None:
    part = body_of(box(0, size=(0.1, 0.2, 0.3))).parts[0]
    bigger = grown(part, 0.001)
    assert np.allclose(np.ptp(bigger.vertices, axis=0), np.ptp(part.vertices, axis=0) + 0.002, atol=1e-12)
    assert len(bigger.vertices) == len(part.vertices)


@pytest.mark.parametrize("thick", [2e-7, 2e-6, 1e-5, 1.9e-5])
def test_a_sheet_thinner_than_what_counts_as_one_flat_grows_to_both_sides(thick: float):
    tilted = rotation_about((1, 2, 3), 0.7)[:3, :3]
    around = np.array([[np.cos(a), np.sin(a), 0] for a in np.linspace(0, 6, 13)]) * 2.5e-3
    part = ConvexPart.hull_of(np.concatenate([around, around + np.array([0, 0, thick])]) @ tilted.T)
    bigger = grown(part, 1.6e-4)
    assert len(bigger.vertices) <= len(part.vertices)
    assert beyond(part.vertices, *planes(bigger)).max() < 1e-9
    assert np.ptp(bigger.vertices @ tilted[:, 2]) == pytest.approx(thick + 3.2e-4, rel=1e-3)


def test_grown_parts_hold_the_part_and_have_no_more_corners() -> None:
    rng = np.random.default_rng(5)
    for count in (4, 8, 30, 60):
        part = ConvexPart.hull_of(rng.normal(size=(count, 3)) * [0.05, 0.03, 0.002])
        bigger = grown(part, 1.6e-4)
        assert len(bigger.vertices) <= len(part.vertices)
        planes = bigger.vertices[bigger.faces]
        normals = np.cross(planes[:, 1] - planes[:, 0], planes[:, 2] - planes[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        outside = np.einsum("fk,fnk->fn", normals, part.vertices[None] - planes[:, :1])
        assert outside.max() < 1e-9, "the part lies inside"
        away = np.linalg.norm(bigger.vertices[:, None] - part.vertices[None], axis=2).min(1)
        assert away.max() <= SHARPEST * 1.6e-4 + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_flats_of_grown_parts_are_plane(seed: int) -> None:
    """An engine finds contacts face by face: an orange on a pan's flat of several faces trembles."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    top = np.stack([0.05 * np.cos(angles), 0.04 * np.sin(angles), np.full(12, 0.004)], axis=1)
    tilted = rotation_about(np.array([1.0, 0, 0]), 0.3)
    below = rng.normal(size=(20, 3)) * 0.01 - [0, 0, 0.04]
    bigger = grown(ConvexPart.hull_of(np.concatenate([top, below]) @ tilted.T), 1.6e-4)
    heights = np.sort((bigger.vertices @ tilted)[:, 2])
    assert np.ptp(heights[-12:]) < 1e-12
    assert heights[-1] == pytest.approx(0.004 + 1.6e-4, abs=1e-12)


def test_corners_that_are_one_become_one() -> None:
    """Drake refuses the slivers between corners that are nanometres apart."""
    corners = body_of(box(0, size=(0.1, 0.2, 0.3))).parts[0].vertices
    part = ConvexPart.hull_of(np.concatenate([corners, corners[:1] + 1e-7 * np.sign(corners[:1]) * [1, -1, 0]]))
    assert len(part.vertices) == 9 and len(grown(part, 1e-4).vertices) == 8


# --- clients ----------------------------------------------------------------------------------------------------

ANSWER = """
import json, os, sys, time
from pathlib import Path
job = Path(sys.argv[sys.argv.index("--job") + 1])
asked = json.loads((job / "request.json").read_text())
package = json.loads(Path(PACKAGE, "scene.json").read_text())
bodies, sample = {}, {}
for o, name in zip(package["objects"], asked["names"]):
    T = o["T_world_object"]
    sample[name] = [*(row[3] for row in T[:3]), *QUATERNIONS[str(o["id"])]]
    if o["mobility"] == "dynamic":
        bodies[name] = {"mass": o["mass"], "center": o["center_of_mass"], "inertia": o["inertia"]}
count = round(asked["seconds"] / asked["interval"]) + 1
answer = {"versions": {"fake": "1"}, "settings": "none", "timestep": 0.002, "bodies": bodies,
          "samples": [sample] * count, "penetrations": None, "notes": []}
first = asked["names"][-1]
FAULT
(job / "answer.json").write_text(json.dumps(answer))
"""


def fake(folder: Path, package: Package, fault: str) -> str:
    """A program in the place of an engine's Python: it answers with the package's own poses, or misbehaves."""
    quaternions = {o.id: list(map(float, quaternion_from_rotation(o.T_world_object[:3, :3]))) for o in package.scene}
    text = ANSWER.replace("PACKAGE", repr(str(package.folder))).replace("FAULT", fault)
    text = text.replace("QUATERNIONS", repr({str(k): v for k, v in quaternions.items()}))
    file = folder / "engine"
    file.write_text(f"#!{sys.executable}\n{text}")
    file.chmod(0o755)
    return str(file)


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return read_package(write_package(labelled_boxes(), tmp_path_factory.mktemp("certified") / "table"))


FAULTS = {
    "": ("passed", ""),
    "print('boom', file=sys.stderr); sys.exit(3)": ("no answer", "exit code 3; its last words: boom"),
    "os.kill(os.getpid(), 11)": ("no answer", "it was killed by SIGSEGV"),
    "sys.exit(0)": ("no answer", "answer.json"),
    "answer['samples'][0] = {}": ("no answer", "a sample without"),
    "answer['samples'] = answer['samples'][:-1]": ("no answer", "3 samples, not 4"),
    "answer['samples'] = [{**sample, 'stranger': sample[first]}] * count": ("no answer", "'stranger'"),
    "answer['bodies'].pop(first)": ("no answer", "bodies without"),
    "answer['bodies'][first]['mass'] = float('nan')": ("no answer", "NaN"),
    "answer['bodies'][first]['mass'] *= 2": ("failed", ""),
    "answer['samples'] = [{**sample, first: [None] * 7}] * count": ("failed", ""),
    "answer['samples'] = [{**sample, first: [0.0] * 3}] * count": ("no answer", "samples"),
    "answer['penetrations'] = {first: 0.0}": ("no answer", "penetrations without"),
    "answer['secret'] = 1": ("no answer", "secret"),
    "answer = {'missing': 'No module named engine'}": ("not installed", "No module named engine"),
    "answer = []": ("no answer", "answer.json"),
    "(job / 'answer.json').write_text('{'); sys.exit(0)": ("no answer", "no valid JSON"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_client_that_misbehaves_is_one_row(fault: str, package: Package, tmp_path: Path) -> None:
    state, words = FAULTS[fault]
    programs = {"pybullet": fake(tmp_path, package, fault)}
    made = certify(package, tmp_path / "out", clients=["pybullet"], programs=programs, config=SHORT)
    (row,) = made.engines
    assert row.state == state and words in row.reason, row.reason
    assert "\n" not in row.reason and str(tmp_path) not in row.reason.replace(programs["pybullet"], "")
    assert bool(made.problems) == (state != "passed"), "it was named: then no answer is a problem"
    assert json.loads((tmp_path / "out" / DOCUMENT).read_text())["engines"][0]["state"] == state
    assert row.client.title in (tmp_path / "out" / PAGE).read_text()


def test_an_interpreter_may_be_named_from_here(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The client runs in a folder of its own."""
    fake(tmp_path, package, "")
    monkeypatch.chdir(tmp_path)
    programs = {"sapien": "./engine"}
    assert certify(package, "out", clients=["sapien"], programs=programs, config=SHORT).engines[0].state == "passed"


def test_a_client_that_hangs_is_ended(package: Package, tmp_path: Path) -> None:
    programs = {"drake": fake(tmp_path, package, "time.sleep(600)")}
    made = certify(package, tmp_path / "out", clients=["drake"], programs=programs, config=SHORT, deadline=1)
    assert made.engines[0].state == "no answer" and "not done after 1 s" in made.engines[0].reason


# --- the whole --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Package:
    """Boxes on one another, settled as f3sr does it."""
    scene = box_stack_scene(3)
    poses = settle(scene.objects).T_world_object
    resting = scene.with_objects(*(replace(o, T_world_object=poses[o.id]) for o in scene))
    return read_package(write_package(resting, tmp_path_factory.mktemp("stack") / "stack"))


def test_mujoco_releases_a_package_and_the_page_has_every_row(stack: Package, tmp_path: Path) -> None:
    made = certify(stack, tmp_path / "out", clients=["mujoco"], config=SHORT)
    (row,) = made.engines
    assert row.state == "passed" and row.versions["python"] and made.problems == []
    assert [o.name for o in row.objects] == [export_name(o.id, o.label) for o in stack.scene]
    for o in row.objects:
        assert o.verdict.verdict == "rests" and o.verdict.mass_error is not None and o.verdict.mass_error < 1e-12
        assert o.verdict.drift is not None and o.verdict.drift < 1e-4 and o.penetration is not None
    page = (tmp_path / "out" / PAGE).read_text()
    for o in stack.scene:
        assert f"<bdi>{o.id} {o.label}</bdi>" in page
    assert all(name in page for name in MEANINGS) and "MuJoCo" in page and "<script src" not in page


def test_a_client_named_twice_is_asked_once_and_the_page_lists_those_not_asked(stack: Package, tmp_path: Path) -> None:
    made = certify(stack, tmp_path / "out", clients=["mujoco", "mujoco"], config=SHORT)
    assert [row.client.name for row in made.engines] == ["mujoco"]
    silent = (tmp_path / "out" / PAGE).read_text().partition('id="silent"')[2].partition("</section>")[0]
    assert silent.count("not asked") == len(CLIENTS) - 1 and "pip install drake" in silent


def test_a_validator_without_its_program_says_which_one(stack: Package, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    if Path(sys.executable).with_name("simready-validate").exists():
        pytest.skip("simready-validate is installed")
    (row,) = certify(stack, tmp_path / "out", clients=["simready"], config=SHORT).validators
    assert (row.state, row.reason) == ("not installed", "No program simready-validate beside its Python")


def test_labels_of_attackers_are_text(package: Package, tmp_path: Path) -> None:
    certify(package, tmp_path / "out", clients=["pybullet"], programs={"pybullet": fake(tmp_path, package, "")},
            config=SHORT)  # fmt: skip
    page = (tmp_path / "out" / PAGE).read_text()
    assert "../<x>" not in page and "../&lt;x&gt;" in page
    assert "Content-Security-Policy" in page and "default-src &#39;none&#39;" in page


def test_the_document_names_no_place_of_this_machine(package: Package, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    made = certify(package, tmp_path / "out", clients=["usd"])
    assert made.validators[0].state == "passed" and made.validators[0].checked == 4
    assert str(tmp_path) not in json.dumps(as_plain(made))


def test_the_command_says_what_it_found(stack: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["certify", str(stack.folder), "--engines", "mujoco", "-o", str(tmp_path / "out"), "--json"]
    assert main(command) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["engines"][0]["state"] == "passed" and printed["folder"] == str(tmp_path / "out")
    assert main(command) == 1 and "--overwrite" in capsys.readouterr().err
    named = [*command, "--overwrite", "--engines", "mujoco,drake", "--python", f"drake={sys.executable}"]
    assert main(named) == 1 and "Drake: not installed" in capsys.readouterr().err
    assert main([*command, "--overwrite", "--engines", "bullet"]) == 2
    assert "accepted: mujoco" in capsys.readouterr().err
    assert main([*command, "--overwrite", "--python", "drake"]) == 2


def test_bad_places_and_names_are_refused_before_anything_runs(package: Package, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("dear")
    with pytest.raises(OutputError, match="no certificate"):
        certify(package, tmp_path / "mine", clients=["mujoco"], overwrite=True)
    with pytest.raises(InputError, match="can be started"):
        certify(package, tmp_path / "out", programs={"drake": "/no/such/python"})
    with pytest.raises(InputError, match="--deadline"):
        certify(package, tmp_path / "out", deadline=0.0)
    assert not (tmp_path / "out").exists()


def test_every_client_has_its_script_and_says_what_brings_it() -> None:
    for client in CLIENTS.values():
        assert client.path.is_file() and "install" in client.install
    assert all(client.cannot for client in ENGINES.values())
