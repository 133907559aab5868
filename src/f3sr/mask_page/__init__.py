"""The page on which a user outlines objects in a photo, and the server that it comes from."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

from f3sr.errors import F3srWarning
from f3sr.mask_page.drawing_session import Drawing, DrawingSession
from f3sr.mask_page.loopback_server import LoopbackServer, Reply, Route
from f3sr.web.browser import shown_in_browser
from f3sr.web.document import WEB, document

HERE = Path(__file__).parent
SCRIPTS = ("marks.js", "viewport.js", "mask_page.js")
RELOAD_S = 15.0
"""How long the last page may be gone before the session ends [s]: a reload takes less."""
WAKE_S = 0.25
"""How soon the end of a session is noticed [s]."""


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
