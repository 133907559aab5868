"""The command line: its commands, their output, exit codes and what they leave behind."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pytest

import f3sr
from f3sr import example, options, pipeline, settings
from f3sr.cli import doctor
from f3sr.cli.main import main
from f3sr.metrics.measures import IMAGE_MEASURES
from f3sr.pipeline_config import Config
from f3sr.scene_package.package import read_package
from folders import write_folder


def test_the_command_line_from_folder_to_numbers(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "package"
    assert main(["reconstruct", str(folder), "-o", str(out), "--skip", "refine", "--export", "urdf"]) == 0
    printed = capsys.readouterr().out
    assert "direct composition" in printed and str(out) in printed
    assert {"scene.json", "scene.glb", "scene.xml", "report.json", "photo.png"} <= {p.name for p in out.iterdir()}
    assert sorted(p.name for p in (out / "pictures").iterdir()) == [
        "overlay_after.png", "overlay_before.png", "render_after.png", "render_before.png", "sheet.png",
        "side_after.png", "side_before.png",
    ]  # fmt: skip
    exported = json.loads((tmp_path / "package_export/export.json").read_text())
    assert exported["formats"] == ["urdf"] and len(exported["objects"]) == 3 and "package_export" in printed
    document = json.loads((out / "scene.json").read_text())
    assert [o["id"] for o in document["objects"]] == [2, 5, 7]

    assert main(["evaluate", str(out), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    for name, value in document["metrics"].items():
        tolerance = 0.15 if name == "proxy_far_pct" else 1e-3  # a few thousand random samples
        assert table["f3sr"][name] == pytest.approx(value, rel=tolerance, abs=1e-4), name
    assert list(table) == ["direct composition", "direct composition, fitted camera", "f3sr"]
    assert table["direct composition"]["n"] == 3
    report = json.loads((out / "report.json").read_text())
    assert list(report["measures"]) == list(table) and report["measures"]["f3sr"] == document["metrics"]
    assert report["stages"][-1]["stage"] == "evaluate" and "camera" in report["stages"][-1]["decisions"][0]["choice"]
    assert read_package(out).direct is not None and read_package(out).camera_aligned

    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.xipos.copy()
    for _ in range(round(5 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    assert model.njnt == 3 and np.abs(data.xipos - start).max() < 1e-3


def test_a_raw_folder_is_measured_with_and_without_a_fitted_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_folder(tmp_path / "input", perturb=0.12, seed=5)
    assert main(["evaluate", str(tmp_path / "input"), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    given, fitted = table["direct composition"], table["direct composition, fitted camera"]
    assert len(table) == 2 and fitted["mIoU"] > given["mIoU"]
    assert all(fitted[name] == given[name] for name in given.keys() - set(IMAGE_MEASURES))


def test_a_package_that_was_not_aligned_is_foreign(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_folder(tmp_path / "input", perturb=0.12, seed=5)
    out = str(tmp_path / "package")
    assert main(["reconstruct", str(tmp_path / "input"), "-o", out, "--skip", "align,evaluate"]) == 0
    capsys.readouterr()
    assert main(["evaluate", out, "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    assert list(table)[2:] == ["f3sr", "f3sr, fitted camera"]
    assert table["f3sr, fitted camera"]["mIoU"] > table["f3sr"]["mIoU"]
    assert main(["evaluate", out]) == 0
    assert "fitted camera" in capsys.readouterr().out
    assert main(["evaluate", out, "--ignore", "ground"]) == 2
    assert "only with a prompted-image folder" in capsys.readouterr().err
    assert main(["reconstruct", out, "-o", str(tmp_path / "other")]) == 2
    assert "found an f3sr package; accepted: a folder with image.png|jpg and masks/*.png" in capsys.readouterr().err


EITHER = "an f3sr package, or a folder with image.png|jpg and masks/*.png"


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["reconstruct", "{folder}-absent", "-o", "{out}"], 2, "nothing there"),
        (["reconstruct", "{folder}-absent", "-o", "{out}", "--skip", "polish"], 2, "--skip: found polish; accepted: l"),
        (["evaluate", "{folder}-absent"], 2, f"-absent: found nothing there; accepted: {EITHER}"),
        (["evaluate", "{folder}/image.png"], 2, f"image.png: found a file; accepted: {EITHER}"),
        (["evaluate", "{folder}/assets"], 2, f"assets: found a folder without scene.json; accepted: {EITHER}"),
        (["goals", "{folder}/image.png"], 2, "image.png: found a file; accepted: an f3sr package"),
        (["goals", "{folder}"], 2, "found an input folder; accepted: an f3sr package, which `f3sr reconstruct FOLDER"),
        (["reconstruct", "{folder}", "-o", "{out}", "--ignore", "photo"], 2, "photo"),
        (["reconstruct", "{folder}", "-o", "{out}", "--asset-frame", "left"], 2, "left"),
        (["reconstruct", "{folder}", "-o", "{folder}"], 1, "may not hold one another"),
        (["reconstruct", "{folder}", "-o", "{folder}/.."], 1, "may not hold one another"),
        (["evaluate", "{folder}/masks"], 2, "scene.json"),
        (["evaluate", "{folder}", "--ignore", "photo"], 2, "photo"),
        (["evaluate", "{folder}", "--true-scale", "-1"], 2, "positive"),
    ],
)
def test_wrong_calls_end_with_one_line_and_their_exit_code(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, message: str
):
    out = tmp_path / "out"
    assert main([a.format(folder=folder, out=out) for a in arguments]) == code
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and error.startswith("f3sr: ")
    assert not out.exists()


def test_settings_from_a_file_reach_stages_and_package(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file, out = tmp_path / "settings.toml", tmp_path / "out"
    file.write_text("[settle.physics]\ntimestep = 0.001\n[refine]\nrounds = 0\n")
    call = ["reconstruct", str(folder), "-o", str(out), "--config", str(file), "--skip", "evaluate"]
    assert main(call) == 0
    option = ET.parse(out / "scene.xml").getroot().find("option")
    assert option is not None and float(option.attrib["timestep"]) == 0.001
    provenance = json.loads((out / "scene.json").read_text())["provenance"]
    assert provenance["settings"] == {"settle.physics.timestep": 0.001, "refine.rounds": 0}


def test_a_wrong_setting_ends_before_any_work(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, out = tmp_path / "settings.toml", tmp_path / "out"
    file.write_text("[align]\nmax_yaw = 9\n")
    assert main(["reconstruct", str(folder), "-o", str(out), "--config", str(file)]) == 2
    said = capsys.readouterr()
    assert said.err == f"f3sr: {file}: found align.max_yaw = 9; accepted: a number > 0 and <= 3.1415927\n"
    assert not said.out and not out.exists()


def test_every_step_is_told_with_its_time(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    call = ["reconstruct", str(folder), "-o", str(tmp_path / "out"), "--skip", "refine,evaluate"]
    assert main(call) == 0
    steps = [line.split(": ")[0] for line in capsys.readouterr().out.splitlines()]
    assert steps[:10] == [
        "read", "kernels", "assemble", "level", "align", "relate", "decompose", "separate", "settle", "close",
    ]  # fmt: skip
    assert steps[10:14] == ["refine", "coarsen", "describe", "uncertainty"]
    assert steps[14:18] == ["evaluate", "inpaint", "pictures", "package"]


def test_config_prints_what_config_files_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["config"]) == 0
    (tmp_path / "settings.toml").write_text(capsys.readouterr().out)
    assert settings.read(tmp_path / "settings.toml", Config()) == Config()


# --- what nobody foresaw ------------------------------------------------------------------------------------------


def fails_with(error: Exception, monkeypatch: pytest.MonkeyPatch, traceback: str = "") -> None:
    def fail(_: object) -> str:
        raise error

    monkeypatch.setenv("F3SR_TRACEBACK", traceback)
    monkeypatch.setattr(settings, "describe", fail)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyError("x"), "unforeseen KeyError: 'x'"),
        (ValueError("one\nand more"), "unforeseen ValueError: one"),
        (RecursionError(), "unforeseen RecursionError"),
        (MemoryError(), "out of memory"),
        (np._core._exceptions._ArrayMemoryError((10**12,), np.dtype(float)), "out of memory: Unable to allocate 7.28"),
        (ImportError("a.so: failed to map segment"), "unforeseen ImportError: a.so: failed to map segment"),
        (AssertionError("y" * 9999), "unforeseen AssertionError: yyy"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "\x1b[2J"), "unforeseen UnicodeDecodeError"),
    ],
)
def test_an_error_that_nobody_foresaw_is_one_line(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    fails_with(error, monkeypatch)
    assert main(["config"]) == 1
    line = capsys.readouterr().err
    assert line.startswith(f"f3sr: {said}") and line.count("\n") == 1 and len(line) < 400 and line[:-1].isprintable()
    assert line.endswith("; nothing was written; F3SR_TRACEBACK=1 shows where\n")


def test_an_error_tells_the_first_cause_that_was_given(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    error = ImportError("\n\nIMPORTANT: PLEASE READ THIS")
    error.__cause__ = MemoryError()
    fails_with(error, monkeypatch)
    assert main(["config"]) == 1 and capsys.readouterr().err.startswith("f3sr: out of memory; ")


def test_the_traceback_is_shown_where_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    fails_with(KeyError("x"), monkeypatch, traceback="1")
    assert main(["config"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("Traceback") and "in fail" in said and said.splitlines()[-1].startswith("f3sr: unforeseen")


# --- help ---------------------------------------------------------------------------------------------------


def help_of(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The help of a command in one line, without its frames."""
    with pytest.raises(SystemExit):
        main([*command.split(), "--help"])
    return " ".join(re.sub("[─-╿]", " ", capsys.readouterr().out).split())


COMMANDS = (
    "photo",
    "segment",
    "reconstruct",
    "evaluate",
    "simulate",
    "film",
    "goals",
    "batch",
    "dataset",
    "demo",
    "config",
    "doctor",
)
DATASET_COMMANDS = ("dataset stats", "dataset filter", "dataset sheet", "dataset export", "dataset prune")


@pytest.mark.parametrize("command", [*COMMANDS, *DATASET_COMMANDS])
def test_help_names_what_an_argument_is_and_no_empty_default(command: str, capsys: pytest.CaptureFixture[str]):
    said = help_of(command, capsys)
    assert not re.search(r"None|\bPATH\b|\bSTR\b|default: (\)|'')", said), said


def test_the_first_help_has_every_exit_code_and_variable(capsys: pytest.CaptureFixture[str]):
    said = help_of("", capsys)
    assert re.search(r"Exit codes: 0 .*, 1 .*, 2 .*, 3 .*, 4 ", said)
    sources = "".join(file.read_text() for file in Path(f3sr.__file__).parent.rglob("*.py"))
    assert all(name in said for name in set(re.findall(r"\bF3SR_[A-Z_]+", sources)))
    assert "fitted to its masks" not in said and all(command in said for command in COMMANDS)


def test_the_help_of_skip_tells_what_else_is_left_out(capsys: pytest.CaptureFixture[str]):
    said = help_of("reconstruct", capsys)
    for stage in pipeline.REPEATED_BY_REFINE:
        assert stage in said.partition(". Without ")[2].partition(", refine is left out too")[0]


def test_the_help_of_the_demo_has_its_goal(capsys: pytest.CaptureFixture[str]):
    assert example.GOAL in help_of("demo", capsys)


@pytest.mark.parametrize(
    ("command", "option", "accepted"),
    [
        ("reconstruct", "--skip", options.SKIPPABLE),
        ("reconstruct", "--ignore", options.PARTS),
        ("reconstruct", "--asset-frame", options.ASSET_FRAMES),
        ("evaluate", "--ignore", options.PARTS),
        ("batch", "--skip", options.SKIPPABLE),
        ("batch", "--ignore", options.PARTS),
        ("batch", "--asset-frame", options.ASSET_FRAMES),
    ],
)
def test_help_names_all_that_an_option_accepts(
    command: str, option: str, accepted: tuple[str, ...], capsys: pytest.CaptureFixture[str]
):
    said = help_of(command, capsys).partition(f" {option} ")[2].partition(" --")[0]
    assert ",".join(accepted) in said.replace(" ", "")


def test_the_package_says_what_it_is():
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    assert project["version"] == f3sr.__version__ and project["authors"]
    assert "Typing :: Typed" in project["classifiers"] and (Path(f3sr.__file__).parent / "py.typed").is_file()


def test_the_version_is_printed(capsys: pytest.CaptureFixture[str]):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"f3sr {f3sr.__version__}\n"


@pytest.mark.parametrize(("given", "taken"), [(None, "1"), ("2", "2")])
def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(given: str | None, taken: str):
    code = """
import os, sys, f3sr.__main__ as command
os._exit = lambda code: print(*(os.environ[name] for name in command.ONE_THREAD))
sys.argv = ["f3sr", "--version"]
command.run()
"""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
    others = {name: value for name, value in os.environ.items() if name not in names}
    env = others | (dict.fromkeys(names, given) if given else {})
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[-1] == f"{taken} {taken}", done.stderr


# --- doctor -------------------------------------------------------------------------------------------------


def test_the_doctor_finds_this_machine_able(capsys: pytest.CaptureFixture[str]):
    assert main(["doctor", "--json"]) == 0
    checks = {(c["group"], c["name"]): c for c in json.loads(capsys.readouterr().out)["checks"]}
    assert not [c for c in checks.values() if c["state"] == "failed"]
    for part in (("decomposition", "cuts"), ("statics", "HiGHS"), ("physics", "MuJoCo"), ("assets", "given")):
        assert checks[part]["state"] == "ok"
    assert {"numpy", "numba", "mujoco-core", "manifold3d", "f3sr", "Python"} <= {name for _, name in checks}


def test_the_doctor_says_what_does_not_work_and_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def broken(*_: object) -> int:
        raise RuntimeError("no such library\nand more")

    monkeypatch.setattr("f3sr.proxies.split", broken)
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "numba" else "1.0")
    assert main(["doctor"]) == 1
    said = capsys.readouterr()
    assert said.err == "f3sr: does not work here: numba, cuts\n"
    lines = said.out.splitlines()
    assert lines[0].split() == ["state", "group", "name", "found"]
    assert any(
        line.startswith("failed") and "cuts" in line and "RuntimeError: no such library" in line for line in lines
    )
    assert any(line.startswith("failed") and "numba" in line and "pip install f3sr" in line for line in lines)


# --- importing ----------------------------------------------------------------------------------------------


def test_importing_f3sr_is_quick_and_loads_nothing_heavy():
    code = """
import sys, time
start = time.process_time()
import f3sr
seconds = time.process_time() - start
heavy = {"numpy", "scipy", "numba", "trimesh", "mujoco", "pydantic", "PIL", "tyro", "rich", "jinja2"} & set(sys.modules)
print(seconds, sorted(heavy), dir(f3sr))
assert seconds < 0.3 and not heavy
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_public_name_is_the_same_whatever_was_imported_since():
    """A module of the same name takes a function's place as soon as anything imports it."""
    code = """
import importlib, pkgutil, f3sr
before = {name: getattr(f3sr, name) for name in f3sr.__all__}
for module in pkgutil.walk_packages(f3sr.__path__, "f3sr."):
    if "__main__" not in module.name:
        importlib.import_module(module.name)
changed = [name for name in f3sr.__all__ if getattr(f3sr, name) is not before[name]]
assert not changed, changed
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_example_is_had_without_an_import_of_its_own():
    code = "import f3sr; assert 'example' in dir(f3sr); print(f3sr.example.folder().name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "tabletop\n", done.stderr


def test_types_that_public_functions_take_and_raise_are_public():
    assert {"Exporter", "FilmConfig", "Inputs", "Package", "PlanError"} <= set(f3sr.__all__)


def test_every_public_name_can_be_had():
    for name in f3sr.__all__:
        assert getattr(f3sr, name) is not None
    assert set(f3sr.__all__) <= set(dir(f3sr))
    with pytest.raises(AttributeError, match="it has ASSET_GENERATORS"):
        _ = f3sr.nothing
