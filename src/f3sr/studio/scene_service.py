"""What one project's process answers: its outlines, its scene and edits of it, and what goals mean in it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from f3sr import mask_page
from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.goals.refusal import Refusal
from f3sr.language.planner import planned
from f3sr.mask_page.drawing_session import Drawing, DrawingSession
from f3sr.mask_page.loopback_server import Reply, json_reply
from f3sr.scene_package.package_folder import SCENE
from f3sr.segmentation.input_folder_writer import read_photo, require_writable
from f3sr.segmentation.segmenters import DEFAULT_SEGMENTER, SEGMENTERS
from f3sr.segmentation.selection import Selection
from f3sr.segmentation.selection_json import PROMPTS, read_selection
from f3sr.studio.edited_scene import EditedScene
from f3sr.studio.suggestions import suggestions
from f3sr.studio.workspace import Project

SAVE_S = 10.0
"""Pause after an edit, after which the package is written [s]: that takes as long as two edits."""
AFTER = "The next step makes the scene."
"""What the page that outlines objects says once it has saved."""


class SceneService:
    """Answers the calls about one project's folder. Calls come from several threads; the scene is one at a time."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self._lock = threading.RLock()
        self._outlining: DrawingSession | None = None
        self._edits: EditedScene | None = None
        self._saving: threading.Timer | None = None
        self.calls: Mapping[str, Callable[[bytes], Reply]] = {
            "outline": lambda body: self._outline_page(),
            "outline/photo": lambda body: self._outlined().photo(body),
            "outline/open": lambda body: self._outlined().open(body),
            "outline/outline": lambda body: self._outlined().outline(body),
            "outline/ground": lambda body: self._outlined().ground(body),
            "outline/save": self._save_outlines,
            "outline/segmenter": self._segment_with,
            "outline/cancel": lambda body: self._outlined().cancel(body),
            "view": lambda body: json_reply(self._scene().view),
            "labels": lambda body: Reply(body=self._scene().labels, kind="image/png"),
            "state": lambda body: json_reply(self._scene().state()),
            "edit": lambda body: self._edited(lambda scene: scene.add(_asked(body)["edit"])),
            "undo": lambda body: self._edited(EditedScene.undo),
            "redo": lambda body: self._edited(EditedScene.redo),
            "saved": lambda body: self._saved(),
            "menu": lambda body: json_reply({"suggestions": list(suggestions(self._scene().scene))}),
            "understand": self._understand,
        }

    # --- outlines --------------------------------------------------------------------------------------------------

    def _outline_page(self) -> Reply:
        """The page of ``f3sr segment``. A session that has saved is followed by another, which begins with it."""
        with self._lock:
            if self._outlining is not None and self._outlining.ended.is_set():
                self._outlining = None
            return Reply(body=mask_page.page(self._outlined().drawing), kind="text/html; charset=utf-8")

    def _outlined(self) -> DrawingSession:
        """The session of the page that is open, also where this process was started again behind it."""
        with self._lock:
            if self._outlining is None:
                self._outlining = _outlining(self.project)
            return self._outlining

    def _segment_with(self, body: bytes) -> Reply:
        """Another back end cuts objects out; what is drawn stays."""
        segmenter = SEGMENTERS.find(str(_asked(body)["segmenter"]))
        with self._lock:
            before = self._outlined()
            self._outlining = DrawingSession(replace(before.drawing, segmenter=segmenter), before.selection)
        return json_reply({})

    def _save_outlines(self, body: bytes) -> Reply:
        reply = self._outlined().save(body)
        if reply.status == 200:
            self.project.outlines_changed.touch()
        return reply

    # --- the scene -------------------------------------------------------------------------------------------------

    def _scene(self) -> EditedScene:
        if not (self.project.package / SCENE).is_file():
            raise InputError("the project", found="no scene", accepted="one whose scene is made")
        with self._lock:
            if self._edits is None or self._edits.is_old():
                self._edits = EditedScene(self.project)
            return self._edits

    def _edited(self, change: Callable[[EditedScene], None]) -> Reply:
        """The scene after a change, as soon as it is measured. The package follows."""
        with self._lock:
            scene = self._scene()
            change(scene)
            reply = json_reply(scene.state())
            if self._saving is not None:
                self._saving.cancel()
            self._saving = threading.Timer(SAVE_S, self._save)
            self._saving.daemon = True
            self._saving.start()
            return reply

    def _save(self) -> None:
        with self._lock:
            if self._edits is not None:
                self._edits.save()

    def _saved(self) -> Reply:
        """Once the package holds all edits: before a job reads it."""
        if self.project.package.exists():
            with self._lock:
                self._scene().save()
        return json_reply({})

    def _understand(self, body: bytes) -> Reply:
        """What the rules make of words, without playing it."""
        goal, scene = str(_asked(body)["goal"]), self._scene().scene
        found = planned(goal, scene)
        if isinstance(found, Refusal):
            return json_reply({"refused": found.message})
        task = found.readings[0]
        return json_reply({"interpretation": task.interpretation, "assumptions": list(task.assumptions)})


def _asked(body: bytes) -> dict[str, Any]:
    """What a page sent, as the server hands it on. Raises InputError for numbers and depths beyond reason."""
    try:
        return strict_json.loads(body)
    except ValueError as error:
        raise InputError("the request", found=str(error), accepted="what a page sends") from None


def _outlining(project: Project) -> DrawingSession:
    """A session of the page that outlines objects, with what was drawn before."""
    if project.photo is None:
        raise InputError("the project", found="no photo of its own", accepted="one that began with a photo")
    folder = require_writable(project.input)
    drawing = Drawing(
        photo=read_photo(project.photo),
        file=project.photo,
        folder=folder,
        segmenter=SEGMENTERS.find(project.segmenter or DEFAULT_SEGMENTER),
        name=project.name,
        after=AFTER,
    )
    file = folder / PROMPTS
    return DrawingSession(drawing, read_selection(file) if file.exists() else Selection(prompts=()))
