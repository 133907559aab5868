"""The studio as a web application: its pages, and what they ask of projects, scenes and jobs."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Annotated, Any

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import FileResponse, Response, StreamingResponse

from f3sr.errors import F3srError, InputError, one_line, unforeseen
from f3sr.mask_page.loopback_server import BEAT_S, json_reply
from f3sr.studio.access_control import FRAMED, FRAMES, AddressSecrets
from f3sr.studio.choices import choices
from f3sr.studio.job_options import ReconstructOptions
from f3sr.studio.job_queue import JobQueue
from f3sr.studio.job_record import SHOWN_STAGES
from f3sr.studio.project_files import ProjectFiles
from f3sr.studio.project_pictures import masks, photo, thumbnail
from f3sr.studio.service_clients import ServiceClients
from f3sr.studio.workspace import Project, Workspace
from f3sr.web.document import WEB, environment

HERE = Path(__file__).parent
PAGES = {file.name: file for file in (*sorted((HERE / "pages").iterdir()), WEB / "page.css", WEB / "view3d.js")}
"""Scripts and styles, by their name below ``pages/``."""
PICTURES = {f"{name}.png" for name in SHOWN_STAGES.values()}
"""Of a job that makes a scene."""
GOING = {
    "reconstruct": "is being made",
    "play": "plays a goal",
    "vary": "plays a goal",
    "export": "is exported",
    "certify": "is certified",
}
"""Kinds of jobs as the list of projects says that they run."""
OUTLINE_POSTS = ("open", "outline", "ground", "save", "cancel")
"""What the page that outlines objects asks for."""
KINDS = {
    ".html": "text/html; charset=utf-8",
    ".jpg": "image/jpeg",
    ".mp4": "video/mp4",
    ".png": "image/png",
    ".json": "application/json",
}
"""Media types of files that pages show; all others are bytes to be saved."""
SANDBOX = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    f"img-src 'self' data:; media-src 'self' data:; base-uri 'none'; form-action 'none'; {FRAMED}"
)
"""Policy of files of packages: their scripts run, with no origin that could ask this server for anything, and no way to
tell others what they see."""


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class FolderAsked(_Asked):
    folder: Annotated[str, Field(min_length=1, max_length=4000)]


class JobAsked(_Asked):
    kind: Annotated[str, Field(max_length=40)]
    options: dict[str, Any] = {}


class EditAsked(_Asked):
    edit: dict[str, Any]


class SegmenterAsked(_Asked):
    segmenter: Annotated[str, Field(min_length=1, max_length=200)]


class GoalAsked(_Asked):
    goal: Annotated[str, Field(max_length=2000)]


class NothingAsked(_Asked):
    pass


@dataclass(frozen=True, eq=False)
class StudioApp:
    """Routes over a workspace, its queue of jobs and the processes that serve scenes."""

    workspace: Workspace
    queue: JobQueue
    clients: ServiceClients
    secrets: AddressSecrets

    @cached_property
    def app(self) -> FastAPI:
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None, redirect_slashes=False)
        app.add_exception_handler(RequestValidationError, _misshapen)
        app.add_exception_handler(F3srError, _problem)
        app.add_exception_handler(OSError, _problem)
        app.add_exception_handler(HTTPException, _refused)
        for method, path, route in self._routes():
            app.add_api_route(path, route, methods=[method], response_model=None)
        return app

    def _routes(self) -> Iterator[tuple[str, str, Callable[..., Any]]]:
        yield "GET", "/", self.home
        yield "GET", "/pages/{name}", self.page
        yield "GET", "/projects", self.projects
        yield "POST", "/projects/photo", self.from_photo
        yield "POST", "/projects/example", self.from_example
        yield "POST", "/projects/folder", self.from_folder
        yield "GET", "/p/{id}/", self.project
        yield "GET", "/p/{id}/state", self.state
        yield "POST", "/p/{id}/delete", self.delete
        for name, drawn in (("photo", photo), ("thumb", thumbnail), ("masks", masks)):
            yield "GET", f"/p/{{id}}/{name}.jpg", self._drawn(drawn)
        yield "GET", "/p/{id}/outline/", self.outline
        yield "GET", "/p/{id}/outline/photo.jpg", self._served("outline/photo")
        yield "GET", "/p/{id}/outline/alive", self.alive
        for name in OUTLINE_POSTS:
            yield "POST", f"/p/{{id}}/outline/{name}", self._asked(f"outline/{name}")
        yield "POST", "/p/{id}/outline/segmenter", self.segment_with
        yield "GET", "/p/{id}/scene/view", self._served("view")
        yield "GET", "/p/{id}/scene/labels.png", self._served("labels")
        yield "GET", "/p/{id}/scene/state", self._served("state")
        yield "POST", "/p/{id}/scene/edits", self.edit
        for name in ("undo", "redo"):
            yield "POST", f"/p/{{id}}/scene/{name}", self._again(name)
        yield "GET", "/p/{id}/goals/menu", self._served("menu")
        yield "POST", "/p/{id}/goals/understand", self.understand
        yield "POST", "/p/{id}/jobs", self.begin
        yield "GET", "/p/{id}/jobs/{job}", self.follow
        yield "POST", "/p/{id}/jobs/{job}/cancel", self.cancel
        yield "GET", "/p/{id}/jobs/{job}/pictures/{name}", self.picture
        yield "GET", "/p/{id}/rollouts", self.rollouts
        yield "GET", "/p/{id}/rollouts/{number}/film.png", self.strip
        yield "GET", "/p/{id}/rollouts/{number}/film.mp4", self.film
        yield "GET", "/p/{id}/{name}.zip", self.zipped
        yield "GET", f"/{FRAMES}{{id}}/{{path:path}}", self.framed

    # --- pages -----------------------------------------------------------------------------------------------------

    def home(self) -> Response:
        return _html(environment(HERE / "templates").get_template("home.html").render(root=""))

    def project(self, id: str) -> Response:
        name = self.workspace.project(id).name
        return _html(environment(HERE / "templates").get_template("project.html").render(root="../../", name=name))

    def page(self, name: str) -> Response:
        if name not in PAGES:
            raise InputError("the page", found=name[:60], accepted=", ".join(PAGES))
        kind = "text/css" if name.endswith(".css") else "text/javascript"
        return _answer(PAGES[name].read_bytes(), f"{kind}; charset=utf-8")

    # --- projects --------------------------------------------------------------------------------------------------

    def projects(self) -> dict[str, Any]:
        return {"projects": [ProjectFiles(p).summary() | {"job": self._going(p)} for p in self.workspace.listed()]}

    def _going(self, project: Project) -> str:
        """What is being done in a project, in words."""
        with suppress(InputError):  # a damaged record hides no project
            return next((GOING[job.record.kind] for job in self.queue.going(project)), "")
        return ""

    async def from_photo(self, request: Request, name: str = "photo") -> dict[str, str]:
        data = await request.body()
        return {"id": (await run_in_threadpool(lambda: self.workspace.create_photo(name[:200], data))).id}

    def from_example(self, asked: NothingAsked) -> dict[str, str]:
        return {"id": self.workspace.create_example().id}

    def from_folder(self, asked: FolderAsked) -> dict[str, str]:
        return {"id": self.workspace.create_folder(Path(asked.folder)).id}

    def state(self, id: str) -> dict[str, Any]:
        files = self._files(id)
        jobs = [job.told() for job in self.queue.jobs(files.project)]
        framed = f"/{self.secrets.framed}/{FRAMES}{files.project.id}/"
        return files.state() | {"jobs": jobs, "framed": framed, "choices": self.choices}

    def delete(self, id: str, asked: NothingAsked) -> dict[str, Any]:
        project = self.workspace.found(id)
        self.queue.cancel_all(project)
        self.clients.end(project.folder)
        self.workspace.delete(id)
        return {}

    # --- the project's process ---------------------------------------------------------------------------------------

    def segment_with(self, id: str, asked: SegmenterAsked) -> Response:
        answer = self._call(id, "outline/segmenter", asked.model_dump_json().encode())
        if answer.status_code == HTTPStatus.OK:
            self.workspace.keep_segmenter(self.workspace.project(id), asked.segmenter)
        return answer

    def edit(self, id: str, asked: EditAsked) -> Response:
        return self._call(id, "edit", json.dumps(asked.model_dump()).encode())

    def understand(self, id: str, asked: GoalAsked) -> Response:
        return self._call(id, "understand", json.dumps(asked.model_dump()).encode())

    def outline(self, id: str) -> Response:
        """The page that outlines objects: a document with a policy of its own."""
        answer = self._call(id, "outline")
        answer.headers["Content-Security-Policy"] = FRAMED
        return answer

    def alive(self, id: str) -> Response:
        """An open connection, which tells the page that the studio is there."""
        self.workspace.project(id)
        return StreamingResponse(_beats(), media_type="text/plain")

    def _served(self, name: str) -> Callable[..., Response]:
        def answer(id: str) -> Response:
            return self._call(id, name)

        return answer

    def _drawn(self, draw: Callable[[Project], bytes]) -> Callable[..., Response]:
        def answer(id: str) -> Response:
            return _answer(draw(self.workspace.project(id)), "image/jpeg")

        return answer

    def _again(self, name: str) -> Callable[..., Response]:
        def answer(id: str, asked: NothingAsked) -> Response:
            return self._call(id, name)

        return answer

    def _asked(self, name: str) -> Callable[..., Any]:
        async def answer(id: str, request: Request) -> Response:
            body = await request.body()
            return await run_in_threadpool(lambda: self._call(id, name, body))

        return answer

    def _call(self, id: str, name: str, body: bytes = b"") -> Response:
        reply = self.clients.call(self.workspace.project(id).folder, name, body)
        return _answer(reply.body, reply.kind, reply.status)

    # --- jobs --------------------------------------------------------------------------------------------------------

    def begin(self, id: str, asked: JobAsked) -> dict[str, Any]:
        project = self.workspace.project(id)
        if asked.kind != ReconstructOptions.kind:  # which makes the package anew, from the list of edits
            self._written(project)
        job = self.queue.submit(project, asked.kind, asked.options)
        if asked.kind == ReconstructOptions.kind:
            self.workspace.keep_options(project, asked.options)
        return job.told()

    def follow(self, id: str, job: str, after: int = 0) -> dict[str, Any]:
        """How a job stands, and its events from number ``after`` on."""
        found = self.queue.job(self.workspace.project(id), job)
        told = found.told()  # before its events: nothing is added to those of a job that has ended
        return told | {"events": found.events(after)}

    def cancel(self, id: str, job: str, asked: NothingAsked) -> dict[str, Any]:
        found = self.queue.job(self.workspace.project(id), job)
        self.queue.cancel(found)
        return found.told()

    def picture(self, id: str, job: str, name: str) -> Response:
        pictures = self.queue.job(self.workspace.project(id), job).pictures
        if name not in PICTURES or not (pictures / name).is_file():
            raise InputError("the picture", found=name[:60], accepted="one that the job has told of")
        return _file(pictures / name)

    # --- files -------------------------------------------------------------------------------------------------------

    def rollouts(self, id: str) -> dict[str, Any]:
        return {"rollouts": self._files(id).rollouts()}

    def strip(self, id: str, number: int) -> Response:
        return _file(self._files(id).strip(number))

    def film(self, id: str, number: int) -> Response:
        return _file(self._files(id).film(number))

    def zipped(self, id: str, name: str) -> Response:
        """A package with all its edits, or an export, as a ZIP file that is made while it is sent."""
        files = self._files(id)
        if name == "package":
            self._written(files.project)
        called, parts = files.zipped(name)
        headers = {"Content-Disposition": f'attachment; filename="{called}"'}
        return StreamingResponse(parts, media_type="application/zip", headers=headers)

    def framed(self, id: str, path: str) -> Response:
        """A file of a package for a frame: it may come from others, so it has no rights here."""
        answer = _file(self._files(id).inside(path))
        answer.headers["Content-Security-Policy"] = SANDBOX
        answer.headers["Cross-Origin-Resource-Policy"] = "cross-origin"
        return answer

    def _files(self, id: str) -> ProjectFiles:
        return ProjectFiles(self.workspace.project(id))

    def _written(self, project: Project) -> None:
        """Have the package hold all edits before it is read. Raises F3srError where it cannot."""
        reply = self.clients.call(project.folder, "saved")
        if reply.status != HTTPStatus.OK:
            raise F3srError(json.loads(reply.body)["problem"])

    @cached_property
    def choices(self) -> dict[str, list[dict[str, Any]]]:
        """Back ends, formats and engines, as ``f3sr doctor`` finds them."""
        return choices()


async def _beats() -> AsyncIterator[bytes]:
    """A sign of life every ``BEAT_S``, until the page goes."""
    while True:
        yield b"."
        await asyncio.sleep(BEAT_S)


def _html(page: str) -> Response:
    return _answer(page.encode(), "text/html; charset=utf-8")


def _answer(body: bytes, kind: str, status: int = 200) -> Response:
    return Response(body, status_code=status, headers={"Content-Type": kind})


def _file(file: Path) -> Response:
    return FileResponse(file, media_type=KINDS.get(file.suffix, "application/octet-stream"))


def _problem(request: Request, error: Exception) -> Response:
    """One line about what went wrong."""
    status = HTTPStatus.UNPROCESSABLE_ENTITY if isinstance(error, InputError) else HTTPStatus.CONFLICT
    line = str(error) if isinstance(error, F3srError) else unforeseen(error, "what was saved is still there")
    return _line(status, line)


def _misshapen(request: Request, error: Any) -> Response:
    """A request that no page sends."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"] if part != "body") or "the request"
    return _line(HTTPStatus.UNPROCESSABLE_ENTITY, f"{place}: {first['msg']}")


def _refused(request: Request, error: Any) -> Response:
    """A path that no page has, or a body that is no JSON."""
    return _line(HTTPStatus(error.status_code), str(error.detail))


def _line(status: HTTPStatus, line: str) -> Response:
    reply = json_reply({"problem": one_line(line)}, status=int(status))
    return _answer(reply.body, reply.kind, reply.status)
