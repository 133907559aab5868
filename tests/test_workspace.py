"""Projects of the studio: whole or not there, found by checked names only, one damaged one hides no other."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import struct
import subprocess
import sys
import threading
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import forked
from f3sr.errors import F3srError, InputError, OutputError
from f3sr.io.images import encode_png
from f3sr.runtime import file_lock
from f3sr.studio import workspace as workspace_module
from f3sr.studio.workspace import ID, LOCK, LONGEST_ID, PROJECTS, RECORD, Workspace
from waiting import soon

PHOTO = encode_png(np.zeros((16, 24, 3), np.uint8))


@pytest.fixture
def space(tmp_path: Path) -> Workspace:
    return Workspace(tmp_path / "workspace")


def entries(space: Workspace) -> list[str]:
    return sorted(entry.name for entry in (space.folder / PROJECTS).iterdir())


def png_that_says(width: int, height: int) -> bytes:
    """A small file whose header tells of many pixels."""
    header = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))


# --- what a project begins with ---------------------------------


def test_a_photo_becomes_a_project_and_is_kept_byte_for_byte(space: Workspace):
    made = space.create_photo("My Desk (1).PNG", PHOTO)
    assert made.name == "My Desk (1)" and made.id.startswith("my-desk-1-") and not made.problem
    assert made.photo is not None and made.photo.read_bytes() == PHOTO
    assert space.project(made.id) == made and space.listed() == [made]


@pytest.mark.parametrize(
    "data",
    [b"", b"GIF89a", b"<svg/>", PHOTO[:40], b"\xff\xd8\xff" + bytes(100), png_that_says(60_000, 60_000)],
)
def test_what_is_no_photo_leaves_nothing(space: Workspace, data: bytes):
    with pytest.raises(InputError, match=r"^x\.png: found .*; accepted: "):
        space.create_photo("x.png", data)
    assert entries(space) == []


def test_a_photo_of_too_many_bytes_is_not_read(space: Workspace, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(workspace_module, "MAX_PHOTO_BYTES", len(PHOTO) - 1)
    with pytest.raises(InputError, match="bytes"):
        space.create_photo("x.png", PHOTO)
    assert entries(space) == []


@given(name=st.text(max_size=300))
@example(name="../../etc/passwd")
@example(name="..")
@example(name="a" * 300)
@example(name="\0\ud800\u202e")
@example(name="CON / ...")
def test_any_name_makes_a_plain_id(tmp_path_factory: pytest.TempPathFactory, name: str):
    space = Workspace(tmp_path_factory.mktemp("names"))
    made = space.create_photo(name, PHOTO)
    assert ID.fullmatch(made.id) and len(made.id) <= LONGEST_ID and made.name.isprintable() and made.name
    assert made.folder.parent == space.folder / PROJECTS and space.listed() == [made]
    space.close()


def test_the_example_and_folders_are_copied(space: Workspace, folder: Path, tmp_path: Path):
    (folder / "link").symlink_to("/etc/passwd")
    os.mkfifo(folder / "pipe")
    made = space.create_folder(folder)
    given_there = {p.relative_to(folder) for p in folder.rglob("*") if p.is_file() and not p.is_symlink()}
    assert {p.relative_to(made.input) for p in made.input.rglob("*") if not p.is_dir()} == given_there
    assert (space.create_example().input / "masks").is_dir()
    assert [p.name for p in space.listed()] == ["Example", folder.name]


@pytest.mark.parametrize("place", ["absent", "empty", "file", "", "workspace", "workspace/projects", "\0"])
def test_no_other_folder_becomes_a_project(space: Workspace, tmp_path: Path, place: str):
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_bytes(PHOTO)
    with pytest.raises(InputError):
        space.create_folder(tmp_path / place)
    assert entries(space) == []


def test_a_folder_beyond_bounds_is_not_copied(space: Workspace, folder: Path, monkeypatch: pytest.MonkeyPatch):
    for name, most in (("MAX_FILES", 3), ("MAX_BYTES", 100)):
        with monkeypatch.context() as patch:
            patch.setattr(workspace_module, name, most)
            with pytest.raises(InputError, match="one scene's folder"):
                space.create_folder(folder)
    for k in range(5):
        (folder / f"empty{k}").mkdir()
    monkeypatch.setattr(workspace_module, "MAX_FILES", 10)
    with pytest.raises(InputError, match="one scene's folder"):
        space.create_folder(folder)
    folder.joinpath(*"d" * 30).mkdir(parents=True)
    monkeypatch.setattr(workspace_module, "MAX_FILES", 20_000)
    with pytest.raises(InputError, match="one scene's folder"):
        space.create_folder(folder)
    assert entries(space) == []


def test_a_workspace_has_so_many_projects(space: Workspace, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(workspace_module, "MOST_PROJECTS", 1)
    made = space.create_photo("a", PHOTO)
    with pytest.raises(OutputError, match="1 projects; delete some"):
        space.create_photo("b", PHOTO)
    space.delete(made.id)
    space.create_photo("b", PHOTO)


# --- names and damage -------------------------------------------

HOSTILE = ["", ".", "..", "../x", "a/b", "/etc", "a\0", "A", "a b", "-a", "a-", "a--b", "a\n", ".new-a", "é", "a" * 65]


@pytest.mark.parametrize("id", HOSTILE)
def test_no_other_name_is_a_project(space: Workspace, id: str):
    space.create_photo("a", PHOTO)
    for call in (space.project, space.delete):
        with pytest.raises(InputError, match="one of the workspace's"):
            call(id)
    assert len(space.listed()) == 1


def test_a_link_is_no_project(space: Workspace, tmp_path: Path):
    made = space.create_photo("a", PHOTO)
    outside = tmp_path / "outside"
    shutil.copytree(made.folder, outside)
    (space.folder / PROJECTS / "link").symlink_to(outside)
    for call in (space.project, space.delete):
        with pytest.raises(InputError):
            call("link")
    assert space.listed() == [made] and (outside / RECORD).is_file()


DAMAGED = [
    b"",
    b"{",
    b"\xff\xfe",
    b"[]",
    b"[" * 10**5,
    b'{"version": 2}',
    b'{"version": 1, "name": "", "origin": "photo", "created": 1}',
    b'{"version": 1, "name": "a", "origin": "moon", "created": 1}',
    b'{"version": 1, "name": "a", "origin": "photo", "created": NaN}',
    b'{"version": 1, "name": "a", "origin": "photo", "created": 1, "photo": "../../x"}',
    b'{"version": 1, "name": "a", "origin": "photo", "created": 1, "more": 1}',
    bytes(200_000),
    None,
]


@pytest.mark.parametrize("damage", DAMAGED)
def test_a_damaged_project_is_listed_with_its_problem_and_can_be_deleted(space: Workspace, damage: bytes | None):
    sound, broken = space.create_photo("sound", PHOTO), space.create_photo("broken", PHOTO)
    file = broken.folder / RECORD
    file.unlink()
    file.mkdir() if damage is None else file.write_bytes(damage)
    found = {project.id: project.problem for project in space.listed()}
    assert found[sound.id] == "" and found.keys() == {sound.id, broken.id}
    assert found[broken.id].startswith(str(file)) and found[broken.id].isprintable()
    with pytest.raises(F3srError):
        space.project(broken.id)
    space.delete(broken.id)
    assert space.listed() == [sound]


def test_a_name_that_somebody_wrote_there_is_shown_plain(space: Workspace):
    made = space.create_photo("a", PHOTO)
    record = b'{"version": 1, "name": "a\\u202e\\n<b>", "origin": "photo", "created": 1e300}'
    (made.folder / RECORD).write_bytes(record)
    assert [project.name for project in space.listed()] == ["a<b>"]


# --- disks, kills and two servers -------------------------------


def test_two_servers_have_no_workspace_together(space: Workspace, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(file_lock, "WAIT_S", 0.2)
    with pytest.raises(OutputError, match="another studio is open there"):
        Workspace(space.folder)
    space.close()
    Workspace(space.folder).close()


def test_a_process_that_a_killed_server_was_starting_is_waited_for(space: Workspace):
    """Until it is another program, it has the lock of the workspace too."""
    space.close()
    with (space.folder / LOCK).open("rb") as inherited:
        fcntl.flock(inherited, fcntl.LOCK_EX)
        threading.Timer(0.1, inherited.close).start()
        Workspace(space.folder).close()


def test_a_workspace_that_cannot_be_made_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="no workspace can be made there"):
        Workspace(tmp_path / "file")


@pytest.mark.parametrize("moment", ["write_bytes", "rename"])
def test_a_full_disk_makes_no_project_and_loses_none(space: Workspace, monkeypatch: pytest.MonkeyPatch, moment: str):
    made = space.create_photo("a", PHOTO)

    def full(*_: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(Path, moment, full)
    with pytest.raises(OutputError, match="no space left on device"):
        space.create_photo("b", PHOTO)
    monkeypatch.undo()
    assert entries(space) == [made.id]


def test_options_are_kept_whole_or_not(space: Workspace, monkeypatch: pytest.MonkeyPatch):
    made = space.create_photo("a", PHOTO)
    space.keep_options(made, {"known": "mug=0.1"})

    def full(_: int) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="no space left on device"):
        space.keep_options(made, {"known": ""})
    monkeypatch.undo()
    assert space.project(made.id).options == {"known": "mug=0.1"}
    assert sorted(p.name for p in made.folder.iterdir()) == ["photo.png", RECORD]
    assert json.loads((made.folder / RECORD).read_text())["version"] == 1


def test_what_a_killed_server_leaves_is_taken_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """It is killed in the middle of a copy, and of a deletion."""
    monkeypatch.setattr(file_lock, "WAIT_S", 0.2)
    script = f"""
import sys, time; sys.path[:0] = {sys.path!r}
from pathlib import Path
from f3sr.studio import workspace
space = workspace.Workspace(Path({str(tmp_path / "workspace")!r}))
made = space.create_photo("gone", {PHOTO!r})
space.create_photo("stays", {PHOTO!r})
workspace.shutil.rmtree = lambda folder, ignore_errors: None
space.delete(made.id)
def copy(source, target, **more):
    target.mkdir()
    (target / "half").write_bytes(b"half")
    print("half", flush=True)
    time.sleep(60)
workspace.shutil.copytree = copy
space.create_example()
"""
    with forked.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, process_group=0) as server:
        assert server.stdout and server.stdout.readline() == b"half\n"
        space_folder = tmp_path / "workspace" / PROJECTS
        assert sum(p.name.startswith(".") for p in space_folder.iterdir()) == 2
        with pytest.raises(OutputError, match="another studio"):
            Workspace(tmp_path / "workspace")
        server.send_signal(signal.SIGKILL)
    assert soon(lambda: server.poll() is not None)
    space = Workspace(tmp_path / "workspace")
    assert [p.name for p in space.listed()] == ["stays"] == [name.partition("-")[0] for name in entries(space)]
