"""player.html: the film, the rollout in 3-D and what happened when, in one file that asks for nothing."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import f3sr.page
from f3sr.errors import OutputError
from f3sr.film.captions import speed_words
from f3sr.film.moments import Moment
from f3sr.film.strip import clock
from f3sr.film.timeline import pairs_of, timeline
from f3sr.film.video import Video
from f3sr.film.words import named
from f3sr.frames import Array, quaternion_from_rotation
from f3sr.goals.plan import Plan
from f3sr.goals.rollout import Rollout
from f3sr.goals.seen import Seen
from f3sr.goals.verify import Verdict
from f3sr.page.document import document, part
from f3sr.page.light_mesh import lightened
from f3sr.page.markup import Child, Markup, clean, el
from f3sr.page.viewer import Textures, packed_mesh
from f3sr.scene import Scene

LARGEST_PLAYER = 12 * 10**6
"""Bytes: what an e-mail still takes. The film has its own size; meshes and textures get what it leaves."""
SIZES = ((80_000, 512), (40_000, 256), (12_000, 128), (3_000, 64))
"""Triangles of all meshes and longest side of a texture [px], tried in order until the page is small enough."""
FEWEST_FACES = 200
"""Of one mesh."""
FAR = 2.0
"""How far beyond the scene's box, in its diagonals, the view frames what moves."""
HERE = Path(__file__).parent
STYLES = Path(f3sr.page.__file__).parent / "page.css"
KEYS = (
    "Space plays; ← → step a frame, with Shift ten; Home, End. 3-D: drag to turn, Shift or two fingers to move, wheel "
    "(after a click) or pinch to zoom; W A S D, +, −; 1 photo, 2 top, 3 side."
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Shown:
    """What a player shows: a played goal, its film (a frame per sample of ``rollout``) and its moments."""

    scene: Scene
    plan: Plan
    rollout: Rollout
    verdict: Verdict
    video: Video
    moments: tuple[Moment, ...]
    slow: Fraction = Fraction(1)


def player(shown: Shown) -> bytes:
    """The page, at most ``LARGEST_PLAYER`` bytes: the same for the same film and rollout. Raises OutputError where the
    film alone is larger."""
    for faces, texture in SIZES:
        page = _page(shown, faces, texture)
        if len(page) <= LARGEST_PLAYER:
            return page
    found = f"{len(page):,} bytes with the smallest meshes, {len(shown.video.data):,} of them the film"
    raise OutputError(f"player.html: would have {found}; at most {LARGEST_PLAYER:,}")


def _page(shown: Shown, faces: int, texture: int) -> bytes:
    return document(
        f"f3sr: {clean(shown.plan.goal)}",
        [
            _head(shown),
            el("main", _stage(shown), _controls(shown), _moments(shown), _timeline(shown), _words(shown)),
            el("script", _payload(shown, faces, texture), type="application/json", id="player-data"),
        ],
        style=Markup(part(STYLES) + part(HERE / "player.css")),
        script=Markup(part(HERE / "view3d.js") + part(HERE / "player.js")),
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
            el("bdi", ", ".join(m.what)),
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
        "Click or drag anywhere to go there. Marks: when a condition was met (✓), or nearest to it (✗). Contacts: height is "
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


# --- what the script reads ----------------------------------------------------------------------------------------


def _payload(shown: Shown, faces: int, texture: int) -> Markup:
    """All data as JSON that cannot end its script element."""
    scene, rollout = shown.scene, shown.rollout
    textures = Textures(texture)
    each = max(FEWEST_FACES, faces // len(scene.objects))
    way = Seen(rollout, scene).way(shown.plan.task.active)
    data = {
        "fps": float(shown.video.fps),
        "frames": shown.video.frames,
        "step": float(rollout.time[-1]) / max(1, len(rollout.time) - 1),
        "view": {
            "camera": {
                "width": scene.camera.width,
                "height": scene.camera.height,
                "K": scene.camera.K.ravel().tolist(),
                "T": scene.camera.T_world_camera.ravel().tolist(),
            },
            "bounds": _bounds(scene, rollout),
            "objects": [{"mesh": packed_mesh(lightened(_scaled(o), each), textures.index)} for o in scene],
            "path": np.round(way, 5).ravel().tolist(),
        },
        "names": [clean(f"{o.id} {o.label}".strip()) for o in scene],
        "ids": [o.id for o in scene],
        "poses": base64.b64encode(_poses(rollout).astype("<f4").tobytes()).decode(),
        "contacts": [
            {"a": p.a, "b": p.b, "forces": [round(float(f), 3) for f in p.forces]}
            for p in pairs_of(rollout)
            if not p.rests
        ],
    }
    data["view"]["textures"] = textures.uris
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def _scaled(o: Any) -> Any:
    return o.mesh if o.scale == 1 else o.mesh.with_vertices(o.scale * o.mesh.vertices)


def _poses(rollout: Rollout) -> Array:
    """(T, N, 7): place and quaternion (wxyz)."""
    T = rollout.T_world_object
    quaternions = [quaternion_from_rotation(R) for R in T[..., :3, :3].reshape(-1, 3, 3)]
    return np.concatenate([T[..., :3, 3], np.reshape(quaternions, (*T.shape[:2], 4))], axis=-1)


def _bounds(scene: Scene, rollout: Rollout) -> Sequence[float]:
    """The box that presets frame: the scene and where things go, but not what is flung far away."""
    corners = np.concatenate([o.bounds_world for o in scene])
    low, high = corners.min(0), corners.max(0)
    reach = FAR * float(np.linalg.norm(high - low))
    ways = rollout.T_world_object[..., :3, 3].reshape(-1, 3)
    ways = np.clip(ways, low - reach, high + reach)
    return [*np.minimum(low, ways.min(0)).tolist(), *np.maximum(high, ways.max(0)).tolist()]
