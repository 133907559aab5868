"""The studio served: workspace, queue, processes and pages behind one address, until somebody ends it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from f3sr.errors import F3srWarning, InputError
from f3sr.files import limited_file
from f3sr.runtime import signals
from f3sr.segmentation.input_folder_writer import MAX_PHOTO_BYTES
from f3sr.studio.access_control import AccessControl
from f3sr.studio.job_queue import JobQueue, QueueConfig
from f3sr.studio.login_page import login_page
from f3sr.studio.service_clients import ServiceClients
from f3sr.studio.studio_app import StudioApp
from f3sr.studio.web_server import address, listening, names_server, require_password, run
from f3sr.studio.workspace import Workspace
from f3sr.web.browser import shown_in_browser


def serve(
    folder: Path,
    given: Path | None = None,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    config: QueueConfig | None = None,
    open_browser: bool = True,
    tell: Callable[[str], object] = print,
) -> None:
    """Serve the projects of a workspace ``folder`` until Ctrl-C.

    ``given`` is a photo, an input folder or a package that becomes a project; its page comes first. A ``host`` that
    other machines reach needs a password. Without a ``port`` it is that of the server before, or a free one. ``tell``
    gets the address. Raises InputError and OutputError for what cannot be opened.
    """
    if port is not None and not 1 <= port <= 65535:
        raise InputError("--port", found=str(port), accepted="1 to 65535")
    password = require_password(host)
    signals.keeps("jobs go on, and all that was saved is kept")
    with closing(Workspace(folder)) as workspace:
        first = f"p/{_project(workspace, given)}/" if given else ""
        made, secrets = listening(host, port, workspace.folder)
        secrets.password, secrets.first = password, first
        with closing(made), closing(JobQueue(workspace, config)) as queue, closing(ServiceClients()) as clients:
            app = StudioApp(workspace, queue, clients, secrets).app
            control = AccessControl(
                app,
                secrets,
                names_server(host, made.getsockname()[1]),
                login=login_page(secrets) if password else None,
                refused=_warn,
            )
            place = address(host, made, "" if password else f"{secrets.token}/{first}")

            def opened() -> None:
                shown = open_browser and shown_in_browser(address(host, made, f"{secrets.once}/"))
                tell(f"{'the studio is open at' if shown else 'open this page in a browser:'} {place}")
                tell("Ctrl-C ends it; jobs go on, and nothing that was saved is lost")

            run(control, made, opened=opened)


def _project(workspace: Workspace, given: Path) -> str:
    """The id of the project that what the user named becomes."""
    if given.is_file():
        data = limited_file.read(given, most=MAX_PHOTO_BYTES, accepted="a PNG or JPEG image")
        return workspace.create_photo(given.name, data).id
    return workspace.create_folder(given).id


def _warn(why: str) -> None:
    """Each kind of refusal is told once in the terminal, as warnings are."""
    warnings.warn(f"the studio refused a request: {why}", F3srWarning, stacklevel=1)
