"""A studio's server in this process, over a workspace of its own, asked over a real socket."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any

from f3sr.studio import web_server
from f3sr.studio.access_control import AccessControl, AddressSecrets
from f3sr.studio.job_queue import JobQueue, QueueConfig
from f3sr.studio.service_clients import ServiceClients
from f3sr.studio.studio_app import StudioApp
from f3sr.studio.workspace import Workspace
from waiting import soon


@dataclass(eq=False)
class StudioServer:
    """What a page of the studio can ask."""

    port: int
    secrets: AddressSecrets
    workspace: Workspace
    clients: ServiceClients

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/{self.secrets.token}/"

    def get(self, path: str, *, word: str = "") -> tuple[int, bytes, HTTPResponse]:
        """Status, body and the answer with its headers."""
        return self._asked("GET", path, None, {}, word)

    def post(self, path: str, value: Any = None, *, data: bytes | None = None) -> tuple[int, Any]:
        """Status, and the answer as JSON where it is some."""
        if data is None:
            return self.post_text(path, json.dumps({} if value is None else value))
        return self._posted(path, data, "application/octet-stream")

    def post_text(self, path: str, text: str) -> tuple[int, Any]:
        """The same of a text that need not be JSON."""
        return self._posted(path, text.encode(), "application/json")

    def _posted(self, path: str, body: bytes, kind: str) -> tuple[int, Any]:
        status, answer, _ = self._asked("POST", path, body, {"Content-Type": kind}, "")
        try:
            return status, json.loads(answer)
        except ValueError:
            return status, answer

    def state(self, path: str) -> Any:
        status, answer, _ = self.get(path)
        assert status == 200, answer
        return json.loads(answer)

    def _asked(
        self, method: str, path: str, body: bytes | None, headers: dict[str, str], word: str
    ) -> tuple[int, bytes, HTTPResponse]:
        with closing(HTTPConnection("127.0.0.1", self.port, timeout=60)) as connection:
            given = {"Origin": f"http://127.0.0.1:{self.port}", **headers} if method == "POST" else headers
            connection.request(method, f"/{word or self.secrets.token}/{path}", body, given)
            answer = connection.getresponse()
            return answer.status, answer.read(), answer


@contextmanager
def studio(folder: Path, config: QueueConfig | None = None) -> Iterator[StudioServer]:
    """A server over the workspace of a folder, until the block ends."""
    made, secrets = web_server.listening("127.0.0.1", None, folder)
    port = made.getsockname()[1]
    with (
        closing(Workspace(folder)) as workspace,
        closing(made),
        closing(JobQueue(workspace, config)) as queue,
        closing(ServiceClients()) as clients,
    ):
        app = StudioApp(workspace, queue, clients, secrets).app
        server = web_server.server_of(AccessControl(app, secrets, web_server.names_server("127.0.0.1", port)))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [made]}, daemon=True)
        thread.start()
        assert soon(lambda: server.started)
        yield StudioServer(port, secrets, workspace, clients)
        server.should_exit = True
        thread.join(10)
