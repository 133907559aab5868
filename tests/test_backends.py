"""Back ends: laws of the registry, every check of what they answer, and a third party's package through the CLI."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import f3sr
from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import EstimatedGeometry, GeneratedAsset
from f3sr.backends.registry import Backend, BackendError, Kind
from f3sr.cli.main import main
from f3sr.core.mesh import Material
from f3sr.core.transforms import pose
from f3sr.errors import TRACEBACK, F3srError, InputError
from f3sr.exporters.exported_scene import ExportedScene
from f3sr.exporters.protocol import EXPORTERS
from f3sr.goals.checks import PlanError
from f3sr.goals.plan import TaskSpec
from f3sr.io import inputs
from f3sr.io.answers import checked_masks, checked_photo
from f3sr.io.inputs import Fillers, Inputs
from f3sr.pipeline import reconstruct
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.play.languages import LANGUAGES, CheckedLanguage
from f3sr.play.rule_based_language import Rules
from f3sr.runtime.result_store import Store
from f3sr.scene import Photo, Relation
from f3sr.scene_package.package import WRITTEN, read_package, write_package
from folders import write_folder
from foreign_packages import install
from scenes import box, scene_of

GUIDE = Path(__file__).parents[1] / "docs" / "contributing.md"
ALL_BUT_INPAINT = "align,relate,decompose,separate,settle,describe,evaluate"


class Echo:
    """A Protocol's one method, answering what it was made with."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *_: self.answer


def answering(kind: str, answer: Any, *, name: str = "echo", version: str = "1.0") -> Backend[Any]:
    return Backend(kind=kind, name=name, version=version, made=Echo(answer))


# --- the registry -------------------------------------------------------------------------------------------


class Speaks:
    """A protocol of one method and one value."""

    name: str

    def say(self, word: str) -> str: ...

    @property
    def loud(self) -> bool: ...


KIND = Kind(name="test", protocol=Speaks, built_in={"own": "test_backends:Own", "broken": "no.such.module:Own"})


class Own:
    name = "own"
    loud = True

    def say(self, word: str) -> str:
        return word


SOURCE = """
    from f3sr.errors import InputError
    class Good:
        loud = False
        def say(self, word): return 2 * word
    class Mute:
        loud = False
    class Fails:
        def __init__(self): raise KeyError("no weights\\nand more")
    class Needs:
        def __init__(self, argument): pass
    def leaves(): raise SystemExit(3)
    def tells(): raise InputError("KEY", found="nothing", accepted="a key")
"""
BAD = {
    "mute": ("foreign_voices:Mute", "has no say(); accepted: all of Speaks"),
    "fails": ("foreign_voices:Fails", "unforeseen KeyError: 'no weights"),
    "needs": ("foreign_voices:Needs", "TypeError"),
    "leaves": ("foreign_voices:leaves", "it ended the process"),
    "tells": ("foreign_voices:tells", "KEY: found nothing; accepted: a key"),
    "absent": ("foreign_voices:Absent", "AttributeError"),
    "nowhere": ("foreign_void:Good", "No module named 'foreign_void'"),
    "nonsense": ("!!", "it cannot be loaded"),
}


@pytest.fixture
def voices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    points = {"good": "foreign_voices:Good", **{name: target for name, (target, _) in BAD.items()}}
    place = tmp_path / "site"
    install(place, monkeypatch, module="foreign_voices", source=SOURCE, points={"f3sr.test": points}, version="2.5")
    return place


class Modelled(Own):
    """An implementation that runs weights, on which it lacks something."""

    takes_model = True

    def __init__(self, choice: ModelChoice) -> None:
        self.choice = choice
        self.provenance = {"weights": choice.model, "licence": "", "device": choice.device}

    def say(self, word: str) -> str:
        return word

    def needs(self) -> tuple[Need, ...]:
        return (Need(what="weights", met=False, found="none", remedy="put them there"),)


MODELLED = replace(KIND, built_in={"own": "test_backends:Own", "modelled": "test_backends:Modelled"})


def test_a_model_is_named_after_a_colon_and_told_with_its_back_end():
    backend = MODELLED.find("modelled:hub/name:latest", ModelChoice(device="cpu", allow_downloads=True))
    assert isinstance(made := cast(object, backend.made), Modelled)
    assert made.choice == ModelChoice(model="hub/name:latest", device="cpu", allow_downloads=True)
    assert backend.told == f"modelled {f3sr.__version__} (weights hub/name:latest, device cpu)"
    assert MODELLED.find("own").told == f"own {f3sr.__version__}"


def test_another_model_is_another_key_of_stored_results():
    first, same, other = (MODELLED.find(f"modelled:{name}").key for name in ("a", "a", "b"))
    assert first == same != other and MODELLED.find("own").key == MODELLED.find("own").key


def test_a_back_end_without_a_model_takes_none():
    with pytest.raises(InputError, match="own:hub/name; accepted: own without a model"):
        MODELLED.find("own:hub/name")


def test_examining_tells_what_a_back_end_needs():
    (need,) = next(found for found in MODELLED.examined() if found.name == "modelled").needs
    assert (need.met, need.remedy) == (False, "put them there")


def test_a_back_end_says_what_it_lacks_before_it_is_asked():
    with pytest.raises(InputError, match="test back end modelled: found weights: none; accepted: put them there"):
        MODELLED.find("modelled").require_ready()
    MODELLED.find("modelled", ModelChoice(allow_downloads=True)).require_ready()
    MODELLED.find("own").require_ready()


def test_built_in_and_foreign_names_are_found(voices: Path):
    own, foreign = KIND.find("own"), KIND.find("good")
    assert own.asked(lambda b: b.say("a")) == "a" and own.version == f3sr.__version__
    assert foreign.asked(lambda b: b.say("a")) == "aa" and str(foreign) == "test back end good 2.5"
    assert KIND.names() == sorted(["own", "broken", "good", *BAD])


def test_an_unknown_name_is_told_with_all_that_there_are(voices: Path):
    with pytest.raises(InputError, match=r"found 'nobody'; accepted: .*good.*own.*entry point in the group f3sr\.test"):
        KIND.find("nobody")
    with pytest.raises(InputError, match="none is installed"):
        Kind(name="nothing", protocol=Speaks).find("nobody")


@pytest.mark.parametrize("name", BAD)
def test_one_that_cannot_be_loaded_is_one_line_and_hides_no_other(name: str, voices: Path):
    with pytest.raises(F3srError) as told:
        KIND.find(name)
    assert BAD[name][1] in str(told.value) and "\n" not in str(told.value)
    assert KIND.find("good") and KIND.find("own")


def test_every_name_is_examined(voices: Path):
    found = {f.name: f.problem for f in KIND.examined()}
    assert {name for name, problem in found.items() if not problem} == {"own", "good"}
    assert set(found) == {"own", "good", "broken", *BAD}


def test_nobody_takes_a_built_in_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    points = {"f3sr.test": {"own": "foreign_voices:Good", "other": "foreign_voices:Good"}}
    install(tmp_path / "site", monkeypatch, module="foreign_voices", source=SOURCE, points=points, name="evil")
    with pytest.raises(InputError, match=r"found own from f3sr itself and from evil 1\.0; accepted: one of a name"):
        KIND.find("own")
    assert KIND.find("other")


def test_damaged_entry_points_hide_no_others(voices: Path):
    info = voices / "aaa-1.0.dist-info"
    info.mkdir()
    (info / "entry_points.txt").write_text("[f3sr.test]\nno equals sign\n")
    assert KIND.find("good")
    (problem,) = [f.problem for f in KIND.examined() if not f.name]
    assert "its entry points cannot be read" in problem


def test_what_a_back_end_raises_names_it():
    def fails(_: object) -> None:
        raise ZeroDivisionError("weights\nare gone")

    with pytest.raises(BackendError, match=r"test back end own .*: unforeseen ZeroDivisionError: weights; it gave no"):
        KIND.find("own").asked(fails)


def test_keys_tell_versions_and_kinds_apart():
    a = answering("background", 1)
    keys = {a.key, replace(a, version="1.1").key, replace(a, name="other").key, replace(a, made=Rules()).key}
    assert len(keys) == 4 and a.key == answering("background", 2).key


# --- what a folder lacks ------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_folder(tmp_path / "input")
    return tmp_path / "input"


def as_read(given: Inputs) -> tuple[EstimatedGeometry, dict[int, GeneratedAsset]]:
    """What a folder has, as back ends would answer it."""
    g = given.geometry
    geometry = EstimatedGeometry(points=g.points, valid=g.valid, K=given.K, normals=g.normals)
    assets = {
        id: GeneratedAsset(mesh=a.mesh, T_camera_object=a.T_camera_object, scale=a.scale)
        for id, a in given.assets.items()
    }
    return geometry, assets


def test_what_is_filled_in_is_as_what_was_given(folder: Path):
    given = inputs.read(folder)
    geometry, assets = as_read(given)
    fillers = Fillers(geometry=answering("geometry", geometry), assets=answering("assets", assets))
    made = inputs.read(folder, ignore=["geometry", "assets"], fillers=fillers)
    assert np.array_equal(made.K, given.K) and np.array_equal(made.geometry.points, given.geometry.points)
    assert made.geometry.source == "estimate" and made.fillers == {"geometry": "echo 1.0", "assets": "echo 1.0"}
    for id, asset in given.assets.items():
        assert np.array_equal(made.assets[id].mesh.vertices, asset.mesh.vertices)
        assert np.array_equal(made.assets[id].T_camera_object, asset.T_camera_object)
    choices = [d.choice for d in made.decisions]
    assert "geometry: estimated by geometry back end echo 1.0" in choices
    assert "assets: generated by assets back end echo 1.0" in choices


def test_what_the_folder_has_is_not_asked_for(folder: Path):
    (folder / "scene_graph.json").write_text(json.dumps({"relations": []}))
    fillers = Fillers(
        geometry=answering("geometry", "nonsense"),
        assets=answering("assets", "nonsense"),
        scene_graph=answering("scene_graph", 7),
    )
    given, plain = inputs.read(folder, fillers=fillers), inputs.read(folder)
    assert not given.fillers and given.key == plain.key
    assert sum("is not asked" in d.choice for d in given.decisions) == 3


def test_another_answer_is_another_key(folder: Path):
    geometry, assets = as_read(inputs.read(folder))

    def key(geometry: EstimatedGeometry, assets: dict[int, GeneratedAsset]) -> str:
        fillers = Fillers(geometry=answering("geometry", geometry), assets=answering("assets", assets))
        return inputs.read(folder, ignore=["geometry", "assets"], fillers=fillers).key

    moved = {id: replace(a, scale=1.001 * a.scale) for id, a in assets.items()}
    other = replace(geometry, K=geometry.K * [[1.001], [1], [1]])
    keys = [key(geometry, assets), key(geometry, assets), key(geometry, moved), key(other, assets)]
    assert len(set(keys)) == 3


def test_relations_count_as_given_ones(folder: Path):
    said = Relation(subject=5, predicate="supported_by", object=2, confidence=0.9, evidence="seen\n\x1b[2J")
    backend = answering("scene_graph", [said])
    graph = inputs.read(folder, fillers=Fillers(scene_graph=backend)).graph
    assert graph is not None and graph.source == str(backend)
    (relation,) = graph.relations
    assert relation.source == "given" and relation.evidence.isprintable() and relation.evidence.startswith("given by ")
    assert (relation.subject, relation.predicate, relation.object) == (5, "supported_by", 2)


def relation(**changed: Any) -> list[Relation]:
    r = Relation(subject=5, predicate="supported_by", object=2, confidence=0.5, evidence="")
    return [replace(r, **changed)]


GEOMETRY: dict[str, tuple[Callable[[EstimatedGeometry], Any], str]] = {
    "nothing": (lambda g: None, "NoneType"),
    "a tuple": (lambda g: (g.points, g.K), "tuple"),
    "lists": (lambda g: replace(g, points=g.points.tolist()), "list"),
    "flat points": (lambda g: replace(g, points=g.points[..., 0]), "points of shape"),
    "whole numbers": (lambda g: replace(g, points=g.points.astype(int)), "points of shape"),
    "another size": (lambda g: replace(g, points=g.points[1:]), "points of shape"),
    "no mask": (lambda g: replace(g, valid=g.valid.astype(float)), "valid of shape"),
    "NaN": (lambda g: replace(g, points=np.nan * g.points), "no valid depth"),
    "behind": (lambda g: replace(g, points=-g.points), "no valid depth"),
    "nothing valid": (lambda g: replace(g, valid=np.zeros_like(g.valid)), "no valid depth"),
    "another unit": (lambda g: replace(g, points=1e6 * g.points), "median depth"),
    "K of zeros": (lambda g: replace(g, K=0 * g.K), "K ="),
    "K negative": (lambda g: replace(g, K=g.K * [[-1], [1], [1]]), "K ="),
    "K of NaN": (lambda g: replace(g, K=np.nan * g.K), "K ="),
    "K of words": (lambda g: replace(g, K=np.array([["f"] * 3] * 3)), "K of shape"),
    "K normalised": (lambda g: replace(g, K=g.K / [[192], [144], [1]]), "K ="),
    "an error of the ground below zero": (lambda g: replace(g, up_error=-1.0), "an error of -1 rad"),
    "an error that is none": (lambda g: replace(g, focal_error=float("nan")), "an error of nan"),
    "an error in words": (lambda g: replace(g, focal_error="1 %"), "an answer with str"),
    "normals of another size": (lambda g: replace(g, normals=np.zeros((3, 3, 3))), "normals of shape"),
}


@pytest.mark.parametrize("case", GEOMETRY)
def test_a_wrong_geometry_is_one_error_that_names_its_back_end(case: str, folder: Path):
    change, found = GEOMETRY[case]
    backend = answering("geometry", change(as_read(inputs.read(folder))[0]))
    with pytest.raises(InputError) as told:
        inputs.read(folder, ignore=["geometry"], fillers=Fillers(geometry=backend))
    assert str(told.value).startswith(f"{backend}: found ") and found in str(told.value)


def meshed(**changed: Any) -> Callable[[GeneratedAsset], Any]:
    return lambda a: replace(a, mesh=replace(a.mesh, **{k: v(a.mesh) for k, v in changed.items()}))


def turned(T: np.ndarray) -> Callable[[GeneratedAsset], Any]:
    return lambda a: replace(a, T_camera_object=a.T_camera_object @ T)


ASSET: dict[str, tuple[Callable[[GeneratedAsset], Any], str]] = {
    "a mesh alone": (lambda a: a.mesh, "Mesh"),
    "no mesh": (lambda a: replace(a, mesh=None), "NoneType"),
    "NaN vertices": (meshed(vertices=lambda m: np.nan * m.vertices), "NaN"),
    "flat vertices": (meshed(vertices=lambda m: m.vertices[:, :2]), "vertices of shape"),
    "no faces": (meshed(faces=lambda m: m.faces[:0], face_material=lambda m: None), "0 faces"),
    "faces of nothing": (meshed(faces=lambda m: m.faces + 1000), "do not exist"),
    "negative faces": (meshed(faces=lambda m: m.faces - 1), "do not exist"),
    "a flat mesh": (meshed(vertices=lambda m: m.vertices * [1, 1, 0]), "flat"),
    "uv of others": (meshed(uv=lambda m: np.zeros((3, 2))), "uv of shape"),
    "colours of others": (meshed(vertex_colors=lambda m: np.zeros((2, 3))), "vertex_colors of shape"),
    "materials missing": (meshed(materials=lambda m: ()), "materials"),
    "a material of words": (meshed(materials=lambda m: ("red",)), "str"),
    "a colour of words": (meshed(materials=lambda m: (Material(base_color=("a", "b", "c")),)), "str"),  # type: ignore[arg-type]
    "a texture of floats": (meshed(materials=lambda m: (Material(texture=np.zeros((4, 4, 3))),)), "texture"),  # type: ignore[arg-type]
    "sheared": (turned(np.diag([1.0, 2, 1, 1])), "not rigid"),
    "mirrored": (turned(np.diag([1.0, -1, 1, 1])), "not rigid"),
    "NaN pose": (turned(np.full((4, 4), np.nan)), "not rigid"),
    "a small pose": (lambda a: replace(a, T_camera_object=np.eye(3)), "T_camera_object of 2 of shape"),
    "no scale": (lambda a: replace(a, scale=0), "scale 0"),
    "a scale of NaN": (lambda a: replace(a, scale=np.nan), "scale nan"),
    "a scale of words": (lambda a: replace(a, scale="1"), "str"),
    "kilometres": (lambda a: replace(a, scale=1e6), "an object of"),
    "behind the camera": (lambda a: replace(a, T_camera_object=pose(a.T_camera_object[:3, :3], [0, 0, -1])), "behind"),
}


@pytest.mark.parametrize("case", ASSET)
def test_a_wrong_asset_is_one_error_that_names_its_back_end(case: str, folder: Path):
    change, found = ASSET[case]
    assets: dict[int, Any] = dict(as_read(inputs.read(folder))[1])
    backend = answering("assets", {**assets, 2: change(assets[2])})
    with pytest.raises(InputError) as told:
        inputs.read(folder, ignore=["assets"], fillers=Fillers(assets=backend))
    assert str(told.value).startswith(str(backend)) and found in str(told.value)


@pytest.mark.parametrize("change", [lambda a: list(a.values()), lambda a: {2: a[2]}, lambda a: {**a, 99: a[2]}])
def test_assets_are_one_for_every_mask(change: Callable[[Any], Any], folder: Path):
    backend = answering("assets", change(as_read(inputs.read(folder))[1]))
    with pytest.raises(InputError, match="assets back end echo"):
        inputs.read(folder, ignore=["assets"], fillers=Fillers(assets=backend))


@pytest.mark.parametrize(
    ("answer", "found"),
    [
        (None, "NoneType"),
        ("text", "str"),
        ([1], "int"),
        (relation(subject=99), "99 supported_by 2"),
        (relation(object=5), "5 supported_by 5"),
        (relation(subject=-1), "-1 supported_by"),
        (relation(predicate="eats"), "eats"),
        (relation(predicate=[]), "predicate"),
        (relation(subject="5"), "str"),
        (relation(confidence=2.0), "confidence 2"),
        (relation(confidence=float("nan")), "confidence nan"),
        (relation(evidence="x" * 2000), "2000 characters"),
        (relation(evidence=None), "NoneType"),
        (10_001 * relation(), "10,001 relations"),
    ],
)
def test_wrong_relations_are_one_error(answer: Any, found: str, folder: Path):
    with pytest.raises(InputError, match="scene_graph back end echo") as told:
        inputs.read(folder, fillers=Fillers(scene_graph=answering("scene_graph", answer)))
    assert found in str(told.value)


# --- masks and backgrounds ----------------------------------------------------------------------------------

PHOTO = Photo(rgb=np.full((20, 30, 3), 9, np.uint8))


def test_masks_are_one_per_prompt_of_the_photos_size_and_not_empty():
    full = np.ones((20, 30), np.bool_)
    assert len(checked_masks("segmenter", [full, full], PHOTO, 2)) == 2
    for answer in (None, "ab", [full], [full, 255 * full.astype(np.uint8)], [full, full.T], [full, ~full], [full, 1]):
        with pytest.raises(InputError, match=r"segmenter: found .*; accepted: "):
            checked_masks("segmenter", answer, PHOTO, 2)


@pytest.mark.parametrize(
    "answer", [None, PHOTO, PHOTO.rgb[1:], PHOTO.rgb / 255, PHOTO.rgb.astype(np.uint16), PHOTO.rgb[..., 0]]
)
def test_a_completed_photo_is_one_of_its_size(answer: Any):
    with pytest.raises(InputError, match="completer: found"):
        checked_photo("completer", answer, PHOTO)
    assert checked_photo("completer", PHOTO.rgb, PHOTO) is PHOTO.rgb


def test_a_background_is_taken_in_the_hole_only_and_stored_by_its_back_end(folder: Path, tmp_path: Path):
    given, store = inputs.read(folder), Store(tmp_path / "store")
    skip = ALL_BUT_INPAINT.split(",")
    magenta = np.broadcast_to(np.array([255, 0, 255], np.uint8), given.photo.rgb.shape)

    def result(backend: Backend[Any] | None) -> Any:
        return reconstruct(given, skip=skip, background=backend, store=store)

    plain, painted = result(None), result(answering("background", magenta))
    assert "backends" not in plain.provenance
    assert painted.provenance["backends"] == {"background": "echo 1.0"}
    changed = (painted.inpainting.rgb != given.photo.rgb).any(2)
    assert changed.any() and (painted.inpainting.rgb[changed] == magenta[changed]).all() and not changed.all()
    assert not np.array_equal(plain.inpainting.rgb, painted.inpainting.rgb)
    assert "inpaint" in result(answering("background", magenta)).resumed
    assert "inpaint" not in result(answering("background", magenta, version="2")).resumed
    assert any("completed by background back end echo" in d.choice for r in painted.reports for d in r.decisions)


# --- languages ----------------------------------------------------------------------------------------------


def test_rules_by_name_give_what_rules_give(package: Any):
    goal = "push the can"
    named = simulate_goal(package, goal, language=CheckedLanguage(LANGUAGES.find("rules")))
    plain = simulate_goal(package, goal)
    assert isinstance(named, Played) and isinstance(plain, Played) and named.plan == plain.plan


@pytest.mark.parametrize(
    "answer", [None, "text", [1], [{"active": 0}], [TaskSpec.model_construct(kind="push")], 1001 * [1], {}, b"x"]
)
def test_answers_of_another_type_cannot_be_played(answer: Any, package: Any):
    with pytest.raises(PlanError):
        simulate_goal(package, "push the can", language=CheckedLanguage(answering("language", answer)))


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Any:
    scene = scene_of(box(0, size=(0.07, 0.07, 0.1), at=(0, 0, 0.05), label="can"))
    return read_package(write_package(scene, tmp_path_factory.mktemp("language") / "package"))


# --- exporters ----------------------------------------------------------------------------------------------


def test_a_package_holds_what_the_exporters_of_both_formats_give(package: Any):
    scene = scene_of(box(0, size=(0.07, 0.07, 0.1), at=(0, 0, 0.05), label="can"))
    files = dict[str, bytes]()
    for exporter in WRITTEN:
        files |= exporter.files(ExportedScene.of(scene))
    assert all((package.folder / path).read_bytes() == data for path, data in files.items())
    named = set(re.findall(r'file="([^"]+)"', files["scene.xml"].decode()))
    exact = {name for name in files if re.fullmatch(r"collision/\d+/\d+\.obj", name)}
    assert named == files.keys() - {"scene.xml", "scene.glb"} - exact and any("_grown" in name for name in named)
    assert len(exact) == sum("_grown" in name for name in named), "scene.json names the exact parts"


def test_an_exporter_has_the_name_that_finds_it():
    for name in EXPORTERS.names():
        assert EXPORTERS.find(name).made.name == name


# --- the whole way ------------------------------------------------------------------------------------------


def guide(language: str) -> str:
    """The one block of a language in the guide's section on back ends."""
    section = GUIDE.read_text().partition("## Add a back end")[2].partition("\n## ")[0]
    (block,) = re.findall(rf"```{language}\n(.*?)```", section, re.DOTALL)
    return block


def test_the_guides_package_runs_through_the_command_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    project = tomllib.loads(guide("toml"))["project"]
    install(
        tmp_path / "site",
        monkeypatch,
        module="mean_background",
        source=guide("python"),
        points=project["entry-points"],
        name=project["name"],
        version=project["version"],
    )
    out = tmp_path / "out"
    call = ["reconstruct", str(folder), "-o", str(out), "--skip", ALL_BUT_INPAINT, "--background", "mean"]
    assert main(call) == 0, capsys.readouterr().err
    content = read_package(out)
    assert content.document.provenance["backends"] == {"background": "mean 1.0"}
    background, photo = content.background(), content.scene.photo.rgb
    assert background is not None
    changed = (background != photo).any(2)
    assert changed.any() and len(np.unique(background[changed], axis=0)) == 1
    assert main(["doctor", "--json"]) == 0
    checks = json.loads(capsys.readouterr().out.splitlines()[-1])["checks"]
    assert [c["found"] for c in checks if c["name"] == "mean"] == ["from mean-background 1.0"]


def test_the_command_line_tells_of_a_broken_one_in_one_line_and_works_without_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    points = {"f3sr.geometry": {"bad": "broken_weights:Model"}, "f3sr.language": {"bad": "broken_weights:Model"}}
    install(tmp_path / "site", monkeypatch, module="broken_weights", source="1 / 0", points=points)
    monkeypatch.delenv(TRACEBACK, raising=False)
    out = ["-o", str(tmp_path / "out")]
    for call, code in (
        (["reconstruct", str(folder), *out, "--geometry", "bad"], 1),
        (["reconstruct", str(folder), *out, "--assets", "nobody"], 2),
        (["simulate", str(folder), "push it", "--language", "bad"], 1),
        (["simulate", str(folder), "push it", "--language", "nobody"], 2),
    ):
        assert main(call) == code
        said = capsys.readouterr()
        assert said.err.count("\n") == 1 and "back end" in said.err and not (tmp_path / "out").exists()
    assert main(["doctor", "--json"]) == 0
    bad = [c for c in json.loads(capsys.readouterr().out)["checks"] if c["name"] == "bad"]
    assert [c["state"] for c in bad] == ["broken"] * 2 and all("ZeroDivisionError" in c["found"] for c in bad)
    code = f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r}); import f3sr; f3sr.LANGUAGES.find('rules')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
