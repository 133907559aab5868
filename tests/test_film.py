"""Laws of films: exact frames and times, true colours, the same bytes; moments, strips, pages that say what is so."""

from __future__ import annotations

import errno
import html
import io
import json
import re
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from f3sr.background.inpainting import Inpainting
from f3sr.edits import EditSession, edit_of, write_edited
from f3sr.env.episode_pictures import EpisodePictures
from f3sr.errors import InputError, OutputError
from f3sr.film import FILM, PLAYER, STRIP, encode, key_moments, make_film
from f3sr.film.captions import captioned, font, slowed, speed_words, wrapped
from f3sr.film.event_text import clock, happened, told
from f3sr.film.moments import FEWEST, MOST
from f3sr.film.player import LARGEST_REST
from f3sr.film.slow_motion import factor, finer, rate_of
from f3sr.film.strip import Title, strip
from f3sr.film.studio import FilmFrames, Studio
from f3sr.film.timeline import pairs_of
from f3sr.film.video import BT709, even, yuv420
from f3sr.goals.plan import Contact
from f3sr.goals.verify import verify
from f3sr.rendering.canvas import Canvas
from f3sr.rendering.light import Light
from f3sr.rendering.renderer import Renderer
from f3sr.scene import GROUND
from f3sr.scene_package.package import read_package, write_package
from f3sr.vision import rasterizer
from f3sr.vision.regions import grown
from film_scene import film_files, given, unlit
from goal_scene import BLOCK, LID
from plans import changed
from resting_boxes import resting_boxes

av = pytest.importorskip("av")
HOSTILE = "</script><img src=x onerror=alert(1)>\"' \u2028\u202e\0" + "9" * 10_000


def moving(count: int, width: int = 96, height: int = 64) -> Iterator[NDArray[np.uint8]]:
    """Smooth colours with a block that moves by four pixels a frame."""
    y, x = np.mgrid[:height, :width]
    base = np.stack([255 * x / width, 255 * y / height, 127 + 100 * np.sin(x / 15)], -1).astype(np.uint8)
    for k in range(count):
        frame = base.copy()
        frame[10:26, 4 * k : 4 * k + 16] = (250, 240, 20)
        yield frame


def opened(data: bytes) -> Any:
    return av.open(io.BytesIO(data))


def decoded(data: bytes) -> list[NDArray[np.uint8]]:
    """RGB by BT.709 from limited range, without the decoder library's own rounding."""
    return [rgb_of(frame.to_ndarray(format="yuv420p")) for frame in opened(data).decode(video=0)]


def rgb_of(planes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height = len(planes) * 2 // 3
    luma = (planes[:height].astype(float) - 16) / 219
    u, v = planes[height:].reshape(2, height // 2, -1).astype(float)
    u, v = (np.kron((p - 128) / 224, np.ones((2, 2))) for p in (u, v))
    red, blue = luma + 1.5748 * v, luma + 1.8556 * u
    green = (luma - 0.2126 * red - 0.0722 * blue) / 0.7152
    return np.clip(np.rint(255 * np.stack([red, green, blue], -1)), 0, 255).astype(np.uint8)


def psnr(a: NDArray[Any], b: NDArray[Any]) -> float:
    return float(10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2)))


# --- the video ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fps", [30, Fraction(15, 2), Fraction(30000, 1001), 7.3])
@pytest.mark.parametrize("count", [1, 2, 33])
def test_every_frame_is_there_at_its_time_and_the_last_for_as_long(fps: Fraction | float, count: int):
    video = encode(moving(count), fps)
    assert video.frames == count and abs(float(video.fps) - float(fps)) < 1e-9
    with opened(video.data) as file:
        stream = file.streams.video[0]
        times = [f.pts * f.time_base for f in file.decode(stream)]
        assert times == [k / video.fps for k in range(count)]
        assert stream.duration * stream.time_base == video.seconds == count / video.fps
        assert stream.frames == count and stream.start_time == 0


def test_frame_k_shows_picture_k():
    shown = decoded(encode(moving(20), 30).data)
    for k, frame in enumerate(moving(20)):
        nearest = min(range(20), key=lambda j: -psnr(shown[j], frame))
        assert nearest == k


def test_the_same_frames_give_the_same_bytes_and_the_index_comes_first():
    first = encode(moving(9), 30)
    for k in range(60):  # with other films in between, that leave other memory behind
        encode(moving(1 + k % 7, 96 + k % 40, 64 + k % 20), 30)
        assert encode(moving(9), 30).data == first.data
    boxes, at = [], 0
    while at < len(first.data):
        size = int.from_bytes(first.data[at : at + 4], "big")
        boxes.append(first.data[at + 4 : at + 8])
        at += size
    assert boxes.index(b"moov") < boxes.index(b"mdat") and b"elst" not in first.data[:5000]


def test_frames_are_taken_one_at_a_time():
    alive = {"now": 0, "most": 0}

    class Counted(np.ndarray[Any, Any]):
        def __del__(self) -> None:
            if self.base is None:
                alive["now"] -= 1

    def frames() -> Iterator[NDArray[np.uint8]]:
        for _ in range(40):
            frame = Counted((64, 96, 3), np.uint8)
            frame[:] = 128
            alive["now"] += 1
            alive["most"] = max(alive["most"], alive["now"])
            yield frame
            del frame

    encode(frames(), 30)
    assert alive["most"] <= 4


@pytest.mark.parametrize("size", [(96, 64), (97, 64), (96, 65), (97, 65)])
def test_an_odd_size_repeats_the_last_row_and_column(size: tuple[int, int]):
    width, height = size
    frames = list(moving(3, width, height))
    video = encode(frames, 30)
    assert (video.width, video.height) == (width + width % 2, height + height % 2)
    shown = decoded(video.data)[0]
    assert shown.shape == (video.height, video.width, 3)
    assert psnr(shown[:height, :width], frames[0]) > 35
    grown = even(frames[0])
    assert (grown[:height, :width] == frames[0]).all() and (grown[-1, -1] == frames[0][-1, -1]).all()


def test_colours_come_back():
    with opened(encode(moving(2), 30).data) as file:
        frame = next(file.decode(video=0))
        tags = frame.colorspace, frame.color_range, frame.color_primaries, frame.color_trc
        assert tags == (1, 1, 1, 1)  # BT.709 in limited range
    rng = np.random.default_rng(0)
    colors = np.concatenate(
        [[[0, 0, 0], [255] * 3, [255, 0, 0], [0, 255, 0], [0, 0, 255]], rng.integers(0, 256, (59, 3))]
    )
    chart = np.kron(colors.reshape(8, 8, 3), np.ones((16, 16, 1))).astype(np.uint8)
    exact = rgb_of(yuv420(chart, BT709)).astype(int)
    assert np.abs(exact - chart).max() <= 2  # what eight bits of limited range can hold
    shown = decoded(encode([chart] * 3, 30).data)[1].astype(int)
    inner = np.kron(np.ones((8, 8)), np.pad(np.ones((8, 8)), 4)) > 0
    assert np.abs(shown - chart)[inner].max() <= 8 and psnr(shown, chart) > 36
    assert np.abs((shown - chart)[inner].mean(0)).max() < 0.5


@pytest.mark.parametrize(
    ("frames", "fps", "found"),
    [
        ([], 30, "no frame"),
        ([np.zeros((64, 96, 3), np.float32)], 30, "float32"),
        ([np.zeros((64, 96), np.uint8)], 30, r"\(64, 96\)"),
        ([np.zeros((64, 96, 3), np.uint8), np.zeros((64, 98, 3), np.uint8)], 30, "98x64"),
        ([np.zeros((64, 10, 3), np.uint8)], 30, "10x64"),
        ([np.zeros((64, 96, 3), np.uint8)], 0, "0 frames"),
        ([np.zeros((64, 96, 3), np.uint8)], float("nan"), "nan frames"),
        ([np.zeros((64, 96, 3), np.uint8)], 1000, "1000 frames"),
    ],
)
def test_what_is_no_film_is_told(frames: list[NDArray[Any]], fps: float, found: str):
    with pytest.raises(InputError, match=found):
        encode(frames, fps)


def test_an_encoder_makes_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A process that is killed while it films leaves none."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def watched():
        for frame in moving(4):
            assert not list(tmp_path.iterdir())
            yield frame

    assert encode(watched(), 30).frames == 4


def test_an_encoder_that_fails_is_told(monkeypatch: pytest.MonkeyPatch):
    def full(*_: Any, **__: Any) -> None:
        raise av.FFmpegError(errno.ENOMEM, "Cannot allocate memory")

    monkeypatch.setattr(av, "open", full)
    with pytest.raises(OutputError, match="the encoder failed"):
        encode(moving(2), 30)


# --- times ------------------------------------------------------------------------------------------------------------


def test_film_time_is_simulated_time():
    g = given()
    rollout = g.played.rollout
    rate = rate_of(rollout)
    assert rate == 30
    assert np.allclose([float(k / rate) for k in range(len(rollout.time))], rollout.time, atol=1e-9, rtol=0)
    uneven = replace(rollout, time=rollout.time**2)
    with pytest.raises(InputError, match="uneven"):
        rate_of(uneven)


def test_slow_motion_shows_more_of_the_same_motion():
    g = given()
    fine = finer(g.scene, g.played.plan.phases[0], g.played.rollout, 4)
    assert rate_of(fine) == 120
    assert (fine.T_world_object[::4] == g.played.rollout.T_world_object).all()
    other = replace(g.played.rollout, T_world_object=g.played.rollout.T_world_object + 1e-3)
    with pytest.raises(InputError, match="another motion"):
        finer(g.scene, g.played.plan.phases[0], other, 4)
    assert finer(g.scene, g.played.plan.phases[0], g.played.rollout, 1) is g.played.rollout


@pytest.mark.parametrize(("slow", "said"), [(4, "1/4 speed"), (2.5, "0.4x speed"), (0.5, "2x speed"), (3, "1/3 speed")])
def test_the_speed_is_said_on_the_picture(slow: float, said: str):
    assert speed_words(factor(slow)) == said
    frame = np.full((240, 320, 3), 200, np.uint8)
    written = list(slowed([frame, frame], factor(slow)))
    assert (written[0] == written[1]).all() and (written[0][:40, :120] != frame[:40, :120]).any()
    assert next(slowed([frame], Fraction(1))) is frame
    for wrong in (0, -1, 1000, float("nan")):
        with pytest.raises(InputError, match="factor"):
            factor(wrong)


# --- captions -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [0, 128, 255])
@pytest.mark.parametrize("corner", ["top left", "top right", "bottom left", "bottom right"])
def test_a_caption_can_be_read_over_anything_and_stays_in_its_corner(level: int, corner: Any):
    frame = np.full((480, 640, 3), level, np.uint8)
    shown = captioned(frame, "0.42 s", corner)
    changed = np.argwhere((shown != frame).any(2)) if level else np.argwhere((shown > 0).any(2))
    middle = changed.mean(0) / frame.shape[:2]
    assert (middle[0] < 0.3) == ("top" in corner) and (middle[1] < 0.3) == ("left" in corner)
    patch = shown[changed[:, 0].min() : changed[:, 0].max() + 1, changed[:, 1].min() : changed[:, 1].max() + 1]
    assert patch.max() == 255 and luminance_contrast(int(np.median(patch)), 255) > 4.5
    assert (patch == patch[..., :1]).all()  # no colour to be lost in 4:2:0


def luminance_contrast(dark: int, light: int) -> float:
    linear = [((v / 255 + 0.055) / 1.055) ** 2.4 if v > 10 else v / 255 / 12.92 for v in (dark, light)]
    return (linear[1] + 0.05) / (linear[0] + 0.05)


def test_long_and_hostile_captions_are_cut():
    frame = np.zeros((48, 64, 3), np.uint8)
    assert captioned(frame, HOSTILE).shape == frame.shape
    lines = wrapped(HOSTILE + " and more", font(19), 200, 3)
    assert len(lines) <= 3 and all(font(19).getlength(line) <= 200 for line in lines)
    assert wrapped("a cup of tea", font(19), 500, 3) == ["a cup of tea"]
    assert told(("start", "cup is set off")) == "start, cup is set off"
    assert told(("cup rises", "cup falls", "cup is broken", "end")) == "cup rises, falls, is broken, end"
    assert told(("cup leans 45°", "cup has moved 7 cm")) == "cup leans 45° and has moved 7 cm"


# --- moments and strip ----------------------------------------------------------------------------------------------


GOALS = [
    "throw the ball at the soup can",
    "knock over the cereal box",
    "drop the sponge onto the soup can",
    "roll the ball into the soup can",
    "push the sponge off the wooden block",
]


@pytest.mark.parametrize("goal", GOALS)
def test_moments_are_few_in_order_and_hold_every_met_condition(goal: str):
    g = given(goal)
    played = g.played
    moments = key_moments(g.scene, played.plan.phases[0], played.rollout, played.verdict)
    frames = [m.frame for m in moments]
    assert FEWEST <= len(moments) <= MOST and frames == sorted(set(frames))
    assert frames[0] == 0 and frames[-1] == len(played.rollout.time) - 1
    assert moments[0].what[0] == "start" and "end" in moments[-1].what
    for judged in played.verdict.conditions:
        if judged.met and judged.time is not None and isinstance(judged.condition, Contact):
            near = [m for m in moments if abs(played.rollout.time[m.frame] - judged.time) < 0.09]
            assert near, judged.said
            words = happened(judged.condition, g.scene)
            told_at = {clock(m.time) if w == words else w for m in moments for w in m.what if w.startswith(words)}
            assert told_at <= {clock(judged.time), f"{words} ({clock(judged.time)})"}, "and no other time"
    for m in moments:  # the first frame that shows it
        assert m.time - 1e-6 <= played.rollout.time[m.frame] < m.time + 1 / 30 + 1e-6


def test_the_first_contact_is_the_rollouts():
    g = given()
    task = g.played.plan.phases[0].task
    assert task.target is not None
    first = float(g.played.rollout.touches(task.active, task.target)["time"][0])
    moments = key_moments(g.scene, g.played.plan.phases[0], g.played.rollout, g.played.verdict)
    said = [m for m in moments if "tennis ball touches soup can" in m.what]
    assert len(said) == 1 and said[0].time == first


def test_what_was_missed_is_said_at_the_end():
    g = given()
    task = g.played.plan.phases[0].task
    wrong = task.model_copy(update={"conditions": (Contact(a=task.active, b=0),)})
    plan = changed(g.played.plan, task=wrong)
    verdict = verify(g.scene, plan, g.played.rollout)
    assert not verdict.met
    end = key_moments(g.scene, plan.phases[0], g.played.rollout, verdict)[-1]
    assert f"missed: {verdict.conditions[0].said}" in end.what


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6])
def test_a_strip_holds_every_picture_in_order(count: int):
    moments = [replace(m, frame=k) for k, m in enumerate(key_moments(given().scene, *_of(given().played))[:1] * count)]
    pictures = [np.full((60, 80, 3), (40 * k + 10, 0, 0), np.uint8) for k in range(count)]
    sheet = np.asarray(Image.open(io.BytesIO(strip(moments, pictures, Title(goal="g", met=True)))).convert("RGB"), int)
    reds = [40 * k + 10 for k in range(count)]
    centers = [np.argwhere((sheet == (red, 0, 0)).all(2)).mean(0) for red in reds]
    places = [(round(y / 100), x) for y, x in centers]
    assert places == sorted(places)


def _of(played: Any) -> tuple[Any, Any, Any]:
    return played.plan.phases[0], played.rollout, played.verdict


# --- all of it ------------------------------------------------------------------------------------------------------


def test_a_film_is_its_three_files_and_the_same_again():
    g = given()
    files = film_files()
    assert list(files) == [FILM, STRIP, PLAYER]
    again = make_film(g.scene, g.played.plan, *_of(g.played)[1:], unlit(g.scene))
    assert {k: v == again[k] for k, v in files.items()} == dict.fromkeys(files, True)
    with opened(files[FILM]) as file:
        assert file.streams.video[0].frames == len(g.played.rollout.time)
    assert len(files[PLAYER]) < LARGEST_REST + 1.4 * len(files[FILM]) and files[PLAYER].count(b"http://") == 0


def test_a_slow_film_has_four_times_the_frames_at_the_same_rate():
    files = film_files(4)
    samples = len(given().played.rollout.time)
    with opened(files[FILM]) as file:
        stream = file.streams.video[0]
        assert stream.frames == 4 * (samples - 1) + 1 and stream.average_rate == 30
    assert "at 1/4 speed" in files[PLAYER].decode()


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_the_shortest_rollouts_are_films_too(samples: int):
    g = given()
    whole = g.played.rollout
    rollout = replace(
        whole,
        time=whole.time[:samples],
        T_world_object=whole.T_world_object[:samples],
        contacts=whole.contacts[whole.contacts["time"] <= whole.time[samples - 1] + 1e-9],
    )
    verdict = verify(g.scene, g.played.plan, rollout)
    moments = key_moments(g.scene, g.played.plan.phases[0], rollout, verdict)
    assert [moments[0].frame, moments[-1].frame] == [0, samples - 1] and "end" in moments[-1].what
    files = make_film(g.scene, g.played.plan, rollout, verdict, unlit(g.scene))
    with opened(files[FILM]) as file:
        assert file.streams.video[0].frames == samples


def test_every_frame_is_drawn_once_and_in_order():
    g = given()
    asked: list[NDArray[Any]] = []

    def draw(poses: NDArray[Any]) -> NDArray[np.uint8]:
        asked.append(poses)
        return np.full((64, 96, 3), 99, np.uint8)

    make_film(g.scene, g.played.plan, *_of(g.played)[1:], draw)
    assert (np.array(asked) == g.played.rollout.T_world_object).all()


def test_pairs_are_those_of_the_rollout():
    rollout = given().played.rollout
    pairs = pairs_of(rollout)
    assert {(p.a, p.b) for p in pairs} == {(int(r["a"]), int(r["b"])) for r in rollout.contacts}
    for p in pairs:
        rows = rollout.touches(p.a, p.b)
        assert p.forces.max() == rows["force"].max()
        for row in rows:
            k = min(int(np.searchsorted(rollout.time, row["time"] + 1e-9, side="right")), len(rollout.time) - 1)
            assert p.forces[k] >= row["force"] and rollout.time[k] >= row["time"] - 1e-6
    assert all(p.rests for p in pairs if p.a == GROUND and p.b in (0, 3))  # the box and the crate just stand


def test_hostile_words_stay_words():
    g = given()
    scene = g.scene.with_objects(*(replace(o, label=HOSTILE) for o in g.scene))
    task = g.played.plan.phases[0].task.model_copy(
        update={"interpretation": HOSTILE[:1900], "assumptions": (HOSTILE[:1900],)}
    )
    plan = changed(g.played.plan, task=task).model_copy(update={"goal": HOSTILE[:1900]})
    verdict = verify(scene, plan, g.played.rollout)
    text = make_film(scene, plan, g.played.rollout, verdict, unlit(scene))[PLAYER].decode()
    assert text.count("</script>") == 2 and "<img src=x" not in text
    assert "\u2028" not in text and "\u202e" not in text and "9" * 1000 not in text
    data = re.search(r'<script type="application/json" id="player-data">(.*?)</script>', text, re.S)
    assert data and json.loads(data[1])["names"][0].startswith("0 </script><img")
    assert html.escape("</script><img src=x") in text


def test_what_rests_touches_in_every_frame_but_the_first() -> None:
    """A row's time is that of the step's start: on a sample's time it belongs to the frame after."""
    found = {(p.a, p.b): p.forces for p in pairs_of(given().played.rollout)}
    block, lid = found[GROUND, BLOCK], found[BLOCK, LID]
    assert block[0] == 0 and (block[1:] > 0).all() and (lid[1:] > 0).all()


# --- edited packages ------------------------------------------------------------------------------------------------


def test_a_film_shows_what_edits_made_of_the_photo(tmp_path: Path):
    """One box moved and one deleted, neither of which moves in the film. All boxes are brighter than the ground."""
    dark = resting_boxes(tmp_path / "table").scene
    shown = np.any([o.mask for o in dark], axis=0)[..., None]
    bright = replace(dark, photo=replace(dark.photo, rgb=np.where(shown, 220, 90).repeat(3, 2).astype(np.uint8)))
    package = read_package(write_package(bright, tmp_path / "bright"))
    moved, gone = package.scene[2], package.scene[3]
    session = EditSession(package)
    session.add(edit_of({"kind": "delete", "id": gone.id, "label": gone.label}))
    session.add(edit_of({"kind": "move", "id": moved.id, "label": moved.label, "by": [0.1, 0, 0]}))
    studio = Studio.of(read_package(write_edited(session, tmp_path / "edited")))
    assert {o.id for o, is_edited in zip(studio.shown, studio.edited, strict=True) if is_edited} == {moved.id, gone.id}
    assert any("object 2: drawn where edits moved it" in line for line in studio.told)
    assert not Studio.of(package).edited.any()
    rest = np.array([o.T_world_object for o in studio.scene])
    frame = FilmFrames(studio, np.zeros(len(rest), np.bool_)).draw(rest)
    now = rasterizer.visible_ids(studio.scene.objects, studio.scene.camera)
    for o in (moved, gone):
        left = o.mask & ~grown(now >= 0, 4)
        assert left.sum() > 20 and frame[left].max() < 150, o.label
    assert np.median(frame[now == moved.id]) > 150
    assert np.array_equal(frame[package.scene[1].mask], package.scene.photo.rgb[package.scene[1].mask])


def test_shadows_leave_with_what_edits_moved_or_deleted(tmp_path: Path):
    """The photo is drawn in a light from the side, and its shadows are away in the completed photo."""
    scene = resting_boxes(tmp_path / "table").scene
    height, width = scene.camera.height, scene.camera.width
    bare, rest = np.full((height, width, 3), 150, np.uint8), np.array([o.T_world_object for o in scene])
    light = Light(direction=np.array([0.6, 0, 0.8]), angle=0.15, direct=np.full(3, 0.6), sky=np.full(3, 0.4))
    photo = Canvas(replace(Renderer.of(scene, bare).setting, light=light)).drawn(rest)
    completed = Inpainting(
        rgb=bare, support=np.ones((height, width), np.bool_), kept=np.full((height, width), np.inf, np.float32)
    )
    seen = replace(scene, photo=replace(scene.photo, rgb=photo))
    package = read_package(write_package(seen, tmp_path / "lit", inpainting=completed))
    session = EditSession(package)
    for edit in ({"kind": "delete", "id": 3}, {"kind": "move", "id": 2, "by": [0.0, -0.25, 0.0]}):
        session.add(edit_of({**edit, "label": package.scene[edit["id"]].label}))
    edited = read_package(write_edited(session, tmp_path / "edited"))
    studio = Studio.of(edited)
    assert np.allclose(studio.renderer.setting.light.direction, Studio.of(package).renderer.setting.light.direction)
    poses = np.array([o.T_world_object for o in studio.scene])
    frame = FilmFrames(studio, np.zeros(len(poses), np.bool_)).draw(poses)
    truth = Canvas(replace(Renderer.of(studio.scene, bare).setting, light=light)).drawn(poses)
    ground = ~grown(rasterizer.visible_ids(scene.objects, scene.camera) >= 0, 4)
    ground &= ~grown(rasterizer.visible_ids(studio.scene.objects, scene.camera) >= 0, 4)
    left, come = (ground & (np.abs(a.astype(int) - b).max(2) > 12) for a, b in ((photo, bare), (truth, bare)))
    left, come = left & ~come, come & ~left
    assert left.sum() > 50 and come.sum() > 50
    assert np.abs(frame[left].astype(int) - truth[left]).mean() < 8
    off, without = (np.abs(picture[come].astype(int) - truth[come]).mean() for picture in (frame, bare))
    assert off < 0.5 * without
    episode = EpisodePictures(edited, max(height, width), None).drawn(poses, {})
    assert np.abs(episode[left].astype(int) - truth[left]).mean() < 8


def test_a_black_photo_tells_of_no_light(tmp_path: Path):
    scene = resting_boxes(tmp_path / "table").scene
    renderer = Renderer.of(scene, np.full((*scene.photo.rgb.shape[:2], 3), 150, np.uint8))
    assert not scene.photo.rgb.any() and "no object can be compared" in renderer.decisions[0]
