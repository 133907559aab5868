"""What one page is about: the photo, what has been drawn on it so far, and the masks that come of it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from f3sr.backends.protocols import Prompt, Segmenter
from f3sr.backends.registry import Backend
from f3sr.errors import F3srError, one_line, unforeseen
from f3sr.files import strict_json
from f3sr.mask_page.loopback_server import Reply, json_reply
from f3sr.mask_page.mask_pictures import mask_picture, shown_photo, shown_size
from f3sr.scene import Photo
from f3sr.segmentation.ground_region import ground_mask
from f3sr.segmentation.input_folder_writer import OutlinedObject, write_input_folder
from f3sr.segmentation.selection import Selection, object_masks, require_prompts
from f3sr.segmentation.selection_json import selection_bytes, selection_form, selection_of

MAX_REVISION = 2**53 - 1
"""Largest whole number that a script counts to."""

Masks = tuple[NDArray[np.bool_], ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawing:
    """What the page needs of the rest of f3sr."""

    photo: Photo
    file: Path
    """Of the photo."""
    folder: Path
    """Where the masks go; a full path."""
    segmenter: Backend[Segmenter]
    name: str = ""
    """What the page calls the photo; without it, the file's name."""
    after: str = ""
    """What follows once it is saved: one sentence for the page."""
    command: str = ""
    """The command that goes on from the folder, for the page; it may be empty."""


class PageRefusedError(F3srError):
    """A page that may not change anything: it is behind another one, or sent what no page sends."""


class DrawingSession:
    """Answers the page. Of several pages only the one that was opened last may change something."""

    def __init__(self, drawing: Drawing, given: Selection) -> None:
        self.drawing = drawing
        self.saved: Path | None = None
        self.ended = threading.Event()
        """Set once the page has saved or has been cancelled, and knows it."""
        self._state, self._working = threading.Lock(), threading.Lock()
        self._selection, self._revision, self._page = given, 0, 0
        self._grounding = threading.Lock()
        self._masks_known: tuple[bytes, Masks] | None = None
        self._ground_known: tuple[bytes, NDArray[np.bool_]] | None = None
        self._photo = shown_photo(drawing.photo)

    @property
    def selection(self) -> Selection:
        """What is drawn now."""
        with self._state:
            return self._selection

    def photo(self, body: bytes) -> Reply:
        return Reply(body=self._photo, kind="image/jpeg")

    def open(self, body: bytes) -> Reply:
        """A page begins, with what has been drawn until now."""
        return self._answer(body, set(), self._opened)

    def outline(self, body: bytes) -> Reply:
        """The masks of what is drawn on the page."""
        return self._answer(body, {"page", "revision", "selection"}, self._outlined)

    def ground(self, body: bytes) -> Reply:
        """The ground beside those masks: it takes longer, so the page asks once the user pauses."""
        return self._answer(body, {"page", "revision"}, self._grounded)

    def save(self, body: bytes) -> Reply:
        """The folder is written; the session ends."""
        return self._answer(body, {"page", "revision", "selection"}, self._written)

    def cancel(self, body: bytes) -> Reply:
        """The session ends, with nothing written."""
        return self._answer(body, {"page"}, self._cancelled)

    def result(self) -> Path | None:
        """What was saved, once the work in hand is done."""
        with self._working:
            return self.saved

    def _answer(self, body: bytes, keys: set[str], work: Callable[[dict[str, Any]], Reply]) -> Reply:
        """The answer, or one line that says what is wrong."""
        try:
            value = strict_json.loads(body)
            if not isinstance(value, dict) or set(value) != keys:
                raise PageRefusedError(f"an object with {', '.join(sorted(keys)) or 'nothing'} is accepted")
            if self.ended.is_set():
                raise PageRefusedError("this page is done")
            return work(value)
        except ValueError as error:
            return _problem(HTTPStatus.BAD_REQUEST, f"no valid JSON ({error})")
        except PageRefusedError as error:
            return _problem(HTTPStatus.CONFLICT, str(error))
        except F3srError as error:
            return _problem(HTTPStatus.UNPROCESSABLE_ENTITY, str(error))
        except Exception as error:  # a segmenter of others may raise anything; the page goes on
            return _problem(HTTPStatus.INTERNAL_SERVER_ERROR, unforeseen(error, "nothing was saved"))

    def _opened(self, value: Mapping[str, Any]) -> Reply:
        with self._state:
            self._page += 1
            page, revision, selection = self._page, self._revision, self._selection
        d = self.drawing
        width, height = shown_size(d.photo)
        return json_reply(
            {
                "page": page,
                "revision": revision,
                "selection": selection_form(selection),
                "photo": {"width": d.photo.width, "height": d.photo.height, "shown": [width, height]},
                "name": d.name or d.file.name,
                "folder": str(d.folder),
            }
        )

    def _outlined(self, value: Mapping[str, Any]) -> Reply:
        selection, revision = self._taken(value)
        with self._working:
            if revision != self._revision:
                return _stale(revision)
            masks = self._masks(selection)
        size = shown_size(self.drawing.photo)
        return json_reply({"revision": revision, "masks": [mask_picture(mask, size) for mask in masks]})

    def _grounded(self, value: Mapping[str, Any]) -> Reply:
        with self._state:
            self._require_page(value["page"])
            selection, revision = self._selection, self._revision
        if value["revision"] != revision:
            return _stale(revision)
        with self._working:
            masks = self._masks(selection)
        with self._grounding:
            if revision != self._revision:
                return _stale(revision)
            ground = self._ground(selection, masks)
        return json_reply({"revision": revision, "ground": mask_picture(ground, shown_size(self.drawing.photo))})

    def _written(self, value: Mapping[str, Any]) -> Reply:
        (selection, _), d = self._taken(value), self.drawing
        if not selection.prompts:
            raise PageRefusedError("there is nothing to save yet: draw a box around an object")
        with self._working:
            masks = self._masks(selection)
            with self._grounding:
                ground = self._ground(selection, masks)
            objects = {
                k: OutlinedObject(label=prompt.label, mask=masks[k]) for k, prompt in enumerate(selection.prompts)
            }
            self.saved = write_input_folder(d.folder, photo=d.file, objects=objects, ground=ground, selection=selection)
        told = {"folder": str(self.saved), "after": d.after, "command": d.command}
        return json_reply(told, sent=self.ended.set)

    def _cancelled(self, value: Mapping[str, Any]) -> Reply:
        with self._state:
            self._require_page(value["page"])
        return json_reply({}, sent=self.ended.set)

    def _taken(self, value: Mapping[str, Any]) -> tuple[Selection, int]:
        """The selection that a page sent, kept for the next page, and its revision."""
        selection, revision = selection_of(value["selection"], "the page"), value["revision"]
        require_prompts(self.drawing.photo, selection)
        if type(revision) is not int or not 0 <= revision <= MAX_REVISION:
            raise PageRefusedError(f"a revision from 0 to {MAX_REVISION} is accepted")
        with self._state:
            self._require_page(value["page"])
            if revision < self._revision:
                raise PageRefusedError("this is older than what is here")
            if revision > self._revision:
                self._selection, self._revision = selection, revision
            return self._selection, revision

    def _require_page(self, page: object) -> None:
        if type(page) is not int or page != self._page:
            raise PageRefusedError("The photo was opened again in another window. Reload this page to go on here.")

    def _masks(self, selection: Selection) -> Masks:
        """Of the objects. Other names and strokes on the ground change none, so nothing is asked again for them."""
        bare = Selection(prompts=_nameless(selection.prompts))
        key = selection_bytes(bare)
        if self._masks_known is None or self._masks_known[0] != key:
            self._masks_known = key, object_masks(self.drawing.photo, bare, self.drawing.segmenter)
        return self._masks_known[1]

    def _ground(self, selection: Selection, masks: Masks) -> NDArray[np.bool_]:
        key = selection_bytes(replace(selection, prompts=_nameless(selection.prompts)))
        if self._ground_known is None or self._ground_known[0] != key:
            self._ground_known = key, ground_mask(self.drawing.photo.rgb, selection.ground, masks)
        return self._ground_known[1]


def _nameless(prompts: tuple[Prompt, ...]) -> tuple[Prompt, ...]:
    return tuple(replace(prompt, label="") for prompt in prompts)


def _stale(revision: int) -> Reply:
    """Something newer is being asked."""
    return json_reply({"revision": revision, "stale": True})


def _problem(status: HTTPStatus, line: str) -> Reply:
    return json_reply({"problem": one_line(line)}, status=int(status))
