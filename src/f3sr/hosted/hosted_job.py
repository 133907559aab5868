"""One job from request to meshes: sent once, kept by its id, waited for, downloaded, checked and kept."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from f3sr.core.mesh import Mesh
from f3sr.errors import NoAnswerError
from f3sr.hosted.hosted_client import HostedClient, JobRefusedError, Telling, UnknownOutcomeError
from f3sr.hosted.hosted_service import HostedRequest, JobFailedError, JobTicket, MeshReply
from f3sr.hosted.job_files import JobFiles, JobRecord, KeptMesh, now
from f3sr.hosted.mesh_replies import checked_mesh, checked_pose
from f3sr.io.sam3d import AssetPose

UNPROCESSABLE = 422
"""Of a result: the model could not do it."""
SEND_AGAIN = "delete {} to send the request again"


@dataclass(frozen=True, eq=False, kw_only=True)
class JobMesh:
    """A checked mesh of a job, and its pose where the service gives one."""

    mesh: Mesh
    pose: AssetPose | None
    job: str
    """The job's id."""


@dataclass(frozen=True, eq=False, kw_only=True)
class HostedJob:
    """A request and what is kept of it."""

    client: HostedClient
    files: JobFiles
    request: HostedRequest
    upload: bytes | None
    """The picture, where it is uploaded first."""
    count: int
    """Objects that it is about."""
    tell: Telling

    def begun(self) -> JobRecord:
        """The record of the job: as an earlier run left it, or of a request that is sent now.

        Raises NoAnswerError; a record with an id stays."""
        with self.files.locked():
            record = self.files.record()
            if record and record.state != "sent":
                self.tell(f"job {record.id or 'of an earlier run'} is taken up again")
                return record
            if record:
                self.client.fail(
                    f"a request of {record.sent_at} had no answer and may have been paid; look into your account, "
                    + SEND_AGAIN.format(self.files.file)
                )
            try:
                return self._sent()
            except NoAnswerError as error:
                if not isinstance(error, UnknownOutcomeError) or not self.client.service.is_paid:
                    self.files.forget()
                    raise
                said = f"{error}; it may have been paid, so it is not sent again; look into your account, "
                raise UnknownOutcomeError(said + SEND_AGAIN.format(self.files.file)) from None

    def ended(self, record: JobRecord) -> list[JobMesh]:
        """The job's meshes, one per object in order: kept ones, or downloaded once the job is done."""
        if record.state == "done" and (known := self._kept(record)):
            return known
        if self.client.service.is_direct:
            return self._direct(record)
        client = replace(self.client, job=record.id)
        try:
            replies = self._waited(client, record)
        except JobFailedError as error:
            self.files.forget()
            client.fail(f"the job failed ({client.key.redacted(str(error))[:300]})")
        meshes = list[JobMesh]()
        kept = list[KeptMesh]()
        for number, reply in enumerate(replies):
            self.tell(f"downloading mesh {number + 1} of {len(replies)}")
            data = client.download(reply.url)
            mesh, pose = client.understood(lambda data=data, reply=reply: _checked(data, reply))
            kept.append(self.files.keep(f"{number}.glb", data, pose))
            meshes.append(JobMesh(mesh=mesh, pose=pose, job=record.id))
        self.files.save(record.model_copy(update={"state": "done", "meshes": kept}))
        return meshes

    # --- parts -----------------------------------------------------------------------------------------------------

    def _sent(self) -> JobRecord:
        service, client = self.client.service, self.client
        record = JobRecord(service=service.name, model=self.request.model, state="sent", sent_at=now())
        if service.is_direct:
            return record
        request = self.request
        if (token_of := service.uploaded) and (picture := self.upload):
            self.tell("uploading the picture")
            uploaded = self._free(lambda: client.upload(service.upload_path, picture))
            request = replace(request, token=client.understood(lambda: token_of(uploaded)))
        if service.is_paid and not self.files.save(record):
            client.fail(
                "nothing can be kept in the cache, so a run that is cut off would pay twice; set F3SR_CACHE_DIR"
            )
        self.tell("sending the request")
        reply = client.post_json(*service.submit(request))
        try:
            ticket = self._ticket(lambda: service.ticket(reply))
        except NoAnswerError as error:
            raise UnknownOutcomeError(str(error)) from None
        record = record.model_copy(
            update={"state": "accepted", "id": ticket.id, "poll": ticket.poll, "result": ticket.result}
        )
        self.files.save(record)
        self.tell(f"job {ticket.id} is accepted")
        return record

    def _free(self, ask: Callable[[], object]) -> object:
        """A request that costs nothing: where its outcome is unknown, nothing is lost."""
        try:
            return ask()
        except UnknownOutcomeError as error:
            raise JobRefusedError(str(error)) from None

    def _ticket(self, read: Callable[[], JobTicket]) -> JobTicket:
        ticket: JobTicket = self.client.understood(read)
        if any(map(self.client.key.is_in, (ticket.id, ticket.poll, ticket.result))):
            self.client.fail("it gives an id or a URL with the key in it")
        return ticket

    def _waited(self, client: HostedClient, record: JobRecord) -> list[MeshReply]:
        service, pause, words = client.service, client.limits.first_wait, ""
        while True:
            status, reply = client.get_json(record.poll)
            if status >= 400:
                self._gone(client, status, reply)
            state = client.understood(lambda reply=reply: service.state(reply))
            if state.words != words:
                words = state.words
                self.tell(f"job {record.id} is {words}")
            if state.stage == "done":
                break
            client.wait(pause)
            pause = min(1.5 * pause, client.limits.longest_wait)
        if record.result:
            status, reply = client.get_json(record.result)
            if status == UNPROCESSABLE:
                raise JobFailedError(str(reply))
            if status >= 400:
                self._gone(client, status, reply)
        return list(client.understood(lambda: service.read(reply, self.count)))

    def _gone(self, client: HostedClient, status: int, said: str) -> None:
        """A service that knows a job no longer will never give it: only the user may decide to pay anew."""
        more = f"; {SEND_AGAIN.format(self.files.file)}" if status in (404, 410) else ""
        client.fail(f"{said}{more}")

    def _direct(self, record: JobRecord) -> list[JobMesh]:
        client, started = self.client, time.monotonic()
        path, body = client.service.submit(self.request)
        self.tell("sending the request and waiting for the mesh")
        data = client.post_for_mesh(path, body)
        mesh, pose = client.understood(lambda: _checked(data, MeshReply(url="")))
        kept = [self.files.keep("0.glb", data, pose)]
        self.files.save(record.model_copy(update={"state": "done", "meshes": kept}))
        self.tell(f"the mesh came after {time.monotonic() - started:.0f} s")
        return [JobMesh(mesh=mesh, pose=pose, job="")]

    def _kept(self, record: JobRecord) -> list[JobMesh] | None:
        """The meshes of an earlier run; None where one of them is gone or changed."""
        files = [(kept, self.files.kept(kept)) for kept in record.meshes]
        if len(files) != self.count or any(data is None for _, data in files):
            return None
        self.tell("meshes of an earlier run are taken")
        return [
            JobMesh(
                mesh=self.client.understood(lambda kept=kept, data=data: checked_mesh(data or b"", kept.file)),
                pose=kept.pose,
                job=record.id,
            )
            for kept, data in files
        ]


def _checked(data: bytes, reply: MeshReply) -> tuple[Mesh, AssetPose | None]:
    pose = None if reply.pose is None else checked_pose(reply.pose, "object")
    return checked_mesh(data, "its mesh.glb"), pose
