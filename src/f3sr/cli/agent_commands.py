"""The commands for agents: mcp."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

RootFolder = Annotated[Path, arg(metavar="FOLDER")]


def mcp(root: RootFolder) -> None:
    """Serve scenes as tools of the Model Context Protocol, over standard input and output. Needs the extra llm.

    Args:
        root: The one folder in which agents may read and write.
    """
    from f3sr.mcp_server.allowed_root import AllowedRoot
    from f3sr.mcp_server.scene_tools import SceneTools
    from f3sr.mcp_server.server import make_server

    make_server(SceneTools(AllowedRoot.of(root))).run("stdio")
