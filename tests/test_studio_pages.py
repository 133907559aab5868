"""The studio's pages in a real browser: every step, errors, keys, accessibility, and no word in the console."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi", reason="the extra studio is not installed")

from folders import write_folder
from resting_boxes import resting_boxes
from studio_server import StudioServer, studio

KNOWN = "GPU stall due to ReadPixels"
"""What Chromium says of its own pictures."""
SHARES = """(i) => {
    const box = document.querySelector("#scene-view").getBoundingClientRect();
    const at = window.studio.STEPS.scene.view.middleOf(i);
    return [at[0] / box.width, at[1] / box.height];
}"""
"""Where an object is in the view, as shares of its size: there the photo shows it too."""
SERIOUS = ("serious", "critical")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudioServer]:
    with studio(tmp_path_factory.mktemp("studio")) as served:
        yield served


@pytest.fixture(scope="module")
def scene(server: StudioServer, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of a project with a scene."""
    package = resting_boxes(tmp_path_factory.mktemp("packages") / "table")
    return f"{server.address}p/{server.post('projects/folder', {'folder': str(package.folder)})[1]['id']}/"


@pytest.fixture
def tab(browser: Any, server: StudioServer) -> Iterator[Any]:
    """A page whose console stays silent."""
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    said = list[str]()
    page.on(
        "console", lambda m: said.append(m.text) if m.type in ("error", "warning") and KNOWN not in m.text else None
    )
    page.on("pageerror", lambda error: said.append(str(error)))
    page.said = said
    yield page
    page.close()
    assert not said


def findings(tab: Any) -> list[str]:
    """What axe finds that is serious, here and in frames."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    found = axe.Axe().run(tab).response["violations"]
    return [f"{v['id']}: {v['nodes'][0]['html'][:120]}" for v in found if v["impact"] in SERIOUS]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_first_page_is_clear_to_everybody(tab: Any, server: StudioServer, scene: str, scheme: str) -> None:
    tab.emulate_media(color_scheme=scheme)
    tab.goto(server.address)
    tab.wait_for_selector("#projects a")
    assert findings(tab) == []


@pytest.mark.parametrize("step", ["run", "scene", "play", "take"])
@pytest.mark.parametrize("width", [1280, 390])
def test_every_step_is_clear_and_fits(tab: Any, scene: str, step: str, width: int) -> None:
    tab.set_viewport_size({"width": width, "height": 800})
    tab.goto(f"{scene}#{step}")
    tab.wait_for_selector(f"#step-{step}:not([hidden])")
    if step == "scene":
        tab.click("#objects button >> nth=2")
        tab.wait_for_selector("#object:not([hidden])")
    if step == "play":
        tab.wait_for_selector("#suggestions button")
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert findings(tab) == []


def test_an_object_is_chosen_in_the_photo_moved_by_keys_and_put_back(tab: Any, scene: str) -> None:
    tab.goto(f"{scene}#scene")
    tab.wait_for_selector("#objects button")
    x, y = tab.evaluate(f"({SHARES})(2)")
    stage = tab.locator("#photo-stage").bounding_box()
    tab.mouse.click(stage["x"] + x * stage["width"], stage["y"] + y * stage["height"])
    assert tab.locator("#objects [aria-pressed=true]").inner_text() == "brick"
    before = tab.evaluate("window.studio.STEPS.scene.state.objects.map((o) => o.pose)")
    tab.focus("#scene-view")
    tab.keyboard.press("ArrowRight")
    tab.wait_for_selector("#edit-state:has-text('At rest again')", timeout=20_000)
    after = tab.evaluate("window.studio.STEPS.scene.state.objects.map((o) => o.pose)")
    assert [a == b for a, b in zip(before, after, strict=True)] == [True, True, False, True]
    tab.keyboard.press("Control+z")
    tab.wait_for_selector("#undo:disabled")
    tab.wait_for_selector("#scene-work:not([aria-busy])")
    assert tab.evaluate("window.studio.STEPS.scene.state.objects.map((o) => o.pose)") == before


def test_an_object_is_dragged_in_the_view(tab: Any, scene: str) -> None:
    tab.goto(f"{scene}#scene")
    tab.wait_for_selector("#objects button")
    tab.click("#objects button >> nth=2")
    stage, at = tab.locator("#scene-view").bounding_box(), tab.evaluate("window.studio.STEPS.scene.view.middleOf(2)")
    tab.mouse.move(stage["x"] + at[0], stage["y"] + at[1])
    tab.mouse.down()
    tab.mouse.move(stage["x"] + at[0] + 30, stage["y"] + at[1], steps=3)
    tab.mouse.up()
    tab.wait_for_selector("#edit-state:has-text('At rest again')", timeout=20_000)
    assert re.match("brick: moved by", tab.locator("#edits li").last.text_content())
    tab.click("#undo")
    tab.wait_for_selector("#scene-work:not([aria-busy])")


def test_what_cannot_be_is_told_and_changes_nothing(tab: Any, scene: str) -> None:
    tab.goto(f"{scene}#scene")
    tab.wait_for_selector("#objects button")
    tab.click("#objects button >> nth=0")
    field = tab.get_by_label("Mass")
    field.fill("-3")
    field.press("Enter")
    assert "accepted: " in tab.text_content("#line")
    assert tab.evaluate("window.studio.STEPS.scene.state.edits.length") == 0


def test_words_are_understood_before_anything_is_played(tab: Any, scene: str) -> None:
    tab.goto(f"{scene}#play")
    tab.fill("#goal", "sing a song")
    tab.wait_for_selector("#understood.bad")
    tab.click("#suggestions button >> nth=0")
    tab.wait_for_selector("#understood:has-text('Understood as')")


@pytest.mark.slow
def test_from_a_folder_to_a_film(tab: Any, server: StudioServer, tmp_path: Path) -> None:
    write_folder(tmp_path / "boxes", perturb=0.06, seed=3)
    tab.goto(server.address)
    tab.fill("#folder", str(tmp_path / "boxes"))
    tab.click("#open button")
    tab.wait_for_selector("#run-start:not([disabled])")
    tab.click("#run-start")
    tab.wait_for_selector("#run-next:not([hidden]), #run-state.bad", timeout=120_000)
    assert tab.text_content("#run-state") == "The scene stands."
    assert tab.locator("#run-pictures img").count() == 3
    tab.click("#run-next a")
    tab.wait_for_selector("#objects button")
    tab.click("text=4 Play")
    tab.click("#suggestions button >> nth=0")
    tab.click("#play-start")
    tab.wait_for_selector(".rollout iframe, #play-state.bad", timeout=120_000)
    frame = tab.frame_locator(".rollout iframe")
    frame.locator("#film").wait_for()
    assert frame.locator("h1").inner_text() == tab.input_value("#goal")
    assert tab.locator("#rollouts .card").count() == 1
    tab.click("text=5 Take away")
    with tab.expect_download() as download:
        tab.click("#take-package")
    assert download.value.suggested_filename == "boxes_scene.zip"


def test_an_answer_that_does_not_come_is_told(tab: Any, scene: str) -> None:
    tab.goto(f"{scene}#play")
    tab.wait_for_selector("#suggestions button")
    tab.route("**/goals/understand", lambda route: route.abort())
    tab.click("#suggestions button >> nth=0")
    tab.wait_for_selector("#line:has-text('does not answer')")
    assert len(tab.said) == 1 and "ERR_FAILED" in tab.said.pop()


def test_one_click_deletes_nothing_and_two_thoughts_do(tab: Any, server: StudioServer) -> None:
    tab.goto(server.address)
    tab.click("#example")
    tab.wait_for_selector("#step-run:not([hidden])")
    tab.goto(server.address)
    card = tab.locator("#projects li", has_text="Example")
    tab.wait_for_timeout(2500)
    card.locator(".quiet-button").dblclick()
    assert card.locator(".quiet-button").inner_text() == "Delete it?"
    tab.wait_for_timeout(1100)
    card.locator(".quiet-button").click()
    tab.wait_for_selector("#note:has-text('Example is deleted.')")
    assert card.count() == 0


def test_a_photo_is_refused_in_words(tab: Any, server: StudioServer, tmp_path: Path) -> None:
    (tmp_path / "notes.png").write_text("no picture")
    tab.goto(server.address)
    tab.set_input_files("#photo", str(tmp_path / "notes.png"))
    tab.wait_for_selector("#line:has-text('accepted: a PNG or JPEG image')")
    assert len(tab.said) == 1 and "422" in tab.said.pop()
