"""Producers of meshes by services: ``fal-sam3d``, ``fal-trellis2``, ``replicate`` and others."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from f3sr.backends.model_choice import ModelChoice, Need
from f3sr.backends.protocols import ProducedMesh, PromptedImage
from f3sr.core.transforms import Array
from f3sr.errors import InputError, cut, printable
from f3sr.hosted.cut_outs import cut_out_png, data_uri_of, mask_png, photo_jpeg
from f3sr.hosted.hosted_client import HostedClient, HostedLimits, Telling, require_address
from f3sr.hosted.hosted_job import HostedJob, JobMesh
from f3sr.hosted.hosted_service import HostedRequest, HostedService
from f3sr.hosted.job_files import FORMAT, JobFiles, tidy_jobs
from f3sr.hosted.service_key import ServiceKey, service_key
from f3sr.runtime import signals
from f3sr.runtime.result_store import digest
from f3sr.scene import Geometry, Instance, Photo

GO_ON = "jobs that were accepted are kept; the same command takes them up without paying again"


def _silent(words: str) -> None:
    del words


@dataclass(frozen=True, eq=False, kw_only=True)
class HostedProducer:
    """Meshes by one service. It costs what the service charges; docs/hosted.md says what leaves the machine."""

    service: HostedService
    limits: HostedLimits = field(default_factory=HostedLimits)
    tell: Telling = _silent
    """Told a line per change of a job's state."""

    @property
    def provenance(self) -> Mapping[str, str]:
        """Service, model and licence, for the report."""
        return {"service": self.service.name, "model": self.service.model, "licence": self.service.licence}

    def telling(self, tell: Telling) -> HostedProducer:
        """The producer that tells what it is at."""
        return replace(self, tell=tell)

    def needs(self) -> tuple[Need, ...]:
        """The key, or the address; nothing is sent to find out."""
        service = self.service
        if not service.key_variable:
            remedy = f"--assets {service.name}:http://HOST:PORT"
            return (Need(what="address", met=bool(service.base_url), found=service.base_url or "none", remedy=remedy),)
        try:
            service_key(service.key_variable)
        except InputError as error:
            return (Need(what="key", met=False, found=error.found, remedy=f"export {service.key_variable}=..."),)
        return (Need(what="key", met=True, found=f"in ${service.key_variable}"),)

    def produce(self, image: PromptedImage, geometry: Geometry, K: Array) -> Mapping[int, ProducedMesh]:
        """One mesh per instance, by its id; geometry and K are not sent.

        Raises InputError without a key or an address, NoAnswerError where any mesh does not come."""
        del geometry, K
        key = service_key(self.service.key_variable)
        require_address(self.service, key)
        if not image.instances:
            return {}
        jobs = list(self._jobs(image, key))
        try:
            signals.keeps(GO_ON)
            records = [job.begun() for _, job in jobs]
            made = [(them, job.ended(record)) for (them, job), record in zip(jobs, records, strict=True)]
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"{self.service.name}: interrupted; {GO_ON}") from None
        tidy_jobs()
        return {
            instance.id: self._produced(mesh)
            for them, meshes in made
            for instance, mesh in zip(them, meshes, strict=True)
        }

    def _jobs(self, image: PromptedImage, key: ServiceKey) -> Iterator[tuple[Sequence[Instance], HostedJob]]:
        """The instances of every job, and the job."""
        service = self.service
        end = time.monotonic() + self.limits.deadline
        client = HostedClient(service=service, key=key, limits=self.limits, end=end)
        groups = [image.instances] if service.whole_photo else [(instance,) for instance in image.instances]
        photo_digest = _photo_digest(image.photo)
        for number, them in enumerate(groups, start=1):
            upload = None
            if service.whole_photo:
                pictures = self._scene(image.photo, them)
            else:
                upload = self._cut_out(image.photo, them[0])
                pictures = [data_uri_of(upload, "image/png")]
            request = HostedRequest(model=service.model, pictures=pictures)
            who = f"{len(them)} objects" if service.whole_photo else f"{number} of {len(groups)}, {_name(them[0])}"
            yield (
                them,
                HostedJob(
                    client=client,
                    files=JobFiles.of(service.name, self._digest(request, photo_digest, them)),
                    request=request,
                    upload=upload if service.upload_path else None,
                    count=len(them),
                    tell=lambda words, who=who: self.tell(f"{service.name}: {who}: {words}"),
                ),
            )

    def _scene(self, photo: Photo, them: Sequence[Instance]) -> list[str]:
        jpeg, size = photo_jpeg(photo.rgb, longest=self.service.longest_side)
        masks = [data_uri_of(mask_png(instance.mask, size), "image/png") for instance in them]
        return [data_uri_of(jpeg, "image/jpeg"), *masks]

    def _cut_out(self, photo: Photo, instance: Instance) -> bytes:
        service = self.service
        return cut_out_png(
            photo.rgb,
            instance.mask,
            least=service.least_side,
            longest=service.longest_side,
            most_bytes=service.most_picture_bytes,
        )

    def _digest(self, request: HostedRequest, photo_digest: str, them: Sequence[Instance]) -> str:
        """Of all that is asked for: the request without its pictures, and the pixels that these are made of."""
        service = self.service
        plain = service.submit(replace(request, pictures=[""] * len(request.pictures)))
        sizes = (service.least_side, service.longest_side, service.most_picture_bytes)
        masks = [hashlib.sha256(np.packbits(i.mask).tobytes()).hexdigest() for i in them]
        return digest(FORMAT, service.name, service.base_url, request.model, plain, sizes, photo_digest, masks)

    def _produced(self, made: JobMesh) -> ProducedMesh:
        facts = ", ".join(f"{name} {value}" for name, value in self.provenance.items() if value)
        return ProducedMesh(
            mesh=made.mesh,
            up=self.service.up,
            pose=None if made.pose is None else made.pose.given,
            told=facts + (f", request {made.job}" if made.job else ""),
        )


@dataclass(frozen=True, eq=False)
class ProducerMaker:
    """Makes the producer of a service for what the user says after the colon: a model, or an address."""

    service: HostedService
    takes_model = True

    def __call__(self, choice: ModelChoice) -> HostedProducer:
        """InputError for a model's name or an address that cannot be one."""
        service, said = self.service, choice.model
        if not said:
            return HostedProducer(service=service)
        if not service.key_variable:
            service = replace(service, base_url=said.rstrip("/"))
            require_address(service, ServiceKey())
            return HostedProducer(service=service)
        if len(said) > 200 or not service.model_form.fullmatch(said):
            accepted = "letters, digits and - _ . /, as owner/name; owner/name:VERSION@FIELD for replicate"
            raise InputError(f"model of {service.name}", found=cut(repr(said)), accepted=accepted)
        return HostedProducer(service=replace(service, model=said))


def _name(instance: Instance) -> str:
    return printable(instance.label or instance.name)


def _photo_digest(photo: Photo) -> str:
    return hashlib.sha256(repr(photo.rgb.shape).encode() + photo.rgb.tobytes()).hexdigest()
