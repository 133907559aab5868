"""A project's scene as pages show it and change it. Its edits are kept as they come, its package is written after."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from f3sr.core.transforms import Array
from f3sr.edits import EditSession, edit_of, edits_json, read_edits, write_edited
from f3sr.edits.edit_list import Edit
from f3sr.errors import F3srError, InputError
from f3sr.io.images import encode_png
from f3sr.physics.mujoco_model import body_of
from f3sr.runtime.atomic_file import write_whole
from f3sr.scene import Scene, SceneObject
from f3sr.scene_package.package import SCENE
from f3sr.studio.workspace import Project
from f3sr.vision.pictures import Backdrop
from f3sr.web.document import clean
from f3sr.web.light_mesh import lightened
from f3sr.web.packed import TextureIndex, packed_camera, packed_mesh, packed_parts

MOST_FACES = 20_000
"""Triangles of one mesh in the view: eight of them turn with 15 frames a second without a graphics card."""
TEXTURE = 512
"""Longest side of a texture in the view [px]."""
LONGEST = 1024
"""Longest side of the picture of masks [px]."""


class EditedScene:
    """The scene of a project's package with the project's edits, which count where both differ."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self._file = project.package / SCENE
        self._read = self._file.stat().st_mtime_ns
        self._session = EditSession.open(project.package)
        self._written = self._session.edits
        given = read_edits(project.edits) if project.edits.exists() else self._written
        if given != self._written:
            self._session = EditSession(self._session.unedited.package, given)
        self._seconds = 0.0

    def is_old(self) -> bool:
        """Whether another package has taken its place."""
        return self._file.stat().st_mtime_ns != self._read

    def add(self, edit: Any) -> None:
        """Apply an edit of a page, which names an object by id. Raises InputError."""
        known = {o.id: o.label for o in self._session.scene}
        if not isinstance(edit, dict) or edit.get("id") not in known:
            raise InputError("edit", found="no object of the scene", accepted="an id of the scene")
        outcome = self._session.add(edit_of({"label": known[edit["id"]], **edit}))
        if not outcome.done:  # a list keeps what a later scene may allow; a page says at once that it is not so
            self._session.undo()
            raise F3srError("; ".join(f"{d.choice}: {d.reason}" for d in outcome.decisions))
        self._seconds = outcome.seconds
        self._keep()

    def undo(self) -> None:
        self._session.undo()
        self._seconds = 0.0
        self._keep()

    def redo(self) -> None:
        self._session.redo()
        self._seconds = 0.0
        self._keep()

    def save(self) -> None:
        """Write the package where edits are not in it yet."""
        if self._session.edits == self._written:
            return
        write_edited(self._session, self.project.package)
        self._written = self._session.edits
        self._read = self._file.stat().st_mtime_ns

    def _keep(self) -> None:
        """The list of edits, at once: with it everything can be made again."""
        write_whole(self.project.edits, edits_json(self._session.edits))

    # --- for the page ------------------------------------------------------------------------------------------------

    @property
    def scene(self) -> Scene:
        return self._session.scene

    @cached_property
    def view(self) -> dict[str, Any]:
        """All that ``view3d.js`` reads and that no edit changes: meshes, their parts and textures, the ids of masks."""
        scene, textures = self._session.unedited.package.scene, TextureIndex(TEXTURE)
        corners = np.concatenate([o.bounds_world for o in scene])
        return {
            "bounds": [*corners.min(0).tolist(), *corners.max(0).tolist()],
            "objects": [
                {
                    "id": o.id,
                    "mesh": packed_mesh(lightened(o.mesh, MOST_FACES), textures.index),
                    "parts": packed_parts(o.colliders),
                }
                for o in scene
            ],
            "textures": textures.uris,
            "masks": [o.id for o in scene],
        }

    @cached_property
    def labels(self) -> bytes:
        """PNG of the photo's masks: the place of an object in ``masks`` plus 1, in red and 256 times in green."""
        scene = self._session.unedited.package.scene
        wanted = Backdrop.of(scene, LONGEST).wanted
        numbers = np.zeros(wanted.shape, np.uint16)
        for k, o in enumerate(scene, 1):
            numbers[wanted == o.id] = k
        return encode_png(np.stack([numbers & 255, numbers >> 8, np.zeros_like(numbers)], -1).astype(np.uint8))

    def state(self) -> dict[str, Any]:
        """All that edits change."""
        session, scene = self._session, self.scene
        known = {o.id: o for o in session.outcome.details.objects}
        return {
            "camera": packed_camera(scene.camera),
            "objects": [
                _told(o, known[o.id].IoU_visible if o.id in known else None, self._decisions(o)) for o in scene
            ],
            "measures": session.outcome.measures.as_dict(),
            "edits": [edit_in_words(e) for e in session.edits],
            "undo": session.can_undo,
            "redo": session.can_redo,
            "told": [{"choice": d.choice, "reason": d.reason} for d in session.outcome.decisions],
            "seconds": self._seconds,
        }

    def _decisions(self, o: SceneObject) -> list[dict[str, Any]]:
        """What stages and edits decided about an object, in order."""
        edits = [
            {"stage": "edit", "choice": d.choice, "reason": d.reason, "fallback": d.fallback}
            for d in self._session.report.decisions
            if d.about == o.id
        ]
        return [*self._of_stages.get(o.id, []), *edits]

    @cached_property
    def _of_stages(self) -> dict[int, list[dict[str, Any]]]:
        """By object: what the report says that stages decided about it."""
        found = dict[int, list[dict[str, Any]]]()
        for stage in self._session.unedited.report.get("stages", []):
            for d in stage.get("decisions", []):
                if d.get("about") is not None:
                    told = {key: clean(str(d.get(key, ""))) for key in ("choice", "reason")}
                    row = {"stage": clean(str(stage.get("stage", ""))), **told, "fallback": d.get("fallback") is True}
                    found.setdefault(d["about"], []).append(row)
        return found


def edit_in_words(edit: Edit) -> str:
    """An edit as the list on the page says it."""
    name = f"{edit.id} {edit.label}".strip()
    match edit.kind:
        case "move":
            return f"{name}: moved by {_centimetres(edit.by)} cm along x, y and z"
        case "turn":
            return f"{name}: turned by {edit.degrees:g}° about {', '.join(f'{c:.2g}' for c in edit.axis)}"
        case "scale":
            return f"{name}: scaled by {edit.factor:g}"
        case "support":
            return f"{name}: put onto {'the ground' if edit.on == -1 else f'object {edit.on}'}"
        case "material":
            given = {"density": (edit.density, "kg/m³"), "mass": (edit.mass, "kg"), "friction": (edit.friction, "")}
            said = [f"{key} {value:g} {unit}".strip() for key, (value, unit) in given.items() if value is not None]
            return f"{name}: {', '.join(said)}"
        case "label":
            return f"{name}: called {edit.to}"
        case "delete":
            return f"{name}: deleted"
        case "fix":
            return f"{name}: fixed"
        case "release":
            return f"{name}: no longer fixed"


def _centimetres(way: tuple[float, float, float]) -> str:
    return ", ".join(f"{100 * c:.1f}" for c in way)


def _told(o: SceneObject, iou: float | None, decisions: list[dict[str, Any]]) -> dict[str, Any]:
    low, high = o.bounds_world
    return {
        "id": o.id,
        "label": clean(o.label),
        "pose": _rows(o.T_world_asset),
        "center": ((low + high) / 2).tolist(),
        "size": (high - low).tolist(),
        "mobility": o.mobility,
        "mass": body_of(o).mass,
        "material": o.material,
        "friction": o.friction,
        "support": o.supported_by,
        "iou": iou,
        "decisions": decisions,
    }


def _rows(T: Array) -> list[float]:
    return T.ravel().tolist()
