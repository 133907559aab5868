"""player.html: the film, the rollout in 3-D and what happened when, in one file that asks for nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from f3sr.errors import OutputError
from f3sr.film.captions import speed_words
from f3sr.film.event_text import clock, named, told
from f3sr.film.payload import Shown, payload
from f3sr.film.timeline import timeline
from f3sr.goals.refusal import listed
from f3sr.web.data_uri import data_uri
from f3sr.web.document import WEB, document

LARGEST_REST = 6 * 10**6
"""Bytes of a page beside its film: what loads in a second or two on a phone. The film is as long as it is."""
SIZES = ((80_000, 512), (40_000, 256), (12_000, 128), (3_000, 64))
"""Triangles of all meshes and longest side of a texture [px], tried in order until the page is small enough."""
HERE = Path(__file__).parent


def player(shown: Shown) -> bytes:
    """The page, at most ``LARGEST_REST`` bytes beside its film: the same for the same film and rollout. Raises
    OutputError where the smallest meshes and textures are larger."""
    values = _values(shown)
    most = LARGEST_REST + len(values["film"])
    for faces, texture in SIZES:
        page = document(
            HERE / "templates" / "player.html",
            {**values, "data": payload(shown, faces=faces, texture=texture)},
            styles=(WEB / "page.css", HERE / "player.css"),
            scripts=(WEB / "view3d.js", HERE / "player.js"),
            films=True,
        )
        if len(page) <= most:
            return page
    raise OutputError(f"player.html: would have more than {most:,} bytes with the smallest meshes and textures")


def _launched(shown: Shown) -> tuple[str, ...]:
    """The objects that are launched, each once."""
    return tuple(dict.fromkeys(named(shown.scene, phase.task.active) for phase in shown.plan.phases))


def _values(shown: Shown) -> dict[str, Any]:
    """What the templates may name but ``data``, whose size varies."""
    return {
        "plan": shown.plan,
        "verdict": shown.verdict,
        "video": shown.video,
        "film": data_uri(shown.video.data, "video/mp4"),
        "camera": shown.scene.camera,
        "moments": shown.moments,
        "active": listed(_launched(shown), "and"),
        "pace": "in real time" if shown.slow == 1 else f"at {speed_words(shown.slow)}",
        "rate": f"{float(shown.video.fps):g}",
        "timeline": timeline(shown.scene, shown.footage),
        "clock": clock,
        "told": told,
    }
