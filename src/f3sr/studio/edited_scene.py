"""A project's scene as pages show it and change it. Its edits are kept as they come, its package is written after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from f3sr.core.transforms import Array
from f3sr.edits import EditSession, edit_of, edits_json, read_edits, write_edited
from f3sr.edits.edit_list import Edit
from f3sr.edits.unedited import kept_edits
from f3sr.errors import F3srError, InputError, OutputError
from f3sr.files import strict_json
from f3sr.io.images import encode_png
from f3sr.language.reference_resolution import names
from f3sr.physics.mujoco_model import body_of
from f3sr.runtime.atomic_file import write_whole
from f3sr.runtime.daemon_thread import begun
from f3sr.scene import Scene, SceneObject
from f3sr.scene_package.package import SCENE, Package, read_package
from f3sr.scene_package.package_folder import REPORT
from f3sr.studio.workspace import Project
from f3sr.vision.pictures import Backdrop
from f3sr.web.document import clean
from f3sr.web.light_mesh import lightened
from f3sr.web.packed import TextureIndex, packed_camera, packed_mesh, packed_parts

FACES, FACES_EACH = 48_000, (2_000, 20_000)
"""Triangles of all meshes in the view, and fewest and most of one: without a graphics card they turn smoothly."""
TEXTURE = 512
"""Longest side of a texture in the view [px]."""
MAX_REPORT = 50_000_000
"""Bytes of report.json."""
LONGEST = 1024
"""Longest side of the picture of masks [px]."""


class EditedScene:
    """The scene of a project's package with the project's edits, which count where both differ.

    A package is shown as soon as it is read. The session, which makes every scene between its edits again, is there for
    the first change.
    """

    def __init__(self, project: Project) -> None:
        """Raises InputError for a damaged package or list."""
        self.project = project
        self._file = project.package / SCENE
        self._read = self._file.stat().st_mtime_ns
        package = read_package(project.package)
        base, self._written = package.unedited(), kept_edits(project.package)
        given = read_edits(project.edits) if project.edits.exists() else self._written
        self._seconds = 0.0
        self._views = dict[bool, dict[str, Any]]()
        self._opening = begun(lambda: EditSession(base, given))
        self._as_written = package if given == self._written else None
        """The package, while no change has needed the session."""

    def is_old(self) -> bool:
        """Whether another package has taken its place."""
        return self._file.stat().st_mtime_ns != self._read

    def add(self, edit: Any) -> None:
        """Apply an edit of a page, which names an object by id. Raises InputError."""
        known = {o.id: o.label for o in self._session.scene}
        if not isinstance(edit, dict) or type(edit.get("id")) is not int or edit["id"] not in known:
            raise InputError("edit", found="no object of the scene", accepted="an id of the scene")
        outcome = self._session.add(edit_of({"label": known[edit["id"]], **edit}))
        if not outcome.done:  # a list keeps what a later scene may allow; a page says at once that it is not so
            self._session.discard()
            raise F3srError("; ".join(f"{d.choice}: {d.reason}" for d in outcome.decisions))
        self._changed(outcome.seconds, back=self._session.discard)

    def undo(self) -> None:
        self._session.undo()
        self._changed(0.0, back=self._session.redo)

    def redo(self) -> None:
        self._session.redo()
        self._changed(0.0, back=self._session.undo)

    def save(self) -> None:
        """Write the package where edits are not in it yet."""
        if self._as_written is not None or self._session.edits == self._written:
            return
        write_edited(self._session, self.project.package)
        self._written = self._session.edits
        self._read = self._file.stat().st_mtime_ns

    @property
    def _session(self) -> EditSession:
        return self._opening.result()

    def _changed(self, seconds: float, *, back: Callable[[], object]) -> None:
        """Keep the list of edits at once: with it everything can be made again. What a full disk does not keep is taken
        back, and told."""
        try:
            write_whole(self.project.edits, edits_json(self._session.edits))
        except OutputError:
            back()
            raise
        self._seconds, self._as_written = seconds, None

    # --- for the page -----------------------------------------------------------------------------------------------

    @property
    def scene(self) -> Scene:
        return self._as_written.scene if self._as_written else self._session.scene

    @property
    def view(self) -> dict[str, Any]:
        """All that ``view3d.js`` reads and that no edit changes: meshes, their parts and textures, the ids of masks.

        ``meshes`` tells whose: those of an edited package have their sizes in them, those of a session in the poses."""
        own = self._as_written is not None and bool(self._written)
        if own not in self._views:
            self._views[own] = _view(self.scene if own else self._base) | {"meshes": own}
        return self._views[own]

    @property
    def labels(self) -> bytes:
        """PNG of the photo's masks: the place of an object in ``masks`` plus 1, in red and 256 times in green."""
        masks = self.view["masks"]
        wanted = Backdrop.of(self.scene if self.view["meshes"] else self._base, LONGEST).wanted
        numbers = np.zeros(wanted.shape, np.uint16)
        for k, id in enumerate(masks, 1):
            numbers[wanted == id] = k
        return encode_png(np.stack([numbers & 255, numbers >> 8, np.zeros_like(numbers)], -1).astype(np.uint8))

    def state(self) -> dict[str, Any]:
        """All that edits change."""
        shown = self._as_written
        return {
            "meshes": self.view["meshes"],
            "camera": packed_camera(self.scene.camera),
            **(self._of_package(shown) if shown else self._of_session()),
            "seconds": self._seconds,
        }

    @property
    def _base(self) -> Scene:
        """Before all edits."""
        if self._as_written is not None and not self._written:
            return self._as_written.scene
        return self._session.unedited.package.scene

    def _of_package(self, package: Package) -> dict[str, Any]:
        decisions = _decisions(_report(package))
        return {
            "objects": [_told(o, None, decisions.get(o.id, []), names(package.scene)) for o in package.scene],
            "measures": package.document.metrics,
            "edits": [edit_in_words(e) for e in self._written],
            "undo": bool(self._written),
            "redo": False,
            "told": [],
        }

    def _of_session(self) -> dict[str, Any]:
        session, outcome = self._session, self._session.outcome
        stages = [*session.unedited.report.get("stages", []), asdict(session.report)]
        decisions, known = _decisions(stages), {o.id: o.IoU_visible for o in outcome.details.objects}
        called = names(session.scene)
        return {
            "objects": [_told(o, known.get(o.id), decisions.get(o.id, []), called) for o in session.scene],
            "measures": outcome.measures.as_dict(),
            "edits": [edit_in_words(e) for e in session.edits],
            "undo": session.can_undo,
            "redo": session.can_redo,
            "told": [{"choice": d.choice, "reason": d.reason} for d in outcome.decisions],
        }


def _view(scene: Scene) -> dict[str, Any]:
    textures = TextureIndex(TEXTURE)
    corners = np.concatenate([o.bounds_world for o in scene])
    faces = int(np.clip(FACES // len(scene.objects), *FACES_EACH))
    return {
        "bounds": [*corners.min(0).tolist(), *corners.max(0).tolist()],
        "objects": [
            {
                "id": o.id,
                "mesh": packed_mesh(lightened(o.mesh, faces), textures.index),
                "parts": packed_parts(o.colliders),
            }
            for o in scene
        ],
        "textures": textures.uris,
        "masks": [o.id for o in scene],
    }


def _report(package: Package) -> Sequence[Any]:
    """The stages of report.json; none where it is absent or damaged."""
    try:
        tree = strict_json.read(package.folder / REPORT, most=MAX_REPORT, accepted="the report of a package")
    except InputError:
        return ()
    stages = tree.get("stages") if isinstance(tree, dict) else None
    return stages if isinstance(stages, list) else ()


def _decisions(stages: Sequence[Any]) -> dict[int, list[dict[str, Any]]]:
    """By object: what stages decided about it, in order. Reports may come from others: another shape is left out."""
    found = dict[int, list[dict[str, Any]]]()
    for stage in (s for s in stages if isinstance(s, dict)):
        decisions = stage.get("decisions")
        for d in decisions if isinstance(decisions, list | tuple) else ():
            if isinstance(d, dict) and type(d.get("about")) is int:
                told = {key: clean(str(d.get(key, ""))) for key in ("choice", "reason")}
                row = {"stage": clean(str(stage.get("stage", ""))), **told, "fallback": d.get("fallback") is True}
                found.setdefault(d["about"], []).append(row)
    return found


def edit_in_words(edit: Edit) -> str:
    """An edit as the list on the page says it."""
    name = edit.label or f"object {edit.id}"
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


def _told(
    o: SceneObject, iou: float | None, decisions: list[dict[str, Any]], called: Mapping[int, str]
) -> dict[str, Any]:
    """``called``: words that select each object and nothing else, as goals use them."""
    low, high = o.bounds_world
    return {
        "id": o.id,
        "label": clean(o.label),
        "name": clean(called[o.id]),
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
