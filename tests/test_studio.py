"""Films of goals through the commands: what is written, whose film it is, and what goes wrong in one line."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from PIL import Image

from f3sr.cli.main import main
from f3sr.core.transforms import pose, transform
from f3sr.errors import OutputError
from f3sr.film.captions import captioned, slowed
from f3sr.film.deadband import Held
from f3sr.film.studio import FilmConfig, FilmFrames, Studio, film_played
from f3sr.goals.file_names import FILM, FILMS, PLAN, ROLLOUT, STRIP, VERDICT
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.scene import Scene
from f3sr.scene_package.package import Package
from f3sr.vision.regions import shrunk
from goal_scene import BALL, CAN, CRATE, goal_package, goal_scene
from hostile_npz import HOSTILE

FPS = 30
"""Of rollouts and films."""

av = pytest.importorskip("av")
GOAL = "knock over the cereal box"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Package:
    return goal_package(tmp_path_factory.mktemp("films") / "package")


@pytest.fixture(scope="module")
def rollout(package: Package) -> Path:
    """A rollout in its package, without a film."""
    assert main(["simulate", str(package.folder), GOAL, "--no-film"]) == 0
    return package.folder / "rollouts" / "1"


def test_a_goal_is_filmed_to_the_frame(package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", str(package.folder), GOAL, "-o", str(tmp_path / "out"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["goals"][0]
    assert {p.name for p in (tmp_path / "out").iterdir()} == {PLAN, ROLLOUT, VERDICT, *FILMS}
    time = np.load(tmp_path / "out" / ROLLOUT)["time"]
    with av.open(str(tmp_path / "out" / FILM)) as container:
        frames = [frame.time for frame in container.decode(video=0)]
    opening, closing = (round(still * FPS) for still in (FilmConfig().opening, FilmConfig().closing))
    assert told["film"]["frames"] == len(frames) == opening + len(time) + closing
    played = frames[opening : len(frames) - closing]
    assert np.allclose(played, opening / FPS + time, atol=1e-6), "film time is simulated time"


def test_without_a_film_there_is_none_and_it_can_be_made_later(
    package: Package, rollout: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {name: (rollout / name).read_bytes() for name in (PLAN, ROLLOUT, VERDICT)}
    assert not (rollout / FILM).exists()
    assert main(["film", str(rollout)]) == 0
    assert "film.mp4" in capsys.readouterr().out
    made = {name: (rollout / name).read_bytes() for name in FILMS}
    assert main(["film", str(rollout), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] > 10
    assert made == {name: (rollout / name).read_bytes() for name in FILMS}, "the same bytes again"
    assert before == {name: (rollout / name).read_bytes() for name in before}, "and nothing else changes"
    assert sorted(p.name for p in rollout.iterdir()) == sorted({*before, *FILMS})


def test_slow_motion_has_more_frames_of_the_same_time(package: Package, rollout: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(rollout, tmp_path / "copy")
    assert main(["film", str(copy), "--package", str(package.folder), "--slow", "4"]) == 0
    time = np.load(copy / ROLLOUT)["time"]
    with av.open(str(copy / FILM)) as container:
        frames = [frame.time for frame in container.decode(video=0)]
    still = FilmConfig().opening + FilmConfig().closing
    assert len(frames) == 4 * (round(still * FPS) + len(time) - 1) + 1
    assert frames[-1] == pytest.approx(4 * (still + time[-1]), abs=0.05)


def _no_plan(rollout: Path) -> None:
    (rollout / PLAN).unlink()


def _other_scene(rollout: Path) -> None:
    plan = json.loads((rollout / PLAN).read_text())
    (rollout / PLAN).write_text(json.dumps(plan | {"scene": "0" * 64}))


def _condition_of_nobody(rollout: Path) -> None:
    plan = json.loads((rollout / PLAN).read_text())
    plan["phases"][0]["task"]["conditions"][0]["a"] = 77
    (rollout / PLAN).write_text(json.dumps(plan))


def _other_objects(rollout: Path) -> None:
    arrays = dict(np.load(rollout / ROLLOUT))
    arrays["ids"] = arrays["ids"] + 1
    np.savez(rollout / ROLLOUT, **arrays)


def _broken_rollout(rollout: Path) -> None:
    (rollout / ROLLOUT).write_bytes(b"PK nothing")


def _empty_rollout(rollout: Path) -> None:
    (rollout / ROLLOUT).write_bytes(b"")


def _cut_rollout(rollout: Path) -> None:
    data = bytearray((rollout / ROLLOUT).read_bytes())
    data[200:400] = bytes(200)
    (rollout / ROLLOUT).write_bytes(data)


def _pipe(rollout: Path) -> None:
    (rollout / ROLLOUT).unlink()
    os.mkfifo(rollout / ROLLOUT)


def _with(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """A rollout with some arrays changed."""

    def change(rollout: Path) -> None:
        arrays = dict(np.load(rollout / ROLLOUT))
        np.savez(rollout / ROLLOUT, **{name: changes.get(name, lambda a: a)(a) for name, a in arrays.items()})

    return change


def _of_nobody(contacts: np.ndarray) -> np.ndarray:
    contacts = contacts.copy()
    contacts["b"][0] = 77
    return contacts


def _hostile(case: str, name: str) -> Callable[[Path], None]:
    return lambda rollout: HOSTILE[case][0](rollout / ROLLOUT, name)


def _many_samples(rollout: Path) -> None:
    """So many that filming them would never end."""
    arrays = dict(np.load(rollout / ROLLOUT))
    poses = np.broadcast_to(arrays["T_world_object"][:1], (200_000, *arrays["T_world_object"].shape[1:]))
    np.savez_compressed(rollout / ROLLOUT, **arrays | {"time": np.arange(2e5) / 2e4, "T_world_object": poses})


def _more_samples(rollout: Path) -> None:
    """More than its plan gives in as much time."""
    arrays = dict(np.load(rollout / ROLLOUT))
    poses = np.broadcast_to(arrays["T_world_object"][:1], (1000, *arrays["T_world_object"].shape[1:]))
    time = np.linspace(0, arrays["time"][-1], 1000)
    np.savez_compressed(rollout / ROLLOUT, **arrays | {"time": time, "T_world_object": poses})


def _not_finite(rollout: Path) -> None:
    arrays = dict(np.load(rollout / ROLLOUT))
    arrays["T_world_object"][3, 1, 0, 3] = np.nan
    np.savez(rollout / ROLLOUT, **arrays)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_no_plan, "plan.json"),
        (_other_scene, "another scene"),
        (_condition_of_nobody, "plan.json"),
        (_other_objects, "objects"),
        (_broken_rollout, "rollout.npz"),
        (_empty_rollout, "rollout.npz"),
        (_pipe, "a pipe"),
        (_with(time=lambda time: time[:0]), "rollout.npz"),
        (_with(time=lambda time: 0 * time), "times"),
        (_with(T_world_object=lambda T: 50 * T), "rotations"),
        (_with(T_world_object=lambda T: T * [1, 1, -1, 1]), "mirror"),
        (_with(T_world_object=lambda T: T + np.array([[0, 0, 0, 1e300]] * 3 + [[0] * 4])), "places"),
        (_with(contacts=lambda contacts: _of_nobody(contacts)), "contacts"),
        (_cut_rollout, "rollout.npz"),
        (_not_finite, "finite"),
        (_many_samples, "more than 4,004 values"),
        (_more_samples, "1000 samples"),
        (_with(time=lambda time: 2 * time), "as its plan has them"),
        (_with(time=lambda time: time + 0j), "time of complex numbers"),
        (_with(time=lambda time: time.astype(str)), "time ("),
        (_with(time=lambda time: time * 1e307), "as its plan has them"),
        (_with(time=lambda time: time * np.nan), "times that do not rise"),
        (_with(ids=lambda ids: ids * np.nan), "ids (6,) float64"),
        (_with(ids=lambda ids: ids.astype(np.uint64) + 2**63), "ids (6,) uint64"),
        (_with(ids=lambda ids: ids[:-1]), "T_world_object ("),
        (_with(T_world_object=lambda T: T[:-1]), "T_world_object ("),
        (_with(T_world_object=lambda T: T + 0j), "T_world_object of complex numbers"),
        (_with(contacts=lambda contacts: contacts["time"]), "contacts ("),
        (_hostile("U0 of 10^12 elements", "time"), "time of type"),
        (_hostile("V0 of 10^12 elements", "contacts"), "contacts of raw bytes"),
        (_hostile("a shape of 10^400", "ids"), "shape beyond"),
        (_hostile("9,000 brackets", "time"), "header of 9,000 bytes"),
        (_hostile("9,000 minus signs", "T_world_object"), "header of 9,001 bytes"),
        (_hostile("an encrypted entry", "ids"), "encrypted"),
        (_hostile("a bomb", "contacts"), "in an entry of 4,000,000,000 bytes"),
    ],
)
def test_what_is_no_rollout_of_the_package_is_told_in_one_line(
    package: Package, rollout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change, message: str
) -> None:
    copy = shutil.copytree(rollout, tmp_path / "copy", ignore=shutil.ignore_patterns(*FILMS))
    change(copy)
    before = sorted(copy.iterdir())
    start = perf_counter()
    assert main(["film", str(copy), "--package", str(package.folder)]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1 and perf_counter() - start < 5
    assert sorted(copy.iterdir()) == before, "nothing is left"


def test_a_rollout_without_its_package_says_how_to_name_it(
    rollout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(rollout, tmp_path / "copy")
    assert main(["film", str(copy)]) == 2
    assert "--package" in capsys.readouterr().err


@pytest.mark.parametrize("case", ["U0 of 10^12 elements", "a shape of 10^400", "3,000 brackets", "a bomb"])
def test_hostile_depths_of_a_package_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    package = goal_package(tmp_path / "package")
    shape = package.scene.camera.height, package.scene.camera.width
    np.savez(package.folder / "kept_depth.npz", depth=np.full(shape, np.inf, np.float32))
    assert package.kept_depth() is not None
    HOSTILE[case][0](package.folder / "kept_depth.npz", "depth")
    assert main(["simulate", str(package.folder), GOAL, "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "kept_depth.npz: found depth" in error and error.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize("slow", ["0", "nan", "-1", "1000"])
def test_a_speed_that_no_player_has_is_refused_first(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str], slow: str
) -> None:
    assert main(["simulate", str(package.folder), GOAL, "-o", str(tmp_path / "out"), "--slow", slow]) == 2
    assert "factor" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["background.png", "support.png", "kept_depth.npz"])
def test_what_a_film_needs_is_read_before_a_goal_is_played(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    folder = goal_package(tmp_path / "package").folder
    (folder / name).write_bytes(b"damaged")
    assert main(["simulate", str(folder), GOAL, "-o", str(tmp_path / "out")]) == 2
    assert name in capsys.readouterr().err and not (tmp_path / "out").exists()
    without_film = main(["simulate", str(folder), GOAL, "-o", str(tmp_path / "out"), "--no-film"])
    assert without_film == (2 if name == "support.png" else 0), "goals stay on the support that the photo shows"


def test_a_film_that_fails_keeps_its_verdict_and_the_other_goals(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OutputError("film: no space left")

    monkeypatch.setattr(Studio, "film", full)
    call = ["simulate", str(package.folder), GOAL, "push the banana", GOAL, "-o", str(tmp_path / "out")]
    assert main([*call, "--json"]) == 1
    told = capsys.readouterr()
    goals = json.loads(told.out)["goals"]
    assert [g["state"] for g in goals] == ["met", "refused", "met"] and "no space" in goals[2]["film_error"]
    assert "no space" in told.err and (tmp_path / "out" / "3" / VERDICT).exists()


def test_what_was_decided_for_all_films_is_told_once(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calls = ["push the can 5 cm to the left", "push the can 5 cm to the right"]
    assert main(["simulate", str(package.folder), *calls, "-o", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    decided = [line for line in printed.splitlines() if line.startswith("decided:")]
    assert decided and len(decided) == len(set(decided)) and printed.count("film.mp4") == 2


def test_a_place_where_no_film_can_be_is_refused_before_filming(
    package: Package, rollout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Studio, "of", lambda *_: pytest.fail("filmed"))
    copy = shutil.copytree(rollout, tmp_path / "copy", ignore=shutil.ignore_patterns(*FILMS))
    (copy / FILM).mkdir()
    assert main(["film", str(copy), "--package", str(package.folder)]) == 1
    assert "film.mp4: is a folder" in capsys.readouterr().err
    (copy / FILM).rmdir()
    monkeypatch.setattr(Path, "mkdir", _full)
    assert main(["film", str(copy), "--package", str(package.folder)]) == 1
    assert "could not be written (no space left" in capsys.readouterr().err.lower()


def _full(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_what_leaves_the_support_is_told(package: Package) -> None:
    found = simulate_goal(package, GOAL)
    assert isinstance(found, Played)
    shape = package.scene.photo.rgb.shape[:2]
    for support, told in ((np.ones(shape, bool), False), (np.zeros(shape, bool), True)):
        studio = Studio.of(package)
        studio = replace(studio, scene=replace(studio.scene, ground_mask=support))
        assert any("no edge" in d for d in studio.film(found).decisions) == told


@pytest.mark.parametrize("where", ["captions", "strip"])
def test_the_narrowest_pictures_have_captions(where: str) -> None:
    for height, width in ((480, 20), (16, 640), (16, 16)):
        picture = np.zeros((height, width, 3), np.uint8)
        if where == "captions":
            assert next(iter(slowed([picture], Fraction(4)))).shape == picture.shape
        else:
            assert captioned(picture, "0.00 s").shape == picture.shape


def test_a_package_without_background_is_filmed_and_that_is_told(package: Package) -> None:
    found = simulate_goal(package, GOAL)
    assert isinstance(found, Played)
    made = film_played(package, found)
    assert any("background.png" in d for d in made.decisions) and made.files[FILM][4:8] == b"ftyp"


def test_a_film_opens_with_the_photo_and_keeps_its_pixels_where_nothing_moves(package: Package) -> None:
    found = simulate_goal(package, GOAL)
    assert isinstance(found, Played)
    studio = Studio.of(package)
    frames = FilmFrames(studio, studio.moving(found))
    rest = np.array([o.T_world_object for o in studio.scene])
    photo = studio.scene.photo.rgb
    assert np.array_equal(frames.draw(rest), photo)
    nudged = rest.copy()
    nudged[:, 2, 3] += 1e-5
    assert np.array_equal(frames.draw(nudged), photo), "a creep is no motion"
    last = frames.draw(found.rollout.T_world_object[-1])
    moved = studio.moving(found)
    assert moved.any() and not moved.all()
    for o, moves in zip(studio.scene, moved, strict=True):
        inner = shrunk(o.mask, 2)
        changed = (last[inner] != photo[inner]).any(1).mean() if inner.any() else 0.0
        assert moves or changed < 0.5, o.label


def seen_from_there(scene: Scene, k: int, T: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) of an object's vertices at a pose."""
    o = scene.objects[k]
    return scene.camera.project(transform(T, o.scale * o.mesh.vertices))[0]


def test_what_creeps_is_drawn_anew_when_it_is_seen_elsewhere_and_what_trembles_is_not() -> None:
    scene, rng = goal_scene(), np.random.default_rng(0)
    rest = np.array([o.T_world_object for o in scene])
    here, there = (seen_from_there(scene, CAN, T) for T in (rest[CAN], pose(t=[1e-3, 0, 0]) @ rest[CAN]))
    pixel = 1e-3 / np.linalg.norm(here - there, axis=1).max()
    frames = np.repeat(rest[None], 60, axis=0)
    frames[:, CAN, 0, 3] += 0.02 * pixel * np.arange(60)
    frames[:, CRATE, :3, 3] += 0.01 * pixel * rng.normal(size=(60, 3))
    frames[:, BALL, 0, 3] += 0.01 * np.arange(60)
    held = Held(scene, 0.1)
    shown = np.array([held(T) for T in frames])
    different = [len(np.unique(shown[:, k].reshape(60, 16), axis=0)) for k in range(len(rest))]
    assert different[CRATE] == 1 and 5 < different[CAN] < 15 and different[BALL] == 60
    assert np.array_equal(shown[:, BALL], frames[:, BALL]), "what moves is where it is"
    for drawn, T in zip(shown[:, CAN], frames[:, CAN], strict=True):
        away = seen_from_there(scene, CAN, drawn) - seen_from_there(scene, CAN, T)
        assert np.linalg.norm(away, axis=1).max() <= 0.1


def test_what_is_behind_the_camera_is_never_held() -> None:
    scene = goal_scene()
    behind = np.array([o.T_world_object for o in scene])
    behind[BALL, :3, 3] = scene.camera.center - 3 * scene.camera.T_world_camera[:3, 2]
    held = Held(scene, 1.0)
    held(behind)
    farther = behind.copy()
    farther[BALL, :3, 3] -= 1e-9
    assert np.array_equal(held(farther), farther)


def test_a_large_photo_is_filmed_smaller_and_that_is_told(package: Package) -> None:
    found = simulate_goal(package, "push the can 5 cm to the left")
    assert isinstance(found, Played) and found.plan.phases[0].task.active == CAN
    made = film_played(package, found, FilmConfig(longest=32))
    assert made.size == (32, 24) and any("larger than 32" in d for d in made.decisions)
    with av.open(io.BytesIO(made.files[FILM])) as container:
        assert {(f.width, f.height) for f in container.decode(video=0)} == {(32, 24)}
    with Image.open(io.BytesIO(made.files[STRIP])) as picture:
        assert picture.width >= 32
