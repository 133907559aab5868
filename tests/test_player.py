"""The player page in a browser: film, 3-D view and timeline show the same frame, whatever asks for it."""

from __future__ import annotations

import io
import json
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from f3sr.film import PLAYER, make_film
from f3sr.film.timeline import pairs_of
from f3sr.goals.verify import verify
from f3sr.vision import rasterizer
from film_scene import film_files, given, unlit
from plans import changed

PATIENCE = 20_000
"""How long anything may take [ms]."""
STATE = "[player.frame, player.filmFrame, player.playing, film.currentTime, film.seeking, film.readyState]"
pytestmark = pytest.mark.timeout(120)


class Opened:
    """A player in a tab, with all that it said and asked for."""

    def __init__(self, browser: Any, page: bytes, folder: Path, script: str = "", **context: Any) -> None:
        (folder / PLAYER).write_bytes(page)
        self.context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **context})
        self.tab = self.context.new_page()
        self.tab.set_default_timeout(PATIENCE)
        self.said: list[str] = []
        self.asked: list[str] = []
        self.tab.on("console", lambda m: self.said.append(m.text))
        self.tab.on("pageerror", lambda e: self.said.append(str(e)))
        self.tab.on("dialog", lambda d: (self.said.append(d.message), d.dismiss()))
        self.tab.on("request", lambda r: self.asked.append(r.url))
        if script:
            self.tab.add_init_script(script)
        self.tab.goto((folder / PLAYER).as_uri())

    def until(self, condition: str) -> None:
        """Asked from outside: playwright's own waiting evaluates strings, which the page's policy forbids."""
        end = time.monotonic() + PATIENCE / 1000
        while not self.tab.evaluate(condition):
            assert time.monotonic() < end, f"{condition}: {self.tab.evaluate(STATE)}"
            self.tab.wait_for_timeout(30)

    def at(self, k: int) -> None:
        """Wait until the film and everything else show frame k."""
        self.until(f"player.frame === {k} && player.filmFrame === {k} && !film.seeking")

    def state(self, expression: str) -> Any:
        return self.tab.evaluate(expression)

    def picture(self, selector: str) -> np.ndarray[Any, Any]:
        self.tab.wait_for_timeout(300)
        return np.asarray(Image.open(io.BytesIO(self.tab.locator(selector).screenshot())).convert("RGB"), int)


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Opened]:
    """The player on a desktop; at the end nothing has been complained about or asked for."""
    player = Opened(browser, film_files()[PLAYER], tmp_path)
    player.until("player.loaded")
    yield player
    player.context.close()
    assert player.said == []
    assert [u for u in player.asked if not u.startswith("data:")] == [(tmp_path / PLAYER).as_uri()]


def test_film_and_rollout_show_the_frame_that_is_asked_for(opened: Opened):
    g = given()
    rollout, last = g.played.rollout, len(g.played.rollout.time) - 1
    draw = unlit(g.scene)
    opened.at(0)
    for k in (last, 0, 7, 8, 7, last // 2, last):
        opened.state(f"player.seek({k})")
        opened.at(k)
        for id in (int(i) for i in rollout.ids):
            pose = np.reshape(opened.state(f"player.poseOf({id})"), (4, 4))
            assert np.abs(pose - rollout.poses(id)[k]).max() < 1e-5
        wide = opened.state("(() => {const c = new OffscreenCanvas(160, 120), d = c.getContext('2d');"
                            "d.drawImage(film, 0, 0); return [...d.getImageData(0, 0, 160, 120).data]})()")  # fmt: skip
        shown = np.reshape(wide, (120, 160, 4))[..., :3].astype(float)
        errors = [np.mean((draw(rollout.T_world_object[j]) - shown) ** 2) for j in range(last + 1)]
        wanted = draw(rollout.T_world_object[k]).astype(float)
        assert errors[k] == min(errors)
        assert np.abs((shown - wanted).mean((0, 1))).max() < 1.2  # most is one colour, which is rounded one way
        assert f"frame {k} / {last}" in opened.tab.inner_text("#where")


def test_it_plays_to_the_last_frame_with_film_and_rollout_together(opened: Opened):
    last = len(given().played.rollout.time) - 1
    opened.at(0)
    opened.state(
        "window.seen = []; (function watch() {if (player.playing) seen.push([player.frame, player.filmFrame, "
        "Number(slider.value)]); requestAnimationFrame(watch)})()"
    )
    opened.tab.keyboard.press("Space")
    opened.until(f"!player.playing && player.frame === {last}")
    opened.at(last)
    seen = np.array(opened.state("seen"))
    assert len(np.unique(seen[:, 0])) > 5 and (np.diff(seen[:, 0]) >= 0).all()
    assert (seen[:, 0] == seen[:, 1]).mean() > 0.9 and (seen[:, 0] == seen[:, 2]).all()
    opened.tab.click("#play")  # again from the start
    opened.until("player.playing && player.frame < 20")
    opened.tab.click("#play")
    opened.until("!player.playing && !film.seeking && player.filmFrame === player.frame")


def test_half_speed_takes_twice_as_long(opened: Opened):
    opened.at(0)
    opened.tab.select_option("#speed", "0.5")
    opened.state("player.play()")
    opened.until("player.frame > 3")
    assert opened.state("film.playbackRate") == 0.5
    opened.state("player.pause()")


def test_it_repeats_where_asked_to(opened: Opened):
    opened.at(0)
    opened.state("window.back = 0; setInterval(() => {if (player.frame < window.was) back++; was = player.frame}, 5)")
    opened.tab.click("#repeat")
    opened.state("player.play()")
    opened.until("window.back >= 1 && player.playing")
    opened.tab.click("#repeat")
    opened.until("!player.playing")


def test_keys_step_and_jump(opened: Opened):
    last = len(given().played.rollout.time) - 1
    opened.at(0)
    for key, k in (("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("Shift+ArrowRight", 11), ("End", last),
                   ("ArrowRight", last), ("Home", 0), ("ArrowLeft", 0)):  # fmt: skip
        opened.tab.keyboard.press(key)
        opened.at(k)
    opened.tab.click("#on")
    opened.at(1)
    opened.tab.focus("#slider")
    opened.tab.keyboard.press("ArrowRight")
    opened.at(2)
    assert "frame 2 of" in opened.tab.get_attribute("#slider", "aria-valuetext")


def test_the_timeline_is_clicked_and_dragged(opened: Opened):
    last = len(given().played.rollout.time) - 1
    opened.tab.locator(".contact .track").first.scroll_into_view_if_needed()
    box = opened.tab.locator(".contact .track").first.bounding_box()
    y = box["y"] + box["height"] / 2
    for share in (0.25, 0.8):
        opened.tab.mouse.click(box["x"] + share * box["width"], y)
        opened.at(round(share * last))
    opened.tab.mouse.move(box["x"] + 0.1 * box["width"], y)
    opened.tab.mouse.down()
    for share in (0.2, 0.4, 0.6):
        opened.tab.mouse.move(box["x"] + share * box["width"], y)
    opened.tab.mouse.up()
    opened.at(round(0.6 * last))


def test_conditions_contacts_and_moments_are_those_of_the_verdict(opened: Opened):
    played = given().played
    for row, judged in enumerate(played.verdict.conditions):
        mark = opened.tab.locator("#timeline .condition .mark").nth(row)
        assert judged.said in opened.tab.locator("#timeline .condition .name").nth(row).inner_text()
        assert "met" in mark.get_attribute("class").split() and judged.met
        assert judged.time is not None
        assert float(mark.get_attribute("data-time")) == pytest.approx(judged.time, abs=1e-5)
        lane, at = opened.tab.locator("#lane").bounding_box(), mark.bounding_box()
        share = (at["x"] + at["width"] / 2 - lane["x"]) / lane["width"]
        assert share == pytest.approx(judged.time / played.rollout.time[-1], abs=0.01)
        mark.click()
        opened.at(int(np.searchsorted(played.rollout.time, judged.time - 1e-6)))
        assert [2, 1] in opened.state("player.touching()") or [1, 2] in opened.state("player.touching()")
    busy = [p for p in pairs_of(played.rollout) if not p.rests]
    shown = opened.state("player.contacts")
    assert [(c["a"], c["b"]) for c in shown] == [(p.a, p.b) for p in busy]
    for c, p in zip(shown, busy, strict=True):
        assert np.allclose(c["forces"], p.forces, atol=1e-3)
    assert opened.tab.locator("#timeline > .rows:not(details) .contact").count() == len(busy)
    assert opened.tab.locator("#timeline .contact").count() == len(pairs_of(played.rollout))
    for button in opened.tab.locator("#moments button").all():
        button.click()
        opened.at(int(button.get_attribute("data-frame")))
        assert button.get_attribute("aria-current") == "true"


def test_the_view_turns_zooms_names_and_comes_back(opened: Opened):
    opened.at(0)
    start = opened.picture("#view")
    assert len(np.unique(start.reshape(-1, 3), axis=0)) > 50
    box = opened.tab.locator("#view").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    opened.tab.mouse.move(x, y)
    opened.tab.mouse.down()
    opened.tab.mouse.move(x + 100, y - 30, steps=4)
    opened.tab.mouse.up()
    turned = opened.picture("#view")
    assert np.abs(turned - start).mean() > 2
    opened.tab.keyboard.press("d")
    opened.tab.keyboard.press("+")
    assert np.abs(opened.picture("#view") - turned).mean() > 0.5
    for name in ("top", "side"):
        opened.tab.click(f"#from-{name}")
        assert np.abs(opened.picture("#view") - turned).mean() > 2
    opened.tab.click("#from-photo")
    assert np.abs(opened.picture("#view") - start).mean() < 0.5
    assert opened.state("player.view.fromPhoto")


def test_hovering_names_what_is_there(opened: Opened):
    g = given()
    opened.at(0)
    box = opened.tab.locator("#view").bounding_box()
    camera = g.scene.camera.resized(round(box["width"]), round(box["height"]))
    ids = rasterizer.render(g.scene.objects, camera).ids
    for o in g.scene:
        rows, columns = np.nonzero(ids == o.id)
        k = int(np.argmin(np.hypot(rows - rows.mean(), columns - columns.mean())))
        opened.tab.mouse.move(box["x"] + columns[k] + 0.5, box["y"] + rows[k] + 0.5)
        opened.until(f"!document.getElementById('name').hidden && document.getElementById('name').textContent === "
                     f"'{o.id} {o.label}'")  # fmt: skip
    opened.tab.mouse.move(box["x"] + 3, box["y"] + 3)
    opened.until("document.getElementById('name').hidden")


def test_the_view_starts_where_the_photo_was_taken(opened: Opened):
    g = given()
    opened.at(0)
    box = opened.tab.locator("#view").bounding_box()
    width, height = round(box["width"]), round(box["height"])
    picked = opened.state(
        f"(() => {{const found = []; for (let y = 0; y < {height}; y += 9) for (let x = 0; x < {width}; x += 9) "
        "found.push(player.view.pick(x + 0.5, y + 0.5)); return found})()"
    )
    ids = rasterizer.render(g.scene.objects, g.scene.camera.resized(width, height)).ids[::9, ::9]
    known = np.array([rasterizer.EMPTY, *(o.id for o in g.scene)])
    agree = known[np.array(picked).reshape(ids.shape) + 1] == ids
    assert len(np.unique(ids)) == len(known) and agree.mean() > 0.995


@pytest.mark.parametrize("width", [320, 390, 800, 1280])
def test_nothing_is_wider_than_the_screen(opened: Opened, width: int):
    opened.tab.set_viewport_size({"width": width, "height": 844})
    opened.tab.wait_for_timeout(200)
    assert opened.state("document.documentElement.scrollWidth") <= width


def test_it_works_without_webgl(browser: Any, tmp_path: Path):
    none = "HTMLCanvasElement.prototype.getContext = () => null;"
    player = Opened(browser, film_files()[PLAYER], tmp_path, none)
    player.until("player.loaded")
    assert player.state("player.view") is None
    assert "WebGL 2" in player.tab.inner_text("#no-view") and player.tab.is_disabled("#from-top")
    player.state("player.seek(5)")
    player.at(5)
    player.context.close()
    assert player.said == []


def test_it_works_without_the_film(browser: Any, tmp_path: Path):
    page = re.sub(rb"data:video/mp4;base64,[^\"]+", b"data:video/mp4;base64,AAAA", film_files()[PLAYER])
    player = Opened(browser, page, tmp_path)
    player.until("player.loaded")
    player.until("!document.getElementById('no-film').hidden")
    last = player.state("player.frames") - 1
    player.tab.keyboard.press("Space")
    player.until(f"!player.playing && player.frame === {last}")
    player.state("player.seek(3)")
    assert player.state("player.frame") == 3
    player.context.close()


def test_without_scripts_the_film_still_plays_and_words_are_there(browser: Any, tmp_path: Path):
    player = Opened(browser, film_files()[PLAYER], tmp_path, java_script_enabled=False)
    assert player.tab.get_attribute("#film", "controls") is not None
    assert "needs scripts" in player.tab.inner_text("#no-view") and not player.tab.is_visible("#controls")
    assert given().played.verdict.said in player.tab.inner_text("header")
    player.context.close()


def test_fingers_turn_and_pinch(browser: Any, tmp_path: Path):
    player = Opened(
        browser, film_files()[PLAYER], tmp_path,
        viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True,
    )  # fmt: skip
    player.until("player.loaded")
    hand = player.context.new_cdp_session(player.tab)
    player.tab.locator("#view").scroll_into_view_if_needed()
    box = player.tab.locator("#view").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag(*ways: tuple[float, float, float, float]) -> None:
        for kind, k in (("touchStart", 0.0), ("touchMove", 0.5), ("touchMove", 1.0)):
            points = [{"x": a + k * (c - a), "y": b + k * (d - b), "id": i} for i, (a, b, c, d) in enumerate(ways)]
            hand.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        hand.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    start, top = player.picture("#view"), player.state("scrollY")
    drag((x, y, x + 80, y - 20))
    turned = player.picture("#view")
    assert np.abs(turned - start).mean() > 2 and player.state("scrollY") == top
    drag((x - 20, y, x - 90, y), (x + 20, y, x + 90, y))
    assert np.abs(player.picture("#view") - turned).mean() > 2
    player.context.close()


def test_hostile_words_are_only_shown(browser: Any, tmp_path: Path):
    hostile = "</script></title><img src=x onerror=alert(1)>\"'\u2028" + "y" * 10_000
    g = given()
    scene = g.scene.with_objects(*(replace(o, label=hostile) for o in g.scene))
    task = g.played.plan.phases[0].task.model_copy(update={"interpretation": hostile[:1900]})
    plan = changed(g.played.plan, task=task).model_copy(update={"goal": hostile[:1900]})
    verdict = verify(scene, plan, g.played.rollout)
    page = make_film(scene, plan, g.played.rollout, verdict, unlit(scene))[PLAYER]
    player = Opened(browser, page, tmp_path)
    player.until("player.loaded")
    player.state("player.seek(9)")
    player.at(9)
    assert player.tab.locator("img").count() == 0 and "<img src=x" in player.tab.inner_text("h1")
    assert player.state("document.documentElement.scrollWidth") <= 1280
    player.tab.set_viewport_size({"width": 390, "height": 844})
    assert player.state("document.documentElement.scrollWidth") <= 390
    player.context.close()
    assert player.said == []


def test_the_data_are_small_and_exact(tmp_path: Path):
    text = film_files()[PLAYER].decode()
    found = re.search(r'id="player-data">(.*?)</script>', text, re.S)
    assert found
    data = json.loads(found[1])
    rollout = given().played.rollout
    assert data["frames"] == len(rollout.time) and data["step"] == pytest.approx(1 / 30) and data["fps"] == 30
    assert data["ids"] == rollout.ids.tolist()
