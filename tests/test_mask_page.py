"""The page that outlines objects: its server answers nobody but the token's holder, and the page works by hand."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import re
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from http.client import HTTPConnection, HTTPException, HTTPResponse
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from f3sr import mask_page
from f3sr.backends.model_choice import Need
from f3sr.backends.protocols import Prompt, Segmenter
from f3sr.backends.registry import Backend
from f3sr.errors import F3srWarning, InputError
from f3sr.mask_page import loopback_server
from f3sr.mask_page.drawing_session import Drawing, DrawingSession
from f3sr.mask_page.loopback_server import HOST, MAX_BODY, MAX_CONNECTIONS
from f3sr.mask_page.mask_pictures import LONGEST_SIDE, mask_picture, shown_photo, shown_size
from f3sr.scene import Photo
from f3sr.segmentation.selection import Selection, outlined
from f3sr.segmentation.selection_json import FORMAT, PROMPTS, read_selection, selection_of
from waiting import soon

pytestmark = [pytest.mark.timeout(60), pytest.mark.filterwarnings("ignore::f3sr.errors.F3srWarning")]
WIDTH, HEIGHT = 320, 200
THINGS = {"red": (40, 50, 100, 120), "blue": (180, 60, 260, 150)}
"""Boxes of what is in the photo, left, top, right, bottom."""


def photo() -> Photo:
    rgb = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    for name, (left, top, right, bottom) in THINGS.items():
        rgb[top:bottom, left:right] = (220, 30, 30) if name == "red" else (30, 30, 220)
    return Photo(rgb=rgb)


class ByColour:
    """A Segmenter: everything in a box of another colour than the box's corner, and what strokes go over."""

    def segment(self, photo: Photo, prompts: Sequence[Prompt]) -> Sequence[np.ndarray[Any, Any]]:
        masks = list[np.ndarray[Any, Any]]()
        for number, prompt in enumerate(prompts):
            left, top, right, bottom = (int(v) for v in prompt.box or (0, 0, 1, 1))
            mask = np.zeros((HEIGHT, WIDTH), bool)
            cut = photo.rgb[top:bottom, left:right].astype(int)
            mask[top:bottom, left:right] = np.abs(cut - cut[0, 0]).sum(2) > 60
            for strokes, value in ((prompt.inside, True), (prompt.outside, False)):
                for x, y in (p for stroke in strokes for p in stroke):
                    mask[int(y) - 3 : int(y) + 3, int(x) - 3 : int(x) + 3] = value
            if not mask.any():
                raise InputError(f"object {number + 1}", found="an empty box", accepted="a box around an object")
            masks.append(mask)
        return masks


def backend(made: Segmenter | None = None) -> Backend[Segmenter]:
    return Backend(kind="segmentation", name="by colour", version="1", made=made or ByColour())


class Served:
    """A page's server that runs in a thread, as ``f3sr segment`` runs it."""

    def __init__(self, folder: Path, *, given: Selection | None = None, reload_s: float = 60.0) -> None:
        self.told: list[str] = []
        file = folder.with_name("<b>table<.png")
        Image.fromarray(photo().rgb).save(file)
        drawing = Drawing(
            photo=photo(),
            file=file,
            folder=folder,
            segmenter=backend(),
            after="The terminal goes on.",
            command=f"f3sr reconstruct {folder} -o OUT",
        )
        self.folder = folder
        self.session = DrawingSession(drawing, given or Selection(prompts=()))
        self.server = mask_page.page_server(self.session)
        self.result: list[Path | None] = []
        self.thread = threading.Thread(target=self._run, args=[reload_s], daemon=True)
        self.thread.start()

    def _run(self, reload_s: float) -> None:
        self.result.append(
            mask_page.run(
                self.session, open_browser=False, tell=self.told.append, reload_s=reload_s, server=self.server
            )
        )

    def saved(self) -> Selection:
        """What was written."""
        return read_selection(self.folder / PROMPTS)

    def ended(self) -> Path | None:
        self.thread.join(10)
        assert not self.thread.is_alive()
        return self.result[0]

    def ask(
        self, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> tuple[int, bytes, HTTPResponse]:
        connection = HTTPConnection(HOST, self.server.port, timeout=10)
        try:
            connection.request(method, path, body, headers or {})
            answer = connection.getresponse()
            return answer.status, answer.read(), answer
        finally:
            connection.close()

    def post(self, name: str, value: object, **headers: str) -> tuple[int, dict[str, Any]]:
        """As the page posts."""
        usual = {"Content-Type": "application/json", "Origin": f"http://{HOST}:{self.server.port}"}
        status, body, _ = self.ask("POST", f"/{self.server.token}/{name}", json.dumps(value).encode(), usual | headers)
        return status, json.loads(body) if body.startswith(b"{") else {"line": body.decode()}

    def opened(self) -> int:
        status, told = self.post("open", {})
        assert status == 200
        return told["page"]

    def answers(self) -> bool:
        try:
            return self.ask("GET", f"/{self.server.token}/")[0] == 200
        except (OSError, HTTPException):  # too many connections
            return False

    def lives(self) -> None:
        status, body, _ = self.ask("GET", f"/{self.server.token}/")
        assert status == 200 and b"Outline the objects in" in body


@pytest.fixture(autouse=True)
def wakes_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mask_page, "WAKE_S", 0.02)


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    made = Served(tmp_path / "masks")
    yield made
    made.session.ended.set()
    made.ended()


def selection(*boxes: tuple[float, ...], label: str = "") -> dict[str, Any]:
    prompts = [{"label": label, "box": list(box), "inside": [], "outside": []} for box in boxes]
    ground = {"label": "", "box": None, "inside": [], "outside": []}
    return {"format": FORMAT, "version": 1, "prompts": prompts, "ground": ground}


RED, BLUE = (30, 40, 110, 130), (170, 50, 270, 160)


# --- who gets an answer ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "path", ["/", "", "/photo.jpg", "/{short}/", "/{token}x/", "//{token}/", "/?{token}", "/é/", "/{token}"]
)
def test_nothing_without_the_token(served: Served, path: str):
    token = served.server.token
    asked = path.format(token=token, short=token[:-1]).encode().decode("latin-1") or "*"
    with socket.create_connection((HOST, served.server.port), 5) as raw:
        raw.sendall(f"GET {asked} HTTP/1.1\r\nHost: {HOST}:{served.server.port}\r\n\r\n".encode("latin-1"))
        said = raw.makefile("rb").read()
    head, _, body = said.partition(b"\r\n\r\n")
    if path in ("/{token}", "//{token}/"):  # the holder, who left out a slash or put one more
        assert b" 200 " in head.splitlines()[0]
    else:
        assert head.splitlines()[0].endswith(b"404 Not Found") and body == b"nothing here\n"
    served.lives()


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1", "127.0.0.1:1", "localhost", "0.0.0.0:{port}", ""])
def test_another_hosts_name_gets_nothing(served: Served, host: str):
    """A page of another site whose name was made to lead here (DNS rebinding) says its own name."""
    status, body, _ = served.ask(
        "GET", f"/{served.server.token}/", None, {"Host": host.format(port=served.server.port)}
    )
    assert (status, body) == (404, b"nothing here\n")
    served.lives()


def test_a_forwarded_port_may_be_called_localhost(served: Served):
    name = f"localhost:{served.server.port}"
    assert served.ask("GET", f"/{served.server.token}/", None, {"Host": name})[0] == 200
    assert served.post("open", {}, Host=name, Origin=f"http://{name}")[0] == 200


@pytest.mark.parametrize(
    "wrong",
    [
        {"Origin": "http://example.org"},
        {"Origin": "null"},
        {"Origin": "http://localhost:{port}"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Content-Type": "text/plain"},
        {"Content-Type": "application/x-www-form-urlencoded"},
    ],
)
def test_only_the_page_itself_may_post(served: Served, wrong: dict[str, str]):
    status, told = served.post("open", {}, **{k: v.format(port=served.server.port) for k, v in wrong.items()})
    assert status in (403, 415) and one_line(told["line"])
    status, body, _ = served.ask("POST", f"/{served.server.token}/open", b"{}", {"Content-Type": "application/json"})
    assert status == 403 and one_line(body.decode())
    served.lives()


def one_line(text: str) -> bool:
    return text.count("\n") == 1 and text.endswith("\n") and 3 < len(text) < 100


def test_answers_may_be_stored_framed_and_guessed_by_nobody(served: Served):
    for path in (f"/{served.server.token}/", f"/{served.server.token}/photo.jpg", "/"):
        _, _, answer = served.ask("GET", path)
        assert answer.headers["Cache-Control"] == "no-store" and answer.headers["X-Content-Type-Options"] == "nosniff"
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["Referrer-Policy"] == "no-referrer" and answer.headers["Server"] is None
    _, page, _ = served.ask("GET", f"/{served.server.token}/")
    policy = re.search(rb'Content-Security-Policy" content="([^"]*)"', page)
    assert policy and b"default-src &#39;none&#39;" in policy.group(1) and b"unsafe" not in policy.group(1)
    assert b"http:" not in page.replace(b"http://www.w3.org", b"") and b"&lt;b&gt;table&lt;.png" in page
    assert len(served.server.token) > 40 and served.server.token.encode() not in page


def test_the_browsers_command_line_has_an_address_that_counts_once(served: Served):
    path = "/" + served.server.address_once.split("/", 3)[3]
    status, _, answer = served.ask("GET", path)
    assert status == 303 and answer.headers["Location"] == f"/{served.server.token}/"
    assert served.ask("GET", path)[:2] == (404, b"nothing here\n")
    assert soon(lambda: served.told == [f"open this page in a browser: {served.server.address}"])


def test_only_this_machine_is_listened_to(served: Served):
    assert served.server.server_address[0] == "127.0.0.1" and served.server.port > 0


# --- sizes, times, numbers ------------------------------------------------------------------------------------------


def raw_post(served: Served, head: str, body: bytes = b"") -> bytes:
    at = f"{HOST}:{served.server.port}"
    start = f"POST /{served.server.token}/open HTTP/1.1\r\nHost: {at}\r\nOrigin: http://{at}\r\n"
    with socket.create_connection((HOST, served.server.port), 10) as raw:
        raw.sendall(f"{start}Content-Type: application/json\r\n{head}\r\n".encode() + body)
        return raw.makefile("rb").read()


@pytest.mark.parametrize(
    ("head", "status"),
    [
        (f"Content-Length: {MAX_BODY + 1}\r\n", b"413"),
        ("Content-Length: 99999999999999999999\r\n", b"411"),
        ("Content-Length: -1\r\n", b"411"),
        ("Content-Length: 2\r\nContent-Length: 3\r\n", b"411"),
        ("Transfer-Encoding: chunked\r\n", b"411"),
        ("", b"411"),
    ],
)
def test_a_body_has_one_length_that_is_not_too_large(served: Served, head: str, status: bytes):
    said = raw_post(served, head, b"{}")
    assert said.startswith(b"HTTP/1.0 " + status) and one_line(said.partition(b"\r\n\r\n")[2].decode())
    served.lives()


def test_a_large_body_is_not_read(served: Served):
    said = raw_post(served, f"Content-Length: {MAX_BODY + 1}\r\n", b" " * (MAX_BODY + 1))
    assert said.startswith(b"HTTP/1.0 413")
    served.lives()


def test_a_slow_body_and_a_slow_head_end(served: Served, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(loopback_server, "BODY_S", 0.4)
    monkeypatch.setattr(loopback_server, "HEAD_S", 0.4)
    monkeypatch.setattr(loopback_server, "DRAIN_S", 0.2)
    start = time.monotonic()
    assert raw_post(served, "Content-Length: 9\r\n", b"{").startswith(b"HTTP/1.0 408")
    with socket.create_connection((HOST, served.server.port), 5) as raw:
        raw.settimeout(5)
        ended = False
        for letter in f"GET /{served.server.token}/ HTTP/1.1\r\nX: {'y' * 100}":  # one letter after the other
            try:
                raw.sendall(letter.encode())
            except OSError:
                ended = True
                break
            time.sleep(0.02)
        with contextlib.suppress(ConnectionResetError):  # how its end shows where letters were left unread
            assert ended or raw.recv(100) == b""
    assert time.monotonic() - start < 4
    served.lives()


@pytest.mark.parametrize(
    "said", [b"\0\xff\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"BREW / HTTP/1.1\r\n\r\n", b"G" * 70_000]
)
def test_what_is_no_request_gets_a_line_at_most(served: Served, said: bytes):
    answer = b""
    with socket.create_connection((HOST, served.server.port), 5) as raw, contextlib.suppress(OSError):
        raw.sendall(said)  # a server that has heard enough may have gone by now
        raw.shutdown(socket.SHUT_WR)
        answer = raw.makefile("rb").read()
    assert answer == b"" or answer.partition(b"\r\n\r\n")[2] == b"nothing here\n" or answer == b"nothing here\n"
    served.lives()


def test_connections_are_bounded_and_come_free(served: Served, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(loopback_server, "HEAD_S", 0.5)
    idle = [socket.create_connection((HOST, served.server.port), 5) for _ in range(MAX_CONNECTIONS + 5)]
    idle[-1].settimeout(5)
    assert idle[-1].recv(10) == b""  # at once
    assert soon(served.answers)
    served.lives()
    for one in idle:
        one.close()


def test_each_kind_of_refusal_is_told_in_the_terminal(served: Served):
    with pytest.warns(F3srWarning, match="^the page's server refused a request: no token$") as told:
        assert served.ask("GET", "/x/")[0] == 404
        assert soon(lambda: len(told)), "after the answer, from a thread of the server"


# --- drawing --------------------------------------------------------------------------------------------------------


def pixels(served: Served, mask: dict[str, Any]) -> np.ndarray[Any, Any]:
    whole = np.zeros((HEIGHT, WIDTH), bool)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(mask["png"]))).convert("LA"))
    h, w = picture.shape[:2]
    whole[mask["y"] : mask["y"] + h, mask["x"] : mask["x"] + w] = picture[..., 1] > 0
    return whole


def test_masks_come_as_pictures_of_what_was_drawn(served: Served):
    page = served.opened()
    sent = selection(RED, BLUE)
    status, told = served.post("outline", {"page": page, "revision": 1, "selection": sent})
    assert status == 200 and told["revision"] == 1
    wanted = outlined(photo(), selection_of(sent, "a test"), backend())
    for got, mask in zip(told["masks"], wanted.masks, strict=True):
        assert (pixels(served, got) == mask).all()
    status, told = served.post("ground", {"page": page, "revision": 1})
    assert status == 200 and (pixels(served, told["ground"]) == wanted.ground).all()
    assert served.post("ground", {"page": page, "revision": 0})[1]["stale"]


def test_a_reload_goes_on_and_the_older_page_stands_back(served: Served):
    first = served.opened()
    served.post("outline", {"page": first, "revision": 4, "selection": selection(RED, label="mug")})
    status, told = served.post("open", {})
    assert status == 200 and told["revision"] == 4 and told["selection"]["prompts"][0]["label"] == "mug"
    for name in ("outline", "save"):
        status, refused = served.post(name, {"page": first, "revision": 5, "selection": selection(BLUE)})
        assert status == 409 and "another window" in refused["problem"]
    assert served.post("cancel", {"page": first})[0] == 409
    status, old = served.post("outline", {"page": told["page"], "revision": 3, "selection": selection(BLUE)})
    assert status == 409 and "older" in old["problem"]
    assert not served.folder.exists()


def test_two_pages_at_once_lose_nothing(served: Served):
    """Twenty questions at a time from a page that is the last one: every answer is for its own revision or stale."""
    page, answers = served.opened(), list[tuple[int, dict[str, Any]]]()

    def ask(revision: int) -> None:
        told = served.post("outline", {"page": page, "revision": revision, "selection": selection(RED)})
        answers.append(told)

    threads = [threading.Thread(target=ask, args=[k]) for k in range(1, 21)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 20
    for status, told in answers:
        assert (status == 200 and ("masks" in told or told["stale"])) or (status == 409 and "older" in told["problem"])
    assert any(told.get("revision") == 20 and "masks" in told for _, told in answers)


HOSTILE: list[Any] = [
    b"", b"[]", b"{", b"null", b"[" * 100_000, b'{"page": 1}', b'{"page": 1, "page": 1}', b"\xff\xfe", b"{}" * 5,
]  # fmt: skip


@pytest.mark.parametrize("body", HOSTILE, ids=range(len(HOSTILE)))
def test_what_no_page_sends_gets_one_line(served: Served, body: bytes):
    usual = {"Content-Type": "application/json", "Origin": f"http://{HOST}:{served.server.port}"}
    for name in ("outline", "save", "cancel"):
        if name == "cancel" and body == b'{"page": 1}':
            continue
        status, said, _ = served.ask("POST", f"/{served.server.token}/{name}", body, usual)
        told = json.loads(said)["problem"]
        assert status in (400, 409, 422) and told and "\n" not in told
    served.lives()
    assert not served.session.ended.is_set()


@pytest.mark.parametrize(
    "change",
    [
        {"prompts": "none"},
        {"prompts": [{"label": "x", "box": [1, 2, 3]}]},
        {"prompts": [{"label": "x", "box": [1, 2, 3, "4"]}]},
        {"prompts": [{"label": 5, "box": [1, 2, 3, 4]}]},
        {"prompts": [{"label": "x" * 5000, "box": [1, 2, 3, 4]}]},
        {"prompts": [{"box": [1, 2, 30, 40], "inside": [[[1]]]}]},
        {"prompts": [{"box": [1, 2, 30, 40], "mask": "../../x"}]},
        {"prompts": [{"box": [1, 2, 30, 1e308]}]},
        {"prompts": [{"box": [1, 2, 30, 40]}] * 501},
    ],
)
def test_a_selection_is_checked(served: Served, change: dict[str, Any]):
    page = served.opened()
    for name in ("outline", "save"):
        asked = {"page": page, "revision": 1, "selection": selection() | change}
        status, told = served.post(name, asked)
        assert status == 422 and "\n" not in told["problem"]
    assert not served.folder.exists()
    served.lives()


@pytest.mark.parametrize("revision", [-1, 1.5, "1", True, None, 2**60])
def test_a_revision_is_a_whole_number(served: Served, revision: object):
    asked = {"page": served.opened(), "revision": revision, "selection": selection(RED)}
    assert served.post("outline", asked)[0] == 409
    served.lives()


def test_a_box_without_an_object_is_one_line_and_the_page_goes_on(served: Served):
    page = served.opened()
    status, told = served.post("outline", {"page": page, "revision": 1, "selection": selection((1, 1, 20, 20))})
    assert status == 422 and told["problem"].startswith("object 1: found an empty box")
    assert served.post("save", {"page": page, "revision": 2, "selection": selection((1, 1, 20, 20))})[0] == 422
    assert served.post("outline", {"page": page, "revision": 3, "selection": selection(RED)})[0] == 200


def test_a_segmenter_that_lacks_something_opens_no_page(tmp_path: Path):
    class Lacking(ByColour):
        def needs(self) -> tuple[Need, ...]:
            return (Need(what="package torch", met=False, found="not installed", remedy="pip install torch"),)

    with pytest.raises(InputError, match="package torch: not installed; accepted: pip install torch"):
        mask_page.serve(tmp_path / "p.png", tmp_path / "out", backend(Lacking()), tell=pytest.fail)


def test_a_segmenter_that_breaks_is_one_line(served: Served, monkeypatch: pytest.MonkeyPatch):
    class Broken:
        def segment(self, photo: Photo, prompts: Sequence[Prompt]) -> Sequence[np.ndarray[Any, Any]]:
            raise ZeroDivisionError("of others")

    page = served.opened()
    monkeypatch.delenv("F3SR_TRACEBACK", raising=False)
    served.session.drawing = replace(served.session.drawing, segmenter=backend(Broken()))
    status, told = served.post("outline", {"page": page, "revision": 1, "selection": selection(RED)})
    assert status == 422 and "unforeseen ZeroDivisionError" in told["problem"] and "\n" not in told["problem"]
    served.lives()


# --- the end --------------------------------------------------------------------------------------------------------


def test_save_writes_tells_and_ends(served: Served, tmp_path: Path):
    page = served.opened()
    assert served.post("save", {"page": page, "revision": 1, "selection": selection()})[0] == 409
    status, told = served.post("save", {"page": page, "revision": 2, "selection": selection(RED, label="mug")})
    assert status == 200 and told["folder"] == str(tmp_path / "masks")
    assert told["after"] == "The terminal goes on." and told["command"].startswith("f3sr reconstruct")
    assert served.ended() == tmp_path / "masks"
    assert [(p.label, p.box) for p in served.saved().prompts] == [("mug", RED)]
    assert [p.name for p in (tmp_path / "masks" / "masks").iterdir()] == ["00_mug.png"]
    with pytest.raises(OSError):
        served.ask("GET", f"/{served.server.token}/")


def test_cancel_ends_with_nothing(served: Served):
    page = served.opened()
    assert served.post("cancel", {"page": page})[0] == 200
    assert served.ended() is None and not served.folder.exists()


def test_a_page_that_closes_ends_it_unless_it_comes_back(tmp_path: Path):
    reload_s = 0.6
    served = Served(tmp_path / "masks", reload_s=reload_s)

    def stay() -> socket.socket:
        raw = socket.create_connection((HOST, served.server.port), 5)
        raw.sendall(f"GET /{served.server.token}/alive HTTP/1.1\r\nHost: {HOST}:{served.server.port}\r\n\r\n".encode())
        assert raw.recv(10)
        return raw

    time.sleep(1.2 * reload_s)  # nobody has opened the page yet
    assert served.thread.is_alive()
    first = stay()
    first.close()
    second = stay()  # a reload
    time.sleep(1.2 * reload_s)
    assert served.thread.is_alive()
    second.close()
    assert served.ended() is None


def test_what_was_drawn_before_is_there_again(tmp_path: Path):
    given = selection_of(selection(RED, label="mug"), "a test")
    served = Served(tmp_path / "masks", given=given)
    status, told = served.post("open", {})
    assert status == 200 and told["selection"] == selection(RED, label="mug")
    served.session.ended.set()
    assert served.ended() is None


def test_a_large_photo_is_shown_smaller_and_its_masks_fit():
    big = Photo(rgb=np.zeros((1500, 4096, 3), np.uint8))
    assert shown_size(big) == (LONGEST_SIDE, 750)
    assert Image.open(io.BytesIO(shown_photo(big))).size == (LONGEST_SIDE, 750)
    mask = np.zeros((1500, 4096), bool)
    mask[301:1499, 1001:4096] = True
    told = mask_picture(mask, shown_size(big))
    assert told and (told["x"], told["y"]) == (500, 150)
    alpha = np.asarray(Image.open(io.BytesIO(base64.b64decode(told["png"]))))[..., 1]
    assert alpha.shape == (600, 1548) and alpha[1:-1, 1:].all()
    assert mask_picture(np.zeros((9, 9), bool), (9, 9)) is None


# --- in a browser ---------------------------------------------------------------------------------------------------

PATIENCE = 10.0
"""How long anything may take [s]."""


STATE = "[document.querySelector('#line').textContent, page.settled, page.view.scale, page.marks.objects]"
OVERLAPS = """() => {
    const seen = [...document.querySelectorAll("button, input, h1, #hint, #canvas, summary")]
        .map((e) => [e.id || e.className || e.tagName, e.getBoundingClientRect()]).filter(([, r]) => r.width);
    const over = (r, s) => r.left < s.right - 2 && s.left < r.right - 2 && r.top < s.bottom - 2 && s.top < r.bottom - 2;
    const outside = ([, r]) => r.left < -0.5 || r.right > innerWidth + 0.5;
    const bad = seen.filter(outside).map(([a]) => `${a} leaves the window`);
    seen.forEach(([a, r], k) => seen.slice(k + 1).forEach(([b, s]) => over(r, s) && bad.push(`${a} covers ${b}`)));
    if (document.documentElement.scrollWidth > innerWidth) bad.push("scrolls sideways");
    return bad;
}"""


class Hands:
    """A tab with the page and what a user does there, in pixels of the photo."""

    def __init__(self, browser: Any, served: Served, **context: Any) -> None:
        self.context = browser.new_context(**context)
        self.tab = self.context.new_page()
        self.tab.set_default_timeout(1000 * PATIENCE)
        self.served, self.said, self.asked = served, list[str](), list[str]()
        self.tab.on("console", lambda m: self.said.append(m.text))
        self.tab.on("pageerror", lambda e: self.said.append(str(e)))
        self.tab.on("dialog", lambda d: d.accept())
        self.tab.on("request", lambda r: self.asked.append(r.url))
        self.fingers = self.context.new_cdp_session(self.tab)
        self.tab.goto(served.server.address)
        self.until("window.page && (page.settled || !page.marks.objects.length)")

    def until(self, condition: str) -> None:
        """Asked from outside: playwright's own waiting evaluates strings, which the page's policy forbids."""
        end = time.monotonic() + PATIENCE
        while not self.tab.evaluate(condition):
            assert time.monotonic() < end, (condition, self.tab.evaluate(STATE), self.said)
            self.tab.wait_for_timeout(20)

    def at(self, point: tuple[float, float]) -> tuple[float, float]:
        x, y = self.tab.evaluate("(p) => page.view.toCanvas(p)", list(point))
        canvas = self.tab.locator("#canvas").bounding_box()
        return canvas["x"] + x, canvas["y"] + y

    def drag(self, *points: tuple[float, float]) -> None:
        places = [self.at(p) for p in points]
        self.tab.mouse.move(*places[0])
        self.tab.mouse.down()
        for place in places[1:]:
            self.tab.mouse.move(*place, steps=3)
        self.tab.mouse.up()

    def swipe(self, *points: tuple[float, float]) -> None:
        """The same with a finger. A browser that is busy for a second takes a touch back; then it is made again."""
        places = [dict(zip("xy", self.at(p), strict=True)) for p in points]
        before = self.tab.evaluate("page.revision")
        for _ in range(3):
            self.touch("touchStart", [places[0]])
            for place in places[1:]:
                self.touch("touchMove", [place])
            self.touch("touchEnd", [])
            end = time.monotonic() + PATIENCE / 3
            while time.monotonic() < end:
                if self.tab.evaluate("page.revision") != before:
                    return
                self.tab.wait_for_timeout(20)
        pytest.fail("no touch arrived")

    def tap(self, selector: str, then: str) -> None:
        """Tap until a condition holds, for the same reason."""
        for _ in range(3):
            self.tab.tap(selector)
            end = time.monotonic() + PATIENCE / 3
            while time.monotonic() < end:
                if self.tab.evaluate(then):
                    return self.tab.wait_for_timeout(50)
                self.tab.wait_for_timeout(20)
        pytest.fail("no tap arrived")

    def touch(self, kind: str, points: list[dict[str, float]]) -> None:
        self.fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def objects(self) -> list[dict[str, Any]]:
        return self.tab.evaluate("page.marks.objects")

    def settled(self, count: int) -> None:
        self.until(f"page.settled && page.marks.objects.length === {count}")
        self.until(f"page.marks.objects.every((o) => page.masks.get(o.key).image) || {count} === 0")

    def overlaps(self) -> list[str]:
        """Pairs of controls that cover one another, and whatever is wider than the window."""
        return self.tab.evaluate(OVERLAPS)

    def close(self) -> None:
        self.context.close()
        assert self.said == []
        assert all(u.startswith((self.served.server.address, "data:", "blob:")) for u in self.asked)


@pytest.fixture
def desk(browser: Any, served: Served) -> Iterator[Hands]:
    hands = Hands(browser, served, viewport={"width": 1280, "height": 800})
    yield hands
    hands.close()


@pytest.fixture
def phone(browser: Any, served: Served) -> Iterator[Hands]:
    hands = Hands(
        browser, served, viewport={"width": 360, "height": 700}, has_touch=True, is_mobile=True, device_scale_factor=2
    )
    yield hands
    hands.close()


def near(box: list[float], wanted: tuple[float, ...], within: float = 1.0) -> bool:
    return bool(np.abs(np.subtract(box, wanted)).max() <= within)


def test_with_a_mouse_from_boxes_to_saved(desk: Hands, served: Served, tmp_path: Path):
    keys = desk.tab.keyboard
    assert "Drag a box" in desk.tab.inner_text("#hint") and desk.tab.is_disabled("#save")
    desk.drag(RED[:2], RED[2:])
    desk.settled(1)
    assert near(desk.objects()[0]["box"], RED)
    keys.type("red mug")  # the name's field has the focus
    keys.press("Enter")
    desk.drag(BLUE[2:], BLUE[:2])  # from corner to corner, either way
    desk.settled(2)
    keys.type("bag")
    keys.press("Enter")
    desk.settled(2)
    assert [o["label"] for o in desk.objects()] == ["red mug", "bag"]

    keys.press("a")
    desk.drag((150, 100), (165, 100))
    desk.settled(2)
    keys.press("r")
    desk.drag((220, 100), (225, 105))
    desk.settled(2)
    bag = desk.objects()[1]
    assert len(bag["inside"]) == 1 and len(bag["outside"]) == 1 and len(bag["inside"][0]) > 2
    assert near(bag["inside"][0][0], (150, 100)) and near(bag["inside"][0][-1], (165, 100))

    keys.press("g")
    desk.drag((20, 180), (60, 185))
    desk.until("page.grounded && page.masks.get('ground').image")
    assert desk.tab.evaluate("page.marks.ground.inside.length") == 1
    for _ in range(3):
        keys.press("Control+z")
    assert desk.tab.evaluate("page.marks.ground.inside.length") == 0 and not desk.objects()[1]["inside"]
    keys.press("Control+Shift+z")
    assert len(desk.objects()[1]["inside"]) == 1
    desk.tab.click("#undo")
    desk.tab.click("#redo")
    desk.settled(2)

    desk.tab.click("[aria-label='Select object 1, red mug']")
    assert desk.overlaps() == []
    desk.tab.focus("#canvas")
    keys.press("Delete")
    desk.settled(1)
    keys.press("Control+z")
    desk.settled(2)

    desk.tab.focus("#canvas")
    keys.press("Enter")
    assert not served.folder.exists()  # the first one only goes to the button
    keys.press("Enter")
    desk.until("page.done")
    assert str(tmp_path / "masks") in desk.tab.inner_text("#done") and "2 objects" in desk.tab.inner_text("#done")
    assert "f3sr reconstruct" in desk.tab.inner_text("#done-command") and not desk.tab.is_visible("h1")
    assert served.ended() == tmp_path / "masks"
    saved = served.saved()
    assert [p.label for p in saved.prompts] == ["red mug", "bag"] and len(saved.prompts[1].inside) == 1


def test_a_box_is_corrected_and_chosen_by_hand(desk: Hands):
    desk.drag(RED[:2], RED[2:])
    desk.tab.keyboard.press("Enter")
    desk.drag(RED[2:], (120, 140))
    desk.settled(1)
    assert near(desk.objects()[0]["box"], (*RED[:2], 120, 140))
    desk.tab.keyboard.press("Escape")
    assert desk.tab.evaluate("page.selected") is None
    desk.drag((70, 80))  # a click on the mask
    assert desk.tab.evaluate("page.selected") == desk.objects()[0]["key"]
    desk.drag((5, 5))
    assert desk.tab.evaluate("page.selected") is None


def test_zoomed_in_places_stay_those_of_the_photo(desk: Hands):
    before = desk.tab.evaluate("page.view.scale")
    x, y = desk.at((70, 85))
    desk.tab.mouse.move(x, y)
    for _ in range(2):
        desk.tab.mouse.wheel(0, -120)
    desk.until(f"page.view.scale > {1.4 * before}")
    assert np.abs(np.subtract(desk.at((70, 85)), (x, y))).max() < 1  # what is below the pointer stays there
    desk.drag(RED[:2], RED[2:])
    desk.settled(1)
    assert near(desk.objects()[0]["box"], RED)
    desk.tab.keyboard.press("Enter")
    desk.tab.keyboard.press("0")
    assert desk.tab.evaluate("page.view.scale") == pytest.approx(before)


def test_a_reload_shows_what_was_drawn(desk: Hands):
    desk.drag(RED[:2], RED[2:])
    desk.settled(1)
    desk.tab.keyboard.type("mug")
    desk.tab.keyboard.press("Enter")
    desk.settled(1)
    desk.tab.reload()
    desk.until("window.page && page.marks.objects.length === 1")
    desk.settled(1)
    assert desk.objects()[0]["label"] == "mug" and desk.tab.input_value("#objects input") == "mug"


def test_an_object_of_strokes_only_is_shown_and_chosen(browser: Any, tmp_path: Path):
    """``f3sr segment --inside`` makes such ones; the page goes on from them."""
    clicked = Prompt(label="dot", inside=(((70.0, 80.0),),))
    served = Served(tmp_path / "masks", given=Selection(prompts=(clicked,)))
    hands = Hands(browser, served, viewport={"width": 1000, "height": 700})
    hands.settled(1)
    hands.drag((70, 80))
    assert hands.tab.evaluate("page.selected") == hands.objects()[0]["key"]
    hands.drag(BLUE[:2], BLUE[2:])
    hands.settled(2)
    hands.close()
    served.session.ended.set()
    assert served.ended() is None


def test_an_empty_box_is_told_and_can_be_undone(desk: Hands):
    desk.drag((2, 2), (25, 25))
    desk.until("document.querySelector('#line').textContent.includes('an empty box')")
    assert "not found" in desk.tab.inner_text("#objects")
    desk.tab.click("#undo")
    desk.until("page.settled && !document.querySelector('#line').textContent")
    desk.said = [s for s in desk.said if "422" not in s]  # the browser's own note of the refusal


def test_a_save_that_fails_is_told_until_something_is_done(desk: Hands, served: Served):
    desk.drag(RED[:2], RED[2:])
    desk.settled(1)
    served.folder.write_text("mine")
    desk.tab.click("#save")
    desk.until("document.querySelector('#line').textContent && !document.querySelector('#save').disabled")
    said = desk.tab.inner_text("#line")
    desk.tab.wait_for_timeout(1000)
    assert desk.tab.inner_text("#line") == said and not desk.tab.evaluate("page.done")
    assert served.folder.read_text() == "mine"
    served.folder.unlink()
    desk.tab.click("#save")
    desk.until("page.done")
    assert served.ended() == served.folder
    desk.said = [s for s in desk.said if "Failed to load resource" not in s]  # the browser's own note of the refusal


def test_with_a_finger_on_a_phone(phone: Hands, served: Served, tmp_path: Path):
    assert phone.overlaps() == []
    phone.swipe(RED[:2], (70, 90), RED[2:])
    phone.settled(1)
    assert near(phone.objects()[0]["box"], RED, 1.5)
    assert phone.tab.evaluate("document.activeElement.tagName") != "INPUT"  # no keyboard over the photo
    phone.swipe(BLUE[:2], BLUE[2:])
    phone.settled(2)
    phone.tap("#mode-add", "page.mode === 'add'")
    phone.swipe((150, 100), (160, 100), (165, 100))
    phone.settled(2)
    assert len(phone.objects()[1]["inside"]) == 1
    phone.tap("#undo", "page.marks.canRedo")
    phone.settled(2)
    assert not phone.objects()[1]["inside"]
    phone.tap("#redo", "!page.marks.canRedo")
    phone.settled(2)

    before, two = phone.tab.evaluate("page.view.scale"), [phone.at((100, 90)), phone.at((160, 90))]
    a, b = ({"x": x, "y": y, "id": k} for k, (x, y) in enumerate(two))
    phone.touch("touchStart", [a])
    phone.touch("touchStart", [a, b])  # the stroke that the first finger began is dropped
    for k in range(1, 5):
        phone.touch("touchMove", [a | {"x": a["x"] - 8 * k}, b | {"x": b["x"] + 8 * k}])
    phone.touch("touchEnd", [])
    assert phone.tab.evaluate("page.view.scale") > 1.3 * before and len(phone.objects()[1]["inside"]) == 1
    phone.tab.tap("#fit")

    phone.tab.fill("[aria-label='Name of object 1']", "mug")
    assert phone.overlaps() == []
    phone.tap("#save", "page.done")
    assert served.ended() == tmp_path / "masks"
    assert [p.label for p in served.saved().prompts] == ["mug", ""]


def test_the_page_says_when_the_program_has_ended(desk: Hands, served: Served):
    served.session.ended.set()
    served.ended()
    desk.until("document.querySelector('#line').textContent.includes('does not answer')")
    desk.said = [s for s in desk.said if "ERR_" not in s]


def test_cancel_asks_again_once_something_is_drawn(desk: Hands, served: Served):
    desk.drag(RED[:2], RED[2:])
    desk.settled(1)
    desk.tab.click("#cancel")
    assert desk.tab.inner_text("#cancel") == "Discard all?"
    desk.tab.click("#cancel")
    desk.until("page.done")
    assert served.ended() is None
