"""The page on which a user outlines objects in a photo, and the server that it comes from."""

from __future__ import annotations

import shlex
import threading
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

from f3sr.backends.protocols import Segmenter
from f3sr.backends.registry import Backend
from f3sr.errors import F3srWarning
from f3sr.mask_page.drawing_session import Drawing, DrawingSession
from f3sr.mask_page.loopback_server import LoopbackServer, Reply, Route
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.segmentation.input_folder_writer import read_photo, require_writable
from f3sr.segmentation.selection import Selection
from f3sr.segmentation.selection_json import PROMPTS, read_selection
from f3sr.web.browser import shown_in_browser
from f3sr.web.document import WEB, document

HERE = Path(__file__).parent
SCRIPTS = ("marks.js", "viewport.js", "mask_page.js")
RELOAD_S = 15.0
"""How long the last page may be gone before the session ends [s]: a reload takes less."""
NOTHING_SAVED = "nothing was saved in the page; nothing was written"
WAKE_S = 0.25
"""How soon the end of a session is noticed [s]."""


def serve(
    photo: Path,
    out: Path,
    segmenter: Backend[Segmenter],
    *,
    open_browser: bool = True,
    after: str = "",
    tell: Callable[[str], object] = print,
    progress: Progress = silent,
) -> Path | None:
    """Let a user outline the objects of a photo's file in a page, and write the prompted-image folder ``out``.

    The page begins with what an earlier run saved there. ``after`` says in a sentence what follows on Save; without it
    the page names the command that goes on. ``tell`` gets the page's address. Returns the folder's full path, or None
    where nothing was saved. Raises InputError for the photo, and for a back end that lacks something, OutputError where
    ``out`` may not be written.
    """
    segmenter.require_ready()
    folder = require_writable(out)
    drawing = Drawing(
        photo=read_photo(photo),
        file=photo,
        folder=folder,
        segmenter=segmenter,
        after=after,
        command="" if after else _next_command(folder),
    )
    file = folder / PROMPTS
    given = read_selection(file) if file.exists() else Selection(prompts=())
    with timed("outline", progress):
        return run(DrawingSession(drawing, given), open_browser=open_browser, tell=tell)


def page_server(session: DrawingSession) -> LoopbackServer:
    """A server of the page, not running yet."""
    return LoopbackServer(_routes(session), _warn)


def run(
    session: DrawingSession,
    *,
    open_browser: bool = True,
    tell: Callable[[str], object] = print,
    reload_s: float = RELOAD_S,
    server: LoopbackServer | None = None,
) -> Path | None:
    """Serve the page until it has saved, was cancelled, or has been closed for ``reload_s`` seconds.

    Returns the folder that was written, or None. A KeyboardInterrupt ends it too.
    """
    server = server or page_server(session)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": WAKE_S}, daemon=True)
    thread.start()
    try:
        shown = open_browser and shown_in_browser(server.address_once)
        tell(f"{'the page is open at' if shown else 'open this page in a browser:'} {server.address}")
        while not session.ended.wait(WAKE_S) and server.presence.absent_for() < reload_s:
            pass
        return session.result()
    finally:
        server.ended.set()
        server.shutdown()
        server.server_close()
        thread.join()


def page(drawing: Drawing) -> bytes:
    """The document of the page, the same for every photo of a name."""
    return document(
        HERE / "templates" / "mask_page.html",
        {"name": drawing.name or drawing.file.name},
        styles=(WEB / "page.css", HERE / "mask_page.css"),
        scripts=tuple(HERE / name for name in SCRIPTS),
        served=True,
    )


def _next_command(folder: Path) -> str:
    scene = folder.with_name(f"{folder.name.removesuffix('_input')}_scene")
    return f"f3sr reconstruct {shlex.quote(str(folder))} -o {shlex.quote(str(scene))}"


def _routes(session: DrawingSession) -> Mapping[tuple[str, str], Route]:
    whole = Reply(body=page(session.drawing), kind="text/html; charset=utf-8")
    return {
        ("GET", ""): lambda body: whole,
        ("GET", "photo.jpg"): session.photo,
        ("POST", "open"): session.open,
        ("POST", "outline"): session.outline,
        ("POST", "ground"): session.ground,
        ("POST", "save"): session.save,
        ("POST", "cancel"): session.cancel,
    }


def _warn(why: str) -> None:
    """Each kind of refusal is told once in the terminal, as warnings are."""
    warnings.warn(f"the page's server refused a request: {why}", F3srWarning, stacklevel=1)
