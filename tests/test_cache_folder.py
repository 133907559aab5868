"""The cache's folder is one that this user alone can write to, or there is none; nothing is kept elsewhere."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

import forked
from f3sr.errors import F3srWarning
from f3sr.runtime.cache_files import read_sealed, write_sealed, write_whole
from f3sr.runtime.cache_folder import cache_folder, within

ROOT_ONLY = pytest.mark.skipif(os.geteuid() != 0, reason="becomes another user")
STRANGER, OTHER = 4242, 4243
"""User ids without an entry in passwd."""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """HOME and the temporary files in a folder of the test, and no other variable set."""
    for name in ("F3SR_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, folder in (("HOME", "home"), ("TMPDIR", "tmp")):
        (tmp_path / folder).mkdir()
        monkeypatch.setenv(name, str(tmp_path / folder))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    return tmp_path


def decided() -> tuple[Path | None, list[str]]:
    """The folder as a new process decides, and what it warns of."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always", F3srWarning)
        folder = cache_folder.__wrapped__()
    return folder, [str(w.message) for w in heard]


def temporary(place: Path) -> Path:
    return place / "tmp" / f"f3sr-{os.geteuid()}"


def as_seen_by_all(place: Path) -> None:
    """Let other users in, who share the temporary files as they do everywhere."""
    for folder in (place, *place.parents):
        folder.chmod(0o755)
        if folder.name.startswith("pytest-of-"):  # all below is pytest's: one level more where it runs workers
            break
    (place / "tmp").chmod(0o1777)


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return forked.run([sys.executable, "-c", code, *arguments])


# --- which one ------------------------------------------------------------------------------------------------------


def test_the_first_folder_named_is_taken_and_is_private(place: Path, monkeypatch: pytest.MonkeyPatch):
    wanted = [place / "home/.cache/f3sr", place / "xdg/f3sr", place / "mine"]
    for folder, variable in zip(wanted, (None, "XDG_CACHE_HOME", "F3SR_CACHE_DIR"), strict=True):
        if variable:
            monkeypatch.setenv(variable, str(place / "xdg" if "XDG" in variable else folder))
        assert decided() == (folder, [])
        assert folder.stat().st_mode & 0o777 == 0o700


def test_a_mask_that_gives_all_to_all_leaves_the_cache_private(place: Path):
    before = os.umask(0)
    try:
        folder, _ = decided()
        assert folder
        write_whole(folder / "stages" / "x", b"x")
    finally:
        os.umask(before)
    assert {p.stat().st_mode & 0o077 for p in (folder, *folder.rglob("*"))} == {0}


def test_a_relative_xdg_folder_has_no_meaning(place: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert decided() == (place / "home/.cache/f3sr", [])


def test_a_relative_folder_stays_where_it_was_when_the_working_folder_changes(
    place: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(place)
    monkeypatch.setenv("F3SR_CACHE_DIR", "mine")
    assert decided() == (place / "mine", [])


def test_a_working_folder_that_is_gone_is_no_error(place: Path, monkeypatch: pytest.MonkeyPatch):
    (place / "gone").mkdir()
    monkeypatch.chdir(place / "gone")
    (place / "gone").rmdir()
    monkeypatch.setenv("F3SR_CACHE_DIR", "mine")
    assert decided() == (temporary(place), [])


@pytest.mark.parametrize("named", ["/dev/null/f3sr", "{place}/file", "{place}/dangling", "/" + "x" * 5000])
def test_a_folder_that_cannot_be_is_passed_over(named: str, place: Path, monkeypatch: pytest.MonkeyPatch):
    (place / "file").touch()
    (place / "dangling").symlink_to(place / "nowhere")
    monkeypatch.setenv("F3SR_CACHE_DIR", named.format(place=place))
    assert decided() == (temporary(place), [])


def test_a_user_without_home_and_entry_has_a_temporary_cache(place: Path, monkeypatch: pytest.MonkeyPatch):
    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nobody)
    assert decided() == (temporary(place), [])


def test_without_any_place_for_it_there_is_no_cache(place: Path, monkeypatch: pytest.MonkeyPatch):
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    monkeypatch.setattr("tempfile.gettempdir", none)
    monkeypatch.setenv("F3SR_CACHE_DIR", "/dev/null")
    assert decided() == (None, [])
    monkeypatch.setattr("f3sr.runtime.cache_folder.cache_folder", lambda: None)
    assert within("stages") is None


# --- who could write there -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o770, 0o702])
@pytest.mark.parametrize("variable", ["F3SR_CACHE_DIR", "XDG_CACHE_HOME", "HOME", "TMPDIR"])
def test_a_folder_that_others_may_write_to_is_never_used(
    variable: str, mode: int, place: Path, monkeypatch: pytest.MonkeyPatch
):
    shared = {
        "F3SR_CACHE_DIR": place / "shared",
        "XDG_CACHE_HOME": place / "shared/f3sr",
        "HOME": place / "home/.cache/f3sr",
        "TMPDIR": temporary(place),
    }[variable]
    shared.mkdir(parents=True)
    shared.chmod(mode)
    if variable == "TMPDIR":
        monkeypatch.setenv("HOME", "/dev/null")
    elif variable != "HOME":
        monkeypatch.setenv(variable, str(place / "shared"))
    folder, heard = decided()
    assert folder == (None if variable == "TMPDIR" else temporary(place))
    (line,) = heard
    assert line.startswith(f"{shared}: ") and f"{mode:o}" in line and "\n" not in line
    assert not list(shared.iterdir())


@ROOT_ONLY
@pytest.mark.parametrize("planted", ["folder", "link to a folder of ours"])
def test_what_another_user_planted_is_never_used(planted: str, place: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("HOME", "/dev/null")
    if planted == "folder":
        temporary(place).mkdir(mode=0o755)
    else:
        (place / "ours").mkdir(mode=0o700)
        temporary(place).symlink_to(place / "ours")
    os.lchown(temporary(place), STRANGER, STRANGER)
    folder, (line,) = decided()
    assert folder is None and line == f"{temporary(place)}: belongs to another user; this cache is not used"


def test_a_link_of_our_own_is_followed(place: Path, monkeypatch: pytest.MonkeyPatch):
    (place / "large disk").mkdir(mode=0o700)
    (place / "link").symlink_to(place / "large disk")
    monkeypatch.setenv("F3SR_CACHE_DIR", str(place / "link"))
    assert decided() == (place / "link", [])


# --- what is read there ----------------------------------------------------------------------------------------------


def _left_alone(file: Path) -> None:
    pass


def _open_to_all(file: Path) -> None:
    file.chmod(0o666)


def _linked(file: Path) -> None:
    file.rename(file.with_name("elsewhere"))
    file.symlink_to(file.with_name("elsewhere"))


def _of_another(file: Path) -> None:
    os.chown(file, STRANGER, STRANGER)


def _cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:20])


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (_left_alone, b"data"),
        (_open_to_all, None),
        (_linked, None),
        (_cut, None),
        (Path.unlink, None),
        pytest.param(_of_another, None, marks=ROOT_ONLY),
    ],
)
def test_only_whole_files_of_our_own_are_read(change: Callable[[Path], object], found: bytes | None, tmp_path: Path):
    file = tmp_path / "file"
    write_sealed(file, b"data", "key")
    change(file)
    assert read_sealed(file, "key") == found


def test_a_file_is_read_under_its_own_key_only(tmp_path: Path):
    write_sealed(tmp_path / "file", b"data", "key")
    assert read_sealed(tmp_path / "file", "other") is None
    (tmp_path / "file").write_bytes(b"")
    assert read_sealed(tmp_path / "file", "key") is None


class Planted:
    def __reduce__(self) -> tuple[object, ...]:
        return (os.mkdir, (os.environ["PLANTED"],))


@ROOT_ONLY
def test_a_kernel_planted_by_another_user_is_not_run(place: Path, monkeypatch: pytest.MonkeyPatch):
    """Another user plants pickles under every name that this one asks for."""
    monkeypatch.setenv("PLANTED", str(place / "planted"))
    evil = pickle.dumps(Planted())
    as_seen_by_all(place)
    cache = place / "tmp" / f"f3sr-{OTHER}"
    cache.mkdir(mode=0o755)
    code = """
import os
from f3sr.runtime import kernels, kernel_files
from f3sr.runtime.cache_folder import cache_folder
def planted(file, key):
    read.append(file)
    return original(file, key)
read, original = [], kernel_files.read_sealed
kernel_files.read_sealed = planted
assert kernels.kernel(lambda x: 3 * x)(2) == 6  # what numba imports
del read[:]
kernels.kernel_folder.cache_clear(), cache_folder.cache_clear()
os.environ["HOME"] = "/dev/null"
os.setgroups([]), os.setgid(4243), os.setuid(4243)
assert kernels.kernel(lambda x: 2 * x)(2) == 4
print(kernels.kernel_folder(), *read)
"""

    def victim() -> list[str]:
        done = run(code)
        assert done.returncode == 0, done.stderr
        return done.stdout.split()

    os.chown(cache, OTHER, OTHER)
    _, *names = victim()
    assert names, "the victim's own folder is used"
    for name in names:
        Path(name).unlink(missing_ok=True)
        write_sealed(Path(name), evil, Path(name).name)
        os.chown(name, STRANGER, STRANGER)
    victim()
    assert not (place / "planted").exists(), "a file of another user in our folder"
    for path in (cache, *cache.rglob("*")):
        os.chown(path, STRANGER, STRANGER)
        path.chmod(0o755)
    assert victim() == ["None"] and not (place / "planted").exists()


# --- whole processes ------------------------------------------------------------------------------------------------


@ROOT_ONLY
def test_a_user_id_without_home_and_entry_can_run_commands(place: Path):
    code = """
import os, pwd, sys
from f3sr.cli import main, doctor
from f3sr.runtime.cache_folder import cache_folder
list(doctor._caches()), main.main(["config"]), cache_folder.cache_clear()
del os.environ["HOME"]
os.setgroups([]); os.setgid(4242); os.setuid(4242)
code = main.main(["config"])
print([check.found for check in doctor._caches()], file=sys.stderr)
sys.exit(code)
"""
    as_seen_by_all(place)
    done = run(code)
    assert done.returncode == 0 and f"{place}/tmp/f3sr-{STRANGER}, " in done.stderr and "Trace" not in done.stderr


def test_the_command_says_in_one_line_that_a_folder_is_not_used(place: Path, monkeypatch: pytest.MonkeyPatch):
    (place / "shared").mkdir()
    (place / "shared").chmod(0o777)
    monkeypatch.setenv("F3SR_CACHE_DIR", str(place / "shared"))
    done = run(
        "from f3sr.cli import main, doctor; doctor.examine = lambda: list(doctor._caches()); main.run()", "doctor"
    )
    assert done.returncode == 0 and str(temporary(place)) in done.stdout
    assert done.stderr.startswith(f"f3sr: {place}/shared: ") and done.stderr.count("\n") == 1


def test_importing_kernels_touches_no_folder_and_reads_no_sources(place: Path):
    code = """
import sys
opened = []
sys.addaudithook(lambda event, args: opened.append((event, str(args[0]))) if event in ("open", "os.mkdir") else None)
from f3sr.runtime import kernels
from f3sr.vision import rasterizer
assert not [o for o in opened if "cache" in o[1] and "__pycache__" not in o[1] and ".py" not in o[1]], opened
assert not [o for o in opened if o[0] == "os.mkdir"], opened
assert kernels.kernel_folder.cache_info().currsize == 0
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not list((place / "home").iterdir()) and not list((place / "tmp").iterdir())
