"""The command for the studio: everything in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from f3sr.cli.arguments import default_shown

Given = Annotated[Positional[Path | None], arg(metavar="[PHOTO|FOLDER|PACKAGE]", help_behavior_hint=default_shown)]
Port = Annotated[int | None, arg(metavar="PORT", help_behavior_hint=default_shown)]


def studio(
    given: Given = None,
    /,
    workspace: Annotated[Path, arg(metavar="DIR")] = Path("f3sr_studio"),
    host: str = "127.0.0.1",
    port: Port = None,
    jobs: Annotated[int, arg(metavar="N")] = 1,
    open: bool = True,
) -> None:
    """From a photo to a played goal in a browser: outline objects, make the scene, mend it, play goals, take it away.

    Args:
        given: What to begin with: a photo, an input folder or a scene package. It is copied into the workspace.
        workspace: The folder that holds all projects.
        host: Address to listen on. One that other machines reach needs a password: F3SR_STUDIO_PASSWORD, or asked for.
        port: Port to listen on. Without it, that of the studio before in this workspace, or a free one.
        jobs: Jobs at a time, 1 to 16.
        open: Open the page in a browser.
    """
    from f3sr.cli import console
    from f3sr.errors import InputError
    from f3sr.runtime.extras import library
    from f3sr.studio.job_queue import QueueConfig
    from f3sr.studio.serving import serve

    if not 1 <= jobs <= 16:
        raise InputError("--jobs", found=str(jobs), accepted="1 to 16")
    for name in ("fastapi", "uvicorn"):
        library(name, extra="studio", why="the studio")
    serve(
        workspace,
        given,
        host=host,
        port=port,
        config=QueueConfig(parallel=jobs),
        open_browser=open,
        tell=console.say,
    )
