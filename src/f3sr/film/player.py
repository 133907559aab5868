"""player.html: the film, the rollout in 3-D and what happened when, in one file that asks for nothing."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

from f3sr.errors import OutputError
from f3sr.film.captions import speed_words
from f3sr.film.event_text import clock, named, told
from f3sr.film.payload import Shown, payload
from f3sr.film.timeline import pairs_of, timeline
from f3sr.web.document import WEB, document, part
from f3sr.web.markup import Child, Markup, clean, el

LARGEST_REST = 6 * 10**6
"""Bytes of a page beside its film: what loads in a second or two on a phone. The film is as long as it is."""
SIZES = ((80_000, 512), (40_000, 256), (12_000, 128), (3_000, 64))
"""Triangles of all meshes and longest side of a texture [px], tried in order until the page is small enough."""
HERE = Path(__file__).parent
KEYS = (
    "Space plays; ← → step a frame, with Shift ten; Home, End. 3-D: drag to turn, Shift or two fingers to move, wheel "
    "(after a click) or pinch to zoom; W A S D, +, −; 1 photo, 2 top, 3 side."
)


def player(shown: Shown) -> bytes:
    """The page, at most ``LARGEST_REST`` bytes beside its film: the same for the same film and rollout. Raises
    OutputError where the smallest meshes and textures are larger."""
    most = LARGEST_REST + len(base64.b64encode(shown.video.data))
    for faces, texture in SIZES:
        if len(page := _page(shown, faces, texture)) <= most:
            return page
    raise OutputError(f"player.html: would have more than {most:,} bytes with the smallest meshes and textures")


def _page(shown: Shown, faces: int, texture: int) -> bytes:
    return document(
        f"f3sr: {clean(shown.plan.goal)}",
        [
            _head(shown),
            el("main", _stage(shown), _controls(shown), _moments(shown), _timeline(shown), _words(shown)),
            el("script", payload(shown, faces=faces, texture=texture), type="application/json", id="player-data"),
        ],
        style=part(WEB / "page.css", HERE / "player.css"),
        script=part(WEB / "view3d.js", HERE / "player.js"),
        films=True,
    )


# --- what is seen -------------------------------------------------------------------------------------------------


def _head(shown: Shown) -> Markup:
    met = shown.verdict.met
    return el(
        "header",
        el(
            "div",
            el("p", "f3sr film", class_="kicker"),
            el("h1", el("bdi", shown.plan.goal)),
            el("p", el("b", "Met" if met else "Not met", class_="met" if met else "missed"), ": ", shown.verdict.said),
        ),
    )


def _stage(shown: Shown) -> Markup:
    source = Markup("data:video/mp4;base64," + base64.b64encode(shown.video.data).decode())
    video, camera = shown.video, shown.scene.camera
    note = f"From the photo's camera, {_pace(shown)}; {video.frames} frames at {float(video.fps):g} a second."
    film = el(
        "figure",
        el(
            "div",
            el(
                "video",
                id="film",
                src=source,
                width=video.width,
                height=video.height,
                controls=True,
                muted=True,
                playsinline=True,
                preload="auto",
                aria_label="The film",
            ),
            el("p", "This browser cannot show the film (H.264). The 3-D view goes on.", id="no-film", hidden=True),
            class_="screen",
            data_aspect=f"{camera.width} / {camera.height}",
        ),
        el("figcaption", note),
    )
    view = el(
        "figure",
        el(
            "div",
            el("canvas", id="view", tabindex="0", aria_label="The rollout in 3-D. " + KEYS),
            el("div", id="touching", aria_hidden="true"),
            el("div", id="name", hidden=True, aria_hidden="true"),
            el(
                "div",
                (
                    _button(label, f"from-{name}")
                    for name, label in (("photo", "Photo"), ("top", "Top"), ("side", "Side"))
                ),
                class_="group",
                role="toolbar",
                aria_label="Look from",
            ),
            el("p", "The 3-D view needs scripts and WebGL 2, which are not here.", id="no-view"),
            class_="screen",
            data_aspect=f"{camera.width} / {camera.height}",
        ),
        el(
            "figcaption",
            "The same in 3-D: the line is the way of ",
            el("bdi", named(shown.scene, shown.plan.task.active)),
            "'s centre; what strikes lights up. ",
            el("span", id="cell"),
        ),
    )
    return el("div", film, view, class_="stage-row")


def _pace(shown: Shown) -> str:
    return "in real time" if shown.slow == 1 else f"at {speed_words(shown.slow)}"


def _controls(shown: Shown) -> Markup:
    rates = [("1", "1×"), ("0.5", "1/2×"), ("0.25", "1/4×"), ("0.125", "1/8×")]
    speed = el("select", (el("option", label, value=value) for value, label in rates), id="speed", aria_label="Speed")
    return el(
        "div",
        el(
            "div",
            _button("Play", "play"),
            el("span", _button("−1", "back", "One frame back"), _button("+1", "on", "One frame on"), class_="group"),
            speed,
            el("button", "Repeat", type="button", id="repeat", aria_pressed="false"),
            class_="buttons",
        ),
        el("output", id="where", aria_live="off"),
        class_="controls",
        id="controls",
        hidden=True,
    )


def _button(label: str, name: str, title: str | None = None) -> Markup:
    return el("button", label, type="button", id=name, aria_label=title, title=title)


def _moments(shown: Shown) -> Markup:
    buttons = (
        el(
            "button",
            el("b", clock(m.time)),
            " ",
            el("bdi", told(m.what)),
            type="button",
            class_="moment",
            data_frame=m.frame,
        )
        for m in shown.moments
    )
    return el("div", buttons, class_="moments", role="group", aria_label="Key moments", id="moments")


def _timeline(shown: Shown) -> Markup:
    tallest = max((p.forces.max() for p in pairs_of(shown.rollout)), default=0.0)
    legend = (
        "Click or drag to go there. Marks: when a condition was met (✓), or nearest to it (✗). Contacts: height is "
        f"the square root of the largest normal force since the frame before; the tallest is {tallest:,.0f} N."
    )
    return el(
        "section",
        el("h2", "What happened when"),
        timeline(shown.scene, shown.plan, shown.rollout, shown.verdict),
        el("p", legend, class_="fine"),
        class_="when",
    )


def _words(shown: Shown) -> Markup:
    task, verdict = shown.plan.task, shown.verdict
    parts: list[Child] = [el("h2", "The goal"), el("p", el("b", "Understood as"), ": ", el("bdi", task.interpretation))]
    if task.phases:
        parts.append(el("ol", (el("li", el("bdi", phase)) for phase in task.phases)))
    if task.assumptions:
        parts += [el("h3", "Assumed"), el("ul", (el("li", el("bdi", a)) for a in task.assumptions))]
    parts += [el("h3", "Verdict"), el("ul", (_judged(j) for j in verdict.conditions), class_="verdict")]
    if verdict.broken:
        parts += [el("h3", "Broken rules"), el("ul", (el("li", el("bdi", b)) for b in verdict.broken))]
    return el("section", parts, el("p", KEYS, class_="fine"), class_="said")


def _judged(judged: Any) -> Markup:
    word = el("b", "met" if judged.met else "missed", class_="met" if judged.met else "missed")
    return el("li", word, ": ", el("bdi", judged.said))
