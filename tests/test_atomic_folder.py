"""Packages, rollouts and films are written whole or not at all, and nothing of anybody else's is touched."""

from __future__ import annotations

import faulthandler
import itertools
import os
import shutil
import signal
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from f3sr.cli import main
from f3sr.errors import InputError, OutputError
from f3sr.goals.file_names import FILMS, PLAN
from f3sr.play.goal_loop import Played, simulate_goal
from f3sr.play.rollout_folder import read_plan, write_film, write_next, write_played
from f3sr.runtime.atomic_folder import claimed
from f3sr.scene_package.package import prepare_output, read_package, write_package
from folders import write_folder
from goal_scene import goal_package
from scenes import box, box_stack_scene, scene_of

GOAL = "push the can 5 cm to the left"
OLD, NEW = ({name: text + name.encode() for name in FILMS} for text in (b"old ", b"new "))
CALLS = ("rename", "replace", "mkdir", "rmdir", "unlink", "open", "link")
"""Functions of ``os`` that change a disk: a process is killed before each of their calls."""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package, to be copied."""
    return goal_package(tmp_path_factory.mktemp("source") / "package").folder


@pytest.fixture(scope="module")
def played(source: Path) -> Played:
    found = simulate_goal(read_package(source), GOAL)
    assert isinstance(found, Played)
    return found


@pytest.fixture
def package(source: Path, tmp_path: Path) -> Path:
    return shutil.copytree(source, tmp_path / "package")


def tree(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


PATIENCE = 60
"""How long a child may take [s]."""


def in_child(work: Callable[[], object]) -> int:
    """Run in a process of its own; its exit code, or the negative number of the signal that ended it.

    A fork of a process with threads may inherit a lock that nobody will release. Such a child is ended and made again,
    with a warning that shows where it stood."""
    for _ in range(3):
        with tempfile.TemporaryFile("w+") as stood:
            child = os.fork()
            if not child:
                faulthandler.dump_traceback_later(PATIENCE - 5, file=stood)
                try:
                    work()
                    os._exit(0)
                except OutputError as error:
                    os._exit(3 if "\n" not in str(error) else 4)
                finally:
                    os._exit(5)
            end = time.monotonic() + PATIENCE
            while time.monotonic() < end:
                done, status = os.waitpid(child, os.WNOHANG)
                if done:
                    return os.waitstatus_to_exitcode(status)
                time.sleep(0.005)
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            stood.seek(0)
            warnings.warn(f"a child took over {PATIENCE} s:\n{stood.read()}", stacklevel=2)
    pytest.fail(f"three children took over {PATIENCE} s each")


def killed_before(number: int, work: Callable[[], object], calls: tuple[str, ...] = CALLS) -> bool:
    """Whether a process that is killed before its call of that number got so far."""

    def dying() -> None:
        left = itertools.count(1)
        for name in calls:
            original = getattr(os, name)

            def call(*args: Any, original: Callable[..., Any] = original, **more: Any) -> Any:
                if next(left) == number:
                    os.kill(os.getpid(), signal.SIGKILL)
                return original(*args, **more)

            setattr(os, name, call)
        work()

    code = in_child(dying)
    assert code in (0, -signal.SIGKILL), code
    return code != 0


def write(kind: str, place: Path, played: Played, *, new: bool) -> None:
    """An old or a new package, rollout or film; the film beside a rollout that is there already."""
    if kind == "package":
        write_package(scene_of(box(0, size=(0.2 if new else 0.1, 0.1, 0.1))), place, overwrite=True)
    elif kind == "film":
        write_film(NEW if new else OLD, place)
    else:
        plan = played.plan.model_copy(update={"goal": "new" if new else "old"})
        write_played(Played(plan=plan, rollout=played.rollout, verdict=played.verdict), place, overwrite=True)


def begun(kind: str, place: Path, played: Played) -> None:
    """An old one in its place."""
    if kind == "film":
        write("rollout", place, played, new=False)
    write(kind, place, played, new=False)


KINDS = ("package", "rollout", "film")
SECOND_RENAME = {"package": (("rename",), 2), "rollout": (("rename",), 2), "film": (("replace",), 2)}


# --- kill -9 ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_kill_before_any_step_leaves_the_old_or_the_new_after_the_next_command(
    kind: str, played: Played, tmp_path: Path
) -> None:
    begun(kind, tmp_path / "begun", played)
    old, found = tree(tmp_path / "begun"), list[bool]()
    for number in itertools.count(1):
        place = shutil.copytree(tmp_path / "begun", tmp_path / str(number) / "r")
        if not killed_before(number, lambda place=place: write(kind, place, played, new=True)):
            break
        with pytest.raises(InputError):
            read_plan(place / "none.json")
        after, left = tree(place), [p for p in place.parent.iterdir() if p != place]
        assert not any(any(p.iterdir()) for p in left), f"left over after a kill before step {number}"
        write(kind, place, played, new=True)
        new = tree(place)
        assert names(place.parent) == ["r"] and after in (old, new), f"half of each after a kill before step {number}"
        found.append(after == old)
    assert found == sorted(found, reverse=True) and {*found} == {True, False}, "first the old, then the new"


def _refused_goal(place: Path, package: Path) -> list[str]:
    return ["simulate", str(package), "push the banana", "-o", str(place), "--no-film"]


def _no_overwrite(place: Path, package: Path) -> list[str]:
    return ["simulate", str(package), GOAL, "-o", str(place), "--no-film"]


def _no_goal(place: Path, package: Path) -> list[str]:
    return ["simulate", str(package), "-o", str(place)]


def _several(place: Path, package: Path) -> list[str]:
    return ["simulate", str(package), GOAL, GOAL, "-o", str(place), "--no-film"]


def _film(place: Path, package: Path) -> list[str]:
    return ["film", str(place), "--package", str(package / "meshes")]


def _other_plan(place: Path, package: Path) -> list[str]:
    return ["simulate", str(package / "meshes"), "--plan", str(place / PLAN)]


@pytest.mark.parametrize("command", [_refused_goal, _no_overwrite, _no_goal, _several, _film, _other_plan])
@pytest.mark.parametrize("where", ["r", "package/rollouts/r"])
def test_the_next_command_brings_a_rollout_back_even_when_it_is_refused(
    command: Callable[[Path, Path], list[str]], where: str, package: Path, played: Played, tmp_path: Path
) -> None:
    place = tmp_path / where
    begun("rollout", place, played)
    before = tree(place)
    calls, number = SECOND_RENAME["rollout"]
    assert killed_before(number, lambda: write("rollout", place, played, new=True), calls) and not place.exists()
    assert main.main(command(place, package)) != 0
    assert tree(place) == before and not [n for n in names(place.parent) if n.startswith(".")]


@pytest.mark.parametrize(
    "arguments",
    [
        ["goals", "{}"],
        ["evaluate", "{}", "--true-scale", "0"],
        ["simulate", "{}", "push the banana"],
        ["simulate", "{}"],
        ["film", "{}/rollouts/1"],
        ["reconstruct", "{}/none", "-o", "{}"],
        ["reconstruct", "{}/..", "-o", "{}"],
        ["reconstruct", "{}", "-o", "{}/rollouts/1"],
    ],
)
def test_the_next_command_brings_a_package_back(arguments: list[str], played: Played, tmp_path: Path) -> None:
    place = tmp_path / "below" / "out"
    begun("package", place, played)
    before = tree(place)
    calls, number = SECOND_RENAME["package"]
    assert killed_before(number, lambda: write("package", place, played, new=True), calls) and not place.exists()
    main.main([a.format(place) for a in arguments])
    assert tree(place) == before and names(place.parent) == ["out"]


def test_a_numbered_rollout_that_a_kill_left_aside_keeps_its_number(package: Path, played: Played) -> None:
    first = write_next(played, package)
    calls, number = SECOND_RENAME["rollout"]
    assert killed_before(number, lambda: write("rollout", first, played, new=True), calls) and not first.exists()
    assert write_next(played, package).name == "2" and names(package / "rollouts") == ["1", "2"]


def test_a_folder_made_after_a_kill_is_not_taken_for_the_old_one_nor_is_the_old_one_lost(
    played: Played, tmp_path: Path
) -> None:
    place = tmp_path / "r"
    begun("rollout", place, played)
    before = tree(place)
    calls, number = SECOND_RENAME["rollout"]
    assert killed_before(number, lambda: write("rollout", place, played, new=True), calls)
    place.mkdir()
    (place / "mine").write_text("precious")
    with pytest.raises(OutputError, match="move one of the two away"):
        write("rollout", place, played, new=True)
    shutil.rmtree(place)
    with pytest.raises(InputError):
        read_plan(place / "none.json")
    assert tree(place) == before and names(tmp_path) == ["r"]


# --- strangers ----------------------------------------------------------------------------------------------------


def _folder(way: Path, mine: Path) -> None:
    way.mkdir()
    (way / "precious").write_text("mine")


def _file(way: Path, mine: Path) -> None:
    way.write_text("mine")


def _link(way: Path, mine: Path) -> None:
    way.symlink_to(mine)


def _linked_marker(way: Path, mine: Path) -> None:
    _folder(way, mine)
    (way / ".f3sr-building").symlink_to(mine / "precious")


def _other_marker(way: Path, mine: Path) -> None:
    _folder(way, mine)
    (way / ".f3sr-building").write_text("of another program")


def _like_a_rollout(way: Path, mine: Path) -> None:
    shutil.copytree(mine, way)


@pytest.mark.parametrize("stranger", [_folder, _file, _link, _linked_marker, _other_marker, _like_a_rollout])
@pytest.mark.parametrize("name", [".r.previous", ".r.building"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_others_have_beside_a_place_stays(
    kind: str, name: str, stranger: Callable[[Path, Path], None], played: Played, tmp_path: Path
) -> None:
    place, mine = tmp_path / "below" / "r", tmp_path / "mine"
    begun(kind, place, played)
    if kind == "film":
        write("rollout", mine, played, new=False)
    else:
        begun(kind, mine, played)
    (mine / "precious").write_text("mine")
    stranger(place.with_name(name), mine)
    before = tree(place), tree(mine), tree(place.parent), names(place.parent)
    try:
        write(kind, place, played, new=True)
    except OutputError as error:
        assert name in str(error) and before == (tree(place), tree(mine), tree(place.parent), names(place.parent))
    else:
        shutil.rmtree(place)
        begun(kind, place, played)
        assert before == (tree(place), tree(mine), tree(place.parent), names(place.parent))


def test_a_strangers_number_is_not_used(package: Path, played: Played) -> None:
    (package / "rollouts").mkdir()
    _folder(package / "rollouts" / ".1.building", package)
    assert write_next(played, package).name == "2"
    assert (package / "rollouts" / ".1.building" / "precious").exists()


# --- links and places ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("link", "out"),
    [
        ("package/rollouts", None),
        ("package/rollouts", "package/rollouts/7"),
        ("package/rollouts/1", "package/rollouts/1"),
        ("package/rollouts/deep", "package/rollouts/deep/1"),
        ("package/rollouts/deep", "package/rollouts/deep/../1"),
        ("package/meshes/away", "package/meshes/away/1"),
        ("other/rollouts", "other/rollouts/1"),
    ],
)
@pytest.mark.parametrize("target", ["elsewhere", "nowhere"])
def test_no_link_leads_a_rollout_out_of_a_package(
    link: str, out: str | None, target: str, package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(package, tmp_path / "other")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / link).parent.mkdir(exist_ok=True)
    (tmp_path / link).symlink_to(tmp_path / target)
    before = sorted(tmp_path.rglob("*"))
    place = [] if out is None else ["-o", str(tmp_path / out)]
    assert main.main(["simulate", str(package), GOAL, "--no-film", *place]) == 1
    error = capsys.readouterr().err
    assert "link" in error and error.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_a_film_does_not_follow_a_link_out_of_its_package(
    package: Path, played: Played, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    elsewhere = write_played(played, tmp_path / "elsewhere")
    (package / "rollouts").mkdir()
    (package / "rollouts" / "1").symlink_to(elsewhere)
    before = tree(elsewhere)
    assert main.main(["film", str(package / "rollouts" / "1"), "--package", str(package)]) == 1
    assert "link" in capsys.readouterr().err and tree(elsewhere) == before
    with pytest.raises(OutputError, match="link"):
        write_film(NEW, package / "rollouts" / "1")


def _nowhere(tmp_path: Path) -> str:
    (tmp_path / "way").symlink_to(tmp_path / "nowhere")
    return "way"


def _below_nowhere(tmp_path: Path) -> str:
    return f"{_nowhere(tmp_path)}/out"


def _loop(tmp_path: Path) -> str:
    (tmp_path / "way").symlink_to("way")
    return "way/out"


def _below_a_file(tmp_path: Path) -> str:
    (tmp_path / "way").write_text("mine")
    return "way/out"


def _a_pipe(tmp_path: Path) -> str:
    os.mkfifo(tmp_path / "way")
    return "way"


def _scene_that_is_a_pipe(tmp_path: Path) -> str:
    (tmp_path / "way").mkdir()
    os.mkfifo(tmp_path / "way" / "scene.json")
    return "way"


def _too_long(tmp_path: Path) -> str:
    return f"out/{'x' * 300}"


def _our_own_too_long(tmp_path: Path) -> str:
    return f"out/{'x' * 250}"


def _too_many_bytes(tmp_path: Path) -> str:
    return f"out/{'日' * 90}"


def _too_deep(tmp_path: Path) -> str:
    return "/".join(["out", *["x" * 200] * 30])


def _in_a_package(tmp_path: Path) -> str:
    return "package/meshes/out"


def _nul(tmp_path: Path) -> str:
    return "a\0b"


@pytest.mark.parametrize(
    ("command", "way"),
    [
        *itertools.product(
            ["reconstruct", "simulate", "several"],
            [_nowhere, _below_nowhere, _loop, _below_a_file, _a_pipe, _too_long, _too_deep, _in_a_package, _nul],
        ),
        *itertools.product(["reconstruct", "simulate"], [_scene_that_is_a_pipe, _our_own_too_long, _too_many_bytes]),
    ],
)
def test_an_impossible_place_is_told_before_any_work(
    command: str,
    way: Callable[[Path], str],
    package: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("f3sr.play.goal_loop.simulate_goal", lambda *_: pytest.fail("played"))
    monkeypatch.setattr("f3sr.pipeline.reconstruct", lambda *_, **__: pytest.fail("reconstructed"))
    write_folder(tmp_path / "input")
    out = str(tmp_path / way(tmp_path))
    before = sorted(tmp_path.rglob("*"))
    given = {
        "reconstruct": ["reconstruct", str(tmp_path / "input")],
        "simulate": ["simulate", str(package), GOAL, "--no-film"],
        "several": ["simulate", str(package), GOAL, GOAL, "--no-film"],
    }
    assert main.main([*given[command], "-o", out]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and len(error) < 1200 and sorted(tmp_path.rglob("*")) == before


def test_a_rollout_whose_film_cannot_be_put_there_is_told_before_filming(
    package: Path, played: Played, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("f3sr.film.studio.Studio.of", lambda *_: pytest.fail("filmed"))
    place = write_played(played, tmp_path / "r").rename(tmp_path / ("x" * 250))
    assert main.main(["film", str(place), "--package", str(package)]) == 1
    assert "file name too long" in capsys.readouterr().err and names(tmp_path) == ["package", place.name]


@pytest.mark.skipif(not os.path.ismount("/proc"), reason="no file system in a place of its own")
@pytest.mark.parametrize("write", [prepare_output, lambda place: write_film(NEW, place)])
def test_what_no_rename_can_replace_is_told_first(write: Callable[[Path], object]) -> None:
    with pytest.raises(OutputError, match="mount point"):
        write(Path("/proc"))


@pytest.mark.parametrize("where", ["rollouts", "rollouts/deep"])
def test_a_package_does_not_go_into_another(where: str, package: Path) -> None:
    before = sorted(package.rglob("*"))
    with pytest.raises(OutputError, match="inside the package"):
        write_package(box_stack_scene(1), package / where / "out")
    assert sorted(package.rglob("*")) == before


def test_a_file_where_rollouts_go_is_told(package: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (package / "rollouts").write_text("mine")
    assert main.main(["simulate", str(package), GOAL, "--no-film"]) == 1
    assert "rollouts is a file" in capsys.readouterr().err and (package / "rollouts").read_text() == "mine"


@pytest.mark.parametrize("name", ["日本 – ñ", "a..b", "..a", "-o", "%s\\", "x.building", "\udcff", "x" * 244])
@pytest.mark.parametrize("kind", KINDS)
def test_odd_names_are_names(kind: str, name: str, played: Played, tmp_path: Path) -> None:
    place = tmp_path / "below" / ".." / name
    begun(kind, place, played)
    write(kind, place, played, new=True)
    assert names(tmp_path) == [name]


@pytest.mark.parametrize("kind", KINDS)
def test_a_link_to_a_place_is_followed(kind: str, played: Played, tmp_path: Path) -> None:
    begun(kind, tmp_path / "there" / "r", played)
    (tmp_path / "way").symlink_to("there/r")
    write(kind, tmp_path / "way", played, new=True)
    assert (tmp_path / "way").is_symlink() and names(tmp_path / "there") == ["r"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_parent_that_may_not_be_written_to_is_told_and_changes_nothing(
    kind: str, played: Played, tmp_path: Path
) -> None:
    """Root may write anywhere, so root becomes nobody in a child."""
    place = tmp_path / "locked" / "r"
    begun(kind, place, played)
    before = tree(place)
    for folder in (tmp_path, *tmp_path.parents[:2], place.parent):
        folder.chmod(0o755)

    def as_nobody() -> None:
        if os.geteuid() == 0:
            os.setuid(65534)
        write(kind, place, played, new=True)

    place.parent.chmod(0o555)
    assert in_child(as_nobody) == 3
    place.parent.chmod(0o755)
    assert tree(place) == before and names(place.parent) == ["r"]


# --- rivals -------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc")
def test_a_parent_in_which_nothing_can_be_made_is_told_as_that() -> None:
    with pytest.raises(OutputError, match=r"could not be written \(no such file or directory\)"):
        prepare_output(Path("/proc/f3sr-none/package"))


def test_a_parent_that_another_run_takes_away_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is there at one look, and not at the next."""
    parent, looks = tmp_path / "sweep", iter([True])
    parent.mkdir()
    is_dir = Path.is_dir
    monkeypatch.setattr(Path, "is_dir", lambda path: is_dir(path) and not (path == parent and next(looks, False)))
    assert prepare_output(parent / "out").name == "out"


def test_runs_that_begin_at_once_do_not_take_each_others_parents_away(tmp_path: Path) -> None:
    for k in range(20):
        with ThreadPoolExecutor(8) as pool:
            list(pool.map(lambda n, k=k: prepare_output(tmp_path / str(k) / "sweep" / str(n)), range(8)))
    assert {p.name for p in tmp_path.rglob("*") if not p.name.isdecimal()} <= {"sweep"}, "empty parents at most"


def test_a_parent_that_is_gone_again_when_it_is_looked_at_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mkdir, calls = Path.mkdir, itertools.count()

    def gone(path: Path, *given: Any, **more: Any) -> None:
        if not next(calls):
            raise FileExistsError  # as of a parent that another run made and removed
        mkdir(path, *given, **more)

    monkeypatch.setattr(Path, "mkdir", gone)
    prepare_output(tmp_path / "sweep" / "r")
    assert names(tmp_path) == []


def test_a_reader_leaves_a_writer_alone(tmp_path: Path) -> None:
    with claimed(tmp_path / "r", lambda _: None) as claim:
        claim.write("x", b"whole")
        with pytest.raises(InputError):
            read_plan(tmp_path / "r" / PLAN)
        claim.replace()
    assert tree(tmp_path) == {"r/x": b"whole"}


def test_films_and_rollouts_at_once_end_whole(played: Played, tmp_path: Path) -> None:
    place = tmp_path / "r"
    begun("film", place, played)
    made = list[dict[str, bytes]]()
    for new in (False, True):
        write("film", place, played, new=new)
        made.append({name: (place / name).read_bytes() for name in FILMS})

    def attempt(new: int) -> str:
        try:
            write("film", place, played, new=bool(new % 2))
        except OutputError as error:
            return str(error)
        return "wrote"

    with ThreadPoolExecutor(4) as pool:
        said = set(pool.map(attempt, range(40)))
    assert said <= {"wrote", f"{place}: another run is writing it right now"} and "wrote" in said
    assert {name: (place / name).read_bytes() for name in FILMS} in made and names(tmp_path) == ["r"]
