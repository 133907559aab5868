"""What the 3-D view shows, packed small: meshes, textures, collision parts, poses and the photo's cameras."""

from __future__ import annotations

from typing import Any

import numpy as np

from f3sr.report_page.page_data import PageData
from f3sr.scene import Scene, SceneObject
from f3sr.vision.pictures import turned_view
from f3sr.web.document import data
from f3sr.web.figures import figure, img
from f3sr.web.light_mesh import lightened
from f3sr.web.markup import Markup, clean, el
from f3sr.web.packed import TextureIndex, packed_camera, packed_mesh, packed_parts

FACES_EACH = (400, 60_000)
"""Fewest and most triangles of one mesh in the view."""
HELP = (
    "Drag to turn, two fingers or Shift to move, pinch or wheel (after a click) to zoom; "
    "keys: arrows, +, −, 0, 1, 2, 3. Input is levelled: direct composition."
)
STILL = (
    "Ours, the photo's camera turned 35° about the scene. This is a still picture: "
    "the view that turns needs scripts and WebGL 2."
)
STILL_TURN = np.radians(35)
"""How far the still picture's camera is turned from the photo's [rad]."""


def viewer(m: PageData) -> Markup:
    """The view with its buttons; a still picture where it cannot be."""
    camera = m.backdrop.camera(m.scene)
    still = turned_view(m.scene, turn=STILL_TURN, width=camera.width, height=camera.height)
    modes = (("direct", "Input"), ("ours", "Ours"), ("proxies", "Proxies"))
    buttons = el(
        "div",
        el("span", (_button(label, f"mode-{mode}", mode == "ours") for mode, label in modes), class_="group"),
        _button("Photo camera", "photo-view", None),
        el("span", _button("Photo", "photo-behind", True), _button("Names", "names", False), class_="group"),
        class_="buttons",
        role="toolbar",
        aria_label="3-D view",
    )
    stage = el(
        "div",
        img(m.backdrop.rgb, "", class_="behind"),
        el("canvas", tabindex="0", aria_label="The scene in 3-D; " + HELP),
        el("div", class_="names", aria_hidden="true"),
        id="view-stage",
    )
    return el(
        "div",
        el(
            "div",
            buttons,
            stage,
            el("p", HELP, " ", el("span", id="grid-step"), class_="fine"),
            id="view-live",
            hidden=True,
        ),
        figure(img(still, "The scene from another side"), STILL, id="view-still"),
        el("script", payload(m), type="application/json", id="scene-data"),
        id="viewer",
    )


def _button(label: str, name: str, pressed: bool | None) -> Markup:
    state = None if pressed is None else str(pressed).lower()
    return el("button", label, type="button", id=name, aria_pressed=state)


def payload(m: PageData) -> Markup:
    """All data of the view as JSON that cannot end its script element."""
    faces = int(np.clip(m.sizes.faces // len(m.scene.objects), *FACES_EACH))
    textures = TextureIndex(m.sizes.texture)
    document = {
        "cameras": {"direct": packed_camera(m.direct.camera), "ours": packed_camera(m.scene.camera)},
        "bounds": {"direct": _bounds(m.direct), "ours": _bounds(m.scene)},
        "objects": [_object(o, m.direct[o.id], faces, textures) for o in m.scene],
        "textures": textures.uris,
    }
    return data(document)


def _bounds(scene: Scene) -> list[float]:
    corners = np.concatenate([o.bounds_world for o in scene])
    return [*corners.min(0).tolist(), *corners.max(0).tolist()]


def _object(o: SceneObject, direct: SceneObject, faces: int, textures: TextureIndex) -> dict[str, Any]:
    return {
        "id": o.id,
        "label": clean(o.label),
        "mesh": packed_mesh(lightened(o.mesh, faces), textures.index),
        "parts": packed_parts(o.colliders),
        "direct": direct.T_world_asset.ravel().tolist(),
        "ours": o.T_world_asset.ravel().tolist(),
    }
