"""f3sr photo: which folders it reads and writes, when it opens what, and how it ends."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from f3sr import mask_page
from f3sr.cli import photo_command
from f3sr.cli.main import main
from f3sr.cli.run_request import RunRequest
from f3sr.io.input_folder import InputFolder
from f3sr.io.masks import read_instances
from f3sr.runtime import atomic_folder
from f3sr.segmentation.input_folder_writer import read_photo
from f3sr.web import browser

BOXES = ["--box", "30,40,110,130:red thing", "--box", "170,50,270,160"]


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    rgb = np.full((200, 320, 3), 200, np.uint8)
    rgb[50:120, 40:100], rgb[60:150, 180:260] = (220, 30, 30), (30, 30, 220)
    Image.fromarray(rgb).save(tmp_path / "my table.png")
    return tmp_path / "my table.png"


class Calls:
    """What the command called, instead of doing it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.reconstructed: list[tuple[Path, Path, RunRequest, dict[str, Any]]] = []
        self.opened: list[str] = []
        self.page: Callable[..., Path | None] = lambda *args, **more: pytest.fail("no page was asked for")
        self.pages = 0
        monkeypatch.setattr(photo_command, "make_package", self._make)
        monkeypatch.setattr(browser, "shown_in_browser", lambda address: self.opened.append(address) or True)
        monkeypatch.setattr(mask_page, "serve", self._serve)

    def _make(self, folder: Path, out: Path, request: RunRequest, **more: Any) -> None:
        self.reconstructed.append((folder, out, request, more))

    def _serve(self, photo: Path, out: Path, segmenter: object, **more: Any) -> Path | None:
        self.pages += 1
        return self.page(photo, out, **more)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    return Calls(monkeypatch)


def instances(folder: Path) -> dict[str, int]:
    """Labels and pixels of a written folder."""
    found = read_instances(InputFolder(folder), read_photo(folder / "image.png"))
    return {i.label: int(i.mask.sum()) for i in found}


def test_boxes_need_no_page(photo: Path, calls: Calls, tmp_path: Path):
    assert main(["photo", str(photo), *BOXES]) == 0
    assert calls.reconstructed[0][0] == tmp_path / "my table_input"
    assert calls.reconstructed[0][1] == tmp_path / "my table_scene"
    found = instances(tmp_path / "my table_input")
    assert list(found) == ["red thing", ""]
    assert found["red thing"] == pytest.approx(70 * 60, rel=0.05) and found[""] == pytest.approx(90 * 80, rel=0.05)
    assert calls.opened == [(tmp_path / "my table_scene" / "report.html").as_uri()]


def test_the_page_comes_first_and_the_report_last(photo: Path, calls: Calls, tmp_path: Path):
    def page(shown: Path, out: Path, **more: Any) -> Path:
        assert shown == photo and not calls.reconstructed and more["open_browser"] and "report" in more["after"]
        return out

    calls.page = page
    assert main(["photo", str(photo), "-o", str(tmp_path / "out" / "table")]) == 0
    assert calls.pages == 1
    assert calls.reconstructed[0][0] == tmp_path / "out" / "table_input"
    assert calls.reconstructed[0][1] == tmp_path / "out" / "table"
    assert len(calls.opened) == 1


def test_a_page_without_a_result_ends_it(photo: Path, calls: Calls, capsys: pytest.CaptureFixture[str]):
    calls.page = lambda *args, **more: None
    assert main(["photo", str(photo)]) == 1
    assert capsys.readouterr().err == "f3sr: nothing was saved in the page; nothing was written\n"
    assert not calls.reconstructed and not calls.opened


def test_masks_that_are_there_need_no_page(photo: Path, calls: Calls, tmp_path: Path):
    assert main(["photo", str(photo), *BOXES]) == 0
    assert main(["photo", str(tmp_path / "my table_input"), "--no-open", "--background", "lama:big.pt"]) == 0
    folder, out, request, _ = calls.reconstructed[1]
    assert folder == tmp_path / "my table_input" and out == tmp_path / "my table_scene"
    assert request.background and request.background.name == "lama"
    assert len(calls.opened) == 1 and not calls.pages


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--box", "1,2,3:mug"], 2, "--box: found 1,2,3:mug; accepted: X0,Y0,X1,Y1"),
        (["--box", "9,2,3,4:mug"], 2, "left, top, right, bottom"),
        (["--box", "1,1,5,5", "--segmenter", "magic"], 2, "segmentation back end: found 'magic'"),
        (["--edits", "{photo}"], 2, "a list of edits, version 1"),
        (["--config", "{photo}"], 2, "a TOML file of settings"),
        (["--geometry", "magic"], 2, "geometry back end: found 'magic'"),
        (["--normals", "magic"], 2, "normals back end: found 'magic'"),
        (["--normals-axes", "rdf"], 2, "--normals-axes: found rdf; accepted: together with --normals"),
        (["--assets", "magic"], 2, "assets back end: found 'magic'"),
        (["--assets", "saved"], 2, "assets back end saved: found folder: none; accepted: --assets saved:DIR"),
        (["--background", "magic"], 2, "background back end: found 'magic'"),
        (["--focal", "300", "--focal-35mm", "28"], 2, "--focal: found also --focal-35mm"),
        (["--focal", "1"], 2, "--focal: found 1; accepted:"),
        (["--camera-height", "-1"], 2, "--camera-height: found -1; accepted:"),
        (["--known", "mug"], 2, "--known: found mug; accepted:"),
        (["-o", "{photo}"], 1, "my table.png"),
        (["-o", "{folder}"], 1, "accepted: a new or empty folder, or an f3sr package"),
    ],
)
def test_what_is_wrong_is_one_line_before_any_page(
    photo: Path, calls: Calls, capsys: pytest.CaptureFixture[str], arguments: list[str], code: int, said: str
):
    given = [a.format(photo=photo, folder=photo.parent) for a in arguments]
    calls.page = lambda shown, out, **more: out
    for ways in ([], BOXES):
        assert main(["photo", str(photo), *given, *ways]) == code
        told = capsys.readouterr().err
        assert said in told and told.startswith("f3sr: ") and told.count("\n") == 1
    assert not calls.pages and not calls.reconstructed and sorted(photo.parent.iterdir()) == [photo]


def test_a_photo_that_is_none_is_one_line(calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "x.jpg").write_text("no photo")
    for name in ("x.jpg", "absent.jpg"):
        assert main(["photo", str(tmp_path / name), "--box", "1,1,9,9"]) == 2
        told = capsys.readouterr().err
        assert name in told and told.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["x.jpg"]


@pytest.mark.parametrize("option", [BOXES, ["--segmenter", "nosuch"], ["--ground-segmenter", "nosuch"]])
def test_what_makes_masks_is_refused_for_a_folder_that_has_them(
    option: list[str], calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["photo", str(tmp_path), *option]) == 2
    told = capsys.readouterr().err
    assert f"{option[0]}: found the folder" in told and "accepted: a photo" in told and not calls.reconstructed


def test_a_folder_of_somebody_else_is_left_alone(photo: Path, calls: Calls, capsys: pytest.CaptureFixture[str]):
    theirs = photo.with_name("my table_input")
    theirs.mkdir()
    (theirs / "letter.txt").write_text("mine")
    assert main(["photo", str(photo), *BOXES]) == 1
    assert "my table_input" in capsys.readouterr().err and (theirs / "letter.txt").read_text() == "mine"
    assert not atomic_folder.being_written(photo.parent)


def test_boxes_and_json_print_no_table(photo: Path, calls: Calls, capsys: pytest.CaptureFixture[str]):
    assert main(["photo", str(photo), *BOXES, "--json", "--no-open"]) == 0
    assert capsys.readouterr().out == "" and calls.reconstructed[0][3]["json"] is True


def test_segment_without_boxes_opens_the_page_too(
    photo: Path, calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    calls.page = lambda shown, out, **more: out
    assert main(["segment", str(photo), "-o", str(tmp_path / "masks")]) == 0
    assert calls.pages == 1 and "folder:" in capsys.readouterr().out
    calls.page = lambda *args, **more: None
    assert main(["segment", str(photo), "-o", str(tmp_path / "masks")]) == 1
    assert capsys.readouterr().err == f"f3sr: {mask_page.NOTHING_SAVED}\n"


def test_json_leaves_the_output_to_the_package(photo: Path, calls: Calls, capsys: pytest.CaptureFixture[str]):
    def page(shown: Path, out: Path, *, tell: Callable[[str], object], **more: Any) -> Path:
        tell("the page is open at somewhere")
        return out

    calls.page = page
    assert main(["photo", str(photo), "--json", "--no-open"]) == 0
    told = capsys.readouterr()
    assert told.out == "" and told.err == "the page is open at somewhere\n" and not calls.opened
    assert calls.reconstructed[0][3]["json"] is True


def test_a_browser_of_the_terminal_is_not_opened(monkeypatch: pytest.MonkeyPatch):
    for name in browser.WINDOWS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(browser.sys, "platform", "linux")
    monkeypatch.setattr(browser.webbrowser, "open", lambda address: pytest.fail("opened"))
    assert not browser.shown_in_browser("http://127.0.0.1/")
