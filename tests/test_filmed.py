"""Films of goals through the commands: what is written, whose film it is, and what goes wrong in one line."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from f3sr.cli import main
from f3sr.film.filmed import FilmConfig, film_played
from f3sr.goals.files import FILM, FILMS, PLAN, ROLLOUT, STRIP, VERDICT
from f3sr.goals.play import Played, simulate_goal
from f3sr.package import Package
from goal_scene import CAN, goal_package

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
    assert told["film"]["frames"] == len(frames) == len(time)
    assert np.allclose(frames, time, atol=1e-6), "film time is simulated time"


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
    assert len(frames) == 4 * (len(time) - 1) + 1
    assert frames[-1] == pytest.approx(4 * time[-1], abs=1e-3)


def _no_plan(rollout: Path) -> None:
    (rollout / PLAN).unlink()


def _other_scene(rollout: Path) -> None:
    plan = json.loads((rollout / PLAN).read_text())
    (rollout / PLAN).write_text(json.dumps(plan | {"scene": "0" * 64}))


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


def _not_finite(rollout: Path) -> None:
    arrays = dict(np.load(rollout / ROLLOUT))
    arrays["T_world_object"][3, 1, 0, 3] = np.nan
    np.savez(rollout / ROLLOUT, **arrays)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_no_plan, "plan.json"),
        (_other_scene, "another scene"),
        (_other_objects, "objects"),
        (_broken_rollout, "rollout.npz"),
        (_empty_rollout, "rollout.npz"),
        (_cut_rollout, "rollout.npz"),
        (_not_finite, "finite"),
    ],
)
def test_what_is_no_rollout_of_the_package_is_told_in_one_line(
    package: Package, rollout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change, message: str
) -> None:
    copy = shutil.copytree(rollout, tmp_path / "copy", ignore=shutil.ignore_patterns(*FILMS))
    change(copy)
    before = sorted(copy.iterdir())
    assert main(["film", str(copy), "--package", str(package.folder)]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert sorted(copy.iterdir()) == before, "nothing is left"


def test_a_rollout_without_its_package_says_how_to_name_it(
    rollout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(rollout, tmp_path / "copy")
    assert main(["film", str(copy)]) == 2
    assert "--package" in capsys.readouterr().err


@pytest.mark.parametrize("slow", ["0", "nan", "-1", "1000"])
def test_a_speed_that_no_player_has_is_refused_first(
    package: Package, tmp_path: Path, capsys: pytest.CaptureFixture[str], slow: str
) -> None:
    assert main(["simulate", str(package.folder), GOAL, "-o", str(tmp_path / "out"), "--slow", slow]) == 2
    assert "factor" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_broken_background_fails_the_film_and_leaves_the_rollout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = goal_package(tmp_path / "package").folder
    (folder / "background.png").write_bytes(b"no picture")
    assert main(["simulate", str(folder), GOAL, "-o", str(tmp_path / "out")]) == 2
    assert "background.png" in capsys.readouterr().err
    assert {p.name for p in (tmp_path / "out").iterdir()} == {PLAN, ROLLOUT, VERDICT}


def test_a_package_without_background_is_filmed_and_that_is_told(package: Package) -> None:
    found = simulate_goal(package, GOAL)
    assert isinstance(found, Played)
    made = film_played(package, found)
    assert any("background.png" in d for d in made.decisions) and made.files[FILM][4:8] == b"ftyp"


def test_a_large_photo_is_filmed_smaller_and_that_is_told(package: Package) -> None:
    found = simulate_goal(package, "push the can 5 cm to the left")
    assert isinstance(found, Played) and found.plan.task.active == CAN
    made = film_played(package, found, FilmConfig(longest=32))
    assert made.size == (32, 24) and any("larger than 32" in d for d in made.decisions)
    with av.open(io.BytesIO(made.files[FILM])) as container:
        assert {(f.width, f.height) for f in container.decode(video=0)} == {(32, 24)}
    with Image.open(io.BytesIO(made.files[STRIP])) as picture:
        assert picture.width >= 32
