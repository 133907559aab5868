"""The page on which a user outlines objects in a photo, and the server that it comes from."""

from __future__ import annotations

import shlex
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from f3sr.backends.protocols import Prompt, Segmenter
from f3sr.backends.registry import Backend
from f3sr.errors import F3srWarning
from f3sr.io.images import as_rgb, open_image
from f3sr.mask_page.drawing_session import Drawing, DrawingSession
from f3sr.mask_page.interim import earlier, form, outlined, read, require_ours, write
from f3sr.mask_page.loopback_server import LoopbackServer, Reply, Route
from f3sr.runtime.atomic_folder import check
from f3sr.runtime.progress import Progress, silent, timed
from f3sr.scene import Photo
from f3sr.segmentation.selection import Selection
from f3sr.web.browser import shown_in_browser
from f3sr.web.document import WEB, document

HERE = Path(__file__).parent
SCRIPTS = ("marks.js", "viewport.js", "mask_page.js")
RELOAD_S = 15.0
"""How long the last page may be gone before the session ends [s]: a reload takes less."""
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
    where nothing was saved. Raises InputError for the photo, OutputError where ``out`` may not be written.
    """
    picture = Photo(rgb=as_rgb(open_image(photo)))
    folder = check(Path(out).absolute(), require_ours)
    drawing = Drawing(
        photo=picture,
        name=photo.name,
        folder=folder,
        outline=lambda selection: outlined(picture, selection, segmenter),
        write=lambda selection, outlines: write(folder, picture, selection, outlines),
        read=read,
        form=form,
        after=after,
        command="" if after else f"f3sr reconstruct {shlex.quote(str(folder))} -o OUT",
    )
    with timed("outline", progress):
        return run(DrawingSession(drawing, earlier(folder)), open_browser=open_browser, tell=tell)


def outline_boxes(photo: Path, out: Path, segmenter: Backend[Segmenter], prompts: Sequence[Prompt]) -> Path:
    """The same without a page: write the prompted-image folder ``out`` of a photo's file and given prompts."""
    picture, selection = Photo(rgb=as_rgb(open_image(photo))), Selection(prompts=tuple(prompts))
    return write(Path(out).absolute(), picture, selection, outlined(picture, selection, segmenter))


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
        {"name": drawing.name, "after": drawing.after},
        styles=(WEB / "page.css", HERE / "mask_page.css"),
        scripts=tuple(HERE / name for name in SCRIPTS),
        served=True,
    )


def _routes(session: DrawingSession) -> Mapping[tuple[str, str], Route]:
    whole = Reply(body=page(session.drawing), kind="text/html; charset=utf-8")
    return {
        ("GET", ""): lambda body: whole,
        ("GET", "photo.jpg"): session.photo,
        ("POST", "open"): session.open,
        ("POST", "outline"): session.outline,
        ("POST", "save"): session.save,
        ("POST", "cancel"): session.cancel,
    }


def _warn(why: str) -> None:
    """Each kind of refusal is told once in the terminal, as warnings are."""
    warnings.warn(f"the page's server refused a request: {why}", F3srWarning, stacklevel=1)
