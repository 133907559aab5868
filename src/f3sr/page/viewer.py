"""What the 3-D view shows, packed small: meshes, textures, collision parts, poses and the photo's cameras."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.frames import Array, Camera
from f3sr.mesh import ConvexPart, Mesh
from f3sr.page.images import data_uri, figure, img
from f3sr.page.light_mesh import lightened
from f3sr.page.markup import Markup, clean, el
from f3sr.page.material import Material
from f3sr.pictures import resized, turned_view
from f3sr.scene import Scene, SceneObject

FACES_EACH = (400, 60_000)
"""Fewest and most triangles of one mesh in the view."""
TEXTURE_QUALITY = 80
LARGEST = 32767
"""Vertices are 16-bit: a mesh's box is cut into 65534 steps per side."""
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


@dataclass
class Textures:
    """Every texture once, by identity."""

    longest: int
    uris: list[str] = field(default_factory=list)
    known: dict[int, int] = field(default_factory=dict)

    def index(self, texture: NDArray[np.uint8]) -> int:
        if id(texture) not in self.known:
            self.known[id(texture)] = len(self.uris)
            scale = min(1.0, self.longest / max(texture.shape[:2]))
            height, width = (max(1, round(scale * n)) for n in texture.shape[:2])
            self.uris.append(data_uri(resized(texture, width, height), TEXTURE_QUALITY))
        return self.known[id(texture)]


def viewer(m: Material) -> Markup:
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


def payload(m: Material) -> Markup:
    """All data of the view as JSON that cannot end its script element."""
    faces = int(np.clip(m.sizes.faces // len(m.scene.objects), *FACES_EACH))
    textures = Textures(m.sizes.texture)
    document = {
        "cameras": {"direct": _camera(m.direct.camera), "ours": _camera(m.scene.camera)},
        "bounds": {"direct": _bounds(m.direct), "ours": _bounds(m.scene)},
        "objects": [_object(o, m.direct[o.id], faces, textures) for o in m.scene],
        "textures": textures.uris,
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c"))


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.ravel().tolist(),
        "T": camera.T_world_camera.ravel().tolist(),
    }


def _bounds(scene: Scene) -> list[float]:
    corners = np.concatenate([o.bounds_world for o in scene])
    return [*corners.min(0).tolist(), *corners.max(0).tolist()]


def _object(o: SceneObject, direct: SceneObject, faces: int, textures: Textures) -> dict[str, Any]:
    return {
        "id": o.id,
        "label": clean(o.label),
        "mesh": packed_mesh(lightened(o.mesh, faces), textures.index),
        "parts": packed_parts(o.colliders),
        "direct": direct.T_world_asset.ravel().tolist(),
        "ours": o.T_world_asset.ravel().tolist(),
    }


def packed_mesh(mesh: Mesh, texture_index: Any) -> dict[str, Any]:
    """Quantised vertices, texture coordinates and colours, and per material a run of triangles."""
    assert mesh.face_material is not None
    order = np.argsort(mesh.face_material, kind="stable")
    counts = np.bincount(mesh.face_material, minlength=len(mesh.materials))
    runs = [
        {
            "count": int(3 * count),
            "color": [float(c) for c in material.base_color],
            "texture": None if material.texture is None or mesh.uv is None else texture_index(material.texture),
        }
        for material, count in zip(mesh.materials, counts, strict=False)
        if count
    ]
    packed = {**_quantised(mesh.vertices), "faces": _indices(mesh.faces[order], len(mesh.vertices)), "runs": runs}
    if mesh.uv is not None:
        low, high = mesh.uv.min(0), mesh.uv.max(0)
        span = np.where(high > low, high - low, 1.0)
        steps = np.round((mesh.uv - low) / span * 65535).astype("<u2")
        packed |= {"uv": _base64(steps), "uvBox": [*low.tolist(), *span.tolist()]}
    if mesh.vertex_colors is not None:
        packed["colors"] = _base64(np.pad(mesh.vertex_colors, ((0, 0), (0, 1)), constant_values=255))
    return packed


def packed_parts(parts: Sequence[ConvexPart]) -> dict[str, Any] | None:
    """All convex parts as one mesh, a run of triangles each."""
    if not parts:
        return None
    vertices = np.concatenate([p.vertices for p in parts])
    starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=False)])
    counts = [{"count": 3 * len(p.faces)} for p in parts]
    return {**_quantised(vertices), "faces": _indices(faces, len(vertices)), "runs": counts}


def _quantised(vertices: Array) -> dict[str, Any]:
    low, high = vertices.min(0), vertices.max(0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-12)
    steps = np.round((vertices - middle) / half * LARGEST).astype("<i2")
    padded = np.pad(steps, ((0, 0), (0, 1)))
    return {"vertices": _base64(padded), "box": [*middle.tolist(), *half.tolist()]}


def _indices(faces: NDArray[Any], vertices: int) -> dict[str, Any]:
    wide = vertices > 65535
    return {"wide": wide, "data": _base64(faces.astype("<u4" if wide else "<u2"))}


def _base64(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
