"""What a job may be asked to do: one typed record a kind, hostile until it is checked."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from f3sr.errors import InputError
from f3sr.files import strict_json
from f3sr.io.photo_hints import PhotoHints, known_of

Name = Annotated[str, Field(min_length=1, max_length=200)]
Positive = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
Slow = Annotated[float, Field(ge=1, le=8, allow_inf_nan=False)]
MOST_NAMES = 40
"""Formats or engines of one job: more than there are."""


class JobOptions(BaseModel):
    """Of any job."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: ClassVar[str]


class ReconstructOptions(JobOptions):
    """From the project's input folder to its package; the project's edits are applied again."""

    kind = "reconstruct"
    geometry: Name | None = None
    assets: Name | None = None
    background: Name | None = None
    known: Annotated[str, Field(max_length=2000)] = ""
    """Known lengths [m], as for ``f3sr reconstruct --known``."""
    focal: Positive | None = None
    """Focal length [px] of the upright photo."""
    camera_height: Positive | None = None
    """Of the camera above what the objects stand on [m]."""

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        """Lengths that no scene has are refused before anything is begun."""
        PhotoHints(focal=self.focal, camera_height=self.camera_height, known=known_of(self.known))
        return self


class PlayOptions(JobOptions):
    """A goal in words played and filmed."""

    kind = "play"
    goal: Annotated[str, Field(min_length=1, max_length=500)]
    slow: Slow = 1.0
    model: Name | None = None
    """Language model that plans instead of the rules, as openai:NAME; its key is in the environment."""
    samples: Annotated[int, Field(ge=0, le=100)] = 0
    """Also played in so many samples of the scene."""


class VaryOptions(JobOptions):
    """The plan of a rollout played another way."""

    kind = "vary"
    rollout: Annotated[int, Field(ge=1, lt=10**6)]
    speed: Annotated[float, Field(ge=0.1, le=3, allow_inf_nan=False)] = 1.0
    """Factor on the launch."""
    turn: Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)] = 0.0
    """Turn of the launch about the vertical [degrees]."""
    slow: Slow = 1.0


class ExportOptions(JobOptions):
    """The package in other formats."""

    kind = "export"
    formats: Annotated[list[Name], Field(min_length=1, max_length=MOST_NAMES)]


class CertifyOptions(JobOptions):
    """The package in other engines and validators."""

    kind = "certify"
    engines: Annotated[list[Name], Field(min_length=1, max_length=MOST_NAMES)]


KINDS: dict[str, type[JobOptions]] = {
    kind.kind: kind for kind in (ReconstructOptions, PlayOptions, VaryOptions, ExportOptions, CertifyOptions)
}


def options_of(kind: str, given: dict[str, Any]) -> JobOptions:
    """The checked options of a job. Raises InputError."""
    if kind not in KINDS:
        raise InputError("the job", found=kind[:60], accepted=", ".join(KINDS))
    try:
        return KINDS[kind].model_validate(given)
    except ValidationError as error:
        found, wanted = strict_json.problem(error, ", ".join(KINDS[kind].model_fields))
        raise InputError(f"the job {kind}", found=found, accepted=wanted) from None
